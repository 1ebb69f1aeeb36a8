//! Reactions that protect a person: opening under faults, bounded forces, latched stops.

use crate::config::limits::GripLimits;
use crate::estimator::{Estimate, Validity};
use crate::grip::commands::{RefusalReason, flag, mode};
use crate::grip::fault_reactions::{REACTION_TABLE, Reaction};
use crate::grip::states::{GripPhase, PowerState, TaskState};
use crate::grip::tests::rig::GripRig;
use crate::motor::Setpoint;
use crate::protocol::messages::Command;
use crate::system::faults::Fault;
use std::vec::Vec;

fn open(command: &mut Command) {
    (command.position, command.speed) = (1400, 80);
}

fn close(command: &mut Command) {
    (command.position, command.speed) = (0, 80);
}

/// A gripper in each state that a host or a fault can bring about, except foot mode.
fn situations(self_locking: bool) -> Vec<GripRig> {
    let tasks = TaskState::ALL.iter().copied();
    let tasks = tasks.filter(|task| match task {
        TaskState::Foot => false,
        TaskState::HoldLatched => self_locking,
        _ => true,
    });
    let mut rigs: Vec<_> = tasks.map(|task| GripRig::in_task(task, self_locking)).collect();
    let mut disabled = GripRig::enabled(self_locking);
    disabled.send(mode::DISABLE, |_| {});
    rigs.push(disabled);
    rigs
}

#[test]
fn release_opens_from_every_state_under_every_fault_that_allows_it() {
    let rows = REACTION_TABLE.into_iter();
    let allows = rows.filter(|row| row.reaction(GripPhase::Releasing, true) < Reaction::QuickStop);
    let faults: Vec<_> = allows.map(|row| row.fault).collect();
    for situation in [true, false].into_iter().flat_map(situations) {
        let state = (situation.grip.power(), situation.grip.task());
        for fault in &faults {
            for is_blind in [true, false] {
                let mut rig = situation.clone();
                let from_mm = rig.true_mm;
                rig.fault(*fault, true);
                if is_blind {
                    rig.corrupt = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
                }
                // Stops first, where the fault makes it stop.
                rig.run(300);
                rig.send(mode::RELEASE, open);
                rig.run(3000);
                let opened_mm = rig.true_mm - from_mm;
                assert!(opened_mm > 10.0, "{fault:?} {state:?}: {opened_mm} mm {:?}", rig.refused);
            }
        }
    }
}

#[test]
fn opening_under_a_latched_fault_ends_disabled() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::MOVE, close);
    rig.fault(Fault::SensorLost, true);
    rig.run(300);
    rig.fault(Fault::SensorLost, false);
    rig.send(mode::RELEASE, open);
    assert_eq!(rig.grip.task(), TaskState::Releasing);
    rig.send(mode::MOVE, close);
    rig.run(3000);
    assert_eq!(rig.grip.power(), PowerState::Armed);
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.refused, [RefusalReason::Busy, RefusalReason::FaultLatched]);
}

#[test]
fn opening_that_ends_at_once_under_a_latched_fault_ends_disabled() {
    let mut rig = GripRig::enabled(true);
    rig.fault(Fault::SensorLost, true);
    rig.run(300);
    rig.fault(Fault::SensorLost, false);
    // 50.05 mm, from 50 mm.
    rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1001, 1));
    assert_eq!((rig.grip.power(), rig.grip.task()), (PowerState::Enabled, TaskState::Idle));
    rig.tick();
    assert_eq!(rig.grip.power(), PowerState::QuickStop);
    rig.run(20);
    assert_eq!(rig.grip.power(), PowerState::Armed);
    assert!((50.0..50.1).contains(&rig.true_mm), "{}", rig.true_mm);
}

#[test]
fn a_hand_is_squeezed_with_at_most_20_n_however_often_the_host_repeats() {
    for (stiffness, offset_n) in
        [(10.0, 0.0), (10.0, 8.0), (10.0, -8.0), (10.0, -100.0), (50.0, 0.0)]
    {
        let mut rig = GripRig::enabled(true);
        rig.object = Some((40.0, stiffness));
        rig.offset_n = offset_n;
        rig.run(100);
        let mut peak_n: f32 = 0.0;
        for round in 0..20_u8 {
            let mode = if round % 2 == 0 { mode::MOVE } else { mode::HOME };
            rig.send(mode, |command| {
                close(command);
                command.flags = round << 7;
            });
            for _ in 0..600 {
                rig.tick();
                peak_n = peak_n.max(rig.force_n());
            }
            rig.send(mode::STOP, |_| {});
            rig.run(50);
        }
        // The rig stops at once; the offset adds to the threshold.
        let limit_n = 21.0 + if offset_n > -20.0 { -offset_n.min(0.0) } else { 0.0 };
        assert!(
            (5.0 - offset_n..limit_n.max(13.1)).contains(&peak_n)
                || offset_n < -20.0 && peak_n < 21.0,
            "{stiffness} N/mm, {offset_n} N: {peak_n} N"
        );
    }
}

