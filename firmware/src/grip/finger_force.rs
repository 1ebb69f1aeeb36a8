//! Force of each finger: the sum of the lateral forces at its two sensors, if they are valid.
//!
//! Control uses the greater of both forces: a finger that reads low has no effect, one that reads high reduces the
//! grip force.

use crate::config::limits::GripLimits;
use crate::estimator::finger_symmetry::finger_forces;
use crate::estimator::{Estimate, Validity};
use crate::fixed_point::Force;
use crate::sensors::hall::SENSORS;

/// Force of one finger.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FingerForce {
    /// In newtons; positive where an object between the fingers presses.
    Valid(f32),
    /// A magnetic disturbance was detected: the force may be its effect.
    Disturbed,
    /// A field is outside the range of the sensor or of the model.
    OutOfRange,
    /// At least one of the two sensors has no estimate.
    #[default]
    Lost,
}

/// Forces of both fingers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FingerForces {
    /// Sensors 0 and 1.
    pub left: FingerForce,
    /// Sensors 2 and 3.
    pub right: FingerForce,
    /// Drag of the object in newtons: sum of the longitudinal forces of the valid fingers.
    pub drag_n: f32,
}

impl FingerForces {
    /// From the force estimates of all sensors.
    pub fn of(estimates: &[Estimate; SENSORS]) -> Self {
        let [a, b, c, d] = estimates;
        let drag = |finger: FingerForce, pair: [&Estimate; 2]| match finger {
            FingerForce::Valid(_) => pair.map(|e| newtons(e.force[1])).iter().sum(),
            _ => 0.0,
        };
        let [left, right] = finger_forces(estimates);
        let (left, right) = (finger([a, b], left), finger([c, d], right));
        Self { left, right, drag_n: drag(left, [a, b]) + drag(right, [c, d]) }
    }

    /// The greater of the valid forces in newtons.
    pub fn max_n(&self) -> Option<f32> {
        match (self.left, self.right) {
            (FingerForce::Valid(left), FingerForce::Valid(right)) => Some(left.max(right)),
            (FingerForce::Valid(one), _) | (_, FingerForce::Valid(one)) => Some(one),
            _ => None,
        }
    }

    /// Sum of both forces in newtons; an invalid one is taken to equal the other.
    pub fn sum_n(&self) -> Option<f32> {
        match (self.left, self.right) {
            (FingerForce::Valid(left), FingerForce::Valid(right)) => Some(left + right),
            (FingerForce::Valid(one), _) | (_, FingerForce::Valid(one)) => Some(2.0 * one),
            _ => None,
        }
    }

    /// The greatest force in newtons with which a valid finger is pushed closed, as by a tube around the fingers that open;
    /// none without a valid finger.
    pub fn outward_n(&self) -> Option<f32> {
        match (self.left, self.right) {
            (FingerForce::Valid(left), FingerForce::Valid(right)) => Some(-left.min(right)),
            (FingerForce::Valid(one), _) | (_, FingerForce::Valid(one)) => Some(-one),
            _ => None,
        }
    }

    /// Both forces are lost, and not because of a disturbance.
    pub fn are_lost(&self) -> bool {
        let is_lost = |finger| matches!(finger, FingerForce::Lost | FingerForce::OutOfRange);
        is_lost(self.left) && is_lost(self.right)
    }
}

/// Detects a force beyond the range of the model, whose estimate is not valid any more: a sensor leaves the range after a high
/// force. Up to 50 kN/s it has a valid estimate between the threshold and the end of the range; the gripper itself reaches
/// 20 kN/s.
#[derive(Clone, Copy, Debug, Default)]
pub struct BeyondRange {
    /// Last valid lateral force of each sensor in newtons.
    last_n: [f32; SENSORS],
    is_beyond: bool,
}

impl BeyondRange {
    /// Adds the estimates of one millisecond.
    pub(super) fn update(&mut self, estimates: &[Estimate; SENSORS], limits: &GripLimits) {
        let (mut is_outside, mut left_high) = (false, false);
        for (last_n, estimate) in self.last_n.iter_mut().zip(estimates) {
            if estimate.validity.is_in_range() {
                let [lateral, _] = estimate.force;
                *last_n = newtons(lateral).abs();
            } else if is_out_of_range(estimate) {
                is_outside = true;
                // The residuals of such a field resemble a disturbance: only before it has left, the flag counts.
                left_high |= *last_n > limits.beyond_n && !estimate.disturbed;
            }
        }
        self.is_beyond = is_outside && (self.is_beyond || left_high);
    }

    /// Whether the force is excessive.
    pub const fn is_over(&self) -> bool {
        self.is_beyond
    }
}

