//! The power layer, its faults and the observation of the fingers from outside: ends of a calibration, of stops and fault
//! reactions; rest and mean force.

use crate::config::limits::GripLimits;
use crate::estimator::{Estimate, Validity};
use crate::grip::commands::{RefusalReason, mode};
use crate::grip::contact_observer::ContactObserver;
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::{GripRig, pressed};
use crate::grip::{ArmingRequest, ControlInputs, GripSettings, SessionStatus};
use crate::motor::calibration::{CalibrationFailure, CalibrationKind};
use crate::motor::screw::Screw;
use crate::motor::{MotorState, MotorStatus, Setpoint, Trip};
use crate::sensors::hall::SENSORS;
use crate::system::faults::Fault;

const MISSING: [Estimate; SENSORS] = [Estimate::MISSING; SENSORS];

fn bit(fault: Fault) -> u32 {
    1 << fault.index()
}

#[test]
fn late_control_loop_differs_from_accelerating_rotor() {
    for (trip, detail) in [(Trip::Runaway, 0), (Trip::CommandTimeout, 1)] {
        let mut rig = GripRig::enabled(false);
        rig.motor.state = MotorState::Tripped(trip);
        rig.tick();
        assert_eq!(rig.new_fault(Fault::Runaway), Some(detail), "{trip:?}");
    }
}

/// A calibration whose fingers rest with a force.
fn calibrating(limits: GripLimits, newtons: f64) -> GripRig {
    let mut rig = GripRig::with_limits(false, limits);
    rig.press(newtons);
    rig.is_calibrating = true;
    rig.run(5);
    assert_eq!(rig.grip.power(), PowerState::Calibrating);
    rig
}

#[test]
fn calibration_ends_at_faults_but_not_at_trips_and_warnings() {
    let motor = MotorStatus::default();
    let mut rig = calibrating(GripLimits::GRIPPER, 0.0);
    for (faults, is_over) in [
        (0, false),
        (bit(Fault::SensorLost), true),
        (bit(Fault::PowerStage), false),
        (bit(Fault::OverCurrent) | bit(Fault::Runaway), false),
        (bit(Fault::OverCurrent) | bit(Fault::SensorFrozen), true),
        (bit(Fault::HostSilent), false),
    ] {
        let found = rig.grip.calibration_failure(CalibrationKind::Motor, &motor, faults);
        assert_eq!(found, is_over.then_some(CalibrationFailure::Fault), "{faults:#x}");
    }
    // A fault of the grip itself, with and without the same fault from another task.
    rig.estimates = Some(MISSING);
    rig.run(5);
    for faults in [0, bit(Fault::Blind)] {
        let found = rig.grip.calibration_failure(CalibrationKind::Motor, &motor, faults);
        assert_eq!(found, Some(CalibrationFailure::Fault));
    }
}

#[test]
fn calibration_ends_at_20_n_or_200_n_or_15_n_outward() {
    use CalibrationKind::{Motor, Screw};
    // The force when it began, and now: a rise counts as a force.
    for (kind, from_n, newtons, is_over) in [
        (Motor, 20.0, 20.0, false),
        (Motor, 20.1, 20.1, true),
        (Motor, -15.0, 5.0, false),
        (Motor, -15.0, 5.1, true),
        (Screw, 200.0, 200.0, false),
        (Screw, 200.1, 200.1, true),
        (Motor, 0.0, -15.0, false),
        (Motor, 0.0, -15.25, true),
    ] {
        let mut rig = calibrating(GripLimits::GRIPPER, from_n);
        rig.tick_pressed(newtons);
        let found = rig.grip.calibration_failure(kind, &MotorStatus::default(), 0);
        assert_eq!(found, is_over.then_some(CalibrationFailure::Force), "{from_n} {newtons}");
    }
}

/// Why a calibration of the screw ends at a force in newtons and a rotor position in millimetres.
fn failure(rig: &mut GripRig, newtons: f64, rotor_mm: f32) -> Option<CalibrationFailure> {
    rig.tick_pressed(newtons);
    let rotor_rad = rotor_mm / Screw::B.ratio_mm;
    let motor = MotorStatus { rotor_rad, ..MotorStatus::default() };
    rig.grip.calibration_failure(CalibrationKind::Screw, &motor, 0)
}

