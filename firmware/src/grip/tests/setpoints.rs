//! Motor set-points of single states, with numbers worked out from the control laws.
//!
//! At the hardest contact (333 N/mm) and 32 Hz a force error of 1 N is 2 pi 32 / 333 = 0.60379 mm/s.

use crate::config::limits::GripLimits;
use crate::grip::GripController;
use crate::grip::commands::{GraspTarget, MoveTarget, WidthWindow};
use crate::grip::fault_reactions::Reaction;
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::GripRig;
use crate::motor::foc::Dq;
use crate::motor::screw::Screw;
use crate::motor::{MotorStatus, Setpoint};

/// Peak current: 0.96 N m / 0.1 N m/A.
const PEAK_A: f32 = 9.6;
/// Closing speed for one newton at the hardest contact.
const PER_N: f32 = 0.603_79;

fn at(opening_mm: f32) -> MotorStatus {
    MotorStatus { opening_mm: Some(opening_mm), ..MotorStatus::default() }
}

/// A controller in a state, with a grasp target of 100 N and an unlimited speed.
fn in_state(power: PowerState, task: TaskState, self_locking: bool) -> GripController {
    let screw = if self_locking { Screw::A } else { Screw::B };
    let mut grip = GripController::new(GripLimits::GRIPPER, screw, self_locking);
    (grip.power, grip.task, grip.setpoint_n) = (power, task, 100.0);
    grip.target = GraspTarget {
        setpoint_n: 100.0,
        max_mm_s: 60.0,
        cap_n: 100.0,
        window: None,
        is_fast: false,
    };
    grip
}

fn enabled(task: TaskState) -> GripController {
    in_state(PowerState::Enabled, task, true)
}

/// Compares the closing speed and the current limit of a speed set-point.
fn assert_speed(found: Setpoint, closing_mm_s: f32, max_a: f32) {
    let Setpoint::Speed { closing_mm_s: speed, max_a: limit_a } = found else {
        panic!("{found:?}");
    };
    assert!((speed - closing_mm_s).abs() < 1e-3, "{speed} instead of {closing_mm_s}");
    assert!((limit_a - max_a).abs() < 1e-3, "{limit_a} instead of {max_a}");
}

#[test]
fn uncalibrated_move_has_more_current_only_away_from_an_end() {
    let mut grip = enabled(TaskState::Moving);
    // Opening from the closed end, closing from the far end at 80 mm; the ends are 1 mm long.
    for (is_opening, opening_mm, leaves_end) in [
        (true, 0.0, true),
        (true, 0.9, true),
        (true, 1.0, false),
        (true, 79.5, false),
        (false, 80.0, true),
        (false, 79.1, true),
        (false, 79.0, false),
        (false, 0.5, false),
    ] {
        grip.is_opening = is_opening;
        let expected = if leaves_end { (5.0, 4.0) } else { (25.0, 0.6) };
        assert_eq!(
            grip.uncalibrated_limits(&at(opening_mm)),
            expected,
            "{is_opening} {opening_mm}"
        );
    }
    assert_eq!(grip.uncalibrated_limits(&MotorStatus::default()), (25.0, 0.6));
}

#[test]
fn move_is_limited_only_where_the_forces_are_not_believed() {
    let mut grip = enabled(TaskState::Moving);
    for (is_uncalibrated, requested_mm_s, speed_mm_s, max_a) in
        [(false, 40.0, 40.0, PEAK_A), (true, 40.0, 25.0, 0.6), (true, 20.0, 20.0, 0.6)]
    {
        grip.move_target =
            MoveTarget { opening_mm: 30.0, speed_mm_s: requested_mm_s, is_uncalibrated };
        let expected = Setpoint::Position { opening_mm: 30.0, speed_mm_s, max_a };
        assert_eq!(grip.motor_setpoint(&at(50.0)), expected);
    }
}

#[test]
fn release_is_slow_without_valid_forces_or_opening() {
    let mut grip = enabled(TaskState::Releasing);
    grip.move_target = MoveTarget { opening_mm: 60.0, speed_mm_s: 20.0, is_uncalibrated: false };
    let to = |speed_mm_s, max_a| Setpoint::Position { opening_mm: 60.0, speed_mm_s, max_a };
    assert_eq!(grip.motor_setpoint(&at(30.0)), to(20.0, PEAK_A));
    assert_speed(grip.motor_setpoint(&MotorStatus::default()), -10.0, 4.0);
    grip.invalid_ticks = 1;
    assert_eq!(grip.motor_setpoint(&at(30.0)), to(10.0, 4.0));
    grip.move_target.speed_mm_s = 4.0;
    assert_eq!(grip.motor_setpoint(&at(30.0)), to(4.0, 4.0));
    assert_speed(grip.motor_setpoint(&MotorStatus::default()), -4.0, 4.0);
}

