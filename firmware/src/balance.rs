//! Fingers that press against each other press alike: a sensor that lost part of its gain shows.
//!
//! A finger's force is the sum of the lateral forces at its two sensors. Something held that is itself
//! pushed sideways makes a difference too, so this is a warning, and a fault only while nothing else pushes.

use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::params;
use crate::units::Force;

/// Ticks in a row with a difference.
const LASTING: u8 = 3;

/// The watch over both fingers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Balance {
    unbalanced: u8,
}

impl Balance {
    /// Takes a tick's estimates; the difference of the fingers' forces where it has lasted. What cannot
    /// be judged, because a force is not valid, is no difference.
    pub fn note(&mut self, estimates: &[Estimate; SENSORS]) -> Option<Force> {
        let valid = estimates.iter().all(|e| e.validity == Validity::Valid);
        let [a, b, c, d] = estimates.map(|estimate| {
            let [x, _] = estimate.force;
            x.0
        });
        let left = a.saturating_add(b).saturating_abs();
        let right = c.saturating_add(d).saturating_abs();
        let difference = left.saturating_sub(right).saturating_abs();
        let share = left.max(right) / params::UNBALANCED_SHARE;
        let limit = params::UNBALANCED_N.saturating_mul(1 << Force::BITS);
        self.unbalanced = match valid && difference > limit.saturating_add(share) {
            true => self.unbalanced.saturating_add(1),
            false => 0,
        };
        (self.unbalanced >= LASTING).then_some(Force(difference))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressed(newtons: [i32; SENSORS]) -> [Estimate; SENSORS] {
        newtons.map(|n| Estimate {
            force: [Force(n << Force::BITS), Force(0)],
            validity: Validity::Valid,
            ..Estimate::MISSING
        })
    }

    #[test]
    fn fifteen_newtons_and_a_tenth_for_three_ticks_are_a_difference() {
        // Left 100 N, right 75 N, of the other sign: 25 N is the limit, 26 N more.
        for (right, found) in [(-38, false), (-37, true)] {
            let mut balance = Balance::default();
            let estimates = pressed([40, 60, right, -37]);
            assert_eq!(balance.note(&estimates), None);
            assert_eq!(balance.note(&estimates), None);
            assert_eq!(balance.note(&estimates).is_some(), found, "{right}");
            assert_eq!(balance.note(&pressed([40, 60, -50, -50])), None);
        }
    }

    #[test]
    fn a_force_that_is_not_valid_is_not_judged() {
        let mut balance = Balance::default();
        let mut estimates = pressed([200, 0, 0, 0]);
        estimates[3].validity = Validity::Saturated;
        for _ in 0..10 {
            assert_eq!(balance.note(&estimates), None);
        }
    }
}
