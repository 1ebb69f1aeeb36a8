//! Stall detection while the fingers should move, and the velocity filter that it and the rest detection use.

use crate::config::limits::GripLimits;
use crate::grip::debounce::next_ms;
use crate::motor::MotorStatus;

/// Time constant of [`VelocityFilter`] in milliseconds.
const MEAN_MS: f32 = 4.0;

/// Low pass of the finger velocity: the velocity noise of a single millisecond exceeds the threshold of rest,
/// most of all on a screw of large lead.
#[derive(Clone, Copy, Debug, Default)]
pub struct VelocityFilter {
    mean_mm_s: f32,
}

impl VelocityFilter {
    /// Adds the velocity of one millisecond; the filtered velocity in mm/s.
    pub fn update(&mut self, closing_mm_s: f32) -> f32 {
        self.mean_mm_s += (closing_mm_s - self.mean_mm_s) / MEAN_MS;
        self.mean_mm_s
    }
}

/// Detects current without motion and without force.
#[derive(Clone, Copy, Debug, Default)]
pub struct StallDetector {
    velocity: VelocityFilter,
    stalled_ms: u16,
}

impl StallDetector {
    /// Adds one millisecond in which the fingers should move; whether they are stalled.
    pub fn update(&mut self, motor: &MotorStatus, force_n: f32, limits: &GripLimits) -> bool {
        let is_slow = self.velocity.update(motor.closing_mm_s).abs() < limits.stall_mm_s;
        let is_pushing = motor.current.q.abs() > limits.stall_a;
        let is_stalled = is_slow && is_pushing && force_n < limits.contact_n;
        self.stalled_ms = next_ms(self.stalled_ms, is_stalled);
        self.stalled_ms >= limits.stall_ms
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::foc::Dq;

    fn after(ticks: u16, current_a: f32, speed: f32, force_n: f32) -> bool {
        let motor = MotorStatus {
            closing_mm_s: speed,
            current: Dq { d: 0.0, q: current_a },
            ..MotorStatus::default()
        };
        let mut stall = StallDetector::default();
        (0..ticks).any(|_| stall.update(&motor, force_n, &GripLimits::GRIPPER))
    }

    #[test]
    fn stall_is_detected_after_40_ms() {
        assert!(after(40, 1.3, 0.1, 1.0) && !after(39, 1.3, 0.1, 1.0));
        assert!(after(40, -1.3, -0.1, 1.0));
        assert!(!after(500, 1.1, 0.1, 1.0));
        assert!(!after(500, 5.0, 1.0, 1.0));
        assert!(!after(500, 5.0, 0.0, 6.0));
    }

    #[test]
    fn velocity_filter_has_a_time_constant_of_4_ms() {
        let mut velocity = VelocityFilter::default();
        assert_eq!(velocity.update(2.0), 0.5);
        assert_eq!(velocity.update(0.5), 0.5);
        let after = (0..10).map(|_| velocity.update(0.0)).last();
        // 0.5 times 0.75^10.
        assert!(after.is_some_and(|mean| (mean - 0.028).abs() < 0.001));
    }

    #[test]
    fn current_speed_and_force_at_their_thresholds_are_no_stall() {
        assert!(!after(500, 1.2, 0.1, 1.0));
        assert!(!after(500, 1.3, 0.1, 5.0));
        assert!(after(500, 1.3, 0.1, 4.9));
        // The velocity filter begins with a quarter: 0.8 mm/s is not slow, and the second sample is the first that counts.
        let motor = |closing_mm_s| MotorStatus {
            closing_mm_s,
            current: Dq { d: 0.0, q: 1.3 },
            ..MotorStatus::default()
        };
        let mut stall = StallDetector::default();
        let limits = GripLimits { stall_mm_s: 1.0, stall_ms: 1, ..GripLimits::GRIPPER };
        assert!(!stall.update(&motor(4.0), 0.0, &limits));
        assert!(stall.update(&motor(0.0), 0.0, &limits));
    }
}
