//! The task layer from outside: refusals, events of single milliseconds, and the status message.

use crate::config::limits::GripLimits;
use crate::estimator::Estimate;
use crate::grip::commands::{RefusalReason, flag, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::{GripRig, pressed};
use crate::motor::Setpoint;
use crate::motor::foc::Dq;
use crate::motor::screw::Screw;
use crate::protocol::OPENING_UNKNOWN;
use crate::system::faults::Fault;

#[test]
fn disable_is_refused_while_something_moves_or_may_be_held() {
    use TaskState::*;
    // And whether an object is, or may be, gripped.
    for (task, refused, is_loaded) in [
        (Unhomed, None, false),
        (Idle, None, false),
        (NoObject, None, false),
        (Lost, None, false),
        (TimeoutHold, None, false),
        (Homing, Some(RefusalReason::Busy), false),
        (Moving, Some(RefusalReason::Busy), false),
        (Approach, Some(RefusalReason::Busy), false),
        (Releasing, Some(RefusalReason::Busy), false),
        (Stopping, Some(RefusalReason::Busy), false),
        (ContactStop, Some(RefusalReason::Busy), false),
        (Force, Some(RefusalReason::Gripping), true),
        (HoldActive, Some(RefusalReason::Gripping), true),
        (HoldLatched, Some(RefusalReason::Gripping), true),
        (HoldFrozen, Some(RefusalReason::Gripping), true),
        (GripFailed, Some(RefusalReason::Gripping), true),
        (Foot, Some(RefusalReason::FootMode), true),
    ] {
        let mut rig = GripRig::in_task(task, true);
        assert_eq!(rig.grip.is_loaded(), is_loaded, "{task:?}");
        rig.send(mode::DISABLE, |_| {});
        assert_eq!(rig.refused.first().copied(), refused, "{task:?}");
        let power = if refused.is_none() { PowerState::Armed } else { PowerState::Enabled };
        assert_eq!(rig.grip.power(), power, "{task:?}");
        // Once disabled, it has no effect.
        if refused.is_none() {
            rig.send(mode::STOP, |_| {});
            rig.send(mode::DISABLE, |_| {});
            assert_eq!(rig.refused, [RefusalReason::NotEnabled]);
        }
    }
}

#[test]
fn repeated_command_is_executed_again_only_with_the_flag_toggled() {
    let mut rig = GripRig::enabled(true);
    for (flags, is_executed) in [
        (flag::UNCALIBRATED, true),
        (flag::UNCALIBRATED, false),
        (flag::UNCALIBRATED | flag::AGAIN, true),
        (flag::UNCALIBRATED | flag::AGAIN, false),
        (flag::UNCALIBRATED, true),
    ] {
        // At the target already, a move lasts until the fingers have rested.
        rig.motor.closing_mm_s = 10.0;
        rig.send(mode::MOVE, |command| {
            (command.position, command.speed, command.flags) = (900, 200, flags);
        });
        assert_eq!(rig.grip.task() == TaskState::Moving, is_executed, "{flags}");
        rig.run_until(TaskState::Idle);
    }
    // Once enabled, ENABLE is a sign of life.
    rig.send(mode::ENABLE, |_| {});
    assert!(rig.refused.is_empty());
}

#[test]
fn fault_of_two_tasks_prevents_enabling() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.arm();
    rig.corrupt = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
    rig.run(5);
    for is_reported_twice in [false, true] {
        rig.fault(Fault::Blind, is_reported_twice);
        rig.send(mode::ENABLE, |_| {});
        assert_eq!(rig.refused.pop(), Some(RefusalReason::FaultActive));
    }
}

#[test]
fn release_without_a_live_host_is_refused_while_disabled() {
    for (is_alive, refused) in [(false, Some(RefusalReason::NotEnabled)), (true, None)] {
        let mut rig = GripRig::new(true);
        rig.run(5);
        rig.arm();
        rig.host.is_alive = is_alive;
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1400, 40));
        assert_eq!(rig.refused.first().copied(), refused);
        assert_eq!(rig.grip.power() == PowerState::Enabled, is_alive);
    }
}

