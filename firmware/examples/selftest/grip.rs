//! The grasp: the most instructions of a tick while it arms, grips something stiff, holds it and lets it go.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use firmware::force::{Estimate, Validity};
use firmware::frame::SENSORS;
use firmware::grip::order::mode;
use firmware::grip::states::Task;
use firmware::grip::{Arming, Grip, Host, Inputs};
use firmware::limits::Grasp;
use firmware::motor::screw::Screw;
use firmware::motor::{Setpoint, State, Telling};
use firmware::units::Force;
use firmware::wire::messages::Command;

use crate::counts::Counter;
use crate::vectors::Random;

/// Ticks after which it lets go, and all of them.
const HOLDS: u32 = 900;
const TICKS: u32 = 1500;
/// Where something is met, in millimetres, and how stiff it is, in newtons to the millimetre.
const WIDTH_MM: f32 = 40.0;
const STIFFNESS: f32 = 50.0;
const TICK_S: f32 = 1e-3;

/// A line for its tick.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(23);
    let mut grip = Grip::new(Grasp::GRIPPER, Screw::A, true);
    let mut motor = Telling {
        opening_mm: Some(41.0),
        ..Telling::default()
    };
    let (mut greatest, mut has_held) = (0, false);
    for tick in 0..TICKS {
        let estimates = pressed(&motor, &mut random);
        let command = Command {
            mode: match tick {
                0..10 => mode::ENABLE,
                10..HOLDS => mode::GRIP,
                _ => mode::RELEASE,
            },
            position: 1000,
            speed: 100,
            force: 800,
            ..Command::default()
        };
        let inputs = Inputs {
            estimates: &estimates,
            motor,
            host: Host {
                is_offered: tick < 5,
                is_open: tick >= 5,
                is_alive: tick >= 5,
            },
            command: (tick >= 8).then_some(command),
            stop: false,
            clear: false,
            faults: 0,
            is_sound: Some(true),
            is_calibrating: false,
            acceleration: Some([0, 0, 9807]),
        };
        let mut arming = None;
        let mut setpoint = Setpoint::Off;
        let mut is_intact = false;
        let count = counter.instructions(|| {
            is_intact = black_box(&grip).is_intact();
            let outputs = black_box(grip.tick(black_box(&inputs)));
            (arming, setpoint) = (outputs.arming, outputs.setpoint);
        });
        is_intact.then_some(()).ok_or(Error)?;
        // The first run of a piece of code does not count: the emulator translates it meanwhile.
        if tick > 20 {
            greatest = count.max(greatest);
        }
        has_held |= grip.task() == Task::HoldLatched;
        if let Some(Arming::Arm) = arming {
            motor.state = State::Armed;
        }
        follow(&mut motor, setpoint);
    }
    // Otherwise little was counted.
    let has_let_go = grip.task() == Task::Idle;
    (has_held && has_let_go).then_some(()).ok_or(Error)?;
    writeln!(out, "grip_tick {greatest}")
}

/// Forces of a finger against something stiff, with a newton of noise.
fn pressed(motor: &Telling, random: &mut Random) -> [Estimate; SENSORS] {
    let pressed_mm = WIDTH_MM - motor.opening_mm.unwrap_or_default();
    let half_n = 0.5 * STIFFNESS * pressed_mm.max(0.0);
    [1.0, 1.0, -1.0, -1.0].map(|side| {
        let noise = random.word() % 512;
        let lateral = (side * half_n * Force::PER_NEWTON as f32) as i32;
        Estimate {
            force: [Force(lateral.saturating_add(noise)), Force(noise)],
            validity: Validity::Valid,
            ..Estimate::MISSING
        }
    })
}

/// A motor that does at once what it is asked.
fn follow(motor: &mut Telling, setpoint: Setpoint) {
    let opening_mm = motor.opening_mm.unwrap_or_default();
    motor.closing_mm_s = match setpoint {
        Setpoint::Speed { closing_mm_s, .. } => closing_mm_s,
        Setpoint::Position {
            opening_mm: to,
            speed_mm_s,
            ..
        } => ((opening_mm - to) / TICK_S).clamp(-speed_mm_s, speed_mm_s),
        Setpoint::Off | Setpoint::Brake | Setpoint::Current { .. } => 0.0,
    };
    motor.opening_mm = Some(opening_mm - motor.closing_mm_s * TICK_S);
}
