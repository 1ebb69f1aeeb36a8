//! Transitions of both state machines: the tables, typical sequences, and random inputs.

use crate::grip::commands::{RefusalReason, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::GripRig;
use crate::grip::transitions::{
    POWER_TRANSITIONS, PowerEvent, TASK_TRANSITIONS, TaskEvent, next_power_state, next_task_state,
};
use crate::motor::{MotorState, Setpoint, Trip};
use crate::protocol::messages::Command;
use crate::system::faults::Fault;
use proptest::prelude::*;
use std::vec::Vec;

/// Compares the documented predecessors and successors of each state with a table, without self-transitions.
macro_rules! assert_documented {
    ($table:expr, $layer:ty) => {
        for state in <$layer>::ALL {
            let others = |states: Vec<$layer>| {
                let mut codes: Vec<u8> = states.iter().map(|state| *state as u8).collect();
                codes.retain(|code| *code != *state as u8);
                codes.sort_unstable();
                codes.dedup();
                codes
            };
            let from = $table.iter().filter(|(_, _, to)| to == state).map(|(from, ..)| *from);
            assert_eq!(
                others(from.collect()),
                others(state.entered_from().to_vec()),
                "into {state:?}"
            );
            let to = $table.iter().filter(|(from, ..)| from == state).map(|(.., to)| *to);
            assert_eq!(others(to.collect()), others(state.left_to().to_vec()), "out of {state:?}");
        }
    };
}

#[test]
fn documented_transitions_match_the_tables() {
    assert_documented!(POWER_TRANSITIONS, PowerState);
    assert_documented!(TASK_TRANSITIONS, TaskState);
}

#[test]
fn unlisted_events_are_refused_in_every_state() {
    let mut listed = 0;
    for from in PowerState::ALL {
        for event in PowerEvent::ALL {
            let rows = POWER_TRANSITIONS.iter().filter(|row| row.0 == *from && row.1 == *event);
            let rows: Vec<_> = rows.collect();
            assert!(rows.len() <= 1, "{from:?} {event:?}");
            assert_eq!(next_power_state(*from, *event), rows.first().map(|row| row.2));
            listed += rows.len();
        }
    }
    assert_eq!(listed, POWER_TRANSITIONS.len());
    listed = 0;
    for from in TaskState::ALL {
        for event in TaskEvent::ALL {
            let rows = TASK_TRANSITIONS.iter().filter(|row| row.0 == *from && row.1 == *event);
            let rows: Vec<_> = rows.collect();
            assert!(rows.len() <= 1, "{from:?} {event:?}");
            let expected = rows.first().map(|row| row.2).ok_or(RefusalReason::of(*from));
            assert_eq!(next_task_state(*from, *event), expected);
            listed += rows.len();
        }
    }
    assert_eq!(listed, TASK_TRANSITIONS.len());
}

#[test]
fn expired_nonce_returns_to_safe() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.host.is_offered = true;
    rig.run(2);
    assert_eq!(rig.grip.power(), PowerState::ArmPending);
    rig.host.is_offered = false;
    rig.run(2);
    assert_eq!(rig.grip.power(), PowerState::Safe);
}

#[test]
fn failed_self_test_and_calibration_prevent_arming() {
    let mut rig = GripRig::new(true);
    rig.is_sound = None;
    rig.run(5);
    assert_eq!(rig.grip.power(), PowerState::SelfTest);
    rig.is_sound = Some(false);
    rig.run(2);
    assert_eq!(rig.grip.power(), PowerState::Fault);
    assert!(!rig.outputs.as_ref().unwrap().may_arm);
    let mut rig = GripRig::new(true);
    rig.is_calibrating = true;
    rig.run(5);
    assert_eq!(rig.grip.power(), PowerState::Calibrating);
    assert!(!rig.outputs.as_ref().unwrap().may_arm);
}