#[test]
fn calibration_ends_at_a_part_softer_than_30_n_per_mm() {
    let soft = Some(CalibrationFailure::SoftPart);
    // From contact at 3 mm: rise of the force, rotor position in millimetres. 21 N over 0.7 mm are 30 N/mm.
    for (newtons, rotor_mm, is_soft) in [
        (26.0, 3.68, false),
        (26.0, 3.72, true),
        (25.0, 9.0, false),
        (25.1, 9.0, true),
        (24.0, 9.0, false),
        (60.0, 4.8, false),
        (60.0, 4.9, true),
        (26.0, 2.0, false),
    ] {
        let mut rig = calibrating(GripLimits::GRIPPER, 0.0);
        assert_eq!(failure(&mut rig, 5.0, 3.0), None);
        let expected = soft.filter(|_| is_soft);
        assert_eq!(failure(&mut rig, newtons, rotor_mm), expected, "{newtons} {rotor_mm}");
        // Below the force of a contact it begins again.
        assert_eq!(failure(&mut rig, 4.9, 9.0), None);
        assert_eq!(failure(&mut rig, 26.0, 9.0), None);
        assert_eq!(failure(&mut rig, 26.0, 9.72), soft);
    }
    // At the contact both the rise above it and the travel are zero: exactly the minimum stiffness is not soft.
    let mut rig = calibrating(GripLimits { part_n: 4.0, ..GripLimits::GRIPPER }, 0.0);
    assert_eq!(failure(&mut rig, 5.0, 0.0), None);
}

#[test]
fn stops_and_reactions_end_at_rest_or_by_timeout() {
    use PowerState::{FaultReaction, QuickStop};
    let softer = GripLimits { overforce_release_n: 62.5, ..GripLimits::GRIPPER };
    // Excessive force that caused the stop, speed, and force after it; milliseconds.
    for (power, limits, over_n, closing_mm_s, newtons, lasts_ms) in [
        (FaultReaction, GripLimits::GRIPPER, 0.0, 0.0, 0.0, 5),
        (FaultReaction, GripLimits::GRIPPER, 0.0, 10.0, 0.0, 200),
        (QuickStop, GripLimits::GRIPPER, 0.0, 0.0, 0.0, 5),
        (QuickStop, GripLimits::GRIPPER, 0.0, 10.0, 0.0, 200),
        (QuickStop, GripLimits::GRIPPER, 0.0, 0.0, 100.0, 5),
        // Until the force is below 1.2 * 50 N, or for two seconds.
        (QuickStop, GripLimits::GRIPPER, 500.0, 0.0, 59.0, 5),
        (QuickStop, GripLimits::GRIPPER, 500.0, 0.0, 61.0, 2000),
        (QuickStop, GripLimits::GRIPPER, 500.0, 10.0, 59.0, 2000),
        // 1.2 * 62.5 N.
        (QuickStop, softer, 500.0, 0.0, 74.75, 5),
        (QuickStop, softer, 500.0, 0.0, 75.0, 2000),
    ] {
        let mut rig = GripRig::with_limits(false, limits);
        rig.enable();
        rig.press(over_n);
        rig.stop = power == QuickStop && over_n == 0.0;
        if power == FaultReaction {
            rig.motor.state = MotorState::Tripped(Trip::OverSpeed);
        }
        rig.moving(50.0, closing_mm_s, 0.0);
        assert_eq!(rig.grip.power(), power);
        rig.stop = false;
        rig.press(newtons);
        let ended_ms = (1..3000).find(|_| {
            rig.moving(50.0, closing_mm_s, 0.0);
            rig.grip.power() != power
        });
        assert_eq!(ended_ms, Some(lasts_ms), "{power:?} {over_n} {closing_mm_s} {newtons}");
    }
}

