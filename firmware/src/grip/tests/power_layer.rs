//! Details of the power layer: limits of a calibration, ends of stops and fault reactions, estimates of rest and mean force.

use crate::config::limits::GripLimits;
use crate::estimator::{Estimate, Validity};
use crate::grip::commands::{RefusalReason, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::{GripRig, pressed};
use crate::grip::{ArmingRequest, ControlInputs, ControlOutputs, GripController, SessionStatus};
use crate::motor::calibration::{CalibrationFailure, CalibrationKind};
use crate::motor::foc::Dq;
use crate::motor::screw::Screw;
use crate::motor::{MotorState, MotorStatus, Setpoint, Trip};
use crate::sensors::hall::SENSORS;
use crate::system::faults::Fault;

const LIMITS: GripLimits = GripLimits::GRIPPER;
const MISSING: [Estimate; SENSORS] = [Estimate::MISSING; SENSORS];

fn bit(fault: Fault) -> u32 {
    1 << fault.index()
}

/// Estimates of equal forces on both fingers.
fn both(newtons: f64) -> [Estimate; SENSORS] {
    let half = 0.5 * newtons;
    pressed([half, half, -half, -half], [0.0; 4])
}

fn armed_motor() -> MotorStatus {
    MotorStatus { state: MotorState::Armed, opening_mm: Some(50.0), ..MotorStatus::default() }
}

/// One step with these estimates and this motor, and a live host.
fn step(
    grip: &mut GripController,
    estimates: &[Estimate; SENSORS],
    motor: MotorStatus,
) -> ControlOutputs {
    grip.tick(&ControlInputs {
        estimates,
        motor,
        host: SessionStatus { is_offered: false, is_open: true, is_alive: true },
        command: None,
        stop: false,
        clear: false,
        faults: 0,
        is_sound: Some(true),
        is_calibrating: false,
        acceleration: None,
    })
}

/// A controller in a power state, with a backdrivable screw.
fn in_power(power: PowerState) -> GripController {
    let mut grip = GripController::new(LIMITS, Screw::B, false);
    (grip.power, grip.task) = (power, TaskState::Idle);
    grip
}

#[test]
fn late_control_loop_differs_from_accelerating_rotor() {
    for (trip, detail) in [(Trip::Runaway, 0), (Trip::CommandTimeout, 1)] {
        let tripped = MotorStatus { state: MotorState::Tripped(trip), ..armed_motor() };
        let outputs = step(&mut in_power(PowerState::Enabled), &both(0.0), tripped);
        let event = outputs.events.iter().find(|event| event.code == Fault::Runaway as u16);
        assert_eq!(event.map(|event| event.detail), Some(detail), "{trip:?}");
    }
}

#[test]
fn calibration_ends_at_faults_but_not_at_trips_and_warnings() {
    let motor = MotorStatus::default();
    for (faults, expected) in [
        (0, None),
        (bit(Fault::SensorLost), Some(CalibrationFailure::Fault)),
        (bit(Fault::PowerStage), None),
        (bit(Fault::OverCurrent) | bit(Fault::Runaway), None),
        (bit(Fault::OverCurrent) | bit(Fault::SensorFrozen), Some(CalibrationFailure::Fault)),
        (bit(Fault::HostSilent), None),
    ] {
        let mut grip = in_power(PowerState::Calibrating);
        let found = grip.calibration_failure(CalibrationKind::Motor, &motor, faults);
        assert_eq!(found, expected, "{faults:#x}");
    }
    // A fault of the grip itself, with and without the same fault from another task.
    let mut grip = in_power(PowerState::Calibrating);
    for _ in 0..5 {
        step(&mut grip, &MISSING, motor);
    }
    for faults in [0, bit(Fault::Blind)] {
        let found = grip.calibration_failure(CalibrationKind::Motor, &motor, faults);
        assert_eq!(found, Some(CalibrationFailure::Fault));
    }
}

#[test]
fn calibration_ends_at_20_n_or_200_n_or_15_n_outward() {
    use CalibrationKind::{Motor, Screw};
    for (kind, force_n, rise_n, is_over) in [
        (Motor, 20.0, 0.0, false),
        (Motor, 20.1, 0.0, true),
        (Motor, 0.0, 20.0, false),
        (Motor, 0.0, 20.1, true),
        (Screw, 200.0, 0.0, false),
        (Screw, 200.1, 0.0, true),
    ] {
        let mut grip = in_power(PowerState::Calibrating);
        (grip.force_n, grip.rise_n) = (force_n, rise_n);
        let found = grip.calibration_failure(kind, &MotorStatus::default(), 0);
        assert_eq!(found, is_over.then_some(CalibrationFailure::Force), "{force_n} {rise_n}");
    }
    for (newtons, is_over) in [(-15.0, false), (-15.5, true)] {
        let mut grip = in_power(PowerState::Calibrating);
        step(&mut grip, &both(newtons), MotorStatus::default());
        let found = grip.calibration_failure(Motor, &MotorStatus::default(), 0);
        assert_eq!(found, is_over.then_some(CalibrationFailure::Force), "{newtons}");
    }
}

#[test]
fn calibration_ends_at_a_part_softer_than_30_n_per_mm() {
    let at = |rotor_mm: f32| MotorStatus {
        rotor_rad: rotor_mm / Screw::B.ratio_mm,
        ..MotorStatus::default()
    };
    // From contact at 3 mm: rise of the force, rotor position in millimetres. 21 N over 0.7 mm are 30 N/mm.
    for (rise_n, rotor_mm, is_soft) in [
        (26.0, 3.68, false),
        (26.0, 3.72, true),
        (25.0, 9.0, false),
        (25.1, 9.0, true),
        (24.0, 9.0, false),
        (60.0, 4.8, false),
        (60.0, 4.9, true),
        (26.0, 2.0, false),
    ] {
        let mut grip = in_power(PowerState::Calibrating);
        grip.rise_n = 5.0;
        assert_eq!(grip.calibration_failure(CalibrationKind::Screw, &at(3.0), 0), None);
        grip.rise_n = rise_n;
        let found = grip.calibration_failure(CalibrationKind::Screw, &at(rotor_mm), 0);
        let expected = is_soft.then_some(CalibrationFailure::SoftPart);
        assert_eq!(found, expected, "{rise_n} {rotor_mm}");
        // Below the force of a contact it begins again.
        grip.rise_n = 4.9;
        assert_eq!(grip.calibration_failure(CalibrationKind::Screw, &at(9.0), 0), None);
        grip.rise_n = 26.0;
        assert_eq!(grip.calibration_failure(CalibrationKind::Screw, &at(9.0), 0), None);
        let again = grip.calibration_failure(CalibrationKind::Screw, &at(9.72), 0);
        assert_eq!(again, Some(CalibrationFailure::SoftPart));
    }
}

#[test]
fn part_of_exactly_the_minimum_stiffness_is_not_soft() {
    let mut grip = in_power(PowerState::Calibrating);
    // At the contact both the rise above it and the travel are zero.
    (grip.rise_n, grip.limits.part_n) = (5.0, 4.0);
    let motor = MotorStatus::default();
    assert_eq!(grip.calibration_failure(CalibrationKind::Screw, &motor, 0), None);
}

#[test]
fn calibration_lasts_until_its_request_ends() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.is_calibrating = true;
    for _ in 0..10 {
        rig.tick();
        assert_eq!(rig.grip.power(), PowerState::Calibrating);
    }
    rig.is_calibrating = false;
    rig.tick();
    assert_eq!(rig.grip.power(), PowerState::Safe);
}

