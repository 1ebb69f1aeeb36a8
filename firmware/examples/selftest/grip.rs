//! The grip: maximum and mean of the instructions of a tick while it arms, grips a stiff object, holds and releases it; and
//! those of an idle tick.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use firmware::config::limits::GripLimits;
use firmware::estimator::{Estimate, Validity};
use firmware::fixed_point::Force;
use firmware::grip::commands::mode;
use firmware::grip::states::TaskState;
use firmware::grip::{ArmingRequest, ControlInputs, GripController, SessionStatus};
use firmware::motor::screw::Screw;
use firmware::motor::{MotorState, MotorStatus, Setpoint};
use firmware::protocol::messages::Command;
use firmware::sensors::hall::SENSORS;

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

/// Prints maximum and mean of a tick, and an idle tick.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    let idle = idle(counter);
    let mut random = Random(23);
    let mut grip = GripController::new(GripLimits::GRIPPER, Screw::A, true);
    let mut motor = MotorStatus { opening_mm: Some(41.0), ..MotorStatus::default() };
    let (mut max_count, mut sum, mut has_held) = (0, 0, false);
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
        let inputs = ControlInputs {
            estimates: &estimates,
            motor,
            host: SessionStatus { is_offered: tick < 5, is_open: tick >= 5, is_alive: tick >= 5 },
            command: (tick >= 8).then_some(command),
            acceleration: Some([0, 0, 9807]),
            ..idle_inputs(&estimates)
        };
        let count = ticked(&mut grip, &inputs, counter);
        if tick >= WARMS {
            max_count = count.instructions.max(max_count);
            sum += count.instructions;
        }
        has_held |= grip.task() == TaskState::HoldLatched;
        if let Some(ArmingRequest::Arm) = count.arming {
            motor.state = MotorState::Armed;
        }
        follow(&mut motor, count.setpoint);
    }
    // Otherwise too few states were counted.
    let has_released = grip.task() == TaskState::Idle;
    (has_held && has_released).then_some(()).ok_or(Error)?;
    writeln!(out, "grip_tick {max_count}")?;
    writeln!(out, "grip_mean {}", sum / (TICKS - WARMS))?;
    writeln!(out, "grip_idle {idle}")
}

/// Instructions of an idle tick.
fn idle(counter: &Counter) -> u32 {
    let mut grip = GripController::new(GripLimits::GRIPPER, Screw::A, true);
    let estimates = [Estimate::MISSING; SENSORS];
    let inputs = idle_inputs(&estimates);
    let counts = (0..WARMS).map(|_| ticked(&mut grip, &inputs, counter).instructions);
    counts.last().unwrap_or_default()
}

/// Inputs without any request.
fn idle_inputs(estimates: &[Estimate; SENSORS]) -> ControlInputs<'_> {
    ControlInputs {
        estimates,
        motor: MotorStatus::default(),
        host: SessionStatus::default(),
        command: None,
        stop: false,
        clear: false,
        faults: 0,
        is_sound: Some(true),
        is_calibrating: false,
        acceleration: None,
    }
}

/// Instructions of a tick, and orders for the motor.
struct TickCount {
    instructions: u32,
    arming: Option<ArmingRequest>,
    setpoint: Setpoint,
}

fn ticked(grip: &mut GripController, inputs: &ControlInputs, counter: &Counter) -> TickCount {
    let mut ticked = TickCount { instructions: 0, arming: None, setpoint: Setpoint::Off };
    ticked.instructions = counter.instructions(|| {
        // On corrupt memory nothing is counted, and the self-test fails.
        if black_box(&*grip).is_intact() {
            let outputs = black_box(grip.tick(black_box(inputs)));
            (ticked.arming, ticked.setpoint) = (outputs.arming, outputs.setpoint);
        }
    });
    ticked
}

/// Forces of the fingers on a stiff object, with noise of 1 N.
fn pressed(motor: &MotorStatus, random: &mut Random) -> [Estimate; SENSORS] {
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

/// A motor that follows its set-point at once.
fn follow(motor: &mut MotorStatus, setpoint: Setpoint) {
    let opening_mm = motor.opening_mm.unwrap_or_default();
    motor.closing_mm_s = match setpoint {
        Setpoint::Speed { closing_mm_s, .. } => closing_mm_s,
        Setpoint::Position { opening_mm: to, speed_mm_s, .. } => {
            ((opening_mm - to) / TICK_S).clamp(-speed_mm_s, speed_mm_s)
        }
        Setpoint::Off | Setpoint::Brake | Setpoint::Current { .. } => 0.0,
    };
    motor.opening_mm = Some(opening_mm - motor.closing_mm_s * TICK_S);
}
