//! The grasp: instructions of a tick, the most and on the average, while it arms, grips something stiff, holds it
//! and lets it go; and of one in which nothing happens.

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

/// Ticks that do not count: the first run of a piece of code does not, for the emulator translates it meanwhile.
const WARMS: u32 = 21;
/// Ticks after which it lets go, and all of them.
const HOLDS: u32 = 900;
const TICKS: u32 = 1500;
/// Where something is met, in millimetres, and how stiff it is, in newtons to the millimetre.
const WIDTH_MM: f32 = 40.0;
const STIFFNESS: f32 = 50.0;
const TICK_S: f32 = 1e-3;

/// Lines for its tick, and for one in which nobody wants anything.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    let idle = idle(counter);
    let mut random = Random(23);
    let mut grip = Grip::new(Grasp::GRIPPER, Screw::A, true);
    let mut motor = Telling {
        opening_mm: Some(41.0),
        ..Telling::default()
    };
    let (mut greatest, mut sum, mut has_held) = (0, 0, false);
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
            acceleration: Some([0, 0, 9807]),
            ..nothing(&estimates)
        };
        let count = ticked(&mut grip, &inputs, counter);
        if tick >= WARMS {
            greatest = count.instructions.max(greatest);
            sum += count.instructions;
        }
        has_held |= grip.task() == Task::HoldLatched;
        if let Some(Arming::Arm) = count.arming {
            motor.state = State::Armed;
        }
        follow(&mut motor, count.setpoint);
    }
    // Otherwise little was counted.
    let has_let_go = grip.task() == Task::Idle;
    (has_held && has_let_go).then_some(()).ok_or(Error)?;
    writeln!(out, "grip_tick {greatest}")?;
    writeln!(out, "grip_mean {}", sum / (TICKS - WARMS))?;
    writeln!(out, "grip_idle {idle}")
}

/// Instructions of the last of several ticks in which nobody wants anything.
fn idle(counter: &Counter) -> u32 {
    let mut grip = Grip::new(Grasp::GRIPPER, Screw::A, true);
    let estimates = [Estimate::MISSING; SENSORS];
    let inputs = nothing(&estimates);
    let counts = (0..WARMS).map(|_| ticked(&mut grip, &inputs, counter).instructions);
    counts.last().unwrap_or_default()
}

/// Nobody wants anything.
fn nothing(estimates: &[Estimate; SENSORS]) -> Inputs<'_> {
    Inputs {
        estimates,
        motor: Telling::default(),
        host: Host::default(),
        command: None,
        stop: false,
        clear: false,
        faults: 0,
        is_sound: Some(true),
        is_calibrating: false,
        acceleration: None,
    }
}

/// A tick's instructions, and what the motor is to do.
struct Ticked {
    instructions: u32,
    arming: Option<Arming>,
    setpoint: Setpoint,
}

fn ticked(grip: &mut Grip, inputs: &Inputs, counter: &Counter) -> Ticked {
    let mut ticked = Ticked {
        instructions: 0,
        arming: None,
        setpoint: Setpoint::Off,
    };
    ticked.instructions = counter.instructions(|| {
        // What turned in memory would be told here: everything ends without a count.
        if black_box(&*grip).is_intact() {
            let outputs = black_box(grip.tick(black_box(inputs)));
            (ticked.arming, ticked.setpoint) = (outputs.arming, outputs.setpoint);
        }
    });
    ticked
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