/// A fixed-point force in newtons.
pub fn newtons(force: Force) -> f32 {
    force.0 as f32 / Force::PER_NEWTON as f32
}

const fn is_out_of_range(estimate: &Estimate) -> bool {
    matches!(estimate.validity, Validity::Saturated | Validity::OutsideModel)
}

fn finger(pair: [&Estimate; 2], force: Force) -> FingerForce {
    if pair.iter().any(|e| is_out_of_range(e)) {
        FingerForce::OutOfRange
    } else if pair.iter().any(|e| !e.validity.is_in_range()) {
        FingerForce::Lost
    } else if pair.iter().any(|e| e.disturbed) {
        FingerForce::Disturbed
    } else {
        FingerForce::Valid(newtons(force))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grip::tests::rig::pressed;

    #[test]
    fn max_force_is_that_of_the_stronger_finger() {
        // Left 30 + 40 N, right -20 - 35 N.
        let fingers = FingerForces::of(&pressed([30.0, 40.0, -20.0, -35.0], [1.0, 2.0, 3.0, -4.0]));
        assert_eq!(fingers.max_n(), Some(70.0));
        assert_eq!((fingers.sum_n(), fingers.drag_n), (Some(125.0), 2.0));
        let fingers = FingerForces::of(&pressed([20.0, 35.0, -30.0, -40.0], [0.0; 4]));
        assert_eq!(fingers.max_n(), Some(70.0));
    }

    #[test]
    fn invalid_sensor_makes_its_finger_lost() {
        let mut estimates = pressed([50.0, 50.0, -10.0, -10.0], [0.0; 4]);
        estimates[1].validity = Validity::Saturated;
        let fingers = FingerForces::of(&estimates);
        assert_eq!((fingers.max_n(), fingers.sum_n()), (Some(20.0), Some(40.0)));
        estimates[2].disturbed = true;
        let fingers = FingerForces::of(&estimates);
        assert_eq!((fingers.max_n(), fingers.are_lost()), (None, false));
        estimates[2] = Estimate::MISSING;
        assert!(FingerForces::of(&estimates).are_lost());
    }

    #[test]
    fn one_valid_finger_counts_for_both() {
        let mut estimates = pressed([5.0, 5.0, 8.0, 8.0], [1.0, 2.0, 3.0, 4.0]);
        // Left 10 N, right -16 N: pushed closed with 16 N.
        let fingers = FingerForces::of(&estimates);
        assert_eq!((fingers.outward_n(), fingers.drag_n), (Some(16.0), 10.0));
        estimates[0] = Estimate::MISSING;
        let fingers = FingerForces::of(&estimates);
        assert_eq!((fingers.outward_n(), fingers.max_n()), (Some(16.0), Some(-16.0)));
        assert_eq!((fingers.sum_n(), fingers.drag_n), (Some(-32.0), 7.0));
        estimates[0].validity = Validity::OutsideModel;
        assert_eq!(FingerForces::of(&estimates).left, FingerForce::OutOfRange);
        estimates[3] = Estimate::MISSING;
        let fingers = FingerForces::of(&estimates);
        assert_eq!((fingers.outward_n(), fingers.max_n(), fingers.sum_n()), (None, None, None));
        assert_eq!((fingers.right, fingers.drag_n), (FingerForce::Lost, 0.0));
        let mut estimates = pressed([5.0, 5.0, 8.0, 8.0], [0.0; 4]);
        estimates[3] = Estimate::MISSING;
        assert_eq!(FingerForces::of(&estimates).outward_n(), Some(-10.0));
    }

    #[test]
    fn field_that_leaves_the_range_after_a_high_force_is_excessive_force() {
        // 200 N: 0.8 of the range of 250 N.
        for (newtons, disturbed, is_over) in [
            (200.0, false, false),
            (201.0, false, true),
            (-201.0, false, true),
            (201.0, true, false),
        ] {
            let mut beyond = BeyondRange::default();
            let mut estimates = pressed([newtons, 0.0, 0.0, 0.0], [0.0; 4]);
            beyond.update(&estimates, &GripLimits::GRIPPER);
            assert!(!beyond.is_over());
            estimates[0].validity = Validity::OutsideModel;
            estimates[0].disturbed = disturbed;
            beyond.update(&estimates, &GripLimits::GRIPPER);
            assert_eq!(beyond.is_over(), is_over, "{newtons} {disturbed}");
            // It stays until the field is in range again, also with a flag that comes later.
            estimates[0].disturbed = true;
            beyond.update(&estimates, &GripLimits::GRIPPER);
            assert_eq!(beyond.is_over(), is_over);
            estimates[0] = Estimate::MISSING;
            beyond.update(&estimates, &GripLimits::GRIPPER);
            assert!(!beyond.is_over());
        }
    }
}
