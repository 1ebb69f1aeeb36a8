//! Running statistics over rows, in constant memory.

use sketches_ddsketch::{Config, DDSketch};

/// Count, sum and sum of squares.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    pub fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.sum += value;
        self.squares += value * value;
    }

    /// Moments over the values of both.
    pub fn with(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
        }
    }

    /// Moments of the values minus `offset`.
    pub fn less(self, offset: f64) -> Self {
        Self {
            squares: self.squares - 2.0 * offset * self.sum + self.count * offset * offset,
            sum: self.sum - self.count * offset,
            ..self
        }
    }

    pub fn mean(&self) -> f64 {
        self.sum / self.count
    }

    pub fn rms(&self) -> f64 {
        (self.squares / self.count).sqrt()
    }

    pub fn std(&self) -> f64 {
        (self.squares / self.count - self.mean().powi(2)).max(0.0).sqrt()
    }

    pub fn rows(&self) -> f64 {
        self.count
    }
}

/// Relative accuracy of the percentiles.
const ACCURACY: f64 = 0.002;
/// Buckets of the percentile sketch.
const BUCKETS: u32 = 4096;
/// Errors below this, in gauss or newtons, count as zero.
const LEAST: f64 = 1e-6;

/// Statistics of an error, in the unit of the error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorStatistics {
    pub rms: f64,
    /// Mean, which a tare or an offset would remove.
    pub mean: f64,
    pub std: f64,
    /// 95th percentile of the absolute error.
    pub p95: f64,
    /// Maximum absolute error.
    pub greatest: f64,
    /// Peak-to-peak range of the measurement.
    pub span: f64,
}

/// Running error statistics of one channel.
#[derive(Clone)]
pub struct ErrorAccumulator {
    moments: Moments,
    sizes: DDSketch,
    greatest: f64,
    /// Minimum and maximum of the measurement.
    span: (f64, f64),
}

impl Default for ErrorAccumulator {
    fn default() -> Self {
        Self {
            moments: Moments::default(),
            sizes: DDSketch::new(Config::new(ACCURACY, BUCKETS, LEAST)),
            greatest: 0.0,
            span: (f64::INFINITY, f64::NEG_INFINITY),
        }
    }
}

impl ErrorAccumulator {
    /// Adds a row: the measurement and the model's error.
    pub fn add(&mut self, measured: f64, error: f64) {
        self.moments.add(error);
        self.sizes.add(error.abs());
        self.greatest = self.greatest.max(error.abs());
        self.span = (self.span.0.min(measured), self.span.1.max(measured));
    }

    /// Statistics over the rows of both.
    pub fn with(mut self, other: &Self) -> Self {
        self.moments = self.moments.with(other.moments);
        // Sketches of one configuration always merge.
        let merged = self.sizes.merge(&other.sizes);
        debug_assert!(merged.is_ok());
        self.greatest = self.greatest.max(other.greatest);
        self.span = (self.span.0.min(other.span.0), self.span.1.max(other.span.1));
        self
    }

    pub fn rows(&self) -> f64 {
        self.moments.rows()
    }

    /// Statistics so far; all zero without rows.
    pub fn statistics(&self) -> ErrorStatistics {
        if self.rows() == 0.0 {
            return ErrorStatistics::default();
        }
        ErrorStatistics {
            rms: self.moments.rms(),
            mean: self.moments.mean(),
            std: self.moments.std(),
            p95: self.sizes.quantile(0.95).ok().flatten().unwrap_or(0.0),
            greatest: self.greatest,
            span: self.span.1 - self.span.0,
        }
    }
}

/// Root mean square; NaN without values.
pub fn pooled_rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) =
        values.into_iter().fold((0.0, 0.0), |(sum, n), value| (sum + value * value, n + 1.0));
    if count > 0.0 { f64::sqrt(sum / count) } else { f64::NAN }
}

/// Mean and standard deviation; NaN without values.
pub fn mean_and_std(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (mean, (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt())
}

pub fn rms_of_finite(values: impl IntoIterator<Item = f64>) -> f64 {
    pooled_rms(values.into_iter().filter(|value| value.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_after_an_offset_match_shifted_values() {
        let mut sums = Moments::default();
        [1.0, 2.0, 6.0].into_iter().for_each(|value| sums.add(value));
        let shifted = sums.less(3.0);
        assert_eq!((sums.mean(), shifted.mean()), (3.0, 0.0));
        assert!((shifted.rms() - (14.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((shifted.std() - sums.std()).abs() < 1e-12);
    }

    #[test]
    fn error_statistics_match_a_hand_calculation() {
        let mut errors = ErrorAccumulator::default();
        for i in 1..=100 {
            errors.add(f64::from(2 * i), -f64::from(i));
        }
        let statistics = errors.statistics();
        assert_eq!((statistics.mean, statistics.greatest, statistics.span), (-50.5, 100.0, 198.0));
        let p95 = statistics.p95;
        assert!((p95 / 95.0 - 1.0).abs() < 0.012, "{p95}");
        // (100 * 101 * 201 / 6) / 100 = 3383.5.
        assert!((statistics.rms - 3383.5_f64.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn root_mean_square_ignores_nan() {
        assert_eq!(rms_of_finite([3.0, f64::NAN, 4.0]), 12.5_f64.sqrt());
        assert!(rms_of_finite([]).is_nan());
    }
}
