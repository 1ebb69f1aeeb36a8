//! Homing on force: closes until the fingers press on each other, opens to the far end, and compares the travel
//! with the stroke. An object between the fingers makes the travel too short; one around them ends the opening.

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::grip::debounce::next_ms;
use crate::grip::stall_detector::StallDetector;
use crate::motor::{MotorStatus, Setpoint};

/// Opening speed in mm/s.
const OPENING_MM_S: f32 = 20.0;
/// Opening speed in mm/s close to the far end, so that the screw does not jam there, and where that begins, in
/// millimetres before it.
const LANDING: (f32, f32) = (5.0, 3.0);
/// Milliseconds after the reversal in which rest is not taken for the far end.
const REVERSAL_MS: u32 = 100;
/// Samples of a force that confirm it.
const PRESSED_MS: u16 = 2;
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

/// Forces of the fingers in newtons.
#[derive(Clone, Copy, Debug)]
pub struct HomingForces {
    /// The greater of the closing force and its rise.
    pub closing_n: f32,
    /// See [`crate::grip::finger_force::FingerForces::outward_n`].
    pub outward_n: Option<f32>,
}

/// State of a homing run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Homing {
    elapsed_ms: u32,
    /// Time since the fingers pressed; none while closing.
    opening_ms: Option<u32>,
    resting_ms: u16,
    /// Milliseconds of the force that ends the present direction.
    pressed_ms: u16,
    stall: StallDetector,
}

impl Homing {
    /// One millisecond.
    pub fn tick(
        &mut self,
        motor: &MotorStatus,
        forces: HomingForces,
        limits: &GripLimits,
    ) -> HomingStep {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        if self.elapsed_ms > limits.home_ms {
            return HomingStep::Failed(motor.opening_mm.unwrap_or_default());
        }
        match self.opening_ms {
            None => self.close(motor, forces.closing_n, limits),
            Some(since_ms) => {
                self.opening_ms = Some(since_ms.saturating_add(1));
                self.open(motor, since_ms, forces, limits)
            }
        }
    }

    fn close(&mut self, motor: &MotorStatus, force_n: f32, limits: &GripLimits) -> HomingStep {
        self.pressed_ms = next_ms(self.pressed_ms, force_n >= limits.home_n);
        if self.pressed_ms >= PRESSED_MS {
            (self.opening_ms, self.pressed_ms) = (Some(0), 0);
            return HomingStep::Zeroed(-force_n / FLEXURES);
        }
        // A screw that jammed at the far end needs more current than the one that it jammed with.
        let is_loosening = self.elapsed_ms <= limits.loosening_ms;
        if !is_loosening && self.stall.update(motor, force_n, limits) {
            return HomingStep::Stalled;
        }
        let max_a = if is_loosening { limits.blind_a } else { limits.home_a };
        HomingStep::Drive(Setpoint::Speed { closing_mm_s: limits.home_mm_s, max_a })
    }

    fn open(
        &mut self,
        motor: &MotorStatus,
        since_ms: u32,
        forces: HomingForces,
        limits: &GripLimits,
    ) -> HomingStep {
        let is_outward = forces.outward_n.is_some_and(|outward_n| outward_n > limits.outward_n);
        self.pressed_ms = next_ms(self.pressed_ms, is_outward);
        if self.pressed_ms >= PRESSED_MS {
            return HomingStep::Failed(motor.opening_mm.unwrap_or_default());
        }
        let stroke = constants::STROKE.value as f32;
        let is_resting = since_ms > REVERSAL_MS && motor.closing_mm_s.abs() < limits.end_stop_mm_s;
        self.resting_ms = next_ms(self.resting_ms, is_resting);
        if self.resting_ms < limits.end_stop_ms {
            let (landing_mm_s, before_mm) = LANDING;
            let is_near = motor.opening_mm.is_some_and(|mm| mm > stroke - before_mm);
            let opening_mm_s = if is_near { landing_mm_s } else { OPENING_MM_S };
            return HomingStep::Drive(Setpoint::Speed {
                closing_mm_s: -opening_mm_s,
                max_a: limits.home_a,
            });
        }
        match motor.opening_mm {
            Some(mm) if (mm - stroke).abs() <= limits.stroke_mm => HomingStep::Homed,
            mm => HomingStep::Failed(mm.unwrap_or_default()),
        }
    }
}