#[test]
fn fingers_that_open_inside_a_tube_stop() {
    // With forces: 15 N. Without: the current rises by 0.8 A, 47 N here.
    for (is_blind, limit_n) in [(false, 17.0), (true, 60.0)] {
        for is_known in [true, false] {
            for mode in [mode::RELEASE, mode::MOVE] {
                if mode == mode::MOVE && (is_blind || !is_known) {
                    continue;
                }
                let mut rig = GripRig::enabled(false);
                rig.tube = Some((55.0, 10.0));
                if !is_known {
                    rig.motor.opening_mm = None;
                }
                if is_blind {
                    rig.corrupt = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
                    rig.fault(Fault::Blind, true);
                    rig.run(300);
                }
                rig.send(mode, open);
                let mut peak_n: f32 = 0.0;
                for _ in 0..3000 {
                    rig.tick();
                    peak_n = peak_n.max(-rig.force_n());
                }
                assert!((5.0..limit_n).contains(&peak_n), "{is_blind} {is_known}: {peak_n} N");
            }
        }
    }
}

#[test]
fn opening_of_unknown_opening_ends_at_the_stop() {
    let mut rig = GripRig::enabled(true);
    rig.motor.opening_mm = None;
    rig.send(mode::DISABLE, |_| {});
    rig.run(5);
    rig.send(mode::ENABLE, |_| {});
    rig.end_mm = 80.0;
    rig.send(mode::RELEASE, open);
    for _ in 0..12_000 {
        rig.tick();
        if rig.grip.task() == TaskState::Unhomed {
            return;
        }
    }
    panic!("{:?} at {} mm", rig.grip.task(), rig.true_mm);
}

#[test]
fn stop_is_latched_until_cleared_at_rest() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::MOVE, close);
    (rig.stop, rig.clear) = (true, true);
    rig.run(3);
    // A clear together with a stop does not clear it.
    (rig.stop, rig.clear) = (false, false);
    rig.run(300);
    for mode in [mode::ENABLE, mode::RELEASE] {
        rig.send(mode, open);
    }
    assert_eq!(rig.refused, [RefusalReason::Stopped; 2]);
    rig.clear_faults();
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.grip.power(), PowerState::Enabled);
}

#[test]
fn a_stopped_foot_stays_a_foot() {
    for self_locking in [true, false] {
        let mut rig = GripRig::foot(self_locking);
        rig.estimates = Some(crate::grip::tests::rig::pressed([0.0; 4], [50.0; 4]));
        rig.stop_all();
        rig.run(300);
        assert_eq!(rig.setpoint() == Setpoint::Off, self_locking);
        // A backdrivable screw carries the robot without a host.
        rig.host.is_open = false;
        rig.run(5);
        assert_eq!(rig.setpoint() == Setpoint::Off, self_locking);
        if self_locking {
            rig.arm();
        }
        rig.host.is_open = true;
        rig.clear_faults();
        for mode in [mode::RELEASE, mode::ENABLE, mode::MOVE, mode::RELEASE, mode::LEAVE] {
            rig.send(mode, open);
        }
        assert_eq!(rig.grip.task(), TaskState::Foot);
        let foot = RefusalReason::FootMode;
        assert_eq!(rig.refused, [foot, foot, foot, RefusalReason::Loaded]);
    }
}

#[test]
fn a_release_that_is_stopped_still_holds_the_object() {
    for self_locking in [true, false] {
        let mut rig = GripRig::holding(self_locking);
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1400, 4));
        rig.run(20);
        rig.send(mode::STOP, |_| {});
        rig.run(100);
        assert_eq!(rig.grip.task(), TaskState::GripFailed);
        assert!(matches!(rig.setpoint(), Setpoint::Position { .. }), "{:?}", rig.setpoint());
    }
}