/// Steps in a power state until it ends, with moving or resting fingers and a force.
fn lasts(power: PowerState, backs_off: bool, closing_mm_s: f32, newtons: f64) -> Option<u32> {
    let mut grip = in_power(power);
    grip.backs_off = backs_off;
    let motor = MotorStatus { closing_mm_s, ..armed_motor() };
    (1..3000).find(|_| {
        step(&mut grip, &both(newtons), motor);
        grip.power() != power
    })
}

#[test]
fn stops_and_reactions_end_at_rest_or_by_timeout() {
    use PowerState::{FaultReaction, QuickStop};
    assert_eq!(lasts(FaultReaction, false, 0.0, 0.0), Some(5));
    assert_eq!(lasts(FaultReaction, false, 10.0, 0.0), Some(200));
    assert_eq!(lasts(QuickStop, false, 0.0, 0.0), Some(5));
    assert_eq!(lasts(QuickStop, false, 10.0, 0.0), Some(200));
    assert_eq!(lasts(QuickStop, false, 0.0, 100.0), Some(5));
    // After excessive force, below 1.2 * 50 N, or after two seconds.
    assert_eq!(lasts(QuickStop, true, 0.0, 59.0), Some(5));
    assert_eq!(lasts(QuickStop, true, 0.0, 61.0), Some(2000));
    assert_eq!(lasts(QuickStop, true, 10.0, 59.0), Some(2000));
}

