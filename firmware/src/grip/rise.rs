//! Rise of a force or a current above its minimum: a contact that an offset of the sensors can neither hide nor fake.

/// Fraction of the difference by which the minimum follows a larger value, per step: a time constant of 8 s.
const RECOVERY: f32 = 1.0 / 8192.0;

/// Minimum of a signal, and how far the signal is above it.
#[derive(Clone, Copy, Debug, Default)]
pub struct RiseDetector {
    lowest: Option<f32>,
}

impl RiseDetector {
    /// Adds a value; its rise above the minimum.
    pub fn update(&mut self, value: f32) -> f32 {
        let lowest = self.lowest.map_or(value, |lowest| lowest.min(value));
        self.lowest = Some(lowest);
        value - lowest
    }

    /// Lets the minimum follow slow changes of an unloaded sensor, such as drift. Not to be called while the fingers are
    /// loaded, or the load would become the new minimum.
    pub fn follow(&mut self, value: f32) {
        if let Some(lowest) = &mut self.lowest {
            *lowest += (value - *lowest) * RECOVERY;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rise_is_relative_to_the_minimum() {
        let mut rise = RiseDetector::default();
        let rises = [8.0, 3.0, 5.0, 25.0].map(|value| rise.update(value));
        assert_eq!(rises, [0.0, 0.0, 2.0, 22.0]);
    }

    #[test]
    fn minimum_follows_a_drift_with_a_time_constant_of_8_s() {
        let mut rise = RiseDetector::default();
        rise.update(0.0);
        for _ in 0..8192 {
            rise.follow(10.0);
        }
        // 10 e^-1.
        assert!((rise.update(10.0) - 3.68).abs() < 0.01);
    }
}
