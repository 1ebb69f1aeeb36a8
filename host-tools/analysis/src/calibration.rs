//! Calibration of predicted standard deviations: coverage of their multiples compared with a Gaussian, with
//! block-bootstrap intervals that account for autocorrelated errors.

use crate::statistics::Moments;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{ContinuousCDF, Normal};

/// Multiples of the predicted standard deviation at which coverage is measured.
pub const SIGMA_MULTIPLES: [f64; 3] = [1.0, 2.0, 3.0];
/// Length of a bootstrap block in seconds: longer than the correlation time at loads of 0.2 Hz and more.
pub const BLOCK_S: f64 = 5.0;
/// Resamples of the bootstrap, and its seed.
const DRAWS: usize = 1000;
/// Seed of the bootstrap.
pub const SEED: u64 = 1;
/// Nominal coverages of the calibration curve.
const CURVE: [f64; 9] = [0.1, 0.25, 0.5, 0.683, 0.8, 0.9, 0.954, 0.99, 0.997];

/// One error with the standard deviation that was predicted for it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PredictedError {
    /// The board's clock in seconds.
    pub time_s: f64,
    /// Estimate minus reference in newtons.
    pub error_n: f64,
    /// Predicted standard deviation in newtons.
    pub sigma_n: f64,
}

impl PredictedError {
    fn normalised(&self) -> f64 {
        self.error_n.abs() / self.sigma_n.max(f64::MIN_POSITIVE)
    }

    /// Index of its bootstrap block.
    pub fn block(&self) -> usize {
        (self.time_s.max(0.0) / BLOCK_S) as usize
    }
}

/// Errors after subtraction of a tare.
pub fn subtract_tare(
    errors: &[PredictedError],
    tare_n: f64,
) -> impl Iterator<Item = PredictedError> {
    let errors = errors.iter();
    errors.map(move |error| PredictedError { error_n: error.error_n - tare_n, ..*error })
}

/// Factor on sigma that matches the coverage of one and two sigma to a Gaussian, as the geometric mean of
/// both; `None` without errors.
pub fn sigma_factor(errors: &[PredictedError]) -> Option<f64> {
    let mut sorted: Vec<f64> = errors.iter().map(PredictedError::normalised).collect();
    sorted.sort_by(f64::total_cmp);
    let quantile = |p: f64| {
        let index = (p * sorted.len() as f64) as usize;
        sorted.get(index.min(sorted.len().checked_sub(1)?)).copied()
    };
    let multiples = SIGMA_MULTIPLES.iter().take(2);
    let logs = multiples.map(|&multiple| Some((quantile(gaussian(multiple))? / multiple).ln()));
    let sum: f64 = logs.sum::<Option<f64>>()?;
    let factor = (0.5 * sum).exp();
    (factor.is_finite() && factor > 0.0).then_some(factor)
}

/// Coverage of a multiple of sigma for a Gaussian.
pub fn gaussian(multiple: f64) -> f64 {
    let normal = Normal::standard();
    normal.cdf(multiple) - normal.cdf(-multiple)
}

/// Coverage over any number of forces of the same recordings.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Number of errors.
    pub rows: usize,
    /// Number of bootstrap blocks.
    pub blocks: usize,
    /// Fraction of the errors within [`SIGMA_MULTIPLES`].
    pub within: [f64; 3],
    /// 95 % intervals of these fractions by block bootstrap, all forces together.
    pub interval: [[f64; 2]; 3],
    /// Calibration curve: nominal coverage of a Gaussian, measured coverage.
    pub curve: Vec<[f64; 2]>,
    /// Root mean square of the standard deviations in newtons.
    pub sigma_n: f64,
    /// Root mean square of the errors in newtons.
    pub rmse_n: f64,
}