#[test]
fn commands_without_a_session_are_refused_as_not_enabled() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    assert_eq!(rig.grip.power(), PowerState::Safe);
    for mode in [mode::ENABLE, mode::GRIP, mode::RELEASE] {
        rig.send(mode, |command| {
            (command.position, command.speed, command.force) = (1400, 40, 500);
        });
    }
    assert_eq!(rig.refused, [RefusalReason::NotEnabled; 3]);
    assert_eq!(rig.setpoint(), Setpoint::Off);
}

#[test]
fn homing_and_grips_are_refused_without_a_valid_force() {
    let mut rig = GripRig::enabled(true);
    // Disturbed forces are invalid and, unlike lost ones, no fault of the grip.
    rig.corrupt = Some(|estimates| {
        for estimate in estimates {
            estimate.disturbed = true;
        }
    });
    rig.run(3);
    for mode in [mode::HOME, mode::GRIP, mode::MOVE] {
        rig.send(mode, |command| {
            (command.position, command.speed, command.force) = (1400, 40, 500);
        });
    }
    assert_eq!(rig.refused, [RefusalReason::Blind; 2]);
    assert_eq!(rig.grip.task(), TaskState::Moving);
}

#[test]
fn loaded_foot_accepts_foot_again() {
    let mut rig = GripRig::foot(true);
    rig.estimates = Some(pressed([0.0; 4], [50.0; 4]));
    rig.run(10);
    rig.send(mode::FOOT, |command| command.flags = flag::AGAIN);
    assert_eq!((rig.refused.first(), rig.grip.task()), (None, TaskState::Foot));
}

#[test]
fn release_must_open() {
    // At 50 mm: 1000 counts of 0.05 mm.
    for (position, refused) in [
        (999, Some(RefusalReason::OutOfRange)),
        (1000, Some(RefusalReason::OutOfRange)),
        (1001, None),
    ] {
        let mut rig = GripRig::enabled(true);
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (position, 40));
        assert_eq!(rig.refused.first().copied(), refused, "{position}");
    }
}

#[test]
fn line_foot_has_a_tolerance_of_one_millimetre() {
    for (opening_mm, flags, is_parked) in [
        (39.0, flag::LINE, true),
        (41.0, flag::LINE, true),
        (38.9, flag::LINE, false),
        (41.1, flag::LINE, false),
        (0.5, flag::LINE, false),
        (1.0, 0, true),
        (1.1, 0, false),
    ] {
        let mut rig = GripRig::enabled_at(true, opening_mm);
        rig.run(20);
        rig.send(mode::FOOT, |command| command.flags = flags);
        assert_eq!(rig.grip.task() == TaskState::Foot, is_parked, "{opening_mm}");
    }
}

#[test]
fn outward_force_ends_an_opening_move_and_no_closing_one() {
    // At 50 mm: 1000 counts of 0.05 mm. A move to the present opening closes.
    for (position, newtons, ends) in [
        (999, -20.0, false),
        (1000, -20.0, false),
        (1001, -20.0, true),
        (1400, -15.0, false),
        (1400, -15.25, true),
    ] {
        let mut rig = GripRig::enabled(true);
        rig.press(newtons);
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (position, 40));
        assert_eq!(rig.grip.task() == TaskState::ContactStop, ends, "{position} {newtons}");
    }
}

#[test]
fn held_position_is_the_first_at_rest() {
    let mut rig = GripRig::new(true);
    rig.arm();
    rig.motor.closing_mm_s = 10.0;
    rig.send(mode::ENABLE, |_| {});
    for _ in 0..10 {
        assert_eq!(rig.speed().0, 0.0);
        rig.moving(45.0, 10.0, 0.0);
    }
    for opening_mm in [45.0, 45.5] {
        for _ in 0..30 {
            rig.rest(opening_mm, 0.0);
        }
        let Setpoint::Position { opening_mm, .. } = rig.setpoint() else {
            panic!("{:?}", rig.setpoint());
        };
        assert_eq!(opening_mm, 45.0);
    }
}

#[test]
fn each_approach_estimates_the_stiffness_anew() {
    let mut rig = GripRig::holding(false);
    assert!(rig.grip.stiffness() < 60.0, "{}", rig.grip.stiffness());
    rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1200, 80));
    assert!(rig.grip.is_loaded());
    rig.run_until(TaskState::Idle);
    assert!(!rig.grip.is_loaded());
    rig.send(mode::GRIP, |command| command.force = 500);
    assert_eq!((rig.grip.task(), rig.grip.stiffness()), (TaskState::Approach, 333.0));
}

