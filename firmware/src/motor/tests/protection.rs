//! Limits, trips and non-finite values.

use proptest::prelude::*;

use crate::motor::foc::{self, Dq, Windings};
use crate::motor::limits::Limit;
use crate::motor::motion_loop::SpeedController;
use crate::motor::power_stage::{BridgeCommand, EncoderError};
use crate::motor::screw::Screw;
use crate::motor::tests::{MotorModel, armed, both};
use crate::motor::tick_exchange::CurrentLoopAction;
use crate::motor::*;

#[test]
fn lost_angle_brakes_within_a_millisecond() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    motor
        .handle_command(MotorCommand::Setpoint(Setpoint::Speed { closing_mm_s: 50.0, max_a: 9.6 }));
    model.run(&mut motor, 2000, |_, _| {});
    let without_angle = MotorSamples { angle: Err(EncoderError::ErrorFlag), ..model.sensed };
    let braked = (0..20).position(|_| both(&mut motor, &without_angle) == BridgeCommand::Brake);
    assert!(braked.is_some_and(|periods| periods < 20), "{braked:?}");
    assert_eq!(motor.status().state, MotorState::Tripped(Trip::Encoder));
    both(&mut motor, &without_angle);
    assert_eq!(motor.outer.rotor_mm(), None);
}

#[test]
fn brake_ends_below_the_voltage_of_the_gate_drivers() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    let at = |bus| MotorSamples { angle: Err(EncoderError::ErrorFlag), bus, ..model.sensed };
    for _ in 0..20 {
        both(&mut motor, &at(1600));
    }
    assert_eq!(both(&mut motor, &at(1600)), BridgeCommand::Brake);
    // 7.5 V.
    assert_eq!(both(&mut motor, &at(500)), BridgeCommand::Off);
    assert_eq!(both(&mut motor, &at(1600)), BridgeCommand::Brake);
}

#[test]
fn events_wait_while_their_queue_is_full() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    let without_angle = MotorSamples { angle: Err(EncoderError::ErrorFlag), ..model.sensed };
    let inner = &mut motor.inner;
    inner.take_report();
    for _ in 0..20 {
        inner.tick(&without_angle);
    }
    inner.push_report(Err);
    let report = inner.take_report();
    assert!(report.is_angle_lost);
    assert!(!inner.take_report().is_angle_lost);
}

#[test]
fn overcurrent_switches_all_bridges_off() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 1.0 }));
    model.run(&mut motor, 100, |_, _| {});
    let mut sensed = model.sensed;
    sensed.phases[1] = 2048 + 1600;
    assert_eq!(both(&mut motor, &sensed), BridgeCommand::Off);
    assert_eq!(motor.status().state, MotorState::Tripped(Trip::OverCurrent));
    assert_eq!(both(&mut motor, &model.sensed), BridgeCommand::Off);
}

#[test]
fn speed_is_limited_near_the_end_and_before_homing() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    let open = Setpoint::Speed { closing_mm_s: -58.0, max_a: 9.6 };
    motor.handle_command(MotorCommand::Setpoint(open));
    model.run(&mut motor, 40_000, |_, _| {});
    let opening = model.opening(Screw::A);
    assert!((79.5..80.02).contains(&opening), "{opening}");
    assert!(motor.status().limits.has(Limit::EndStop));
    motor.handle_command(MotorCommand::SetOpening { opening_mm: f32::NAN });
    motor.handle_command(MotorCommand::Setpoint(open));
    model.run(&mut motor, 2_000, |_, _| {});
    let status = motor.status();
    assert!((status.closing_mm_s + 5.0).abs() < 0.3, "{status:?}");
    assert!(status.limits.has(Limit::NotHomed) && status.opening_mm.is_none());
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Position {
        opening_mm: 20.0,
        speed_mm_s: 50.0,
        max_a: 9.6,
    }));
    model.run(&mut motor, 2_000, |_, _| {});
    let status = motor.status();
    assert!(status.speed.abs() < 0.5 && status.limits.has(Limit::NotHomed), "{status:?}");
}

#[test]
fn setpoint_current_limit_is_respected() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::B));
    model.load = 0.4;
    motor
        .handle_command(MotorCommand::Setpoint(Setpoint::Speed { closing_mm_s: 30.0, max_a: 3.0 }));
    let mut max_a = 0_f64;
    model.run(&mut motor, 300, |model, _| max_a = max_a.max(model.q().abs()));
    assert!((2.8..3.3).contains(&max_a), "{max_a}");
    assert!(motor.status().limits.has(Limit::Current));
}

