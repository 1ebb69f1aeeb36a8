//! Comparison of the two fingers' forces, which are equal while the fingers press against each other: a difference
//! reveals a sensor that lost part of its gain.
//!
//! A gripped object under a lateral load causes a difference too, so this is a warning.

use crate::config::limits::DetectionLimits;
use crate::estimator::estimate::Estimate;
use crate::fixed_point::Force;
use crate::sensors::hall::SENSORS;

/// A difference up to the larger force divided by this is accepted.
const TOLERANCE_DIVISOR: i32 = 10;

/// Forces of the left and the right finger, positive where an object between them presses: the sum of the lateral forces at
/// two sensors, which has the opposite sign at the right finger.
pub fn finger_forces(sensors: &[Estimate; SENSORS]) -> [Force; 2] {
    let lateral = |estimate: &Estimate| {
        let [lateral, _] = estimate.force;
        lateral.0
    };
    let [a, b, c, d] = sensors;
    let left = lateral(a).saturating_add(lateral(b));
    let right = lateral(c).saturating_add(lateral(d));
    [Force(left), Force(right.saturating_neg())]
}

/// Monitor of both fingers.
#[derive(Clone, Copy, Debug)]
pub struct FingerSymmetry {
    limit: Force,
    ticks: u8,
    unbalanced: u8,
}

impl FingerSymmetry {
    /// Monitor before the first tick.
    pub const fn new(limits: &DetectionLimits) -> Self {
        Self {
            limit: Force(limits.unbalanced_n.saturating_mul(1 << Force::BITS)),
            ticks: limits.unbalanced_ticks,
            unbalanced: 0,
        }
    }

    /// Evaluates a tick. Returns the difference of the fingers' forces if it persists; invalid estimates count as no
    /// difference.
    pub fn update(&mut self, estimates: &[Estimate; SENSORS]) -> Option<Force> {
        let valid = estimates.iter().all(|e| e.validity.is_in_range());
        let [left, right] = finger_forces(estimates).map(|force| force.0.saturating_abs());
        let difference = left.saturating_sub(right).saturating_abs();
        let tolerance = left.max(right) / TOLERANCE_DIVISOR;
        let is_unbalanced = valid && difference > self.limit.0.saturating_add(tolerance);
        self.unbalanced = if is_unbalanced { self.unbalanced.saturating_add(1) } else { 0 };
        (self.unbalanced >= self.ticks).then_some(Force(difference))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::Validity;

    fn pressed(newtons: [i32; SENSORS]) -> [Estimate; SENSORS] {
        newtons.map(|n| Estimate {
            force: [Force(n << Force::BITS), Force(0)],
            validity: Validity::Valid,
            ..Estimate::MISSING
        })
    }

    #[test]
    fn difference_above_15_n_and_a_tenth_is_reported_after_3_ticks() {
        // Left 100 N, right 75 N of the other sign: 25 N is the limit.
        for (right, reported) in [(-38, false), (-37, true)] {
            let mut symmetry = FingerSymmetry::new(&DetectionLimits::GRIPPER);
            let estimates = pressed([40, 60, right, -37]);
            let found = [(); 3].map(|()| symmetry.update(&estimates).is_some());
            assert_eq!(found, [false, false, reported], "{right}");
            assert_eq!(symmetry.update(&pressed([40, 60, -50, -50])), None);
        }
    }

    #[test]
    fn invalid_estimates_are_ignored() {
        let mut symmetry = FingerSymmetry::new(&DetectionLimits::GRIPPER);
        let mut estimates = pressed([200, 0, 0, 0]);
        estimates[3].validity = Validity::Saturated;
        assert!((0..10).all(|_| symmetry.update(&estimates).is_none()));
    }
}