/// A drag of 36 N; the friction limit of both fingers is as great as the force of one, up to 30 N.
const DRAG: fn(&mut [Estimate; 4]) = |estimates| {
    for estimate in estimates {
        estimate.force[1] = crate::fixed_point::Force(9 << 10);
    }
};

#[test]
fn each_slip_raises_the_force_by_a_fifth_up_to_one_and_a_half() {
    // The fragile profile has a cap of 20 N. Set-points in newtons after each slip.
    for (flags, is_alive, expected) in [
        (0, true, [24.0, 28.8, 30.0]),
        (1, true, [20.0, 20.0, 20.0]),
        (0, false, [20.0, 20.0, 20.0]),
    ] {
        let mut rig = GripRig::enabled(false);
        rig.object = Some((40.0, 50.0));
        rig.send(mode::GRIP, |command| (command.force, command.flags) = (200, flags));
        rig.run_until(TaskState::HoldActive);
        rig.run(300);
        rig.host.is_alive = is_alive;
        for setpoint_n in expected {
            rig.corrupt = Some(DRAG);
            let detail = (0..20).find_map(|_| {
                rig.tick();
                rig.new_fault(Fault::Slipping)
            });
            let found_n = detail.map(|detail| detail as f32 / 1024.0).unwrap();
            assert!((found_n - setpoint_n).abs() < 1e-3, "{found_n} {setpoint_n}");
            // Reported for 200 ms from the slip on.
            rig.corrupt = None;
            let reported = (0..400).filter(|_| {
                rig.tick();
                rig.is_active(Fault::Slipping)
            });
            assert_eq!(reported.count(), 198);
        }
    }
}

#[test]
fn raised_force_returns_after_two_seconds_without_a_slip() {
    for self_locking in [true, false] {
        let mut rig = GripRig::gripped(20.0, self_locking, TaskState::HoldActive);
        for _ in 0..20 {
            rig.rest(40.0, 0.0);
        }
        rig.corrupt = Some(DRAG);
        rig.rest_until(|task| task != TaskState::HoldActive);
        rig.corrupt = None;
        rig.press(24.0);
        let mut last = TaskState::Force;
        let returned_ms = (1..3000).find(|_| {
            last = rig.grip.task();
            rig.rest(40.0, 0.0);
            last != TaskState::Force && rig.grip.task() == TaskState::Force
        });
        assert_eq!(returned_ms, Some(2000));
        assert_eq!(last == TaskState::HoldLatched, self_locking);
    }
}

#[test]
fn screw_holds_alone_after_200_ms_near_the_set_point() {
    // One and a half deadbands of 0.3 N, of 350 N 0.7 N, of 250 N 0.5 N; after one second any error within the tolerance.
    for (setpoint_n, force_n, after_ms) in [
        (100.0, 100.0, 200),
        (100.0, 99.56, 200),
        (100.0, 99.54, 1000),
        (100.0, 100.44, 200),
        (100.0, 100.46, 1000),
        (350.0, 349.0, 200),
        (350.0, 348.9, 1000),
        (250.0, 249.25, 1000),
        (100.0, 97.0, 3000),
    ] {
        let mut rig = GripRig::gripped(setpoint_n, true, TaskState::HoldActive);
        rig.settle(force_n);
        let held_ms = (4..3000).find(|_| {
            rig.rest(40.0, 0.0);
            rig.grip.task() == TaskState::HoldLatched
        });
        assert_eq!(held_ms.unwrap_or(3000), after_ms, "{setpoint_n} {force_n}");
    }
}

#[test]
fn force_lost_on_the_screw_is_regripped() {
    // More than 5 N, or 5 %, for 3 ms.
    for (setpoint_n, force_n, is_regripped) in [
        (50.0, 45.0, false),
        (50.0, 44.5, true),
        (200.0, 192.0, false),
        (200.0, 190.0, false),
        (200.0, 189.0, true),
    ] {
        let mut rig = GripRig::gripped(setpoint_n, true, TaskState::HoldLatched);
        rig.press(force_n);
        let states = [(); 3].map(|()| {
            rig.rest(40.0, 0.0);
            rig.grip.task()
        });
        let last = if is_regripped { TaskState::Force } else { TaskState::HoldLatched };
        let expected = [TaskState::HoldLatched, TaskState::HoldLatched, last];
        assert_eq!(states, expected, "{setpoint_n} {force_n}");
    }
}

