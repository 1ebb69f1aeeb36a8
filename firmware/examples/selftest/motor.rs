//! The motor's control: the most instructions of its ticks over much that may be sensed.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use firmware::motor::screw::Screw;
use firmware::motor::stage::Sensed;
use firmware::motor::{MOTION_PERIODS, Motor, Setpoint, Settings, State};

use crate::counts::Counter;
use crate::vectors::Random;

/// Periods that are counted for each set-point.
const PERIODS: u32 = 600;
/// Periods in which it arms.
const ARMS: u32 = 600;

/// A line for each tick.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(17);
    let mut greatest = [0; 2];
    let mut motor = Motor::new(Settings::assumed(Screw::A));
    for setpoint in [
        Setpoint::Current { closing_a: -9.0 },
        Setpoint::Speed {
            closing_mm_s: 50.0,
            most_a: 9.6,
        },
        Setpoint::Position {
            opening_mm: 70.0,
            speed_mm_s: 58.0,
            most_a: 9.6,
        },
        Setpoint::Position {
            opening_mm: 10.0,
            speed_mm_s: 58.0,
            most_a: 9.6,
        },
    ] {
        motor.disarm();
        motor.arm();
        for _ in 0..ARMS {
            motor.current_tick(&sensed(0, &mut random, 0));
        }
        motor.set_opening(40.0);
        motor.command(setpoint);
        let counts = count(&mut motor, counter, &mut random).ok_or(Error)?;
        for (greatest, count) in greatest.iter_mut().zip(counts) {
            *greatest = count.max(*greatest);
        }
    }
    let [current, motion] = greatest;
    writeln!(out, "current_tick {current}")?;
    writeln!(out, "motion_tick {motion}")
}

/// The most instructions of both ticks; none where the motor did not stay armed, and little was counted.
fn count(motor: &mut Motor, counter: &Counter, random: &mut Random) -> Option<[u32; 2]> {
    let mut greatest = [0; 2];
    for period in 0..PERIODS {
        let sensed = sensed(period, random, 700);
        let current = counter.instructions(|| {
            black_box(motor.current_tick(black_box(&sensed)));
        });
        let motion = match period % u32::from(MOTION_PERIODS) {
            0 => counter.instructions(|| motor.motion_tick()),
            _ => 0,
        };
        // The first run of a piece of code does not count: the emulator translates it meanwhile.
        if period > 20 {
            greatest = [greatest[0].max(current), greatest[1].max(motion)];
        }
    }
    (motor.telling().state == State::Armed).then_some(greatest)
}

/// Currents of a width in counts, a bus between braking and too little, a rotor that turns at 100 rad/s.
fn sensed(period: u32, random: &mut Random, width: i32) -> Sensed {
    let mut near = |middle: i32, width: i32| {
        let beside = random.word() % (width + 1);
        middle.saturating_add(beside).clamp(1, 4094) as u16
    };
    Sensed {
        phases: [near(2048, width), near(2048, width), near(2048, width)],
        bus: near(1650, width / 2),
        angle: Ok((period * 13 & 0x3fff) as u16),
    }
}