#[test]
fn back_off_opens_to_50_n_and_never_closes() {
    let mut grip = in_state(PowerState::QuickStop, TaskState::Force, true);
    grip.backs_off = true;
    for (force_n, invalid_ticks, closing_mm_s) in [
        (52.0, 0, -2.0 * PER_N),
        (40.0, 0, 0.0),
        // Beyond 19.9 mm/s the square root: (8000 * 50 / 333 - 19.894^2)^0.5, at most 58.3 mm/s.
        (100.0, 0, -28.380),
        (400.0, 0, -58.3),
        (400.0, 1, -10.0),
        (52.0, 1, -2.0 * PER_N),
    ] {
        (grip.force_n, grip.invalid_ticks) = (force_n, invalid_ticks);
        assert_speed(grip.motor_setpoint(&at(50.0)), closing_mm_s, PEAK_A);
    }
    grip.backs_off = false;
    assert_speed(grip.motor_setpoint(&at(50.0)), 0.0, PEAK_A);
}

#[test]
fn approach_slows_down_two_millimetres_before_its_window() {
    let mut grip = enabled(TaskState::Approach);
    // (0.1 * 100 N + 2 N) / (333 N/mm * 2.5 ms).
    let slow_mm_s = 14.414;
    assert_speed(grip.motor_setpoint(&at(60.0)), slow_mm_s, PEAK_A);
    grip.target.window = Some(WidthWindow { min_mm: 31.0, max_mm: 39.0 });
    assert_speed(grip.motor_setpoint(&at(60.0)), slow_mm_s, PEAK_A);
    grip.target.is_fast = true;
    let moving = |opening_mm, closing_mm_s| MotorStatus { closing_mm_s, ..at(opening_mm) };
    assert_speed(grip.motor_setpoint(&moving(60.0, 0.0)), 58.3, PEAK_A);
    assert_speed(grip.motor_setpoint(&moving(41.1, 0.0)), 58.3, PEAK_A);
    assert_speed(grip.motor_setpoint(&moving(41.0, 0.0)), slow_mm_s, PEAK_A);
    // 4 ms ahead: 41.3 mm - 0.2 mm, and 41.2 mm - 0.4 mm.
    assert_speed(grip.motor_setpoint(&moving(41.3, 50.0)), 58.3, PEAK_A);
    assert_speed(grip.motor_setpoint(&moving(41.2, 100.0)), slow_mm_s, PEAK_A);
    grip.target.max_mm_s = 5.0;
    assert_speed(grip.motor_setpoint(&at(60.0)), 5.0, PEAK_A);
}

#[test]
fn suspected_contact_ends_the_approach_by_force() {
    let mut grip = enabled(TaskState::Approach);
    grip.contact.update(6.0, &GripLimits::GRIPPER);
    grip.force_n = 90.0;
    assert_speed(grip.motor_setpoint(&at(60.0)), 10.0 * PER_N, PEAK_A);
    grip.force_n = 105.0;
    assert_speed(grip.motor_setpoint(&at(60.0)), -5.0 * PER_N, PEAK_A);
    grip.force_n = 6.0;
    assert_speed(grip.motor_setpoint(&at(60.0)), 14.414, PEAK_A);
}

#[test]
fn force_control_assumes_at_least_50_n_per_mm() {
    let mut grip = enabled(TaskState::Force);
    grip.force_n = 90.0;
    assert_speed(grip.motor_setpoint(&at(60.0)), 10.0 * PER_N, PEAK_A);
    grip.target.max_mm_s = 5.0;
    assert_speed(grip.motor_setpoint(&at(60.0)), 5.0, PEAK_A);
    grip.target.max_mm_s = 60.0;
    // A force that falls while closing gives the softest estimate, 5 N/mm.
    for tick in 0_u8..100 {
        grip.stiffness.update(0.01 * f32::from(tick), -30.0 * f32::from(tick));
    }
    assert!((grip.stiffness() - 5.0).abs() < 1e-3);
    grip.force_n = 99.0;
    // 2 pi 32 / 50.
    assert_speed(grip.motor_setpoint(&at(60.0)), 4.0212, PEAK_A);
}

#[test]
fn hold_controls_the_mean_force_within_the_tolerance() {
    let mut grip = enabled(TaskState::HoldActive);
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
        (grip.setpoint_n, grip.force_n, grip.mean_n) = (setpoint_n, force_n, mean_n);
        grip.target.setpoint_n = setpoint_n;
        let found = grip.motor_setpoint(&at(40.0));
        assert_speed(found, beyond_n * PER_N, PEAK_A);
    }
}

