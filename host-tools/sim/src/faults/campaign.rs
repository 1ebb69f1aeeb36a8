//! Fault campaign: all faults in all operating states, the bounds of the hazard table, and the false alarms without faults,
//! on all cores.

use crate::closed_loop::grasp_result::GraspResult;
use crate::closed_loop::grasp_rig::{contact_object, grip_command};
use crate::closed_loop::requirements::quantile;
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::fingertips::Impact;
use crate::drivetrain::parameters::Lead;
use crate::faults::contact_force::{ContactCase, ObstructedMotion};
use crate::faults::hazards::HazardTable;
use crate::faults::injection::InjectedFault;
use crate::faults::opening::OpeningCase;
use crate::faults::operating_state::{OperatingState, motion};
use crate::faults::retention::{RetentionCase, StopCause};
use crate::faults::run::{FaultCase, FaultOutcome};
use crate::random::{Purpose, stream};
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TaskState};
use firmware::protocol::messages::Command;
use firmware::system::faults::Event;
use model_export::inverse::quantise::TableSet;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Contact stiffnesses in N/mm.
pub const CONTACTS: [f64; 3] = [333.0, 50.0, 20.0];

/// All cases of `seeds` seeds from `first` on; one stiffness where nothing is gripped.
pub fn cases(first: u64, seeds: u64) -> Vec<FaultCase> {
    let mut cases = Vec::new();
    for fault in InjectedFault::ALL {
        for &state in fault.specification().states {
            // The backdrive test needs a stiff part.
            let is_gripped = state.has_object()
                && !matches!(state, OperatingState::Approach | OperatingState::Calibrating);
            let contacts = if is_gripped { &CONTACTS[..] } else { &CONTACTS[..1] };
            for lead in Lead::BOTH {
                for &contact_n_per_mm in contacts {
                    cases.extend((first..first + seeds).map(|seed| FaultCase {
                        fault,
                        state,
                        lead,
                        contact_n_per_mm,
                        seed,
                    }));
                }
            }
        }
    }
    cases
}

/// Runs cases on all cores; `done` is called after each.
pub fn run(
    cases: &[FaultCase],
    tables: &TableSet,
    done: impl Fn() + Sync,
) -> Vec<(FaultCase, FaultOutcome)> {
    let one = |case: &FaultCase| {
        let outcome = case.run(tables, None);
        done();
        (*case, outcome)
    };
    cases.par_iter().map(one).collect()
}

/// Statistics of one fault in one operating state.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultSummary {
    /// Injected fault.
    pub fault: InjectedFault,
    /// Operating state.
    pub state: OperatingState,
    /// Number of runs.
    pub runs: usize,
    /// Number of runs with detection.
    pub found: usize,
    /// Detection latency in ms: median, 99th percentile, maximum.
    pub latency_ms: [f64; 3],
    /// Peak true force after the fault, in N.
    pub peak_n: f64,
    /// Its bound by the hazard table ([`FaultCase::max_n`]), in N.
    pub max_n: Option<f64>,
    /// Number of runs with the specified final state.
    pub specified: usize,
    /// Number of transitions outside the state tables.
    pub forbidden: u32,
    /// Number of runs within the bounds of the hazard table.
    pub bounded: usize,
    /// Final states with their counts.
    pub ends: Vec<(u8, usize)>,
}

impl FaultSummary {
    fn of(
        fault: InjectedFault,
        state: OperatingState,
        outcomes: &[&(FaultCase, FaultOutcome)],
    ) -> Self {
        let mut latencies: Vec<f64> = outcomes.iter().filter_map(|(_, o)| o.found_ms).collect();
        latencies.sort_by(f64::total_cmp);
        let mut ends: Vec<(u8, usize)> = Vec::new();
        for (_, outcome) in outcomes {
            match ends.iter_mut().find(|(end, _)| *end == outcome.end) {
                Some((_, count)) => *count += 1,
                None => ends.push((outcome.end, 1)),
            }
        }
        ends.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let count = |condition: &dyn Fn(&FaultCase, &FaultOutcome) -> bool| {
            let counted = outcomes.iter().filter(|(case, outcome)| condition(case, outcome));
            counted.count()
        };
        Self {
            fault,
            state,
            runs: outcomes.len(),
            found: latencies.len(),
            latency_ms: [0.5, 0.99, 1.0].map(|share| quantile(&latencies, share)),
            peak_n: outcomes.iter().map(|(_, o)| o.peak_n).fold(0.0, f64::max),
            max_n: outcomes.first().and_then(|(case, _)| case.max_n()),
            specified: count(&|_, outcome| outcome.is_as_specified),
            forbidden: outcomes.iter().map(|(_, o)| o.forbidden).sum(),
            bounded: count(&FaultCase::is_bounded),
            ends,
        }
    }

