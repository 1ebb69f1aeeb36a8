//! Bounds of the hazard table on the whole gripper in virtual time: force on a hand, RELEASE under faults, parts that stay
//! gripped. `cargo acceptance fault-campaign` draws more of each.

use rayon::prelude::*;
use sim::closed_loop::DisabledProtection;
use sim::drivetrain::parameters::Lead;
use sim::faults::contact_force::{ContactCase, ObstructedMotion};
use sim::faults::hazards::HazardTable;
use sim::faults::injection::InjectedFault;
use sim::faults::opening::{OpeningCase, StartState};
use sim::faults::retention::{RetentionCase, StopCause};

use crate::nominal_tables;

/// Random grippers of each motion.
const DRAWS: u64 = 8;
/// Worst grippers of a thousand: a rotor with much energy, and a backdrivable screw that something around the fingers pushes
/// back.
const WORST: [(ObstructedMotion, u64); 5] = [
    (ObstructedMotion::UncalibratedMove, 90),
    (ObstructedMotion::UncalibratedMove, 184),
    (ObstructedMotion::UncalibratedMove, 624),
    (ObstructedMotion::ReleaseWithoutSensors, 155),
    (ObstructedMotion::ReleaseWithoutSensors, 458),
];

/// Descriptions of the failed ones.
fn failures<C: Sync + std::fmt::Debug>(
    cases: &[C],
    failure: impl Fn(&C) -> Option<String> + Sync,
) -> String {
    let failed = cases.par_iter().filter_map(|case| Some(format!("{case:?}: {}", failure(case)?)));
    failed.collect::<Vec<_>>().join("\n")
}

#[test]
fn hand_is_pressed_with_at_most_60_n_outside_of_a_grip() {
    let tables = nominal_tables();
    let cases: Vec<ContactCase> = ObstructedMotion::ALL
        .into_iter()
        .flat_map(|motion| (1..=DRAWS).map(move |seed| (motion, seed)))
        .chain(WORST)
        .map(|(motion, seed)| ContactCase::draw(motion, seed))
        .collect();
    let limit_n = HazardTable::gripper().bounds().hand_n;
    assert_eq!(limit_n, 60.0);
    let failed = failures(&cases, |case| match case.run(tables, None) {
        Some(peak_n) if (1.0..=limit_n).contains(&peak_n) => None,
        peak_n => Some(format!("{peak_n:?}")),
    });
    assert!(failed.is_empty(), "{failed}");
}

#[test]
fn hand_is_pressed_harder_without_each_protection() {
    let tables = nominal_tables();
    let limit_n = HazardTable::gripper().bounds().hand_n;
    let failed = failures(&ObstructedMotion::ALL, |motion| {
        let mut cases = (1..=4).map(|seed| ContactCase::draw(*motion, seed));
        let is_exceeded = cases.any(|case| {
            case.run(tables, Some(motion.disable())).is_some_and(|peak_n| peak_n > limit_n)
        });
        (!is_exceeded).then(|| "within the limit".to_owned())
    });
    assert!(failed.is_empty(), "{failed}");
}

#[test]
fn release_opens_by_10_mm_within_3_s_under_every_fault() {
    let tables = nominal_tables();
    let (least_mm, _) = HazardTable::gripper().bounds().opens;
    // Every other case: the screws alternate over faults and states.
    let cases: Vec<OpeningCase> = OpeningCase::all(1).into_iter().step_by(2).collect();
    let failed = failures(&cases, |case| {
        let outcome = case.run(tables, None);
        let is_open = outcome.was_reached && outcome.opened_mm >= least_mm;
        (!is_open).then(|| format!("{outcome:?}"))
    });
    assert!(failed.is_empty(), "{failed}");
}

#[test]
fn gripped_part_is_not_dropped_by_a_stop() {
    let tables = nominal_tables();
    let cases: Vec<RetentionCase> = StopCause::ALL
        .into_iter()
        .flat_map(|cause| (1..=8).map(move |seed| RetentionCase::draw(cause, seed)))
        .collect();
    let least = HazardTable::gripper().bounds().kept_share;
    let failed = failures(&cases, |case| match case.run(tables, None) {
        Some(share) if share >= least => None,
        share => Some(format!("{share:?}")),
    });
    assert!(failed.is_empty(), "{failed}");
}

#[test]
fn backdrivable_screw_declared_self_locking_drops_the_part() {
    let tables = nominal_tables();
    let drawn = RetentionCase::draw(StopCause::Frame, 1);
    let case = RetentionCase { lead: Lead::B, set_n: 200.0, ..drawn };
    let share = case.run(
        tables,
        Some(|setup| {
            setup.disabled = Some(DisabledProtection::Backdrivability);
        }),
    );
    let least = HazardTable::gripper().bounds().kept_share;
    assert!(share.is_some_and(|share| share < least), "{share:?}");
}

#[test]
fn release_without_sensors_needs_current() {
    let tables = nominal_tables();
    let (least_mm, _) = HazardTable::gripper().bounds().opens;
    let cases = OpeningCase::all(1).into_iter().filter(|case| {
        case.fault == InjectedFault::AllSensorsGone && case.state == StartState::Armed
    });
    for case in cases {
        let outcome = case.run(tables, Some(|setup| setup.grasp.blind_a = 0.1));
        assert!(outcome.was_reached && outcome.opened_mm < least_mm, "{case:?}: {outcome:?}");
    }
}
