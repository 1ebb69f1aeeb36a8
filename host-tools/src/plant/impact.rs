//! Steps on the ground: what the foot feels as it lands.

use std::f64::consts::PI;

/// What lands with the gripper on the ground, in kg (assumed).
pub const FOOT_KG: f64 = 2.0;

/// A half sine of ground force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Since the beginning, in s.
    pub start_s: f64,
    /// Time from touching to leaving, in s: 2 to 50 ms are common.
    pub lasts_s: f64,
    /// Greatest force in N.
    pub peak_n: f64,
}

impl Impact {
    /// Force at a time, in N.
    pub fn force_n(&self, time_s: f64) -> f64 {
        let share = (time_s - self.start_s) / self.lasts_s;
        match (0.0..1.0).contains(&share) {
            true => self.peak_n * libm::sin(PI * share),
            false => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_sine_peaks_in_its_middle_and_is_over_at_its_end() {
        let impact = Impact {
            start_s: 1.0,
            lasts_s: 0.004,
            peak_n: 300.0,
        };
        assert!((impact.force_n(1.002) - 300.0).abs() < 1e-9);
        // sin(pi/4).
        assert!((impact.force_n(1.001) - 212.132).abs() < 1e-3);
        assert_eq!((impact.force_n(0.999), impact.force_n(1.0041)), (0.0, 0.0));
    }
}