/// Adds one millisecond of forces of both fingers in newtons, none of an invalid one, and a speed.
fn observe(
    observer: &mut ContactObserver,
    [left, right]: [Option<f64>; 2],
    closing_mm_s: f32,
    is_unloaded: bool,
) {
    let half = [left, right].map(|newtons| 0.5 * newtons.unwrap_or_default());
    let mut estimates = pressed([half[0], half[0], -half[1], -half[1]], [0.0; 4]);
    for (finger, newtons) in [left, right].iter().enumerate() {
        if newtons.is_none() {
            estimates[2 * finger] = Estimate::MISSING;
        }
    }
    let inputs = ControlInputs {
        estimates: &estimates,
        motor: MotorStatus { closing_mm_s, ..MotorStatus::default() },
        host: SessionStatus::default(),
        command: None,
        stop: false,
        clear: false,
        faults: 0,
        is_sound: Some(true),
        is_calibrating: false,
        acceleration: None,
    };
    observer.update(&inputs, &SETTINGS, is_unloaded, false);
}

const SETTINGS: GripSettings =
    GripSettings { limits: GripLimits::GRIPPER, screw: Screw::B, self_locking: false };

#[test]
fn rest_is_five_milliseconds_below_half_a_millimetre_per_second() {
    let mut observer = ContactObserver::default();
    // The velocity filter has a quarter of the first sample: 0.5 mm/s is no rest, 0.375 is.
    let speeds = [2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -3.0];
    let expected = [false, false, false, false, false, true, false];
    let found = speeds.map(|closing_mm_s| {
        observe(&mut observer, [Some(0.0); 2], closing_mm_s, true);
        observer.is_at_rest(&SETTINGS)
    });
    assert_eq!(found, expected);
}

#[test]
fn mean_forces_follow_by_a_sixteenth() {
    let mut observer = ContactObserver::default();
    // Means of the fingers 16 N and 8 N, 17 N and 11 N, then of the right one alone.
    for (forces, mean_n) in [
        ([Some(16.0), Some(8.0)], 15.0),
        ([Some(32.0), Some(56.0)], 16.0),
        ([None, Some(11.0)], 11.0),
    ] {
        observe(&mut observer, forces, 0.0, true);
        assert_eq!(observer.mean_n(), mean_n);
    }
}

#[test]
fn rise_of_a_held_force_does_not_decay() {
    // An offset without a grip does, with a time constant of 8.2 s.
    for (is_unloaded, rise_n) in [(false, 4.0), (true, 4.0 / std::f32::consts::E)] {
        let mut observer = ContactObserver::default();
        observe(&mut observer, [Some(0.0); 2], 0.0, is_unloaded);
        for _ in 0..8192 {
            observe(&mut observer, [Some(4.0); 2], 0.0, is_unloaded);
        }
        assert!((observer.rise_n() - rise_n).abs() < 0.01, "{}", observer.rise_n());
    }
}

#[test]
fn only_some_states_move_or_drive() {
    type Lead = fn(&mut GripRig);
    let trip: Lead = |rig| rig.motor.state = MotorState::Tripped(Trip::OverSpeed);
    let cases: [(TaskState, Lead, u32, PowerState, bool, bool); 6] = [
        (TaskState::Moving, |_| {}, 0, PowerState::Enabled, true, true),
        (TaskState::Idle, |_| {}, 0, PowerState::Enabled, false, true),
        (TaskState::Moving, |rig| rig.stop = true, 1, PowerState::QuickStop, true, true),
        (TaskState::Moving, GripRig::stop_all, 300, PowerState::Armed, false, true),
        (TaskState::Moving, trip, 1, PowerState::FaultReaction, true, true),
        (TaskState::Moving, trip, 300, PowerState::Fault, false, false),
    ];
    for (task, lead, ticks, power, moves, drives) in cases {
        let mut rig = GripRig::in_task(task, false);
        lead(&mut rig);
        rig.run(ticks);
        assert_eq!(rig.grip.power(), power);
        assert_eq!((rig.grip.is_moving(), rig.grip.is_driven()), (moves, drives), "{power:?}");
    }
    // Until it is armed the motor is off.
    let mut rig = GripRig::new(false);
    rig.host.is_offered = true;
    for power in [PowerState::SelfTest, PowerState::Safe, PowerState::ArmPending] {
        rig.tick();
        assert_eq!((rig.grip.power(), rig.setpoint()), (power, Setpoint::Off));
        assert!(!rig.grip.is_moving() && !rig.grip.is_driven());
    }
}

