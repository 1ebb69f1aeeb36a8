//! A proportional-integral controller in two steps, so that what a limit withholds between them can be
//! given back to the integral.

/// Coefficients, ready for one period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gains {
    /// Output for one unit of error.
    pub proportional: f32,
    /// What the integral grows by in one period for one unit of error.
    pub integral: f32,
    /// Share of what a limit withholds by which the integral falls in one period.
    pub back: f32,
}

impl Gains {
    /// From gain, the integral's corner in rad/s, and the period in seconds. The integral follows a limit
    /// within the time of its corner.
    pub const fn of(proportional: f32, corner: f32, period_s: f32) -> Self {
        Self {
            proportional,
            integral: proportional * corner * period_s,
            back: corner * period_s,
        }
    }
}

/// The integral.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pi {
    /// In the output's unit.
    pub sum: f32,
}

impl Pi {
    /// What it asks for.
    pub fn ask(&self, gains: &Gains, error: f32) -> f32 {
        gains.proportional * error + self.sum
    }

    /// Ends the period: `withheld` is what was applied less what was asked.
    pub fn close(&mut self, gains: &Gains, error: f32, withheld: f32) {
        self.sum += gains.integral * error + gains.back * withheld;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_error_gives_a_ramp() {
        let gains = Gains::of(2.0, 100.0, 0.001);
        let mut pi = Pi::default();
        for period in 0..50 {
            let asked = pi.ask(&gains, 3.0);
            let expected = 2.0 * 3.0 + period as f32 * 2.0 * 100.0 * 0.001 * 3.0;
            assert!((asked - expected).abs() < 1e-4, "{period}: {asked}");
            pi.close(&gains, 3.0, 0.0);
        }
    }

    #[test]
    fn behind_a_limit_the_integral_settles_and_the_output_leaves_it_at_once() {
        let gains = Gains::of(2.0, 100.0, 0.001);
        let mut pi = Pi::default();
        let limited = |asked: f32| asked.min(10.0);
        for _ in 0..1000 {
            let asked = pi.ask(&gains, 3.0);
            pi.close(&gains, 3.0, limited(asked) - asked);
        }
        // integral * error = back * withheld: 0.6 of 0.1 is 6 beyond the limit.
        assert!((pi.ask(&gains, 3.0) - 16.0).abs() < 1e-3);
        assert!(pi.ask(&gains, -0.1) < 10.0);
    }
}