#[test]
fn latched_stop_prevents_a_calibration_until_it_is_cleared() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.stop_all();
    rig.is_calibrating = true;
    rig.run(5);
    assert!(rig.grip.is_stopped());
    assert_eq!(rig.grip.power(), PowerState::Safe);
    rig.is_calibrating = false;
    rig.clear_faults();
    rig.is_calibrating = true;
    rig.run(5);
    assert!(!rig.grip.is_stopped());
    assert_eq!(rig.grip.power(), PowerState::Calibrating);
}

#[test]
fn grip_and_release_pass_through_their_states() {
    let mut rig = GripRig::enabled(true);
    rig.object = Some((40.0, 50.0));
    rig.send(mode::GRIP, |command| command.force = 1000);
    let mut states = std::vec![rig.grip.task()];
    for _ in 0..3000 {
        rig.tick();
        if states.last() != Some(&rig.grip.task()) {
            states.push(rig.grip.task());
        }
    }
    use TaskState::{Approach, Force, HoldActive, HoldLatched};
    assert_eq!(states, [Approach, Force, HoldActive, HoldLatched]);
    assert!((rig.force_n() - 100.0).abs() < 2.0, "{}", rig.force_n());
    assert_eq!(rig.setpoint(), Setpoint::Off);
    rig.send(mode::MOVE, |command| (command.position, command.speed) = (1200, 80));
    assert_eq!(rig.refused, [RefusalReason::Gripping]);
    rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1200, 80));
    assert_eq!(rig.grip.task(), TaskState::Releasing);
    rig.run_until(TaskState::Idle);
    assert!((rig.motor.opening_mm.unwrap() - 60.0).abs() < 0.1);
}

#[test]
fn backdrivable_screw_always_has_current() {
    let mut rig = GripRig::holding(false);
    for _ in 0..5000 {
        rig.tick();
        assert_eq!(rig.grip.task(), TaskState::HoldActive);
        assert!(matches!(rig.setpoint(), Setpoint::Speed { .. }));
    }
}

#[test]
fn missing_object_and_repeated_command() {
    let mut rig = GripRig::enabled(true);
    rig.object = Some((0.0, 500.0));
    let grip = |rig: &mut GripRig, flags| {
        rig.send(mode::GRIP, |command| (command.force, command.flags) = (500, flags));
    };
    grip(&mut rig, 0);
    rig.run_until(TaskState::NoObject);
    grip(&mut rig, 0);
    rig.run(100);
    assert_eq!(rig.grip.task(), TaskState::NoObject);
    grip(&mut rig, 0x80);
    assert_eq!(rig.grip.task(), TaskState::Approach);
}

#[test]
fn object_outside_its_width_window_is_not_gripped() {
    let ends = |width_mm| {
        let mut rig = GripRig::enabled(true);
        rig.object = Some((width_mm, 50.0));
        // 30 mm, 4 mm on either side.
        rig.send(mode::GRIP, |command| {
            (command.position, command.force, command.flags) = (600, 500, 3 << 2);
        });
        for _ in 0..20_000 {
            rig.tick();
        }
        rig.grip.task()
    };
    assert_eq!(ends(35.0), TaskState::GripFailed);
    assert_eq!(ends(30.0), TaskState::HoldLatched);
    assert_eq!(ends(25.0), TaskState::NoObject);
}

#[test]
fn contact_during_a_move_stops() {
    let mut rig = GripRig::enabled(true);
    rig.object = Some((40.0, 50.0));
    rig.send(mode::MOVE, |command| (command.position, command.speed) = (200, 80));
    rig.run_until(TaskState::ContactStop);
    rig.run_until(TaskState::Idle);
    assert!(rig.force_n() < 10.0, "{}", rig.force_n());
    assert_eq!(rig.outputs.as_ref().unwrap().status.object, 2);
}