#[test]
fn force_beyond_the_range_of_the_model_is_over_force() {
    let outside = |estimates: &mut [Estimate; 4]| {
        for estimate in estimates {
            estimate.validity = Validity::OutsideModel;
        }
    };
    for (width_mm, is_over) in [(46.5, true), (41.0, false)] {
        let mut rig = GripRig::holding(true);
        rig.object = Some((width_mm, 50.0));
        rig.run(2);
        rig.corrupt = Some(outside);
        rig.tick();
        let cause = rig.grip.first_cause().map(|cause| cause.fault);
        assert_eq!(cause, is_over.then_some(Fault::OverForce));
        let before_mm = rig.true_mm;
        rig.run(50);
        assert_eq!(rig.true_mm > before_mm + 0.2, is_over);
    }
}

#[test]
fn back_off_never_closes() {
    let mut rig = GripRig::holding(false);
    rig.object = Some((48.0, 50.0));
    rig.tick();
    rig.object = None;
    for _ in 0..2500 {
        let before_mm = rig.true_mm;
        rig.tick();
        assert!(rig.true_mm >= before_mm);
    }
    assert_eq!(rig.grip.power(), PowerState::Armed);
}

#[test]
fn slip_raises_the_force_by_half_at_most_and_only_for_two_seconds() {
    for (is_alive, expected_n) in [(true, 30.0), (false, 20.0)] {
        let mut rig = GripRig::enabled(true);
        rig.object = Some((40.0, 50.0));
        rig.send(mode::GRIP, |command| command.force = 200);
        rig.run_until(TaskState::HoldActive);
        rig.host.is_alive = is_alive;
        // 36 N of drag: beyond the friction limit of 20 N on each finger.
        rig.corrupt = Some(|estimates| {
            for estimate in estimates {
                estimate.force[1] = crate::fixed_point::Force(9 << 10);
            }
        });
        rig.run(1800);
        assert!((rig.force_n() - expected_n).abs() < 2.5, "{}", rig.force_n());
        rig.corrupt = None;
        rig.run(3500);
        assert!((rig.force_n() - 20.0).abs() < 2.5, "{}", rig.force_n());
    }
}

#[test]
fn approach_with_an_offset_does_not_mistake_it_for_the_object() {
    let mut rig = GripRig::enabled(true);
    rig.offset_n = 8.0;
    rig.run(20);
    rig.object = Some((40.0, 50.0));
    rig.send(mode::GRIP, |command| command.force = 500);
    rig.run(50);
    assert_eq!(rig.grip.task(), TaskState::Approach);
    rig.run_until(TaskState::HoldActive);
    assert!((rig.force_n() - 42.0).abs() < 2.5, "{}", rig.force_n());
    // A wrong tare of a whole grip: no force could be controlled.
    let mut rig = GripRig::enabled(true);
    rig.offset_n = -100.0;
    rig.run(20);
    rig.object = Some((40.0, 50.0));
    rig.send(mode::GRIP, |command| command.force = 500);
    rig.run_until(TaskState::GripFailed);
    assert!(rig.force_n() < 25.0, "{}", rig.force_n());
}

#[test]
fn enable_after_a_stop_does_not_continue_a_move() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::MOVE, close);
    rig.run(50);
    rig.stop_all();
    rig.run(300);
    rig.clear_faults();
    let from_mm = rig.true_mm;
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.grip.task(), TaskState::Idle);
    rig.run(1000);
    assert!((rig.true_mm - from_mm).abs() < 0.05, "{from_mm} {}", rig.true_mm);
}

#[test]
fn move_without_believed_forces_has_little_current_and_no_force_limit() {
    let mut rig = GripRig::enabled(true);
    // As the field of a neighbouring magnet without its compensation.
    rig.object = Some((49.0, 1.0));
    rig.send(mode::MOVE, |command| {
        close(command);
        command.flags = flag::UNCALIBRATED;
    });
    let Setpoint::Position { speed_mm_s, max_a, .. } = rig.setpoint() else {
        panic!("{:?}", rig.setpoint());
    };
    assert_eq!((speed_mm_s, max_a), (20.0, GripLimits::GRIPPER.uncalibrated_a));
    rig.run(1500);
    assert!(rig.force_n() > 25.0, "{}", rig.force_n());
    assert_eq!(rig.grip.task(), TaskState::Moving);
}