#[test]
fn grip_settles_after_50_ms_or_fails_after_5_s() {
    use TaskState::{Force, GripFailed, HoldActive, Lost};
    // The tolerance is 2 N, or 2 %.
    for (setpoint_n, force_n, ticks, expected) in [
        (100.0, 99.0, 49, Force),
        (100.0, 99.0, 50, HoldActive),
        (100.0, 98.0, 60, Force),
        (100.0, 101.5, 50, HoldActive),
        (350.0, 344.0, 50, HoldActive),
        (350.0, 342.75, 60, Force),
        (100.0, 90.0, 4999, Force),
        (100.0, 90.0, 5000, GripFailed),
        // Without a contact there is no object: five milliseconds below 2.5 N.
        (100.0, 2.5, 60, Force),
        (100.0, 2.25, 4, Force),
        (100.0, 2.25, 5, Lost),
    ] {
        let mut rig = GripRig::gripped(setpoint_n, true, Force);
        rig.press(force_n);
        for _ in 0..ticks {
            rig.rest(40.0, 0.0);
        }
        assert_eq!(rig.grip.task(), expected, "{setpoint_n} {force_n} {ticks}");
    }
    for (is_valid, expected) in [(false, Force), (true, HoldActive)] {
        let mut rig = GripRig::gripped(100.0, true, Force);
        for _ in 0..49 {
            rig.rest(40.0, 0.0);
        }
        if !is_valid {
            rig.estimates = Some([Estimate::MISSING; 4]);
        }
        rig.rest(40.0, 0.0);
        assert_eq!(rig.grip.task(), expected);
    }
}

#[test]
fn stop_of_moving_fingers_ends_after_200_ms() {
    let mut rig = GripRig::in_task(TaskState::Stopping, true);
    for task_ms in 1..=200 {
        rig.moving(45.0, 10.0, 0.0);
        let expected = if task_ms < 200 { TaskState::Stopping } else { TaskState::Idle };
        assert_eq!(rig.grip.task(), expected, "{task_ms}");
    }
}

#[test]
fn homing_again_begins_from_the_start() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::HOME, |_| {});
    assert_eq!(rig.speed(), (5.0, 4.0));
    rig.run(100);
    assert_eq!(rig.speed(), (5.0, 1.5));
    rig.send(mode::STOP, |_| {});
    rig.run_until(TaskState::Idle);
    // The current that loosens the screw, once more.
    rig.send(mode::HOME, |_| {});
    assert_eq!(rig.speed(), (5.0, 4.0));
}

/// An opening from 50 mm towards 60 mm without valid forces, after the time in which the current loosens the screw.
fn blind_opening(limits: GripLimits) -> GripRig {
    let mut rig = GripRig::with_limits(true, limits);
    rig.enable();
    rig.estimates = Some([Estimate::MISSING; 4]);
    rig.motor.rotor_rad = 100.0;
    // The mean current decays to zero.
    for _ in 0..2000 {
        rig.rest(50.0, 0.0);
    }
    assert!(rig.refused.is_empty());
    rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1200, 40));
    for _ in 0..120 {
        rig.rest(50.0, 0.0);
    }
    assert_eq!(rig.grip.task(), TaskState::Releasing);
    rig
}

#[test]
fn obstacle_of_a_blind_opening_is_a_rise_of_the_mean_current() {
    // 12 A for one step is a mean of 0.75 A: at the limit it is no obstacle.
    for (blind_rise_a, is_blocked) in [(0.75, false), (0.5, true)] {
        let mut rig = blind_opening(GripLimits { blind_rise_a, ..GripLimits::GRIPPER });
        rig.moving(50.0, -2.0, -12.0);
        assert_eq!(rig.grip.task() == TaskState::ContactStop, is_blocked, "{blind_rise_a}");
    }
    // The mean follows by a sixteenth: 0.7 A of 1.6 A after 8.9 steps.
    for (current_a, after_ms) in [(-0.7, None), (4.0, None), (-1.6, Some(9))] {
        let mut rig = blind_opening(GripLimits::GRIPPER);
        let ended_ms = (1..40).find(|_| {
            // Not at rest, which is a stall.
            rig.moving(50.0, -2.0, current_a);
            rig.grip.task() == TaskState::ContactStop
        });
        assert_eq!(ended_ms, after_ms, "{current_a}");
    }
}

