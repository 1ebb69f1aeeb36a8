//! Motor set-points of single states, with numbers worked out from the control laws.
//!
//! At the hardest contact (333 N/mm) and 32 Hz a force error of 1 N is 2 pi 32 / 333 = 0.60379 mm/s.

use crate::estimator::Estimate;
use crate::grip::commands::{flag, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::GripRig;
use crate::motor::foc::Dq;
use crate::motor::{MotorState, Setpoint, Trip};

/// Peak current: 0.96 N m / 0.1 N m/A.
const PEAK_A: f32 = 9.6;
/// Closing speed for one newton at the hardest contact.
const PER_N: f32 = 0.603_79;
/// Approach speed for 100 N: (0.1 * 100 N + 2 N) / (333 N/mm * 2.5 ms).
const SLOW_MM_S: f32 = 14.414;

/// Compares the closing speed and the current limit of a speed set-point.
fn assert_speed(rig: &GripRig, closing_mm_s: f32, max_a: f32) {
    let (speed, limit_a) = rig.speed();
    assert!((speed - closing_mm_s).abs() < 1e-3, "{speed} instead of {closing_mm_s}");
    assert!((limit_a - max_a).abs() < 1e-3, "{limit_a} instead of {max_a}");
}

#[test]
fn move_is_limited_only_where_the_forces_are_not_believed() {
    let uncalibrated = flag::UNCALIBRATED;
    // From, to, requested speed; speed and current. Away from an end, which is 1 mm long, it has more current.
    for (from_mm, to_mm, requested_mm_s, flags, speed_mm_s, max_a) in [
        (50.0, 30.0, 40.0, 0, 40.0, PEAK_A),
        (50.0, 30.0, 40.0, uncalibrated, 25.0, 0.6),
        (50.0, 30.0, 20.0, uncalibrated, 20.0, 0.6),
        (0.0, 30.0, 60.0, uncalibrated, 5.0, 4.0),
        (0.9, 30.0, 60.0, uncalibrated, 5.0, 4.0),
        (1.0, 30.0, 60.0, uncalibrated, 25.0, 0.6),
        (79.5, 80.0, 60.0, uncalibrated, 25.0, 0.6),
        (80.0, 30.0, 60.0, uncalibrated, 5.0, 4.0),
        (79.1, 30.0, 60.0, uncalibrated, 5.0, 4.0),
        (79.0, 30.0, 60.0, uncalibrated, 25.0, 0.6),
        (0.5, 0.0, 60.0, uncalibrated, 25.0, 0.6),
    ] {
        let mut rig = GripRig::enabled_at(true, from_mm);
        rig.send(mode::MOVE, |command| {
            command.position = (20.0 * to_mm) as u16;
            (command.speed, command.flags) = ((4.0 * requested_mm_s) as u8, flags);
        });
        let expected = Setpoint::Position { opening_mm: to_mm, speed_mm_s, max_a };
        assert_eq!(rig.setpoint(), expected, "{from_mm} {to_mm}");
        // An unknown opening is at no end.
        rig.rest(None, 0.0);
        let expected = match flags {
            0 => expected,
            _ => Setpoint::Position {
                opening_mm: to_mm,
                speed_mm_s: f32::min(requested_mm_s, 25.0),
                max_a: 0.6,
            },
        };
        assert_eq!(rig.setpoint(), expected, "{from_mm} {to_mm}");
    }
}

#[test]
fn release_is_slow_without_valid_forces_or_opening() {
    for (is_known, is_valid, requested_mm_s, speed_mm_s, max_a) in [
        (true, true, 20.0, 20.0, PEAK_A),
        (true, false, 20.0, 10.0, 4.0),
        (true, false, 4.0, 4.0, 4.0),
        (false, true, 20.0, 10.0, 4.0),
        (false, false, 4.0, 4.0, 4.0),
    ] {
        let task = if is_known { TaskState::Idle } else { TaskState::Unhomed };
        let mut rig = GripRig::in_task(task, true);
        if !is_valid {
            rig.corrupt = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
        }
        rig.send(mode::RELEASE, |command| {
            (command.position, command.speed) = (1200, (4.0 * requested_mm_s) as u8);
        });
        if is_known {
            let expected = Setpoint::Position { opening_mm: 60.0, speed_mm_s, max_a };
            assert_eq!(rig.setpoint(), expected, "{is_valid}");
        } else {
            assert_speed(&rig, -speed_mm_s, max_a);
        }
    }
}

#[test]
fn back_off_opens_to_50_n_and_never_closes() {
    for (newtons, is_valid, closing_mm_s) in [
        (52.0, true, -2.0 * PER_N),
        (40.0, true, 0.0),
        // Beyond 19.9 mm/s the square root: (8000 * 50 / 333 - 19.894^2)^0.5, at most 58.3 mm/s.
        (100.0, true, -28.380),
        (400.0, true, -58.3),
        (400.0, false, -10.0),
        (52.0, false, -2.0 * PER_N),
    ] {
        let mut rig = GripRig::enabled(true);
        rig.tick_pressed(500.0);
        assert_eq!(rig.grip.power(), PowerState::QuickStop);
        rig.tick_pressed(newtons);
        if !is_valid {
            rig.estimates = Some([Estimate::MISSING; 4]);
            rig.tick();
        }
        assert_speed(&rig, closing_mm_s, PEAK_A);
    }
    // A stop for another reason only stops.
    let mut rig = GripRig::enabled(true);
    rig.press(100.0);
    rig.stop_all();
    assert_speed(&rig, 0.0, PEAK_A);
}

/// An approach with 100 N; `speed` in 0.25 mm/s, 0 for the fastest.
fn approaching(flags: u8, speed: u8) -> GripRig {
    let mut rig = GripRig::enabled_at(true, 60.0);
    rig.send(mode::GRIP, |command| {
        // Its window, if the flags give one, is around 35 mm.
        (command.position, command.force) = (700, 1000);
        (command.speed, command.flags) = (speed, flags);
    });
    rig
}

#[test]
fn approach_slows_down_two_millimetres_before_its_window() {
    // 31 to 39 mm.
    let (window, fast) = (3 << 2, 3 << 2 | flag::FAST);
    for (flags, speed, opening_mm, closing_mm_s, expected_mm_s) in [
        (0, 0, 60.0, 0.0, SLOW_MM_S),
        (window, 0, 60.0, 0.0, SLOW_MM_S),
        (fast, 0, 60.0, 0.0, 58.3),
        (fast, 0, 41.1, 0.0, 58.3),
        (fast, 0, 41.0, 0.0, SLOW_MM_S),
        // 4 ms ahead: 41.3 mm - 0.2 mm, and 41.2 mm - 0.4 mm.
        (fast, 0, 41.3, 50.0, 58.3),
        (fast, 0, 41.2, 100.0, SLOW_MM_S),
        (fast, 20, 60.0, 0.0, 5.0),
    ] {
        let mut rig = approaching(flags, speed);
        rig.moving(opening_mm, closing_mm_s, 0.3);
        assert_speed(&rig, expected_mm_s, PEAK_A);
    }
}

#[test]
fn force_ends_the_approach_and_is_controlled_after_it() {
    for (newtons, speed, closing_mm_s) in
        [(90.0, 0, 10.0 * PER_N), (105.0, 0, -5.0 * PER_N), (6.0, 0, SLOW_MM_S), (90.0, 20, 5.0)]
    {
        let mut rig = approaching(0, speed);
        rig.press(newtons);
        // Suspected in the first millisecond, confirmed in the second.
        for task in [TaskState::Approach, TaskState::Force] {
            rig.rest(60.0, 0.3);
            assert_eq!(rig.grip.task(), task);
            assert_speed(&rig, closing_mm_s, PEAK_A);
        }
    }
}

#[test]
fn force_control_assumes_at_least_50_n_per_mm() {
    let mut rig = approaching(0, 0);
    // A force that falls while closing gives the softest estimate, 5 N/mm.
    for tick in 0_u8..20 {
        rig.press(97.0 - 2.0 * f64::from(tick));
        rig.rest(50.0 - 0.1 * f32::from(tick), 0.3);
    }
    rig.press(99.0);
    rig.rest(48.1, 0.3);
    assert_eq!((rig.grip.task(), rig.grip.stiffness()), (TaskState::Force, 5.0));
    // 2 pi 32 / 50.
    assert_speed(&rig, 4.0212, PEAK_A);
}

#[test]
fn hold_controls_the_mean_force_within_the_tolerance() {
    // Set-point, force and mean force, all in newtons; beyond the deadband, and four times slower within the tolerance.
    for (setpoint_n, force_n, mean_n, beyond_n) in [
        (100.0, 99.0, 98.7, 0.25 * 1.0),
        (100.0, 101.0, 101.3, -0.25 * 1.0),
        (100.0, 99.0, 99.8, 0.0),
        (100.0, 98.1, 100.0, 0.0),
        // At the tolerance of 2 N the force itself counts: 2.0 - 0.3 N.
        (100.0, 98.0, 100.0, 1.7),
        (100.0, 95.0, 100.0, 4.7),
        (100.0, 102.0, 100.0, -1.7),
        // Of 350 N: tolerance 7 N, deadband 0.7 N.
        (350.0, 349.0, 348.7, 0.25 * 0.6),
        (350.0, 345.0, 350.0, 0.0),
        (350.0, 342.0, 350.0, 7.3),
        // Of 10 N: tolerance 2 N, deadband 0.3 N.
        (10.0, 9.0, 9.5, 0.25 * 0.2),
    ] {
        let mut rig = GripRig::gripped(setpoint_n, false, TaskState::HoldActive);
        // The mean follows by a sixteenth.
        rig.settle((16.0 * mean_n - force_n) / 15.0);
        rig.press(force_n);
        rig.rest(40.0, 0.0);
        assert_eq!(rig.grip.task(), TaskState::HoldActive);
        assert_speed(&rig, beyond_n * PER_N, PEAK_A);
    }
}

#[test]
fn holding_current_decreases_within_one_and_a_half_deadbands() {
    // Deadband 0.3 N at 100 N, 0.5 N at 250 N.
    for (setpoint_n, mean_n, decreases) in [
        (100.0, 99.6, true),
        (100.0, 99.5, false),
        (100.0, 100.4, true),
        (100.0, 100.5, false),
        (250.0, 249.3, true),
        (250.0, 249.25, false),
        (250.0, 250.7, true),
        (250.0, 250.8, false),
    ] {
        let mut rig = GripRig::gripped(setpoint_n, false, TaskState::HoldActive);
        rig.motor.current_setpoint = Dq { d: 0.0, q: -3.0 };
        rig.settle(mean_n);
        for _ in 0..300 {
            rig.rest(40.0, 0.0);
        }
        let (_, limit_a) = rig.speed();
        assert_eq!(limit_a < PEAK_A, decreases, "{setpoint_n} {mean_n}: {limit_a}");
    }
}

#[test]
fn resting_states_hold_their_position() {
    use TaskState::{GripFailed, HoldFrozen, Idle, Lost, NoObject, TimeoutHold};
    for task in [Idle, NoObject, GripFailed, Lost, TimeoutHold, HoldFrozen] {
        let mut rig = GripRig::in_task(task, false);
        // A frozen hold has the last current with which the force was held: here of an ideal motor, none.
        let max_a = if task == HoldFrozen { 0.0 } else { PEAK_A };
        rig.run(30);
        let opening_mm = rig.true_mm;
        let Setpoint::Position { opening_mm: held_mm, speed_mm_s, max_a: held_a } = rig.setpoint()
        else {
            panic!("{task:?} {:?}", rig.setpoint());
        };
        assert_eq!((rig.grip.task(), speed_mm_s, held_a), (task, 5.0, max_a));
        assert!((held_mm - opening_mm).abs() < 0.01, "{task:?} {held_mm} {opening_mm}");
        rig.rest(None, 0.0);
        assert_speed(&rig, 0.0, max_a);
    }
    for task in [TaskState::ContactStop, TaskState::Stopping] {
        assert_speed(&GripRig::in_task(task, false), 0.0, PEAK_A);
    }
    assert_eq!(GripRig::in_task(TaskState::Unhomed, false).setpoint(), Setpoint::Off);
}

#[test]
fn load_on_a_backdrivable_screw_is_held_without_force_control() {
    // Frozen with the last current, disabled with at least 1.4 times the computed one.
    // Screw B: 100 N * 1.0227 mm/rad * (1 - 0.5649) / 0.1 N m/A = 0.44503 A.
    for (hold_a, disabled_a) in [(0.1, 0.623_05), (2.0, 2.0)] {
        let held = || {
            let mut rig = GripRig::gripped(100.0, false, TaskState::HoldActive);
            rig.motor.current_setpoint = Dq { d: 0.0, q: hold_a };
            rig.rest(40.0, 0.0);
            rig
        };
        let mut rig = held();
        rig.estimates = Some([Estimate::MISSING; 4]);
        rig.rest_until(|task| task == TaskState::HoldFrozen);
        let expected = Setpoint::Position { opening_mm: 40.0, speed_mm_s: 5.0, max_a: hold_a };
        assert_eq!(rig.setpoint(), expected);
        let mut rig = held();
        rig.stop_all();
        for _ in 0..100 {
            rig.rest(40.0, 0.0);
        }
        assert_eq!(rig.grip.power(), PowerState::Armed);
        let (closing_mm_s, max_a) = rig.speed();
        assert_eq!(closing_mm_s, 0.0);
        assert!((max_a - disabled_a).abs() < 1e-4, "{max_a} instead of {disabled_a}");
    }
}

#[test]
fn disabled_drive_is_off_without_a_load_or_on_a_self_locking_screw() {
    for (task, self_locking) in
        [(TaskState::HoldActive, true), (TaskState::Idle, true), (TaskState::Idle, false)]
    {
        let mut rig = GripRig::in_task(task, self_locking);
        rig.stop_all();
        rig.run(100);
        assert_eq!((rig.grip.power(), rig.setpoint()), (PowerState::Armed, Setpoint::Off));
    }
}

#[test]
fn windings_are_shorted_only_by_the_reaction_brake() {
    for (trip, expected) in [(Trip::OverSpeed, Setpoint::Brake), (Trip::OverCurrent, Setpoint::Off)]
    {
        let mut rig = GripRig::holding(false);
        rig.motor.state = MotorState::Tripped(trip);
        for power in [PowerState::FaultReaction, PowerState::Fault] {
            rig.tick();
            assert_eq!((rig.grip.power(), rig.setpoint()), (power, expected), "{trip:?}");
            rig.run(300);
        }
    }
    // No fault of the table, but a failed self-test.
    let mut rig = GripRig::new(false);
    rig.is_sound = Some(false);
    rig.run(5);
    assert_eq!((rig.grip.power(), rig.setpoint()), (PowerState::Fault, Setpoint::Off));
}

#[test]
fn foot_has_one_ampere_on_a_backdrivable_screw() {
    for self_locking in [true, false] {
        let mut rig = GripRig::foot(self_locking);
        let is_off = |rig: &GripRig| rig.setpoint() == Setpoint::Off;
        rig.run(10);
        let held = Setpoint::Position { opening_mm: 0.5, speed_mm_s: 5.0, max_a: 1.0 };
        assert_eq!(rig.setpoint(), if self_locking { Setpoint::Off } else { held });
        rig.stop_all();
        for power in [PowerState::QuickStop, PowerState::Armed] {
            assert_eq!((rig.grip.power(), is_off(&rig)), (power, self_locking));
            if !self_locking {
                assert_speed(&rig, 0.0, 1.0);
            }
            rig.run(100);
        }
    }
}