#[test]
fn stop_after_excessive_force_lasts_at_its_release_force() {
    // 1.2 times 62.5 N.
    for (newtons, is_over) in [(74.75, true), (75.0, false)] {
        let mut grip = in_power(PowerState::QuickStop);
        (grip.backs_off, grip.limits.overforce_release_n) = (true, 62.5);
        for _ in 0..5 {
            step(&mut grip, &both(newtons), armed_motor());
        }
        assert_eq!(grip.power() == PowerState::Armed, is_over, "{newtons}");
    }
}

#[test]
fn rest_is_five_milliseconds_below_half_a_millimetre_per_second() {
    let mut grip = in_power(PowerState::Armed);
    let moving = |closing_mm_s| MotorStatus { closing_mm_s, ..armed_motor() };
    // The velocity filter has a quarter of the first sample: 0.5 mm/s is no rest, 0.375 is.
    step(&mut grip, &both(0.0), moving(2.0));
    assert_eq!(grip.resting_ms, 0);
    step(&mut grip, &both(0.0), moving(0.0));
    assert_eq!(grip.resting_ms, 1);
    for _ in 0..3 {
        step(&mut grip, &both(0.0), moving(0.0));
        assert!(!grip.is_at_rest());
    }
    step(&mut grip, &both(0.0), moving(0.0));
    assert!(grip.is_at_rest());
    for _ in 0..4 {
        step(&mut grip, &both(0.0), moving(-3.0));
    }
    assert!(!grip.is_at_rest());
}

#[test]
fn mean_forces_and_current_follow_by_a_sixteenth() {
    let mut grip = in_power(PowerState::Armed);
    let motor = MotorStatus { current: Dq { d: 0.0, q: -1.6 }, ..armed_motor() };
    let left_and_right = |left: f64, right: f64| {
        pressed([0.5 * left, 0.5 * left, -0.5 * right, -0.5 * right], [0.0; 4])
    };
    step(&mut grip, &left_and_right(16.0, 8.0), motor);
    assert_eq!((grip.means_n, grip.mean_n), ([Some(16.0), Some(8.0)], 15.0));
    assert!((grip.opening_a - 0.1).abs() < 1e-6);
    step(&mut grip, &left_and_right(32.0, 56.0), motor);
    assert_eq!((grip.means_n, grip.mean_n), ([Some(17.0), Some(11.0)], 16.0));
    // 0.1 + (1.6 - 0.1) / 16.
    assert!((grip.opening_a - 0.193_75).abs() < 1e-6);
    let mut estimates = left_and_right(17.0, 11.0);
    estimates[0] = Estimate::MISSING;
    step(&mut grip, &estimates, motor);
    assert_eq!((grip.means_n, grip.mean_n), ([None, Some(11.0)], 11.0));
}