    /// Always detected in time by its detector, within the bounds, with the specified final state and no forbidden transition.
    pub fn is_met(&self) -> bool {
        let [_, p99_ms, _] = self.latency_ms;
        self.found == self.runs
            && self.specified == self.runs
            && p99_ms <= self.fault.specification().within_ms
            && self.forbidden == 0
            && self.bounded == self.runs
    }

    /// Final states as text, the most frequent first.
    pub fn ends_words(&self) -> String {
        let one = |(end, count): &(u8, usize)| match self.ends.len() {
            1 => state_name(*end),
            _ => format!("{} {count}", state_name(*end)),
        };
        self.ends.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

/// Readable name of a heartbeat code.
fn state_name(code: u8) -> String {
    match (PowerState::of_code(code), TaskState::of_code(code)) {
        (_, Some(task)) => GraspResult::state_name((PowerState::Enabled, task)),
        (Some(power), None) => GraspResult::state_name((power, TaskState::Idle)),
        (None, None) => code.to_string(),
    }
}

/// Statistics of each fault in each operating state.
pub fn summarize(outcomes: &[(FaultCase, FaultOutcome)]) -> Vec<FaultSummary> {
    let mut summaries = Vec::new();
    for fault in InjectedFault::ALL {
        for &state in fault.specification().states {
            let matching: Vec<_> = outcomes
                .iter()
                .filter(|(case, _)| case.fault == fault && case.state == state)
                .collect();
            if !matching.is_empty() {
                summaries.push(FaultSummary::of(fault, state, &matching));
            }
        }
    }
    summaries
}

/// Simulated seconds of one gripper in fault-free motion.
const SECONDS: f64 = 60.0;

/// False alarms of fault-free runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FalseAlarms {
    /// Simulated hours.
    pub hours: f64,
    /// Number of reported faults.
    pub alarms: usize,
}

/// Simulates grippers that move, grip, release, land on the ground and rest in random order, one minute each.
pub fn run_fault_free(
    first: u64,
    hours: f64,
    tables: &TableSet,
    done: impl Fn() + Sync,
) -> FalseAlarms {
    let minutes: Vec<(f64, usize)> = (0..fault_free_minutes(hours))
        .into_par_iter()
        .map(|index| {
            let minutes = minute(index, first + index as u64, tables);
            done();
            minutes
        })
        .collect();
    minutes.iter().fold(FalseAlarms::default(), |sum, (seconds, alarms)| FalseAlarms {
        hours: sum.hours + seconds / 3600.0,
        alarms: sum.alarms + alarms,
    })
}

/// Number of one-minute runs for a number of hours.
pub fn fault_free_minutes(hours: f64) -> usize {
    (3600.0 * hours / SECONDS).ceil() as usize
}

/// Simulated seconds and false alarms of one run; a motion that does not end counts as an alarm.
fn minute(index: usize, seed: u64, tables: &TableSet) -> (f64, usize) {
    let setup = ClosedLoopSetup {
        opening_mm: 60.0,
        ..ClosedLoopSetup::scattered(Lead::BOTH[index % 2], seed)
    };
    let mut cell = ClosedLoop::new(&setup, tables);
    let mut rng = stream(seed, Purpose::FaultInjection, MIXED_MOTION_DRAW);
    if !cell.enable() {
        return (0.0, 1);
    }
    let mut stuck = 0;
    while 1e-6 * (cell.time_us() as f64) < SECONDS {
        let has_ended = match rng.random_range(0..4) {
            0 => Some(()),
            1 => move_to(&mut cell, rng.random_range(5.0..75.0), rng.random_range(5.0..58.0)),
            2 => grip(&mut cell, &setup, &mut rng),
            _ => land(&mut cell, &mut rng),
        };
        if has_ended.is_none() {
            stuck = 1;
            break;
        }
        cell.run(rng.random_range(0.2..2.0));
    }
    let events = cell.board.events.borrow();
    let alarms = events
        .iter()
        .filter(|(_, event)| matches!(event, Event::Fault(fault) if fault.active != 0));
    (1e-6 * cell.time_us() as f64, alarms.count() + stuck)
}

/// Random stream of the order of motions.
const MIXED_MOTION_DRAW: u32 = u32::MAX - 1;
/// Time-out of a motion in s: the stroke at the lowest speed.
const MOTION_S: f64 = 20.0;

fn move_to(cell: &mut ClosedLoop, opening_mm: f64, speed_mm_s: f64) -> Option<()> {
    cell.host.order(motion(mode::MOVE, opening_mm, speed_mm_s));
    cell.run(0.05);
    cell.until(MOTION_S, |cell| cell.is_in(TaskState::Idle)).map(|_| ())
}

/// Grips an object of random width, stiffness, force and contact point, and releases it.
fn grip(cell: &mut ClosedLoop, setup: &ClosedLoopSetup, rng: &mut ChaCha8Rng) -> Option<()> {
    let set_n: f64 = rng.random_range(10.0..100.0);
    let contact_n_per_mm = CONTACTS[rng.random_range(0..CONTACTS.len())];
    let width_mm: f64 = rng.random_range(15.0..50.0);
    move_to(cell, width_mm + 10.0, 40.0)?;
    let object = contact_object(&setup.plant, width_mm, contact_n_per_mm);
    {
        let mut gripper = cell.gripper.borrow_mut();
        gripper.towards_first = rng.random_range(-0.8..0.8);
        gripper.rig.plant.set_object(Some(&object));
    }
    cell.host.order(grip_command(set_n));
    cell.until(MOTION_S, |cell| cell.is_in(TaskState::HoldActive))?;
    cell.run(rng.random_range(0.5..3.0));
    cell.host.order(motion(mode::RELEASE, width_mm + 15.0, 40.0));
    cell.until(MOTION_S, |cell| cell.is_in(TaskState::Idle))?;
    cell.gripper.borrow_mut().rig.plant.set_object(None);
    Some(())
}

/// Closes, lands on the ground and leaves it.
fn land(cell: &mut ClosedLoop, rng: &mut ChaCha8Rng) -> Option<()> {
    move_to(cell, 0.5, 20.0)?;
    cell.host.order(Command { mode: mode::FOOT, ..Command::default() });
    cell.until(0.5, |cell| cell.is_in(TaskState::Foot))?;
    {
        let mut gripper = cell.gripper.borrow_mut();
        let start_s = gripper.rig.plant.time_s() + 0.1;
        let peak_n = rng.random_range(50.0..500.0);
        gripper.impacts.push(Impact { start_s, lasts_s: 0.05, peak_n });
    }
    cell.run(rng.random_range(0.5..2.0));
    cell.host.order(Command { mode: mode::LEAVE, ..Command::default() });
    cell.until(0.5, |cell| cell.is_in(TaskState::Idle))?;
    move_to(cell, 60.0, 40.0)
}

/// A requirement of the hazard table, evaluated over random grippers.
#[derive(Clone, Debug, PartialEq)]
pub struct RequirementSummary {
    /// What happens.
    pub description: String,
    /// Quantity that is bounded, with its unit.
    pub quantity: &'static str,
    /// Its bound; [`Self::is_minimum`] states the direction.
    pub bound: f64,
    /// The bound is a minimum.
    pub is_minimum: bool,
    /// Its worst value.
    pub worst: f64,
    /// Number of runs.
    pub runs: usize,
    /// Number of runs that keep the bound.
    pub kept: usize,
}

impl RequirementSummary {
    fn of(
        description: String,
        (quantity, bound, is_minimum): (&'static str, f64, bool),
        values: &[Option<f64>],
    ) -> Self {
        let keeps = |value: &f64| if is_minimum { *value >= bound } else { *value <= bound };
        let known = values.iter().flatten();
        let worst = if is_minimum { f64::min } else { f64::max };
        Self {
            description,
            quantity,
            bound,
            is_minimum,
            worst: known.clone().copied().reduce(worst).unwrap_or(f64::NAN),
            runs: values.len(),
            kept: known.filter(|value| keeps(value)).count(),
        }
    }

    /// Whether all runs keep the bound.
    pub const fn is_met(&self) -> bool {
        self.kept == self.runs
    }
}

/// Extent of [`evaluate_requirements`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RequirementDraws {
    /// The first seed.
    pub first: u64,
    /// Grippers for each obstructed motion, and for each cause of a stop.
    pub grippers: u64,
    /// Grippers for RELEASE in each state, with each screw and under each fault.
    pub openings: u64,
}

impl RequirementDraws {
    /// Number of runs.
    pub fn runs(&self) -> usize {
        let motions = ObstructedMotion::ALL.len() + StopCause::ALL.len();
        motions * self.grippers as usize + OpeningCase::all(0).len() * self.openings as usize
    }
}

/// Bounds of the hazard table in the runs of [`run`].
pub fn fault_requirements(outcomes: &[(FaultCase, FaultOutcome)]) -> Vec<RequirementSummary> {
    let bounds = HazardTable::gripper().bounds();
    let within = |value: fn(&FaultOutcome) -> f64, is_one: &dyn Fn(&FaultCase) -> bool| {
        let of_cases = outcomes.iter().filter(|(case, _)| is_one(case));
        of_cases.map(|(_, o)| o.was_reached.then(|| value(o))).collect::<Vec<_>>()
    };
    let is_on_hand = |state: OperatingState| {
        matches!(state, OperatingState::Moving | OperatingState::Homing | OperatingState::Opening)
    };
    let peak = |o: &FaultOutcome| o.peak_n;
    let on_hand = within(peak, &|case| is_on_hand(case.state) && case.max_n().is_some());
    let gripped = within(peak, &|case| !is_on_hand(case.state) && case.max_n().is_some());
    let travel = within(|o| o.travel_mm, &|case| case.state == OperatingState::Foot);
    let restarts = within(|o| f64::from(o.restarts), &|_| true);
    let rows = [
        (
            "a fault while moving, homing or opening onto a hand",
            "peak force, N",
            bounds.hand_n,
            on_hand,
        ),
        ("a fault of one sensor during a grip of 100 N", "peak force, N", bounds.grip_n, gripped),
        ("a fault in foot mode", "motion of the fingers, mm", bounds.foot_mm, travel),
        ("a fault in any state", "starts of the drive on its own", 0.0, restarts),
    ];
    let rows = rows.map(|(description, quantity, bound, values)| {
        RequirementSummary::of(description.to_owned(), (quantity, bound, false), &values)
    });
    rows.into()
}

/// Evaluates the bounds of the hazard table for motions onto obstacles, stops and openings; `done` is called after each run.
pub fn evaluate_requirements(
    draws: &RequirementDraws,
    tables: &TableSet,
    done: impl Fn() + Sync,
) -> Vec<RequirementSummary> {
    let bounds = HazardTable::gripper().bounds();
    let mut summaries = Vec::new();
    let seeds = draws.first..draws.first + draws.grippers;
    for motion in ObstructedMotion::ALL {
        let peak = |seed: u64| {
            let peak_n = ContactCase::draw(motion, seed).run(tables, None);
            done();
            peak_n
        };
        let peaks: Vec<Option<f64>> = seeds.clone().into_par_iter().map(peak).collect();
        let bound = ("peak force, N", bounds.hand_n, false);
        summaries.push(RequirementSummary::of(motion.description().to_owned(), bound, &peaks));
    }
    for cause in StopCause::ALL {
        let share = |seed: u64| {
            let share = RetentionCase::draw(cause, seed).run(tables, None);
            done();
            share
        };
        let shares: Vec<Option<f64>> = seeds.clone().into_par_iter().map(share).collect();
        let bound = ("remaining share of the force", bounds.kept_share, true);
        summaries.push(RequirementSummary::of(cause.description().to_owned(), bound, &shares));
    }
    let (opens_mm, within_s) = bounds.opens;
    let seeds = draws.first..draws.first + draws.openings;
    let cases: Vec<OpeningCase> = seeds.flat_map(OpeningCase::all).collect();
    let open = |case: &OpeningCase| {
        let outcome = case.run(tables, None);
        done();
        (case.fault, outcome.was_reached.then_some(outcome.opened_mm))
    };
    let opened: Vec<(InjectedFault, Option<f64>)> = cases.par_iter().map(open).collect();
    for fault in InjectedFault::ALL {
        let of_fault = opened.iter().filter(|(of, _)| *of == fault);
        let values: Vec<Option<f64>> = of_fault.map(|(_, opened_mm)| *opened_mm).collect();
        if !values.is_empty() {
            let description =
                format!("RELEASE for {within_s} s: {}", fault.specification().description);
            let bound = ("opened by, mm", opens_mm, true);
            summaries.push(RequirementSummary::of(description, bound, &values));
        }
    }
    summaries
}