#[test]
fn homing_finds_both_ends_and_rejects_a_short_stroke() {
    let home = |stroke_mm: f32| {
        let mut rig = GripRig::in_task(TaskState::Unhomed, true);
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (200, 80));
        assert_eq!(rig.refused, [RefusalReason::NotHomed]);
        (rig.true_mm, rig.end_mm) = (12.0, stroke_mm);
        // The fingers press on each other.
        rig.object = Some((0.0, 500.0));
        rig.send(mode::HOME, |_| {});
        rig.run_while(TaskState::Homing);
        rig
    };
    let rig = home(80.0);
    assert_eq!(rig.grip.task(), TaskState::Idle);
    assert!((rig.motor.opening_mm.unwrap() - 80.0).abs() < 0.1, "{:?}", rig.motor.opening_mm);
    let mut rig = home(70.0);
    assert_eq!((rig.grip.task(), rig.motor.opening_mm), (TaskState::Unhomed, None));
    // The measured stroke in micrometres.
    let stroke_um = rig.new_fault(Fault::StrokeWrong).unwrap();
    assert!((69_900..70_100).contains(&stroke_um), "{stroke_um}");
    rig.run(1);
    assert_eq!(rig.grip.first_cause().unwrap().fault, Fault::StrokeWrong);
}

/// States of both layers.
type States = (PowerState, TaskState);

/// Maximum transitions per tick: one of the power layer, one by a command or event, one by a fault or stop.
const STEPS: usize = 4;

fn next((power, task): States) -> Vec<States> {
    let powers = POWER_TRANSITIONS.iter().filter(|row| row.0 == power);
    let mut successors: Vec<States> = powers
        .flat_map(|row| {
            match row.2 {
                // The first task depends on the opening and on a gripped object.
                PowerState::Enabled => {
                    std::vec![
                        TaskState::Unhomed,
                        TaskState::Idle,
                        TaskState::GripFailed,
                        TaskState::Foot,
                        TaskState::Releasing,
                    ]
                }
                _ => std::vec![task],
            }
            .into_iter()
            .map(|task| (row.2, task))
        })
        .collect();
    if power == PowerState::Enabled {
        let tasks = TASK_TRANSITIONS.iter().filter(|row| row.0 == task);
        successors.extend(tasks.map(|row| (power, row.2)));
    }
    successors
}

fn may_follow(from: States, to: States) -> bool {
    let mut reached = std::vec![from];
    for _ in 0..STEPS {
        if reached.contains(&to) {
            return true;
        }
        reached = reached.into_iter().flat_map(next).collect();
    }
    reached.contains(&to)
}

/// Constant inputs for some milliseconds.
#[derive(Clone, Debug)]
struct Stretch {
    ms: u32,
    command: (u8, u16, u8, u16, u8),
    fault: Option<usize>,
    trip: Option<u8>,
    object: Option<(f32, f32)>,
    /// Stop, clear, offered, open, alive.
    flags: [bool; 5],
}

fn stretches() -> impl Strategy<Value = Vec<Stretch>> {
    let command = (0_u8..10, any::<u16>(), any::<u8>(), any::<u16>(), any::<u8>());
    let fault = prop::option::weighted(0.15, 0..Fault::ALL.len());
    let trip = prop::option::weighted(0.05, 0_u8..4);
    let object = prop::option::weighted(0.7, (0_f32..60.0, 5_f32..333.0));
    let one = (1_u32..150, command, fault, trip, object, prop::array::uniform5(any::<bool>()));
    let one = one.prop_map(|(ms, command, fault, trip, object, flags)| Stretch {
        ms,
        command,
        fault,
        trip,
        object,
        flags,
    });
    prop::collection::vec(one, 1..25)
}

/// Applies the inputs of a stretch; the session is open more often than not.
fn begin(rig: &mut GripRig, stretch: &Stretch) {
    let (mode, position, speed, force, flags) = stretch.command;
    rig.command =
        Some(Command { mode, position: position & 0x7FF, speed, force: force & 0xFFF, flags });
    for (number, fault) in Fault::ALL.into_iter().enumerate() {
        rig.fault(fault, stretch.fault == Some(number));
    }
    if let Some(trip) = stretch.trip {
        let trips = [Trip::OverSpeed, Trip::Encoder, Trip::CurrentSense, Trip::Runaway];
        rig.motor.state = MotorState::Tripped(trips[usize::from(trip)]);
    }
    rig.object = stretch.object;
    let [stop, clear, offered, open, alive] = stretch.flags;
    (rig.stop, rig.clear) = (stop && alive && offered, clear);
    (rig.host.is_offered, rig.host.is_open, rig.host.is_alive) = (offered, open || alive, alive);
}

