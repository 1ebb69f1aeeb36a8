//! The clocks of board and reference: each has its own first tick and its own rate.

use serde::Serialize;

use super::draw::{Purpose, between, normal, stream};

/// First tick after the common event, in microseconds.
const FIRST_US: [f64; 2] = [20.0, 400.0];

/// Deviation of a clock's rate from the true one (temperature-compensated crystals), in 1e-6.
const RATE_PPM: f64 = 1.0;

/// A clock that stamps every so many microseconds of its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clock {
    /// First stamp.
    pub first_us: u64,
    /// Step between stamps.
    pub period_us: u64,
    /// How much faster than true time it runs, in 1e-6.
    pub fast_ppm: f64,
}

impl Clock {
    /// The board's and the reference's clock during a recording.
    pub fn draw(seed: u64, recording: u32, rates_hz: [f64; 2]) -> [Self; 2] {
        let mut rng = stream(seed, Purpose::Clocks, recording);
        rates_hz.map(|rate_hz| Self {
            first_us: between(&mut rng, FIRST_US[0], FIRST_US[1]).round() as u64,
            period_us: (1e6 / rate_hz).round() as u64,
            fast_ppm: RATE_PPM * normal(&mut rng),
        })
    }

    /// All stamps before an end in seconds, each with its true time in seconds.
    pub fn ticks(self, seconds: f64) -> impl Iterator<Item = (u64, f64)> {
        let end_us = (seconds * 1e6) as u64;
        let stamps = (0..).map(move |i| self.first_us + i * self.period_us);
        stamps
            .take_while(move |stamp_us| *stamp_us < end_us)
            .map(move |stamp_us| {
                let true_us = stamp_us as f64 / (1.0 + self.fast_ppm * 1e-6);
                (stamp_us, true_us * 1e-6)
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_honest_to_a_few_millionths() {
        let [board, reference] = Clock::draw(4, 1, [1000.0, 100.0]);
        assert_ne!(board.first_us, reference.first_us);
        assert_eq!(board.ticks(30.0).count(), 30_000);
        for (stamp_us, true_s) in reference.ticks(30.0) {
            assert!((stamp_us as f64 * 1e-6 - true_s).abs() < 30.0 * 5e-6);
        }
    }
}
