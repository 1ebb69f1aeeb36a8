//! Bandwidth, accuracy and limits of the control loops.

use core::f64::consts::TAU;

use crate::motor::foc::Dq;
use crate::motor::limits::ActiveLimits;
use crate::motor::screw::Screw;
use crate::motor::tests::{MotorModel, armed};
use crate::motor::tick_exchange::CurrentLoopAction;
use crate::motor::*;

/// Overshoot of a current step from 1 A to 4 A relative to the step.
fn overshoot(model: &mut MotorModel) -> f64 {
    let mut motor = armed(model, Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 1.0 }));
    model.run(&mut motor, 400, |_, _| {});
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 4.0 }));
    let (mut max_a, mut last) = (0_f64, 0.0);
    model.run(&mut motor, 200, |model, _| {
        last = model.q();
        max_a = max_a.max(last);
    });
    assert!((last - 4.0).abs() < 0.1, "{last}");
    (max_a - 4.0) / 3.0
}

#[test]
fn current_step_overshoots_less_than_ten_percent() {
    let mut worst = 0_f64;
    for number in 0..81 {
        let factor = |place: u32| 0.8 + 0.2 * f64::from(number / 3_u32.pow(place) % 3);
        let mut model = MotorModel::new();
        model.resistance *= factor(0);
        model.inductance *= factor(1);
        model.flux *= factor(2);
        model.imposed_speed = Some([0.0, 100.0, -100.0][(number / 27 % 3) as usize]);
        worst = worst.max(overshoot(&mut model));
    }
    std::println!("max. overshoot {worst:.3}");
    assert!((0.01..0.1).contains(&worst), "{worst}");
}

/// Gain of the current loop at a frequency, from a sine of 1 A around 4 A.
fn gain(model: &mut MotorModel, hertz: f64) -> f64 {
    model.imposed_speed = Some(0.0);
    let mut motor = armed(model, Settings::assumed(Screw::A));
    motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 4.0 }));
    model.run(&mut motor, 200, |_, _| {});
    let (mut sums, periods) = ([0.0; 2], 4000);
    for period in 0..periods + 1000 {
        let (sin, cos) = (TAU * hertz * f64::from(period) * f64::from(PERIOD_S)).sin_cos();
        // The current loop alone.
        let setpoint = Dq { d: 0.0, q: 4.0 + sin as f32 };
        motor.inner.apply(CurrentLoopCommand {
            change: None,
            action: CurrentLoopAction::Follow(setpoint),
        });
        model.period();
        model.drive = motor.inner.tick(&model.sensed);
        if period >= 1000 {
            sums[0] += (model.q() - 4.0) * sin;
            sums[1] += (model.q() - 4.0) * cos;
        }
    }
    2.0 * sums[0].hypot(sums[1]) / f64::from(periods)
}

#[test]
fn current_loop_bandwidth_is_one_kilohertz() {
    for (resistance, inductance) in [(1.0, 1.0), (0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2)] {
        let mut model = MotorModel::new();
        model.resistance *= resistance;
        model.inductance *= inductance;
        let gain = gain(&mut model, 1000.0);
        std::println!("R {resistance} L {inductance}: gain at 1 kHz {gain:.3}");
        // At most 3 dB of attenuation, and no resonance.
        assert!((0.707..1.3).contains(&gain), "{resistance} {inductance}: {gain}");
    }
}

#[test]
fn position_step_reaches_its_target_on_both_screws() {
    for screw in [Screw::A, Screw::B] {
        for (target, load) in [(30.0, 0.0), (50.0, 0.0), (30.0, 0.1)] {
            let mut model = MotorModel::new();
            let mut motor = armed(&mut model, Settings::assumed(screw));
            model.load = load;
            let start = model.opening(screw);
            motor.handle_command(MotorCommand::Setpoint(Setpoint::Position {
                opening_mm: target,
                speed_mm_s: 58.3,
                max_a: 9.6,
            }));
            let (mut beyond, ahead) = (0_f64, (f64::from(target) - start).signum());
            model.run(&mut motor, 12_000, |model, _| {
                beyond = beyond.max(ahead * (model.opening(screw) - f64::from(target)));
            });
            let error = (model.opening(screw) - f64::from(target)).abs();
            std::println!("ratio {}: beyond {beyond:.4} error {error:.5}", screw.ratio_mm);
            assert!(beyond < 0.05 && error < 0.02, "{beyond} {error}");
            assert!(motor.status().limits == ActiveLimits::default(), "{:?}", motor.status());
        }
    }
}

#[test]
fn stop_from_full_speed_is_short_and_keeps_the_bus_in_range() {
    for (screw, stop) in [
        (Screw::A, Setpoint::Brake),
        (Screw::B, Setpoint::Brake),
        (Screw::A, Setpoint::Speed { closing_mm_s: 0.0, max_a: 9.6 }),
        (Screw::B, Setpoint::Speed { closing_mm_s: 0.0, max_a: 9.6 }),
    ] {
        let mut model = MotorModel::new();
        model.capacitance = 470e-6;
        let mut motor = armed(&mut model, Settings::assumed(screw));
        motor.handle_command(MotorCommand::Setpoint(Setpoint::Speed {
            closing_mm_s: 114.0 * screw.ratio_mm,
            max_a: 9.6,
        }));
        model.run(&mut motor, 4000, |_, _| {});
        assert!((model.speed - 114.0).abs() < 1.0, "{}", model.speed);
        let from = model.angle;
        motor.handle_command(MotorCommand::Setpoint(stop));
        let mut highest = 0_f64;
        model.run(&mut motor, 1000, |model, _| highest = highest.max(model.bus));
        let travel = (model.angle - from) * f64::from(screw.ratio_mm);
        std::println!("{stop:?} ratio {}: {travel:.3} mm, {highest:.2} V", screw.ratio_mm);
        assert!(model.speed.abs() < 0.5 && travel < 0.5, "{stop:?}: {travel} mm");
        assert!(highest < 30.0, "{highest} V");
    }
}
