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