proptest! {
    #[test]
    fn random_inputs_follow_listed_transitions(self_locking in any::<bool>(), stretches in stretches()) {
        let mut rig = GripRig::enabled(self_locking);
        let mut was_faulty = false;
        for stretch in &stretches {
            begin(&mut rig, stretch);
            for _ in 0..stretch.ms {
                let before = (rig.grip.power(), rig.grip.task());
                rig.tick();
                let after = (rig.grip.power(), rig.grip.task());
                prop_assert!(may_follow(before, after), "{:?} {:?}", before, after);
                // A fault must be left through `Safe`.
                was_faulty |= after.0 == PowerState::Fault;
                was_faulty &= after.0 != PowerState::Safe;
                prop_assert!(!(was_faulty && after.0 == PowerState::Enabled));
                let drives = !matches!(rig.setpoint(), Setpoint::Off | Setpoint::Brake);
                let may_drive = matches!(after.0, PowerState::Armed | PowerState::Enabled | PowerState::QuickStop);
                prop_assert!(!drives || may_drive, "{:?} {:?}", after, rig.setpoint());
            }
        }
    }

    #[test]
    fn latched_fault_allows_only_opening(
        self_locking in any::<bool>(),
        stretches in stretches(),
    ) {
        let mut rig = GripRig::enabled(self_locking);
        rig.fault(Fault::SensorLost, true);
        rig.run(300);
        prop_assert_eq!(rig.grip.power(), PowerState::Armed);
        for stretch in &stretches {
            begin(&mut rig, stretch);
            // The host never clears.
            rig.clear = false;
            for _ in 0..stretch.ms {
                let was_releasing = rig.grip.task() == TaskState::Releasing;
                let was_enabled = rig.grip.power() == PowerState::Enabled;
                rig.tick();
                let is_releasing = rig.grip.task() == TaskState::Releasing || was_releasing;
                // An opening whose target is the present one has ended in its first millisecond.
                let is_reached = !was_enabled
                    && stretch.command.0 == mode::RELEASE
                    && rig.grip.task() == TaskState::Idle;
                prop_assert!(
                    rig.grip.power() != PowerState::Enabled || is_releasing || is_reached
                );
            }
        }
    }
}

#[test]
fn opening_of_an_aborted_homing_is_unknown() {
    let abort: [fn(&mut GripRig); 3] = [
        |rig| rig.fault(Fault::Disturbed, true),
        |rig| rig.stop = true,
        |rig| rig.send(mode::STOP, |_| {}),
    ];
    for abort in abort {
        let mut rig = GripRig::enabled_at(true, 10.0);
        rig.object = Some((0.0, 333.0));
        rig.send(mode::HOME, |_| {});
        // Beyond the contact of the fingers, on the way to the far end.
        rig.run(3000);
        assert_eq!(rig.grip.task(), TaskState::Homing);
        assert!(rig.motor.opening_mm.is_some_and(|mm| mm > 1.0));
        abort(&mut rig);
        rig.run(3);
        assert_eq!(rig.motor.opening_mm, None);
    }
}

#[test]
fn shorted_windings_stay_until_cleared() {
    let mut rig = GripRig::holding(false);
    rig.motor.state = MotorState::Tripped(Trip::Encoder);
    rig.run(1000);
    assert_eq!(rig.grip.power(), PowerState::Fault);
    // The motor was not disarmed: the load goes down slowly.
    assert_eq!(rig.motor.state, MotorState::Tripped(Trip::Encoder));
    assert_eq!(rig.setpoint(), Setpoint::Brake);
    rig.host.is_open = false;
    rig.clear_faults();
    rig.run(5);
    assert_eq!((rig.grip.power(), rig.motor.state), (PowerState::Safe, MotorState::Disarmed));
}
