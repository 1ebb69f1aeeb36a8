//! Limit of the motor current while holding.

use crate::motor::settings::PEAK_A;

/// Milliseconds within the band after which the holding current decreases.
const RELAX_MS: u32 = 100;
/// Decay factor of the holding current per millisecond.
const DECAY: f32 = 0.99;
/// Holding current relative to the one computed from the assumed friction of the screw.
pub(super) const MARGIN: f32 = 1.4;
/// Factor on the margin each time the force left the band after the current had decreased.
const MARGIN_GROWTH: f32 = 1.25;

/// Current limit while holding: friction helps, so that less current is needed than for gripping.
#[derive(Clone, Copy, Debug)]
pub struct HoldCurrent {
    in_band_ms: u32,
    max_a: f32,
    margin: f32,
}

impl Default for HoldCurrent {
    fn default() -> Self {
        Self { in_band_ms: 0, max_a: PEAK_A, margin: MARGIN }
    }
}

impl HoldCurrent {
    /// Current limit for this millisecond, from the computed holding current and the magnitude of
    /// the present current set-point.
    pub(super) fn update(&mut self, is_in_band: bool, holding_a: f32, present_a: f32) -> f32 {
        if !is_in_band {
            if self.in_band_ms > RELAX_MS {
                self.margin *= MARGIN_GROWTH;
            }
            (self.in_band_ms, self.max_a) = (0, PEAK_A);
            return PEAK_A;
        }
        self.in_band_ms = self.in_band_ms.saturating_add(1);
        if self.in_band_ms > RELAX_MS {
            let from_a = self.max_a.min(present_a.max(holding_a));
            let to_a = (holding_a * self.margin).min(PEAK_A);
            self.max_a = to_a + (from_a - to_a).max(0.0) * DECAY;
        }
        self.max_a
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Peak current: 0.96 N m / 0.1 N m/A.
    const LIMIT_A: f32 = 9.6;

    fn near(found: f32, expected: f32) {
        assert!((found - expected).abs() < 1e-4, "{found} instead of {expected}");
    }

    /// After this many milliseconds within the band, at 1 A computed and 2 A present.
    fn held(ticks: u32) -> (HoldCurrent, f32) {
        let mut hold = HoldCurrent::default();
        let last_a = (0..ticks).map(|_| hold.update(true, 1.0, 2.0)).last();
        (hold, last_a.unwrap_or(LIMIT_A))
    }

    #[test]
    fn current_decays_to_the_margin_after_100_ms() {
        near(held(1).1, LIMIT_A);
        near(held(100).1, LIMIT_A);
        // From 2 A to 1.4 times 1 A: 1.4 + 0.6 * 0.99, then 1.4 + 0.594 * 0.99.
        near(held(101).1, 1.994);
        near(held(102).1, 1.988_06);
        near(held(5000).1, 1.4);
    }

    #[test]
    fn decay_begins_at_the_greater_of_present_and_computed_current() {
        let mut hold = held(100).0;
        // 1.4 * 3 A is more than either: no decay.
        near(hold.update(true, 3.0, 2.0), 4.2);
        let mut hold = held(100).0;
        near(hold.update(true, 1.0, 0.5), 1.4);
        let mut hold = held(100).0;
        near(hold.update(true, 10.0, 2.0), LIMIT_A);
    }

    #[test]
    fn margin_grows_each_time_the_force_leaves_the_band_afterwards() {
        let mut hold = held(100).0;
        near(hold.update(false, 1.0, 2.0), LIMIT_A);
        for _ in 0..100 {
            near(hold.update(true, 1.0, 2.0), LIMIT_A);
        }
        // The current had not decreased yet.
        near(hold.update(true, 1.0, 2.0), 1.994);
        near(hold.update(false, 1.0, 2.0), LIMIT_A);
        for _ in 0..100 {
            hold.update(true, 1.0, 2.0);
        }
        // 1.4 * 1.25 = 1.75: 1.75 + 0.25 * 0.99.
        near(hold.update(true, 1.0, 2.0), 1.9975);
    }
}
