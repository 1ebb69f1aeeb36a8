//! Fingers that press against each other press alike: a sensor that lost part of its gain shows.
//!
//! A finger's force is the sum of the lateral forces at its two sensors. Something held that is itself
//! pushed sideways makes a difference too, so this is a warning, and a fault only while nothing else pushes.

use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::limits::Limits;
use crate::units::Force;

/// One over the share of the greater force that is no difference.
const SHARE: i32 = 10;

/// What a finger presses with, whichever way, from its two sensors.
pub fn pressing(pair: [&Estimate; 2]) -> Force {
    let [first, second] = pair.map(|estimate| {
        let [lateral, _] = estimate.force;
        lateral.0
    });
    Force(first.saturating_add(second).saturating_abs())
}

/// The watch over both fingers.
#[derive(Clone, Copy, Debug)]
pub struct Balance {
    limit: Force,
    ticks: u8,
    unbalanced: u8,
}

impl Balance {
    /// No tick has been seen.
    pub const fn new(limits: &Limits) -> Self {
        Self {
            limit: Force(limits.unbalanced_n.saturating_mul(1 << Force::BITS)),
            ticks: limits.unbalanced_ticks,
            unbalanced: 0,
        }
    }

    /// Takes a tick's estimates; the difference of the fingers' forces where it has lasted. What cannot
    /// be judged, because a force is not valid, is no difference.
    pub fn note(&mut self, estimates: &[Estimate; SENSORS]) -> Option<Force> {
        let valid = estimates.iter().all(|e| e.validity == Validity::Valid);
        let [a, b, c, d] = estimates;
        let [left, right] = [[a, b], [c, d]].map(|pair| pressing(pair).0);
        let difference = left.saturating_sub(right).saturating_abs();
        let share = left.max(right) / SHARE;
        self.unbalanced = match valid && difference > self.limit.0.saturating_add(share) {
            true => self.unbalanced.saturating_add(1),
            false => 0,
        };
        (self.unbalanced >= self.ticks).then_some(Force(difference))
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
            let mut balance = Balance::new(&Limits::GRIPPER);
            let estimates = pressed([40, 60, right, -37]);
            assert_eq!(balance.note(&estimates), None);
            assert_eq!(balance.note(&estimates), None);
            assert_eq!(balance.note(&estimates).is_some(), found, "{right}");
            assert_eq!(balance.note(&pressed([40, 60, -50, -50])), None);
        }
    }

    #[test]
    fn a_force_that_is_not_valid_is_not_judged() {
        let mut balance = Balance::new(&Limits::GRIPPER);
        let mut estimates = pressed([200, 0, 0, 0]);
        estimates[3].validity = Validity::Saturated;
        for _ in 0..10 {
            assert_eq!(balance.note(&estimates), None);
        }
    }
}