#[test]
fn power_stage_trip_lasts_until_disarmed() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Brake));
    model.run(&mut motor, 6, |_, _| {});
    assert_eq!(model.drive, BridgeCommand::Brake);
    motor.trip_power_stage();
    motor.handle_command(MotorCommand::Arm);
    model.run(&mut motor, 10, |_, _| {});
    let tripped = MotorState::Tripped(Trip::PowerStage);
    assert_eq!((motor.status().state, model.drive), (tripped, BridgeCommand::Off));
    motor.handle_command(MotorCommand::Disarm);
    model.run(&mut motor, 10, |_, _| {});
    motor.handle_command(MotorCommand::Arm);
    model.run(&mut motor, 10, |_, _| {});
    assert_eq!(motor.status().state, MotorState::Arming);
}

#[test]
fn missing_motion_loop_brakes_within_a_millisecond() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 2.0 }));
    model.run(&mut motor, 100, |_, _| {});
    let drives = [(); 20].map(|()| motor.inner.tick(&model.sensed));
    let braked = drives.iter().position(|drive| *drive == BridgeCommand::Brake);
    // Its last command was one to five periods ago; three missed ticks are fifteen.
    assert!(braked.is_some_and(|periods| (10..=15).contains(&periods)), "{braked:?}");
    assert_eq!(motor.status().state, MotorState::Tripped(Trip::CommandTimeout));
}

#[test]
fn speed_setpoint_times_out_and_position_does_not() {
    let moving = Setpoint::Speed { closing_mm_s: 20.0, max_a: 9.6 };
    let place = Setpoint::Position { opening_mm: 30.0, speed_mm_s: 20.0, max_a: 9.6 };
    for (setpoint, expected) in [(moving, Some(105)), (place, None)] {
        let mut model = MotorModel::new();
        let mut motor = armed(&mut model, Settings::assumed(Screw::A));
        motor.handle_command(MotorCommand::Setpoint(setpoint));
        // No repetition.
        motor.setpoint = None;
        let mut braked = None;
        for period in 0..400 {
            model.run(&mut motor, 1, |_, _| {});
            if model.drive == BridgeCommand::Brake {
                braked = braked.or(Some(period));
            }
        }
        assert_eq!(braked, expected);
        let is_tripped = motor.status().state == MotorState::Tripped(Trip::CommandTimeout);
        assert_eq!(is_tripped, expected.is_some());
    }
}

#[test]
fn overvoltage_shorts_the_windings_until_it_ends() {
    let mut model = MotorModel::new();
    let mut motor = armed(&mut model, Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 1.0 }));
    model.run(&mut motor, 20, |_, _| {});
    let mut drive_at = |volts: f64| {
        let bus = (volts / 0.015) as u16;
        let sensed = MotorSamples { bus, ..model.sensed };
        let drive = both(&mut motor, &sensed);
        (drive, motor.status().limits.has(Limit::Regeneration))
    };
    assert_eq!(drive_at(32.1), (BridgeCommand::Brake, true));
    assert_eq!(drive_at(29.0), (BridgeCommand::Brake, true));
    assert!(matches!(drive_at(28.0), (BridgeCommand::Duty(_), false)));
    assert_eq!(drive_at(7.0).0, BridgeCommand::Off);
}

#[test]
fn invalid_settings_do_not_arm() {
    let corruptions: [fn(&mut Settings); 10] = [
        |settings| settings.machine.resistance_ohm = f32::NAN,
        |settings| settings.machine.inductance_h = 0.0,
        |settings| settings.machine.torque_nm_a = f32::INFINITY,
        |settings| settings.machine.inertia_kg_m2 = -1.0,
        |settings| settings.machine.pole_pairs = 0,
        |settings| settings.machine.dry_nm = f32::NAN,
        |settings| settings.screw.ratio_mm = f32::NAN,
        |settings| settings.limits.peak_a = f32::NAN,
        |settings| settings.limits.dissipation_v = [28.0, 28.0],
        |settings| settings.angle_age_periods = f32::NAN,
    ];
    for (number, corrupt) in corruptions.into_iter().enumerate() {
        let mut settings = Settings::assumed(Screw::A);
        assert!(settings.is_sound());
        corrupt(&mut settings);
        let mut motor = Motor::new(settings);
        motor.handle_command(MotorCommand::Arm);
        let mut model = MotorModel::new();
        model.run(&mut motor, 10, |_, _| {});
        let state = motor.status().state;
        assert_eq!(state, MotorState::Tripped(Trip::NotANumber), "{number}");
    }
}

/// Commands currents to the current loop, bypassing the motion loop.
fn command_currents(motor: &mut Motor, d: f32, q: f32) {
    motor.pending =
        Some(CurrentLoopCommand { change: None, action: CurrentLoopAction::Follow(Dq { d, q }) });
}

