//! Homing on force: closes until the fingers press on each other, opens to the far end, and compares the way
//! between with the stroke. Something between the fingers makes the way too short.

use super::jam::Jam;
use crate::limits::Grasp;
use crate::motor::{Setpoint, Telling};
use crate::params;

/// How the far end is looked for, in mm/s.
const OPENING_MM_S: f32 = 20.0;
/// Milliseconds in which the drive turns round before a rotor that rests means an end.
const TURN_MS: u32 = 100;
/// How far the fingers give way, newtons to the millimetre: two flexures carry each, one finger behind the other.
const FLEXURES: f32 = params::STIFFNESS_X.value as f32;

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Drive so.
    Drive(Setpoint),
    /// The fingers press: so many millimetres are between them.
    Closed(f32),
    /// The far end is where it should be.
    Homed,
    /// Closing, the rotor stands though nothing presses.
    Jammed,
    /// It took too long, or the way is not the stroke, in millimetres.
    Wrong(f32),
}

/// A homing under way.
#[derive(Clone, Copy, Debug, Default)]
pub struct Homing {
    elapsed_ms: u32,
    /// Since the fingers pressed.
    opening_ms: Option<u32>,
    resting_ms: u16,
    jam: Jam,
}

impl Homing {
    /// Takes a millisecond: the fingers' force in newtons, and whether they press on something.
    pub fn tick(&mut self, motor: &Telling, force_n: f32, presses: bool, limits: &Grasp) -> Step {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        let travelled = motor.opening_mm.unwrap_or_default();
        if self.elapsed_ms > limits.home_ms {
            return Step::Wrong(travelled);
        }
        match self.opening_ms {
            None => self.close(motor, force_n, presses, limits),
            Some(since_ms) => {
                self.opening_ms = Some(since_ms.saturating_add(1));
                self.open(motor, since_ms, limits)
            }
        }
    }

    fn close(&mut self, motor: &Telling, force_n: f32, presses: bool, limits: &Grasp) -> Step {
        if presses && force_n >= limits.home_n {
            self.opening_ms = Some(0);
            return Step::Closed(-force_n / FLEXURES);
        }
        match self.jam.note(motor, force_n, limits) {
            true => Step::Jammed,
            false => Step::Drive(Setpoint::Speed {
                closing_mm_s: limits.home_mm_s,
                most_a: limits.home_a,
            }),
        }
    }

    fn open(&mut self, motor: &Telling, since_ms: u32, limits: &Grasp) -> Step {
        let rests = since_ms > TURN_MS && motor.closing_mm_s.abs() < limits.end_mm_s;
        self.resting_ms = match rests {
            true => self.resting_ms.saturating_add(1),
            false => 0,
        };
        if self.resting_ms < limits.end_ms {
            return Step::Drive(Setpoint::Speed {
                closing_mm_s: -OPENING_MM_S,
                most_a: limits.home_a,
            });
        }
        let stroke = params::STROKE.value as f32;
        match motor.opening_mm {
            Some(mm) if (mm - stroke).abs() <= limits.stroke_mm => Step::Homed,
            mm => Step::Wrong(mm.unwrap_or_default()),
        }
    }
}
