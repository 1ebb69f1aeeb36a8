//! The fingers' forces: each the sum of the lateral forces at its two sensors, and whether it is to be
//! believed.
//!
//! The greater one counts: a finger that reads low then changes nothing, and one that reads high grips less.

use crate::balance::pressing;
use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::units::Force;

/// What is known of a finger's force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finger {
    /// In newtons.
    Told(f32),
    /// A foreign magnet is near: it may be the magnet's.
    Disturbed,
    /// A sensor of it tells nothing that can be used.
    Lost,
}

/// Both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingers {
    /// Sensors 0 and 1.
    pub left: Finger,
    /// Sensors 2 and 3.
    pub right: Finger,
    /// Sum of the longitudinal forces of the fingers that are believed, in newtons: what the object drags.
    pub drag_n: f32,
}

impl Fingers {
    /// From the estimates.
    pub fn of(estimates: &[Estimate; SENSORS]) -> Self {
        let [a, b, c, d] = estimates;
        let drag = |finger: Finger, pair: [&Estimate; 2]| match finger {
            Finger::Told(_) => pair.map(|e| newtons(e.force[1])).iter().sum(),
            _ => 0.0,
        };
        let (left, right) = (finger([a, b]), finger([c, d]));
        Self {
            left,
            right,
            drag_n: drag(left, [a, b]) + drag(right, [c, d]),
        }
    }

    /// The greater force in newtons of those that are believed.
    pub fn greatest_n(&self) -> Option<f32> {
        match (self.left, self.right) {
            (Finger::Told(left), Finger::Told(right)) => Some(left.max(right)),
            (Finger::Told(one), _) | (_, Finger::Told(one)) => Some(one),
            _ => None,
        }
    }

    /// Both together in newtons; a finger that is not believed presses as the other does.
    pub fn sum_n(&self) -> Option<f32> {
        match (self.left, self.right) {
            (Finger::Told(left), Finger::Told(right)) => Some(left + right),
            (Finger::Told(one), _) | (_, Finger::Told(one)) => Some(2.0 * one),
            _ => None,
        }
    }

    /// Neither tells anything, and no magnet is to blame.
    pub fn are_lost(&self) -> bool {
        self.left == Finger::Lost && self.right == Finger::Lost
    }
}

/// In newtons.
pub fn newtons(force: Force) -> f32 {
    force.0 as f32 / Force::PER_NEWTON as f32
}

fn finger(pair: [&Estimate; 2]) -> Finger {
    if pair.iter().any(|e| e.validity != Validity::Valid) {
        return Finger::Lost;
    }
    if pair.iter().any(|e| e.disturbed) {
        return Finger::Disturbed;
    }
    Finger::Told(newtons(pressing(pair)))
}

#[cfg(test)]
mod tests {
    use super::super::fixture::pressed;
    use super::*;

    #[test]
    fn the_greater_of_both_fingers_counts() {
        // Left 30 + 40 N, right -20 - 35 N.
        let fingers = Fingers::of(&pressed([30.0, 40.0, -20.0, -35.0], [1.0, 2.0, 3.0, -4.0]));
        assert_eq!(fingers.greatest_n(), Some(70.0));
        assert_eq!((fingers.sum_n(), fingers.drag_n), (Some(125.0), 2.0));
    }

    #[test]
    fn a_finger_is_lost_with_one_of_its_sensors_and_the_other_counts_alone() {
        let mut estimates = pressed([50.0, 50.0, 10.0, 10.0], [0.0; 4]);
        estimates[1].validity = Validity::Saturated;
        let fingers = Fingers::of(&estimates);
        assert_eq!(
            (fingers.greatest_n(), fingers.sum_n()),
            (Some(20.0), Some(40.0))
        );
        estimates[2].disturbed = true;
        let fingers = Fingers::of(&estimates);
        assert_eq!((fingers.greatest_n(), fingers.are_lost()), (None, false));
        estimates[2] = Estimate::MISSING;
        assert!(Fingers::of(&estimates).are_lost());
    }
}
