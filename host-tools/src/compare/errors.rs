//! What is said of an error while rows go by: memory does not grow with their number.

use sketches_ddsketch::{Config, DDSketch};

use super::Figures;
use crate::sums::Sums;

/// Relative accuracy of a percentile.
const ACCURACY: f64 = 0.002;
/// Buckets of the percentiles' sketch: from the greatest down over some 30 decades of its accuracy.
const BUCKETS: u32 = 4096;
/// Errors smaller than this, in gauss or newtons, count as none.
const LEAST: f64 = 1e-6;

/// Errors of one channel.
#[derive(Clone)]
pub struct Errors {
    sums: Sums,
    sizes: DDSketch,
    greatest: f64,
    /// Least and greatest of what was measured.
    span: (f64, f64),
}

impl Default for Errors {
    fn default() -> Self {
        Self {
            sums: Sums::default(),
            sizes: DDSketch::new(Config::new(ACCURACY, BUCKETS, LEAST)),
            greatest: 0.0,
            span: (f64::INFINITY, f64::NEG_INFINITY),
        }
    }
}

impl Errors {
    /// One row: what was measured, and by how much the model errs.
    pub fn add(&mut self, measured: f64, error: f64) {
        self.sums.add(error);
        self.sizes.add(error.abs());
        self.greatest = self.greatest.max(error.abs());
        self.span = (self.span.0.min(measured), self.span.1.max(measured));
    }

    /// The rows of both.
    pub fn with(mut self, other: &Self) -> Self {
        self.sums = self.sums.with(other.sums);
        // Sketches of one configuration always merge.
        let merged = self.sizes.merge(&other.sizes);
        debug_assert!(merged.is_ok());
        self.greatest = self.greatest.max(other.greatest);
        self.span = (self.span.0.min(other.span.0), self.span.1.max(other.span.1));
        self
    }

    /// Rows.
    pub fn rows(&self) -> f64 {
        self.sums.rows()
    }

    /// The figures; all zero without rows.
    pub fn figures(&self) -> Figures {
        if self.rows() == 0.0 {
            return Figures::default();
        }
        Figures {
            rms: self.sums.rms(),
            mean: self.sums.mean(),
            std: self.sums.std(),
            p95: self.sizes.quantile(0.95).ok().flatten().unwrap_or(0.0),
            greatest: self.greatest,
            span: self.span.1 - self.span.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_hundred_numbers_are_those_counted_by_hand() {
        let mut errors = Errors::default();
        for i in 1..=100 {
            errors.add(f64::from(2 * i), -f64::from(i));
        }
        let figures = errors.figures();
        assert_eq!(
            (figures.mean, figures.greatest, figures.span),
            (-50.5, 100.0, 198.0)
        );
        assert!((figures.p95 / 95.0 - 1.0).abs() < 0.012, "{}", figures.p95);
        // (100 * 101 * 201 / 6) / 100 = 3383.5.
        assert!((figures.rms - 3383.5_f64.sqrt()).abs() < 1e-9);
    }
}
