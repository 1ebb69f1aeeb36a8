//! Fault injection into the whole gripper in virtual time, one run per fault; `magpie faults` runs campaigns.

use firmware::grip::states::PowerState;
use firmware::motor::MotorState;
use firmware::system::crash::CrashKind;
use firmware::system::faults::{Event, Fault};
use rayon::prelude::*;
use sim::board::i2c::I2cSensor;
use sim::closed_loop::{ClosedLoop, ClosedLoopSetup};
use sim::drivetrain::parameters::Lead;
use sim::faults::injection::InjectedFault;
use sim::faults::operating_state::OperatingState;
use sim::faults::run::{FaultCase, FaultOutcome};

use crate::nominal_tables;

/// Contact stiffness in N/mm.
const RIGID: f64 = 333.0;

fn case(fault: InjectedFault, state: OperatingState, lead: Lead) -> FaultCase {
    FaultCase { fault, state, lead, contact_n_per_mm: RIGID, seed: 7 }
}

/// Detected in time, with the specified final state and no forbidden event.
fn is_met(case: &FaultCase, outcome: &FaultOutcome) -> bool {
    let within_ms = case.fault.specification().within_ms;
    let in_time = outcome.found_ms.is_some_and(|ms| ms <= within_ms);
    in_time && outcome.is_as_specified && outcome.forbidden == 0 && case.is_bounded(outcome)
}

#[test]
fn every_fault_is_detected_in_time_with_its_reaction() {
    let tables = nominal_tables();
    // The last two are noisier at rest, and retract faster under overload, than most.
    let grippers = [(7, Lead::A), (10, Lead::B), (1, Lead::A)];
    let cases: Vec<FaultCase> = InjectedFault::ALL
        .iter()
        .flat_map(|fault| fault.specification().states.iter().map(move |state| (*fault, *state)))
        .flat_map(|(fault, state)| {
            grippers.map(|(seed, lead)| FaultCase { seed, ..case(fault, state, lead) })
        })
        .collect();
    let missed: Vec<String> = cases
        .par_iter()
        .filter_map(|case| {
            let outcome = case.run(tables, None);
            (!is_met(case, &outcome)).then(|| format!("{case:?}: {outcome:?}"))
        })
        .collect();
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn fault_with_disabled_detector_is_missed() {
    let tables = nominal_tables();
    let rows = InjectedFault::ALL.iter().flat_map(|fault| {
        fault.specification().states.iter().map(|state| case(*fault, *state, Lead::A))
    });
    let rows: Vec<FaultCase> = rows.collect();
    let unnoticed: Vec<String> = rows
        .par_iter()
        .filter_map(|case| {
            let outcome = case.run(tables, Some(case.fault.specification().disable_detector));
            let is_noticed = outcome.was_reached && !is_met(case, &outcome);
            (!is_noticed).then(|| format!("{case:?}: {outcome:?}"))
        })
        .collect();
    assert!(unnoticed.is_empty(), "{}", unnoticed.join("\n"));
}

#[test]
fn over_force_is_reduced_without_release() {
    for (lead, seed) in [(Lead::A, 1), (Lead::A, 2), (Lead::B, 2), (Lead::B, 3)] {
        for state in [OperatingState::Force, OperatingState::Hold] {
            let outcome = FaultCase { seed, ..case(InjectedFault::OverForce, state, lead) }
                .run(nominal_tables(), None);
            // The reaction reduces the force to 50 N.
            assert!((40.0..60.0).contains(&outcome.end_n), "{outcome:?}");
        }
    }
}

/// A nominal gripper with the self-locking screw.
fn reached(state: OperatingState) -> ClosedLoop {
    let setup = ClosedLoopSetup::nominal(Lead::A, 0.0, 7);
    state.reach(&setup, RIGID, nominal_tables()).unwrap()
}

#[test]
fn sensor_recovers_with_its_configuration() {
    let mut cell = reached(OperatingState::Idle);
    let change = |cell: &ClosedLoop, change: fn(&mut I2cSensor)| {
        change(&mut cell.board.connections.buses[1].borrow_mut().sensors[0]);
    };
    let is_lost = |cell: &ClosedLoop| cell.board.exchange.is_active(Fault::SensorLost);
    assert!(!is_lost(&cell));
    change(&cell, I2cSensor::brown_out);
    cell.run(0.1);
    assert!(is_lost(&cell));
    cell.run(0.5);
    assert!(is_lost(&cell));
    change(&cell, I2cSensor::power_up);
    cell.run(0.1);
    assert!(!is_lost(&cell));
}

#[test]
fn memory_corruption_restarts_and_screw_a_maintains_the_grip() {
    let mut cell = reached(OperatingState::Hold);
    // The exponent of the force set-point.
    cell.board.grip.borrow_mut().flip_bit(32 + 26);
    cell.tick();
    let motor = |cell: &ClosedLoop| cell.gripper.borrow().rig.motor.status();
    assert_eq!(motor(&cell).state, MotorState::Disarmed);
    cell.run(0.3);
    assert_eq!(cell.state(), PowerState::Safe as u8);
    assert_eq!((motor(&cell).state, motor(&cell).opening_mm), (MotorState::Disarmed, None));
    assert!(cell.force_n() > 90.0, "{}", cell.force_n());
    let events = cell.board.events.borrow();
    let detail = events.iter().find_map(|(_, event)| match event {
        Event::Fault(fault) if fault.code == Fault::Crashed as u16 => Some(fault.detail),
        _ => None,
    });
    assert_eq!(detail, Some(CrashKind::Corruption.number() << 24));
}