#[test]
fn both_fingers_above_20_n_may_be_loaded() {
    for (left, right, may_be) in
        [(21.0, 21.0, true), (20.0, 21.0, false), (21.0, 20.0, false), (21.0, -30.0, false)]
    {
        let mut rig = GripRig::new(false);
        rig.estimates = Some(pressed([left, 0.0, -right, 0.0], [0.0; 4]));
        rig.tick();
        assert_eq!(rig.grip.may_be_loaded(), may_be, "{left} {right}");
        rig.estimates = Some(MISSING);
        rig.tick();
        assert!(!rig.grip.may_be_loaded());
    }
}

#[test]
fn screw_changes_only_while_safe() {
    for (power, changes) in
        [(PowerState::Safe, true), (PowerState::Armed, false), (PowerState::Enabled, false)]
    {
        let mut rig = GripRig::new(false);
        match power {
            PowerState::Safe => rig.run(5),
            PowerState::Armed => rig.arm(),
            _ => rig.enable(),
        }
        rig.grip.set_self_locking(true);
        assert_eq!(rig.grip.settings.self_locking, changes, "{power:?}");
    }
}

#[test]
fn lost_rotor_angle_brakes_unless_the_screw_holds_an_object() {
    for (self_locking, is_gripped, expected) in [
        (true, false, Setpoint::Brake),
        (true, true, Setpoint::Off),
        (false, false, Setpoint::Brake),
        (false, true, Setpoint::Brake),
    ] {
        let task = if is_gripped { TaskState::HoldActive } else { TaskState::Idle };
        let mut rig = GripRig::in_task(task, self_locking);
        rig.stop_all();
        rig.run(100);
        assert_eq!((rig.grip.power(), rig.grip.is_loaded()), (PowerState::Armed, is_gripped));
        rig.motor.state = MotorState::Tripped(Trip::Encoder);
        rig.tick();
        assert_eq!(rig.setpoint(), expected, "{self_locking} {is_gripped}");
    }
}

#[test]
fn overload_begins_above_its_threshold_in_foot_mode() {
    // In 1/1024 N.
    for (is_foot, newtons, detail) in
        [(true, 217.5, None), (true, 217.75, Some(222_976)), (false, 230.0, None)]
    {
        let mut rig = if is_foot { GripRig::foot(true) } else { GripRig::enabled(true) };
        rig.estimates = Some(pressed([0.0; 4], [newtons, 0.0, 0.0, 0.0]));
        rig.tick();
        assert_eq!(rig.new_fault(Fault::FootOverload), detail, "{newtons}");
        assert_eq!(rig.is_active(Fault::FootOverload), detail.is_some());
    }
}

#[test]
fn blind_fault_needs_three_ticks_without_both_fingers() {
    let mut rig = GripRig::enabled(true);
    rig.corrupt = Some(|estimates| *estimates = MISSING);
    rig.run(2);
    assert!(!rig.is_active(Fault::Blind));
    rig.tick();
    assert!(rig.is_active(Fault::Blind));
    rig.corrupt = Some(|estimates| estimates[0].validity = Validity::Saturated);
    rig.tick();
    assert!(!rig.is_active(Fault::Blind));
}

#[test]
fn motor_is_armed_and_disarmed_with_the_power_state() {
    for (is_armed, state, expected) in [
        (true, MotorState::Disarmed, Some(ArmingRequest::Arm)),
        (true, MotorState::Armed, None),
        (true, MotorState::Arming, None),
        (false, MotorState::Armed, Some(ArmingRequest::Disarm)),
        (false, MotorState::Arming, Some(ArmingRequest::Disarm)),
        (false, MotorState::Disarmed, None),
    ] {
        let mut rig = GripRig::new(true);
        rig.run(5);
        if is_armed {
            rig.arm();
        }
        rig.motor.state = state;
        rig.tick();
        assert_eq!(rig.outputs.as_ref().unwrap().arming, expected, "{is_armed} {state:?}");
    }
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

#[test]
fn enabling_again_after_a_quick_stop_is_a_new_command() {
    let mut rig = GripRig::enabled(true);
    rig.fault(Fault::SensorLost, true);
    rig.run(100);
    rig.fault(Fault::SensorLost, false);
    rig.clear_faults();
    assert_eq!(rig.grip.power(), PowerState::Armed);
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.grip.power(), PowerState::Enabled);
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
