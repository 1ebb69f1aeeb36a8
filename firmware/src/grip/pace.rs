//! How fast the fingers move, by a mean over a few milliseconds: in a single one the rotor's noise is more than a
//! rest, on a steep screw above all.

/// Milliseconds of the mean.
const MEAN_MS: f32 = 4.0;

/// The fingers' mean speed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pace {
    mean_mm_s: f32,
}

impl Pace {
    /// Takes a millisecond's speed; the mean of the last ones, in mm/s.
    pub fn note(&mut self, closing_mm_s: f32) -> f32 {
        self.mean_mm_s += (closing_mm_s - self.mean_mm_s) / MEAN_MS;
        self.mean_mm_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_millisecond_counts_for_a_quarter_and_is_forgotten_after_some_ten() {
        let mut pace = Pace::default();
        assert_eq!(pace.note(2.0), 0.5);
        assert_eq!(pace.note(0.5), 0.5);
        let after = (0..10).map(|_| pace.note(0.0)).last();
        // 0.5 times 0.75^10.
        assert!(after.is_some_and(|mean| (mean - 0.028).abs() < 0.001));
    }
}
