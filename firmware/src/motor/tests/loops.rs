//! How fast, how exactly, and within which bounds the loops follow.

use core::f64::consts::TAU;

use super::super::*;
use super::bench::{Bench, armed};
use crate::motor::handed::Action;
use crate::motor::limits::Active;
use crate::motor::screw::Screw;
use crate::motor::transform::Dq;

/// Overshoot of a current step from one ampere to four, in shares of the step.
fn overshoot(bench: &mut Bench) -> f64 {
    let mut motor = armed(bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Current { closing_a: 1.0 }));
    bench.run(&mut motor, 400, |_, _| {});
    motor.obey(Order::Do(Setpoint::Current { closing_a: 4.0 }));
    let (mut greatest, mut last) = (0_f64, 0.0);
    bench.run(&mut motor, 200, |bench, _| {
        last = bench.q();
        greatest = greatest.max(last);
    });
    assert!((last - 4.0).abs() < 0.1, "{last}");
    (greatest - 4.0) / 3.0
}

#[test]
fn a_current_step_overshoots_by_less_than_a_tenth_whatever_the_motor() {
    let mut worst = 0_f64;
    for number in 0..81 {
        let share = |place: u32| 0.8 + 0.2 * f64::from(number / 3_u32.pow(place) % 3);
        let mut bench = Bench::new();
        bench.resistance *= share(0);
        bench.inductance *= share(1);
        bench.flux *= share(2);
        bench.turned = Some([0.0, 100.0, -100.0][(number / 27 % 3) as usize]);
        worst = worst.max(overshoot(&mut bench));
    }
    std::println!("overshoot at most {worst:.3}");
    assert!((0.01..0.1).contains(&worst), "{worst}");
}

/// Gain of the current loop at a frequency, by a sine of one ampere on four.
fn gain(bench: &mut Bench, hertz: f64) -> f64 {
    bench.turned = Some(0.0);
    let mut motor = armed(bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Current { closing_a: 4.0 }));
    bench.run(&mut motor, 200, |_, _| {});
    let (mut sums, periods) = ([0.0; 2], 4000);
    for period in 0..periods + 1000 {
        let (sin, cos) = (TAU * hertz * f64::from(period) * f64::from(PERIOD_S)).sin_cos();
        // The inner tick alone: its input is what the outer one asks.
        let asked = Dq {
            d: 0.0,
            q: 4.0 + sin as f32,
        };
        motor.inner.hear(Ask {
            change: None,
            action: Action::Follow(asked),
        });
        bench.period();
        bench.drive = motor.inner.tick(&bench.sensed);
        if period >= 1000 {
            sums[0] += (bench.q() - 4.0) * sin;
            sums[1] += (bench.q() - 4.0) * cos;
        }
    }
    2.0 * sums[0].hypot(sums[1]) / f64::from(periods)
}

#[test]
fn the_current_loop_passes_a_kilohertz_whatever_the_motor() {
    for (resistance, inductance) in [(1.0, 1.0), (0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2)] {
        let mut bench = Bench::new();
        bench.resistance *= resistance;
        bench.inductance *= inductance;
        let gain = gain(&mut bench, 1000.0);
        std::println!("R {resistance} L {inductance}: gain at 1 kHz {gain:.3}");
        // Half the power, and no resonance.
        assert!(
            (0.707..1.3).contains(&gain),
            "{resistance} {inductance}: {gain}"
        );
    }
}

#[test]
fn ten_millimetres_end_where_they_should_on_either_screw() {
    for screw in [Screw::A, Screw::B] {
        for (target, load) in [(30.0, 0.0), (50.0, 0.0), (30.0, 0.1)] {
            let mut bench = Bench::new();
            let mut motor = armed(&mut bench, Settings::assumed(screw));
            bench.load = load;
            let start = bench.opening(screw);
            motor.obey(Order::Do(Setpoint::Position {
                opening_mm: target,
                speed_mm_s: 58.3,
                most_a: 9.6,
            }));
            let (mut beyond, ahead) = (0_f64, (f64::from(target) - start).signum());
            bench.run(&mut motor, 12_000, |bench, _| {
                beyond = beyond.max(ahead * (bench.opening(screw) - f64::from(target)));
            });
            let error = (bench.opening(screw) - f64::from(target)).abs();
            std::println!(
                "ratio {}: beyond {beyond:.4} error {error:.5}",
                screw.ratio_mm
            );
            assert!(beyond < 0.05 && error < 0.02, "{beyond} {error}");
            assert!(
                motor.telling().limits == Active::default(),
                "{:?}",
                motor.telling()
            );
        }
    }
}

#[test]
fn stopping_from_full_speed_takes_less_than_half_a_millimetre_and_the_bus_stays_in_bounds() {
    for (screw, stop) in [
        (Screw::A, Setpoint::Brake),
        (Screw::B, Setpoint::Brake),
        (
            Screw::A,
            Setpoint::Speed {
                closing_mm_s: 0.0,
                most_a: 9.6,
            },
        ),
        (
            Screw::B,
            Setpoint::Speed {
                closing_mm_s: 0.0,
                most_a: 9.6,
            },
        ),
    ] {
        let mut bench = Bench::new();
        bench.capacitance = 470e-6;
        let mut motor = armed(&mut bench, Settings::assumed(screw));
        motor.obey(Order::Do(Setpoint::Speed {
            closing_mm_s: 114.0 * screw.ratio_mm,
            most_a: 9.6,
        }));
        bench.run(&mut motor, 4000, |_, _| {});
        assert!((bench.speed - 114.0).abs() < 1.0, "{}", bench.speed);
        let from = bench.angle;
        motor.obey(Order::Do(stop));
        let mut highest = 0_f64;
        bench.run(&mut motor, 1000, |bench, _| {
            highest = highest.max(bench.bus)
        });
        let way = (bench.angle - from) * f64::from(screw.ratio_mm);
        std::println!(
            "{stop:?} ratio {}: {way:.3} mm, {highest:.2} V",
            screw.ratio_mm
        );
        assert!(bench.speed.abs() < 0.5 && way < 0.5, "{stop:?}: {way} mm");
        assert!(highest < 30.0, "{highest} V");
    }
}