impl Coverage {
    /// Coverage of these errors; `None` without any.
    pub fn of(errors: impl IntoIterator<Item = PredictedError>) -> Option<Self> {
        let normal = Normal::standard();
        let multiples = CURVE.map(|expected| normal.inverse_cdf(0.5 + 0.5 * expected));
        // Of each block: errors within the multiples, all errors.
        let mut counts: Vec<[u32; 4]> = Vec::new();
        let mut inside = [0_u64; CURVE.len()];
        let (mut sigmas, mut moments) = (Moments::default(), Moments::default());
        for error in errors {
            let block = error.block();
            counts.resize(counts.len().max(block + 1), [0; 4]);
            let block = &mut counts[block];
            block[3] += 1;
            let normalised = error.normalised();
            for (count, multiple) in block.iter_mut().zip(SIGMA_MULTIPLES) {
                *count += u32::from(normalised <= multiple);
            }
            for (count, multiple) in inside.iter_mut().zip(multiples) {
                *count += u64::from(normalised <= multiple);
            }
            sigmas.add(error.sigma_n);
            moments.add(error.error_n);
        }
        if counts.is_empty() {
            return None;
        }
        counts.retain(|block| block[3] > 0);
        let fractions = |chosen: &mut dyn Iterator<Item = &[u32; 4]>| {
            let sums = chosen.fold([0.0; 4], |mut sums, block| {
                sums.iter_mut().zip(block).for_each(|(s, b)| *s += f64::from(*b));
                sums
            });
            [0, 1, 2].map(|i| sums[i] / sums[3])
        };
        let within = fractions(&mut counts.iter());
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let draws: Vec<[f64; 3]> = (0..DRAWS)
            .map(|_| {
                let places: Vec<usize> =
                    (0..counts.len()).map(|_| rng.random_range(0..counts.len())).collect();
                fractions(&mut places.iter().map(|&place| &counts[place]))
            })
            .collect();
        let interval = [0, 1, 2].map(|i| {
            let mut drawn: Vec<f64> = draws.iter().map(|draw| draw[i]).collect();
            drawn.sort_by(f64::total_cmp);
            [drawn[DRAWS / 40], drawn[DRAWS - 1 - DRAWS / 40]]
        });
        let curve = CURVE.into_iter().zip(inside);
        Some(Self {
            rows: moments.rows() as usize,
            blocks: counts.len(),
            within,
            interval,
            curve: curve
                .map(|(expected, count)| [expected, count as f64 / moments.rows()])
                .collect(),
            sigma_n: sigmas.rms(),
            rmse_n: moments.rms(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// Gaussian errors of 3 N at 100 Hz with a predicted `sigma_n`.
    fn predicted(sigma_n: f64) -> Vec<PredictedError> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let one = |row: usize| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            PredictedError { time_s: 0.01 * row as f64, error_n: 3.0 * normal, sigma_n }
        };
        (0..10_000).map(one).collect()
    }

    #[test]
    fn correct_sigma_has_gaussian_coverage_and_factor_one() {
        let errors = predicted(3.0);
        let found = Coverage::of(errors.iter().copied()).unwrap();
        for (place, width) in SIGMA_MULTIPLES.into_iter().enumerate() {
            let expected = gaussian(width);
            assert!((found.within[place] - expected).abs() < 0.01, "{found:?}");
            let [lower, upper] = found.interval[place];
            assert!(lower <= found.within[place] && found.within[place] <= upper);
        }
        assert!((sigma_factor(&errors).unwrap() - 1.0).abs() < 0.02);
        assert!(found.curve.iter().all(|[a, b]| (a - b).abs() < 0.015));
    }

    #[test]
    fn halved_sigma_has_low_coverage_and_factor_two() {
        let errors = predicted(1.5);
        let found = Coverage::of(errors.iter().copied()).unwrap();
        // Within half a standard deviation are 38.3 %.
        assert!((found.within[0] - 0.383).abs() < 0.015, "{found:?}");
        assert!((sigma_factor(&errors).unwrap() - 2.0).abs() < 0.04);
    }

    #[test]
    fn correlated_errors_widen_the_coverage_interval() {
        let width = |error: &dyn Fn(usize) -> f64| {
            let one = |row: usize| PredictedError {
                time_s: 0.01 * row as f64,
                error_n: error(row),
                sigma_n: 1.0,
            };
            let errors: Vec<PredictedError> = (0..10_000).map(one).collect();
            let [lower, upper] = Coverage::of(errors.iter().copied()).unwrap().interval[0];
            upper - lower
        };
        // Two thirds within one sigma: row by row, or in blocks of five seconds.
        let rows = width(&|row| if row % 3 == 0 { 1.5 } else { 0.5 });
        let blocks = width(&|row| if row / 500 % 3 == 0 { 1.5 } else { 0.5 });
        assert!(rows < 0.01 && blocks > 0.2, "{rows} {blocks}");
    }

    #[test]
    fn coverage_without_predictions_is_none() {
        assert_eq!(Coverage::of([]), None);
        assert_eq!(sigma_factor(&[]), None);
    }
}