#[test]
fn obstacle_is_forgotten_after_closing_by_6_mm() {
    let ratio_mm = Screw::A.ratio_mm;
    let exact = GripLimits { clear_mm: ratio_mm, ..GripLimits::GRIPPER };
    for (limits, closing_mm, is_forgotten) in [
        (GripLimits::GRIPPER, 5.9, false),
        (GripLimits::GRIPPER, 6.1, true),
        (GripLimits::GRIPPER, -50.0, false),
        // Exactly at the limit, one radian.
        (exact, ratio_mm, false),
    ] {
        let mut rig = blind_opening(limits);
        for _ in 0..40 {
            rig.moving(50.0, -2.0, -1.6);
        }
        assert_ne!(rig.grip.task(), TaskState::Releasing);
        rig.motor.rotor_rad = 100.0 + closing_mm / ratio_mm;
        rig.rest(50.0, 0.0);
        rig.motor.rotor_rad = 100.0;
        for _ in 0..30 {
            rig.rest(50.0, 0.0);
        }
        rig.send(mode::RELEASE, |command| {
            (command.position, command.speed, command.flags) = (1200, 40, flag::AGAIN);
        });
        assert!(rig.refused.is_empty());
        let is_blocked = rig.grip.task() != TaskState::Releasing;
        assert_eq!(is_blocked, !is_forgotten, "{closing_mm}");
    }
}

#[test]
fn stall_of_a_motion_is_a_jam_with_its_current() {
    for task in [TaskState::Approach, TaskState::Moving] {
        for (current_a, ticks, detail) in
            [(1.5, 39, None), (1.2, 100, None), (-1.5, 40, Some(1500))]
        {
            let mut rig = GripRig::in_task(task, true);
            for _ in 0..ticks {
                rig.rest(50.0, current_a);
            }
            assert_eq!(rig.new_fault(Fault::Jammed), detail, "{task:?} {current_a} {ticks}");
            assert_eq!(rig.is_active(Fault::Jammed), detail.is_some());
        }
    }
}

#[test]
fn move_without_believed_forces_ends_at_nine_tenths_of_its_current() {
    // Of 0.6 A, and of 4 A where it leaves an end of the stroke.
    for (opening_mm, target_mm, current_a, ends) in [
        (50.0, 30.0, 0.53, false),
        (50.0, 30.0, 0.55, true),
        (50.0, 70.0, -0.55, true),
        (0.5, 30.0, -3.55, false),
        (0.5, 30.0, -3.65, true),
    ] {
        let mut rig = GripRig::enabled_at(true, opening_mm);
        // A force of such a move has no effect.
        rig.press(30.0);
        rig.send(mode::MOVE, |command| {
            command.position = (20.0 * target_mm) as u16;
            (command.speed, command.flags) = (80, flag::UNCALIBRATED);
        });
        for _ in 0..39 {
            rig.rest(opening_mm, current_a);
        }
        assert_eq!(rig.grip.task(), TaskState::Moving, "{opening_mm} {current_a}");
        rig.rest(opening_mm, current_a);
        let expected = if ends { TaskState::ContactStop } else { TaskState::Moving };
        assert_eq!(rig.grip.task(), expected, "{opening_mm} {current_a}");
        // At the target it has arrived.
        if !ends {
            rig.rest(target_mm + 0.05, 0.1);
            assert_eq!(rig.grip.task(), TaskState::Idle);
        }
    }
}

#[test]
fn approach_ends_by_contact_or_by_a_rise_of_the_force() {
    use TaskState::{Approach, Force, GripFailed};
    // Force since boot, and in each millisecond of the approach. A contact is above 5 N in two milliseconds; the rise is above
    // the least force.
    let cases: [(f64, &[f64], TaskState); 9] = [
        (0.0, &[6.0], Approach),
        (0.0, &[6.0, 6.0], Force),
        (0.0, &[30.0], Approach),
        (-15.0, &[5.0], Approach),
        (-15.25, &[5.0], GripFailed),
        // The contact is older than the approach.
        (6.0, &[6.0, 6.0], Approach),
        (6.0, &[16.0], Approach),
        (6.0, &[16.25], Force),
        (6.0, &[36.0], Force),
    ];
    for (before_n, forces, expected) in cases {
        let mut rig = GripRig::new(true);
        rig.press(before_n);
        rig.enable();
        rig.send(mode::GRIP, |command| command.force = 1000);
        assert_eq!(rig.grip.task(), Approach);
        for force_n in forces {
            rig.press(*force_n);
            rig.rest(50.0, 0.3);
        }
        assert_eq!(rig.grip.task(), expected, "{before_n} {forces:?}");
    }
}

