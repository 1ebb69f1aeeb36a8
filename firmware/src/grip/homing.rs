//! Homing on force: closes until the fingers press on each other, opens to the far end, and compares the travel
//! with the stroke. An object between the fingers makes the travel too short.

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::grip::debounce::next_ms;
use crate::grip::stall_detector::StallDetector;
use crate::motor::{MotorStatus, Setpoint};

/// Opening speed in mm/s.
const OPENING_MM_S: f32 = 20.0;
/// Milliseconds after the reversal in which rest is not taken for the far end.
const REVERSAL_MS: u32 = 100;
/// Stiffness of both fingers in N/mm: two flexures carry each, one finger behind the other.
const FLEXURES: f32 = constants::STIFFNESS_X.value as f32;

/// Result of one step of [`Homing`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HomingStep {
    /// Next motor set-point.
    Drive(Setpoint),
    /// The fingers press on each other: the opening in millimetres, negative by the flexures' deflection.
    Zeroed(f32),
    /// The far end is at the stroke.
    Homed,
    /// The fingers stalled while closing.
    Stalled,
    /// Timeout, or the travel in millimetres is not the stroke.
    Failed(f32),
}

/// State of a homing run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Homing {
    elapsed_ms: u32,
    /// Time since the fingers pressed; none while closing.
    opening_ms: Option<u32>,
    resting_ms: u16,
    stall: StallDetector,
}

impl Homing {
    /// One millisecond, with the fingers' force in newtons and whether contact is confirmed.
    pub fn tick(
        &mut self,
        motor: &MotorStatus,
        force_n: f32,
        in_contact: bool,
        limits: &GripLimits,
    ) -> HomingStep {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        if self.elapsed_ms > limits.home_ms {
            return HomingStep::Failed(motor.opening_mm.unwrap_or_default());
        }
        match self.opening_ms {
            None => self.close(motor, force_n, in_contact, limits),
            Some(since_ms) => {
                self.opening_ms = Some(since_ms.saturating_add(1));
                self.open(motor, since_ms, limits)
            }
        }
    }

    fn close(
        &mut self,
        motor: &MotorStatus,
        force_n: f32,
        in_contact: bool,
        limits: &GripLimits,
    ) -> HomingStep {
        if in_contact && force_n >= limits.home_n {
            self.opening_ms = Some(0);
            return HomingStep::Zeroed(-force_n / FLEXURES);
        }
        if self.stall.update(motor, force_n, limits) {
            return HomingStep::Stalled;
        }
        HomingStep::Drive(Setpoint::Speed { closing_mm_s: limits.home_mm_s, max_a: limits.home_a })
    }

    fn open(&mut self, motor: &MotorStatus, since_ms: u32, limits: &GripLimits) -> HomingStep {
        let is_resting = since_ms > REVERSAL_MS && motor.closing_mm_s.abs() < limits.end_stop_mm_s;
        self.resting_ms = next_ms(self.resting_ms, is_resting);
        if self.resting_ms < limits.end_stop_ms {
            return HomingStep::Drive(Setpoint::Speed {
                closing_mm_s: -OPENING_MM_S,
                max_a: limits.home_a,
            });
        }
        let stroke = constants::STROKE.value as f32;
        match motor.opening_mm {
            Some(mm) if (mm - stroke).abs() <= limits.stroke_mm => HomingStep::Homed,
            mm => HomingStep::Failed(mm.unwrap_or_default()),
        }
    }
}