#[test]
fn obstacle_is_forgotten_after_closing_by_6_mm() {
    let turned = |closing_mm: f32| MotorStatus {
        rotor_rad: 100.0 + closing_mm / Screw::B.ratio_mm,
        ..armed_motor()
    };
    for (closing_mm, is_forgotten) in [(5.9, false), (6.1, true), (-50.0, false)] {
        let mut grip = in_power(PowerState::Armed);
        grip.obstacle_rad = Some(100.0);
        step(&mut grip, &MISSING, turned(closing_mm));
        assert_eq!(grip.obstacle_rad.is_none(), is_forgotten, "{closing_mm}");
    }
    // Exactly at the limit it is kept: one radian.
    let mut grip = in_power(PowerState::Armed);
    (grip.obstacle_rad, grip.limits.clear_mm) = (Some(100.0), Screw::B.ratio_mm);
    step(&mut grip, &MISSING, MotorStatus { rotor_rad: 101.0, ..armed_motor() });
    assert_eq!(grip.obstacle_rad, Some(100.0));
    let mut grip = in_power(PowerState::Armed);
    grip.obstacle_rad = Some(100.0);
    step(&mut grip, &both(0.0), turned(0.0));
    assert_eq!(grip.obstacle_rad, None);
}

#[test]
fn rise_of_a_held_force_does_not_decay() {
    let mut rig = GripRig::holding(true);
    rig.run(8000);
    assert!(rig.grip.rise_n > 97.0, "{}", rig.grip.rise_n);
    // An offset without a grip does, with a time constant of 8.2 s.
    let mut rig = GripRig::enabled(true);
    rig.run(20);
    rig.offset_n = 4.0;
    rig.run(8192);
    assert!((rig.grip.rise_n - 4.0 / std::f32::consts::E).abs() < 0.05, "{}", rig.grip.rise_n);
}

#[test]
fn stiffness_and_force_of_a_grip_are_reported() {
    let mut rig = GripRig::enabled(true);
    assert_eq!((rig.grip.stiffness(), rig.grip.force_n()), (333.0, 0.0));
    rig.object = Some((40.0, 50.0));
    rig.send(mode::GRIP, |command| command.force = 1000);
    rig.run_until(TaskState::HoldActive);
    assert!((rig.grip.stiffness() - 50.0).abs() < 5.0, "{}", rig.grip.stiffness());
    assert!((rig.grip.force_n() - 100.0).abs() < 2.0, "{}", rig.grip.force_n());
}

#[test]
fn only_some_states_move_drive_or_are_loaded() {
    use PowerState::{Armed, Enabled, Fault as Faulty, FaultReaction, QuickStop, Safe};
    for (power, task, moves, drives) in [
        (Safe, TaskState::Moving, false, false),
        (Armed, TaskState::Moving, false, true),
        (Enabled, TaskState::Moving, true, true),
        (Enabled, TaskState::Idle, false, true),
        (QuickStop, TaskState::Idle, true, true),
        (FaultReaction, TaskState::Idle, true, true),
        (Faulty, TaskState::Moving, false, false),
    ] {
        let mut grip = in_power(power);
        grip.task = task;
        assert_eq!((grip.is_moving(), grip.is_driven()), (moves, drives), "{power:?} {task:?}");
        assert!(!grip.is_loaded());
        grip.is_gripped = true;
        assert!(grip.is_loaded());
    }
    let mut foot = in_power(Enabled);
    foot.task = TaskState::Foot;
    assert!(foot.is_loaded());
}

#[test]
fn both_fingers_above_20_n_may_be_loaded() {
    for (left, right, may_be) in
        [(21.0, 21.0, true), (20.0, 21.0, false), (21.0, 20.0, false), (21.0, -30.0, false)]
    {
        let mut grip = in_power(PowerState::Armed);
        let estimates = pressed([left, 0.0, -right, 0.0], [0.0; 4]);
        step(&mut grip, &estimates, armed_motor());
        assert_eq!(grip.may_be_loaded(), may_be, "{left} {right}");
    }
    let mut grip = in_power(PowerState::Armed);
    step(&mut grip, &MISSING, armed_motor());
    assert!(!grip.may_be_loaded());
}

#[test]
fn screw_changes_only_while_safe() {
    for (power, changes) in
        [(PowerState::Safe, true), (PowerState::Armed, false), (PowerState::Enabled, false)]
    {
        let mut grip = in_power(power);
        grip.set_self_locking(true);
        assert_eq!(grip.self_locking, changes, "{power:?}");
    }
}