#[test]
fn approach_ends_beyond_its_window_or_after_a_minute() {
    use TaskState::{Approach, Force, GripFailed, NoObject};
    // Position and flags: 35 mm and 4 mm on either side, 0 mm and 1 mm, none.
    let (window, narrow, none) = ((700, 3 << 2), (0, 1 << 2), (0, 0));
    // Opening, speed, contact and milliseconds of the approach.
    for ((position, flags), opening_mm, closing_mm_s, in_contact, ticks, expected) in [
        (window, 39.0, 0.0, true, 2, Force),
        (window, 39.1, 0.0, true, 2, GripFailed),
        (none, 60.0, 0.0, true, 2, Force),
        (window, 31.1, 0.0, false, 2, Approach),
        (window, 31.0, 0.0, false, 2, NoObject),
        // Below 0.2 mm the fingers touch.
        (none, 0.25, 0.0, false, 2, Approach),
        (none, 0.2, 0.0, false, 2, NoObject),
        (narrow, 0.25, 0.0, false, 2, Approach),
        (narrow, 0.2, 0.0, false, 2, NoObject),
        (none, 50.0, 0.0, false, 59_999, Approach),
        (none, 50.0, 0.0, false, 60_000, GripFailed),
        // 4 ms ahead at 50 mm/s: 0.2 mm.
        (window, 31.15, 50.0, false, 1, NoObject),
        (window, 31.25, 50.0, false, 1, Approach),
        (window, 30.9, -50.0, false, 1, Approach),
    ] {
        let mut rig = GripRig::enabled_at(true, 60.0);
        rig.send(mode::GRIP, |command| {
            (command.position, command.force, command.flags) = (position, 1000, flags);
        });
        rig.press(if in_contact { 6.0 } else { 0.0 });
        for _ in 0..ticks {
            rig.moving(opening_mm, closing_mm_s, 0.3);
        }
        assert_eq!(rig.grip.task(), expected, "{position} {opening_mm} {closing_mm_s} {ticks}");
    }
}

#[test]
fn opening_is_stalled_40_ms_after_loosening_the_screw_for_100_ms() {
    for (opening_mm, repeats, ended) in [
        (Some(50.0), false, TaskState::ContactStop),
        // A repeated command does not loosen the screw again.
        (Some(50.0), true, TaskState::ContactStop),
        (None, false, TaskState::Unhomed),
    ] {
        let task = if opening_mm.is_some() { TaskState::Idle } else { TaskState::Unhomed };
        let mut rig = GripRig::in_task(task, true);
        let release = |rig: &mut GripRig, flags| {
            rig.send(mode::RELEASE, |command| {
                (command.position, command.speed, command.flags) = (1200, 40, flags);
            });
        };
        release(&mut rig, 0);
        for _ in 0..50 {
            rig.rest(opening_mm, -1.5);
        }
        if repeats {
            (rig.motor.closing_mm_s, rig.motor.current.q) = (0.0, -1.5);
            release(&mut rig, flag::AGAIN);
        } else {
            rig.rest(opening_mm, -1.5);
        }
        for _ in 0..86 {
            rig.rest(opening_mm, -1.5);
        }
        assert_eq!(rig.grip.task(), TaskState::Releasing);
        // The milliseconds 100 to 139 count.
        rig.rest(opening_mm, -1.5);
        assert_eq!(rig.grip.task(), ended, "{opening_mm:?} {repeats}");
    }
}

#[test]
fn move_arrives_within_a_tenth_of_a_millimetre() {
    for (position, arrives) in [(1001, true), (999, true), (1003, false), (997, false)] {
        let mut rig = GripRig::enabled(true);
        rig.run(10);
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (position, 1));
        assert_eq!(rig.grip.task() == TaskState::Idle, arrives, "{position}");
    }
}