/// Current limit after 300 ms of a constant mean force error.
fn hold_limit_a(setpoint_n: f32, mean_n: f32) -> f32 {
    let mut grip = enabled(TaskState::HoldActive);
    (grip.setpoint_n, grip.force_n, grip.mean_n) = (setpoint_n, setpoint_n, mean_n);
    let motor = MotorStatus { current_setpoint: Dq { d: 0.0, q: -3.0 }, ..at(40.0) };
    let mut limit_a = 0.0;
    for _ in 0..300 {
        match grip.motor_setpoint(&motor) {
            Setpoint::Speed { max_a, .. } => limit_a = max_a,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(grip.hold_a, 3.0);
    limit_a
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
        let limit_a = hold_limit_a(setpoint_n, mean_n);
        assert_eq!(limit_a < PEAK_A, decreases, "{setpoint_n} {mean_n}: {limit_a}");
    }
}

#[test]
fn current_of_a_latched_hold_ends_after_20_ms() {
    let mut grip = enabled(TaskState::HoldLatched);
    grip.hold_a = 2.0;
    for (task_ms, closing_a) in [(0, 2.0), (5, 1.5), (19, 0.1)] {
        grip.task_ms = task_ms;
        let Setpoint::Current { closing_a: found } = grip.motor_setpoint(&at(40.0)) else {
            panic!("{task_ms}");
        };
        assert!((found - closing_a).abs() < 1e-6, "{task_ms}: {found}");
    }
    for task_ms in [20, 21, 1000] {
        grip.task_ms = task_ms;
        assert_eq!(grip.motor_setpoint(&at(40.0)), Setpoint::Off);
    }
}

#[test]
fn resting_states_hold_their_position() {
    use TaskState::{GripFailed, HoldFrozen, Idle, Lost, NoObject, TimeoutHold};
    for task in [Idle, NoObject, GripFailed, Lost, TimeoutHold, HoldFrozen] {
        let mut grip = in_state(PowerState::Enabled, task, false);
        grip.hold_a = 2.5;
        let max_a = if task == HoldFrozen { 2.5 } else { PEAK_A };
        assert_speed(grip.motor_setpoint(&at(40.0)), 0.0, max_a);
        grip.hold_mm = Some(39.5);
        let expected = Setpoint::Position { opening_mm: 39.5, speed_mm_s: 5.0, max_a };
        assert_eq!(grip.motor_setpoint(&at(40.0)), expected, "{task:?}");
        assert_speed(grip.motor_setpoint(&MotorStatus::default()), 0.0, max_a);
    }
    let mut frozen = enabled(HoldFrozen);
    assert_eq!(frozen.motor_setpoint(&at(40.0)), Setpoint::Off);
    for task in [TaskState::ContactStop, TaskState::Stopping] {
        assert_speed(enabled(task).motor_setpoint(&at(40.0)), 0.0, PEAK_A);
    }
    assert_eq!(enabled(TaskState::Unhomed).motor_setpoint(&at(40.0)), Setpoint::Off);
}

#[test]
fn disabled_gripper_holds_a_load_only_on_a_backdrivable_screw() {
    for self_locking in [true, false] {
        let mut grip = in_state(PowerState::Armed, TaskState::HoldActive, self_locking);
        assert_eq!(grip.motor_setpoint(&at(40.0)), Setpoint::Off);
        (grip.is_gripped, grip.force_n, grip.hold_mm) = (true, 100.0, Some(40.0));
        if self_locking {
            assert_eq!(grip.motor_setpoint(&at(40.0)), Setpoint::Off);
            continue;
        }
        // Screw B: 100 N * 1.0227 mm/rad * (1 - 0.5649) / 0.1 N m/A = 0.44503 A, times 1.4.
        for (hold_a, max_a) in [(0.1, 0.623_05), (2.0, 2.0)] {
            grip.hold_a = hold_a;
            let Setpoint::Position { opening_mm, speed_mm_s, max_a: found } =
                grip.motor_setpoint(&at(40.0))
            else {
                panic!("no position");
            };
            assert_eq!((opening_mm, speed_mm_s), (40.0, 5.0));
            assert!((found - max_a).abs() < 1e-4, "{found}");
        }
    }
}

#[test]
fn foot_has_one_ampere_on_a_backdrivable_screw() {
    for power in [PowerState::Enabled, PowerState::Armed, PowerState::QuickStop] {
        let mut grip = in_state(power, TaskState::Foot, true);
        assert_eq!(grip.motor_setpoint(&at(0.5)), Setpoint::Off);
        grip = in_state(power, TaskState::Foot, false);
        grip.hold_mm = Some(0.5);
        let expected = Setpoint::Position { opening_mm: 0.5, speed_mm_s: 5.0, max_a: 1.0 };
        assert_eq!(grip.motor_setpoint(&at(0.5)), expected, "{power:?}");
    }
}

#[test]
fn windings_are_shorted_only_by_the_reaction_brake() {
    for power in [PowerState::FaultReaction, PowerState::Fault] {
        let mut grip = in_state(power, TaskState::HoldActive, false);
        for (reaction, expected) in [
            (Reaction::Brake, Setpoint::Brake),
            (Reaction::Off, Setpoint::Off),
            (Reaction::Warn, Setpoint::Off),
        ] {
            grip.reaction = reaction;
            assert_eq!(grip.motor_setpoint(&at(40.0)), expected);
        }
    }
    for power in [PowerState::Boot, PowerState::SelfTest, PowerState::Safe, PowerState::ArmPending]
    {
        let mut grip = in_state(power, TaskState::HoldActive, false);
        assert_eq!(grip.motor_setpoint(&at(40.0)), Setpoint::Off);
    }
}

#[test]
fn holding_current_of_a_rig_is_that_of_its_motor() {
    let mut rig = GripRig::holding(false);
    rig.motor.current_setpoint = Dq { d: 0.0, q: 1.75 };
    rig.tick();
    assert_eq!(rig.grip.hold_a, 1.75);
}