#[test]
fn enabling_again_after_a_quick_stop_is_a_new_command() {
    let mut rig = GripRig::enabled(true);
    rig.fault(Fault::SensorLost, true);
    rig.run(100);
    rig.fault(Fault::SensorLost, false);
    rig.clear = true;
    rig.tick();
    rig.clear = false;
    assert_eq!(rig.grip.power(), PowerState::Armed);
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.grip.power(), PowerState::Enabled);
}

#[test]
fn lost_rotor_angle_brakes_unless_the_screw_holds_an_object() {
    for (self_locking, is_gripped, expected) in [
        (true, false, Setpoint::Brake),
        (true, true, Setpoint::Off),
        (false, false, Setpoint::Brake),
        (false, true, Setpoint::Brake),
    ] {
        let mut rig = GripRig::new(self_locking);
        rig.run(5);
        rig.arm();
        rig.grip.is_gripped = is_gripped;
        rig.grip.copy();
        rig.motor.state = MotorState::Tripped(Trip::Encoder);
        rig.tick();
        assert_eq!(rig.setpoint(), expected, "{self_locking} {is_gripped}");
    }
}

#[test]
fn overload_begins_above_its_threshold() {
    for (newtons, is_over) in [(200.0, false), (200.25, true)] {
        let mut rig = GripRig::foot(true);
        rig.grip.limits.overload_n = 200.0;
        rig.estimates = Some(pressed([0.0; 4], [newtons, 0.0, 0.0, 0.0]));
        rig.tick();
        assert_eq!(rig.grip.fault_bits() & bit(Fault::FootOverload) != 0, is_over, "{newtons}");
        let detail = rig.outputs.as_ref().unwrap().events.first().map(|event| event.detail);
        // 200.25 N * 1024.
        assert_eq!(detail, is_over.then_some(205_056));
    }
}

#[test]
fn blind_fault_needs_three_ticks_without_both_fingers() {
    let mut rig = GripRig::enabled(true);
    let blind = |rig: &GripRig| rig.grip.fault_bits() & bit(Fault::Blind) != 0;
    rig.corrupt = Some(|estimates| *estimates = MISSING);
    rig.run(2);
    assert!(!blind(&rig));
    rig.tick();
    assert!(blind(&rig));
    rig.corrupt = Some(|estimates| estimates[0].validity = Validity::Saturated);
    rig.tick();
    assert!(!blind(&rig));
}

#[test]
fn motor_is_armed_and_disarmed_with_the_power_state() {
    for (power, state, expected) in [
        (PowerState::Armed, MotorState::Disarmed, Some(ArmingRequest::Arm)),
        (PowerState::Armed, MotorState::Armed, None),
        (PowerState::Armed, MotorState::Arming, None),
        (PowerState::Safe, MotorState::Armed, Some(ArmingRequest::Disarm)),
        (PowerState::Safe, MotorState::Arming, Some(ArmingRequest::Disarm)),
        (PowerState::Safe, MotorState::Disarmed, None),
    ] {
        let mut grip = in_power(power);
        grip.self_locking = true;
        let motor = MotorStatus { state, ..armed_motor() };
        let outputs = grip.tick(&ControlInputs {
            estimates: &both(0.0),
            motor,
            host: SessionStatus {
                is_offered: false,
                is_open: power == PowerState::Armed,
                is_alive: true,
            },
            command: None,
            stop: false,
            clear: false,
            faults: 0,
            is_sound: Some(true),
            is_calibrating: false,
            acceleration: None,
        });
        assert_eq!(outputs.arming, expected, "{power:?} {state:?}");
    }
}

#[test]
fn refused_command_is_reported_and_an_accepted_one_is_not() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::LEAVE, |_| {});
    assert_eq!(rig.refused, [RefusalReason::NotApplicable]);
    rig.send(mode::STOP, |_| {});
    rig.send(mode::MOVE, |command| (command.position, command.speed) = (200, 40));
    assert_eq!(rig.refused.len(), 1);
    assert_eq!(rig.grip.task(), TaskState::Moving);
}