#[test]
fn non_finite_state_or_setpoint_trips() {
    let corruptions: [fn(&mut Motor); 7] = [
        |motor| command_currents(motor, f32::INFINITY, 0.0),
        |motor| command_currents(motor, 0.0, f32::NAN),
        |motor| motor.outer.speed = SpeedController::start(f32::NAN),
        |motor| {
            motor.inner.windings = Windings::of(&settings::MotorParameters {
                inductance_h: f32::NAN,
                ..motor.inner.settings.machine
            })
        },
        |motor| {
            motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: f32::NAN }))
        },
        |motor| {
            motor.handle_command(MotorCommand::Setpoint(Setpoint::Position {
                opening_mm: f32::NAN,
                speed_mm_s: 1.0,
                max_a: 1.0,
            }))
        },
        |motor| motor.outer.settings.machine.torque_nm_a = f32::NAN,
    ];
    for (number, corrupt) in corruptions.into_iter().enumerate() {
        let mut model = MotorModel::new();
        let mut motor = armed(&mut model, Settings::assumed(Screw::A));
        motor.handle_command(MotorCommand::Setpoint(Setpoint::Speed {
            closing_mm_s: 20.0,
            max_a: 9.6,
        }));
        model.run(&mut motor, 100, |_, _| {});
        corrupt(&mut motor);
        let sensed = model.sensed;
        let drives = [(); 12].map(|()| both(&mut motor, &sensed));
        let state = motor.status().state;
        std::println!("{number} {state:?} {drives:?}");
        assert_eq!(state, MotorState::Tripped(Trip::NotANumber), "{number}");
        assert_eq!(drives[11], BridgeCommand::Off, "{number}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// For any counts and set-points.
    #[test]
    fn duty_cycles_stay_in_range_for_any_samples(
        sensed in prop::collection::vec(
            (prop::array::uniform4(0_u16..4096), 0_u16..16384, 0_u8..20), 50..400,
        ),
        setpoints in prop::collection::vec((0_u8..5, -1e4_f32..1e4), 1..20),
    ) {
        let mut model = MotorModel::new();
        let mut motor = armed(&mut model, Settings::assumed(Screw::B));
        for (at, ([a, b, c, bus], angle, kind)) in sensed.iter().copied().enumerate() {
            if at % 20 == 0 {
                motor.handle_command(MotorCommand::Disarm);
                both(&mut motor, &model.sensed);
                both(&mut motor, &model.sensed);
                motor.inner.state = MotorState::Armed;
                both(&mut motor, &model.sensed);
                let (kind, value) = setpoints[at / 20 % setpoints.len()];
                motor.handle_command(MotorCommand::Setpoint(match kind {
                    0 => Setpoint::Off,
                    1 => Setpoint::Brake,
                    2 => Setpoint::Current { closing_a: value },
                    3 => Setpoint::Speed { closing_mm_s: value, max_a: value },
                    _ => Setpoint::Position { opening_mm: value, speed_mm_s: value, max_a: 5.0 },
                }));
            }
            let angle = match kind {
                0 => Err(EncoderError::Silent),
                _ => Ok(angle),
            };
            let drive = both(&mut motor, &MotorSamples { phases: [a, b, c], bus, angle });
            if let BridgeCommand::Duty(duties) = drive {
                for duty in duties {
                    prop_assert!((0.0..=foc::MODULATION).contains(&duty));
                }
            }
        }
    }
}

/// The power stage fails again each time, just when the offsets have been measured and the motor is armed, or a period before or
/// after it, with a set-point that waits.
#[test]
fn fault_that_returns_at_each_arming_drives_no_current() {
    let mut model = MotorModel::new();
    let mut motor = Motor::new(Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Arm);
    let mut arming = 0_u32;
    while motor.status().state != MotorState::Armed {
        model.run(&mut motor, 1, |_, _| {});
        arming += 1;
    }
    for moment in [arming - 1, arming, arming + 1] {
        let mut model = MotorModel::new();
        let mut motor = Motor::new(Settings::assumed(Screw::A));
        for _ in 0..20 {
            motor.handle_command(MotorCommand::Disarm);
            model.run(&mut motor, 10, |_, _| {});
            motor.handle_command(MotorCommand::Arm);
            motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 5.0 }));
            for period in 0..arming + 20 {
                if period == moment {
                    motor.trip_power_stage();
                }
                model.run(&mut motor, 1, |model, _| {
                    assert!(model.q().abs() < 0.05, "{moment} {period}: {} A", model.q());
                });
            }
            assert_eq!(motor.status().state, MotorState::Tripped(Trip::PowerStage));
        }
    }
}
