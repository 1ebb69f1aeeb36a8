//! Commissioning of intact and defective motors.

use crate::motor::power_stage::BridgeCommand;
use crate::motor::screw::Screw;
use crate::motor::tests::MotorModel;
use crate::motor::*;

#[test]
fn commissioning_identifies_motor_and_wiring() {
    for (pole_pairs, swapped, offset, torque_share, inertia_share) in
        [(7.0, false, 0.013, 1.0, 1.0), (7.0, true, 0.4, 2.5, 0.3), (11.0, false, 0.77, 0.4, 3.0)]
    {
        let mut model = MotorModel::new();
        (model.pole_pairs, model.swapped, model.offset) = (pole_pairs, swapped, offset);
        let (torque, inertia) = (0.1 * torque_share, 6e-5 * inertia_share);
        (model.flux, model.inertia) = (torque / (1.5 * pole_pairs), inertia);
        (model.resistance, model.inductance) = (0.5, 0.3e-3);
        model.angle = 0.21;
        // An earlier wiring has no effect.
        let mut settings = Settings::assumed(Screw::A);
        settings.wiring.is_swapped = offset > 0.3;
        let mut motor = Motor::new(settings);
        motor.handle_command(MotorCommand::Commission);
        model.run(&mut motor, 140_000, |_, _| {});
        let identified = motor.identification().unwrap_or_else(|| panic!("{:?}", motor.status()));
        std::println!("{identified:?}");
        assert_eq!(
            (f64::from(identified.pole_pairs), identified.wiring.is_swapped),
            (pole_pairs, swapped)
        );
        assert!((identified.resistance_ohm / 0.5 - 1.0).abs() < 0.03, "{identified:?}");
        assert!((identified.inductance_h / 0.3e-3 - 1.0).abs() < 0.05, "{identified:?}");
        let error = |found: f32, is: f64| (f64::from(found) / is - 1.0).abs();
        assert!(error(identified.torque_nm_a, torque) < 0.05, "{identified:?}");
        assert!(error(identified.inertia_kg_m2, inertia) < 0.1, "{identified:?}");
        assert!(error(identified.dry_nm, 0.02) < 0.3, "{identified:?}");
        // With the identified motor, the torque has the requested sign and size.
        motor.handle_command(MotorCommand::Arm);
        model.run(&mut motor, 600, |_, _| {});
        model.imposed_speed = Some(0.0);
        motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 3.0 }));
        model.run(&mut motor, 400, |_, _| {});
        assert!((model.q() - 3.0).abs() < 0.05, "{}", model.q());
    }
}

#[test]
fn commissioning_reports_the_defect() {
    use commissioning::CommissioningError;
    let error_of = |defect: fn(&mut MotorModel)| {
        let mut model = MotorModel::new();
        defect(&mut model);
        let mut motor = Motor::new(Settings::assumed(Screw::A));
        motor.handle_command(MotorCommand::Commission);
        model.run(&mut motor, 100_000, |_, _| {});
        assert_eq!(model.drive, BridgeCommand::Off);
        match motor.status().state {
            MotorState::CommissioningFailed(refusal) => refusal,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(error_of(|model| model.imposed_speed = Some(0.0)), CommissioningError::Stuck);
    let open = error_of(|model| model.resistance = 100.0);
    assert!(matches!(open, CommissioningError::NoCurrent { .. }), "{open:?}");
    // Exchanged sensors of V and W, and inverted ones.
    for exchanged in [
        error_of(|model| model.senses = |[u, v, w]| [u, w, v]),
        error_of(|model| model.senses = |[u, v, w]| [u, -v, w]),
        error_of(|model| model.senses = |[u, v, w]| [u, v, -w]),
    ] {
        assert_eq!(exchanged, CommissioningError::CurrentSense);
    }
    let high_ohm = error_of(|model| model.resistance = 1.7);
    assert!(
        matches!(high_ohm, CommissioningError::Resistance { measured_ohm } if measured_ohm > 1.6),
        "{high_ohm:?}"
    );
    let high_h = error_of(|model| model.inductance = 2e-3);
    assert!(
        matches!(high_h, CommissioningError::Inductance { measured_h } if measured_h > 1.7e-3),
        "{high_h:?}"
    );
}

#[test]
fn large_current_offset_prevents_arming() {
    let mut motor = Motor::new(Settings::assumed(Screw::A));
    let mut model = MotorModel::new();
    let sensed = MotorSamples { phases: [2048, 2300, 2048], bus: 1600, angle: Ok(0) };
    let mut state_after = |motor: &mut Motor, command, periods| {
        motor.handle_command(command);
        for _ in 0..periods {
            motor.period(&sensed, &mut model);
        }
        motor.status().state
    };
    let tripped = MotorState::Tripped(Trip::CurrentSense);
    assert_eq!(state_after(&mut motor, MotorCommand::Arm, 600), tripped);
    assert_eq!(state_after(&mut motor, MotorCommand::Arm, 600), tripped);
    assert_eq!(state_after(&mut motor, MotorCommand::Disarm, 10), MotorState::Disarmed);
    assert_eq!(state_after(&mut motor, MotorCommand::Arm, 10), MotorState::Arming);
    assert_eq!(model.drive, BridgeCommand::Off);
}