#[test]
fn closing_move_with_an_offset_ends_above_20_n() {
    for (newtons, ends) in [(20.0, false), (20.25, true)] {
        let mut rig = GripRig::enabled(true);
        rig.press(newtons);
        rig.run(5);
        // The contact is older than the move: an offset of the sensors.
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (200, 40));
        rig.run(3);
        assert_eq!(rig.grip.task() != TaskState::Moving, ends, "{newtons}");
    }
}

#[test]
fn status_message_has_counts_and_signs_of_its_signals() {
    let mut rig = GripRig::enabled(true);
    rig.press(12.5);
    rig.moving(50.25, -3.5, -2.25);
    let outputs = rig.outputs.as_ref().unwrap();
    let status = outputs.status;
    // 0.01 mm, 0.01 mm/s opening positive, 0.1 N, 0.01 A.
    assert_eq!((status.position, status.speed), (5025, 350));
    assert_eq!((status.force, status.current), (125, -225));
    assert_eq!((outputs.state, outputs.foot.is_some()), (18, false));
    rig.rest(None, 0.0);
    assert_eq!(rig.outputs.as_ref().unwrap().status.position, OPENING_UNKNOWN);
}

#[test]
fn ground_contact_is_reported_only_in_foot_mode() {
    let is_reported = |rig: &GripRig| rig.outputs.as_ref().unwrap().foot.is_some();
    assert!(!is_reported(&GripRig::enabled(true)));
    let mut rig = GripRig::foot(true);
    assert!(is_reported(&rig));
    rig.stop_all();
    rig.run(100);
    assert_eq!((rig.grip.power(), rig.grip.task()), (PowerState::Armed, TaskState::Foot));
    assert!(!is_reported(&rig));
}

#[test]
fn object_field_tells_motion_contact_and_position_apart() {
    let object = |rig: &GripRig| rig.outputs.as_ref().unwrap().status.object;
    for (task, expected) in [
        (TaskState::Moving, 0),
        (TaskState::Stopping, 0),
        (TaskState::Idle, 3),
        (TaskState::ContactStop, 2),
        (TaskState::HoldActive, 2),
    ] {
        assert_eq!(object(&GripRig::in_task(task, true)), expected, "{task:?}");
    }
    for (position, expected) in [(1200, 1), (800, 2)] {
        let mut rig = GripRig::enabled(true);
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (position, 80));
        rig.run_until(TaskState::Idle);
        assert_eq!(object(&rig), 3);
        rig.press(6.0);
        rig.run(3);
        assert_eq!(object(&rig), expected, "{position}");
        rig.send(mode::DISABLE, |_| {});
        assert_eq!(object(&rig), expected);
    }
    // One finger is pushed closed by 20 N, the other open by 10 N.
    let mut rig = GripRig::enabled(true);
    rig.send(mode::MOVE, |command| (command.position, command.speed) = (1200, 80));
    rig.estimates = Some(pressed([5.0, 5.0, 10.0, 10.0], [0.0; 4]));
    rig.run(2);
    assert_eq!((rig.grip.task(), object(&rig)), (TaskState::ContactStop, 1));
    // Stopped by a fault while moving, with a contact and without.
    for (newtons, expected) in [(0.0, 3), (6.0, 2)] {
        let mut rig = GripRig::in_task(TaskState::Moving, true);
        rig.fault(Fault::TablesUnsound, true);
        rig.press(newtons);
        rig.run(50);
        assert_eq!((rig.grip.power(), rig.grip.task()), (PowerState::Armed, TaskState::Moving));
        assert_eq!(object(&rig), expected);
    }
}

#[test]
fn current_of_a_latched_hold_ends_after_20_ms() {
    let mut rig = GripRig::gripped(100.0, true, TaskState::HoldActive);
    rig.motor.current_setpoint = Dq { d: 0.0, q: -2.0 };
    rig.rest_until(|task| task != TaskState::HoldActive);
    // A ramp of 20 ms.
    for task_ms in 0..20_u8 {
        let Setpoint::Current { closing_a } = rig.setpoint() else {
            panic!("{:?}", rig.setpoint());
        };
        assert!((closing_a - 0.1 * f32::from(20 - task_ms)).abs() < 1e-6, "{task_ms} {closing_a}");
        rig.rest(40.0, 0.0);
    }
    for _ in 20..=1000 {
        assert_eq!(rig.setpoint(), Setpoint::Off);
        rig.rest(40.0, 0.0);
    }
}
