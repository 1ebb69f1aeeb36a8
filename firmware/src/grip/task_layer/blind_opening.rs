//! Opening without valid forces: the current indicates an obstacle. It decreases while a load is released, and increases
//! against an obstacle.

use crate::config::limits::GripLimits;
use crate::grip::contact_observer::MEAN_TICKS;
use crate::grip::rise::RiseDetector;
use crate::grip::step::GripStep;
use crate::math::greater;
use crate::motor::MotorStatus;

/// Detects an obstacle.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BlindOpening {
    /// Mean opening current in amperes.
    mean_a: f32,
    /// Its rise since the last valid force.
    rise: RiseDetector,
    /// Milliseconds since an opening began.
    elapsed_ms: u32,
    /// Rotor position in radians at which an opening met an obstacle.
    obstacle_rad: Option<f32>,
}

impl BlindOpening {
    /// Adds the current of one millisecond. A valid force, a clear of the host or closing by some millimetres ends an obstacle.
    pub(super) fn observe(&mut self, step: GripStep) {
        let GripStep { inputs, settings, .. } = step;
        let motor = &inputs.motor;
        let is_clear_of = |obstacle_rad: f32| {
            (motor.rotor_rad - obstacle_rad) * settings.screw.ratio_mm > settings.limits.clear_mm
        };
        if step.contact.is_valid() || inputs.clear || self.obstacle_rad.is_some_and(is_clear_of) {
            (self.obstacle_rad, self.rise) = (None, RiseDetector::default());
        }
        self.mean_a += (-motor.current.q - self.mean_a) / MEAN_TICKS;
    }

    /// A new opening begins; a repeated command does not loosen the screw again.
    pub(super) const fn begin(&mut self) {
        self.elapsed_ms = 0;
    }

    /// Adds one millisecond of an opening; whether its current still loosens the screw.
    pub(super) const fn is_loosening(&mut self, limits: &GripLimits) -> bool {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        self.elapsed_ms < limits.loosening_ms
    }

    /// Whether the fingers are at an obstacle.
    pub(super) fn is_blocked(
        &mut self,
        motor: &MotorStatus,
        limits: &GripLimits,
        (is_loosening, is_stalled): (bool, bool),
    ) -> bool {
        // A load that turns a backdrivable screw makes the motor brake: no obstacle.
        let meets_obstacle =
            !is_loosening && self.rise.update(greater(self.mean_a, 0.0)) > limits.blind_rise_a;
        if meets_obstacle || is_stalled {
            self.obstacle_rad.get_or_insert(motor.rotor_rad);
        }
        // Repeated openings would each press harder.
        self.obstacle_rad.is_some_and(|obstacle_rad| motor.rotor_rad <= obstacle_rad)
    }
}
