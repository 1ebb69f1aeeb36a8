//! What the device measures of its motor, and what it makes of one that is not right.

use super::super::*;
use super::bench::Bench;
use crate::motor::screw::Screw;
use crate::motor::stage::Drive;

#[test]
fn commissioning_finds_what_the_motor_is_and_how_it_is_wired() {
    for (pole_pairs, swapped, sits) in [(7.0, false, 0.013), (7.0, true, 0.4), (11.0, false, 0.77)]
    {
        let mut bench = Bench::new();
        (bench.pole_pairs, bench.swapped, bench.sits) = (pole_pairs, swapped, sits);
        bench.flux = 0.1 / (1.5 * pole_pairs);
        (bench.resistance, bench.inductance) = (0.5, 0.3e-3);
        bench.angle = 0.21;
        // What was found before does not matter.
        let mut settings = Settings::assumed(Screw::A);
        settings.wiring.is_swapped = sits > 0.3;
        let mut motor = Motor::new(settings);
        motor.obey(Order::Commission);
        bench.run(&mut motor, 60_000, |_, _| {});
        let found = motor
            .found()
            .unwrap_or_else(|| panic!("{:?}", motor.telling()));
        std::println!("{found:?}");
        assert_eq!(
            (f64::from(found.pole_pairs), found.wiring.is_swapped),
            (pole_pairs, swapped)
        );
        assert!((found.resistance_ohm / 0.5 - 1.0).abs() < 0.03, "{found:?}");
        assert!(
            (found.inductance_h / 0.3e-3 - 1.0).abs() < 0.05,
            "{found:?}"
        );
        // With what was found the motor closes when asked to, with the torque that is asked.
        motor.obey(Order::Arm);
        bench.run(&mut motor, 600, |_, _| {});
        bench.turned = Some(0.0);
        motor.obey(Order::Do(Setpoint::Current { closing_a: 3.0 }));
        bench.run(&mut motor, 400, |_, _| {});
        assert!((bench.q() - 3.0).abs() < 0.05, "{}", bench.q());
    }
}

#[test]
fn commissioning_says_what_is_wrong() {
    use commission::Refusal;
    let refused = |spoil: fn(&mut Bench)| {
        let mut bench = Bench::new();
        spoil(&mut bench);
        let mut motor = Motor::new(Settings::assumed(Screw::A));
        motor.obey(Order::Commission);
        bench.run(&mut motor, 60_000, |_, _| {});
        assert_eq!(bench.drive, Drive::Off);
        match motor.telling().state {
            State::Refused(refusal) => refusal,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(refused(|bench| bench.turned = Some(0.0)), Refusal::Stuck);
    let open = refused(|bench| bench.resistance = 100.0);
    assert!(matches!(open, Refusal::NoCurrent { .. }), "{open:?}");
    let thin = refused(|bench| bench.resistance = 1.7);
    assert!(
        matches!(thin, Refusal::Resistance { measured_ohm } if measured_ohm > 1.6),
        "{thin:?}"
    );
    let iron = refused(|bench| bench.inductance = 2e-3);
    assert!(
        matches!(iron, Refusal::Inductance { measured_h } if measured_h > 1.7e-3),
        "{iron:?}"
    );
}

#[test]
fn amplifiers_that_are_far_off_do_not_arm() {
    let mut motor = Motor::new(Settings::assumed(Screw::A));
    let mut bench = Bench::new();
    let sensed = Sensed {
        phases: [2048, 2300, 2048],
        bus: 1600,
        angle: Ok(0),
    };
    let mut told = |motor: &mut Motor, order, periods| {
        motor.obey(order);
        for _ in 0..periods {
            motor.period(&sensed, &mut bench);
        }
        motor.telling().state
    };
    let tripped = State::Tripped(Trip::CurrentSense);
    assert_eq!(told(&mut motor, Order::Arm, 600), tripped);
    assert_eq!(told(&mut motor, Order::Arm, 600), tripped);
    assert_eq!(told(&mut motor, Order::Disarm, 10), State::Disarmed);
    assert_eq!(told(&mut motor, Order::Arm, 10), State::Arming);
    assert_eq!(bench.drive, Drive::Off);
}
