//! Noise of the force errors of a replay: of the estimates, of the reference, and of its interpolation between its rows.
//!
//! All of it is from differences of successive values. Where rows are sparse these hold the motion of the load, in the reference
//! from about 10 Hz; the differences of the errors at the reference's rows do not.

use model_export::recordings::noise::WhiteNoise;

/// Noise of a linear interpolation between two noisy rows relative to one row, in squares: the mean of (1-s)^2 + s^2.
const INTERPOLATED: f64 = 2.0 / 3.0;
/// Ratio of the differences of the estimates to those of their errors from which they hold the motion of the load.
const HOLDS_MOTION: f64 = 1.5;
/// Ratio of two estimates of the noise from which they differ: one has motion of the load in it, or the other no interpolation.
const DIFFERS: f64 = 1.1;

/// Statistics of one force.
#[derive(Clone, Debug, Default)]
pub struct ErrorNoise {
    of_estimate: WhiteNoise,
    /// At rows of the reference.
    of_error: WhiteNoise,
    /// Number of errors and sum of their squares, at rows of the reference and between them.
    squares: [(f64, f64); 2],
}

impl ErrorNoise {
    /// Adds an estimate and its error in newtons.
    pub fn push(&mut self, estimate_n: f64, error_n: f64, at_reference_row: bool) {
        self.of_estimate.push(estimate_n);
        if at_reference_row {
            self.of_error.push(error_n);
        }
        let (count, sum) = &mut self.squares[usize::from(!at_reference_row)];
        *count += 1.0;
        *sum += error_n * error_n;
    }

    /// Standard deviation in newtons; `reference_n` is the noise of a row of the reference by its own differences.
    pub fn estimate(&self, reference_n: f64) -> f64 {
        let own = self.of_estimate.estimate().unwrap_or(0.0);
        let by_reference = own.hypot(reference_n * INTERPOLATED.sqrt());
        let Some(of_error) = self.of_error.estimate() else { return by_reference };
        if own > HOLDS_MOTION * of_error {
            return of_error;
        }
        let of_reference = (of_error.powi(2) - own.powi(2)).max(0.0);
        let [at_rows, between] = self.squares.map(|(count, sum)| sum / count);
        // Between the rows the error has less of the reference's noise, and that of its interpolation.
        let interpolation = between - at_rows + (1.0 - INTERPOLATED) * of_reference;
        let interpolation = if interpolation > 0.0 { interpolation } else { 0.0 };
        let by_error = (own.powi(2) + INTERPOLATED * of_reference).sqrt();
        let with_interpolation = by_error.hypot(interpolation.sqrt());
        if with_interpolation > DIFFERS * by_error || by_reference > DIFFERS * by_error {
            with_interpolation
        } else {
            by_reference
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Noise that is found of estimates at 1 kHz against a reference every 100 ms with 0.1 N of noise, and its true value.
    fn found(load_n: impl Fn(f64) -> f64) -> (f64, f64) {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        // Of unit variance: the sum of twelve uniform numbers.
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let rows: Vec<f64> =
            (0..602_u32).map(|row| load_n(0.1 * f64::from(row)) + 0.1 * normal()).collect();
        let (mut noise, mut of_reference) = (ErrorNoise::default(), WhiteNoise::default());
        let (mut squares, ticks) = (0.0, 60_000_u32);
        rows.iter().for_each(|row| of_reference.push(*row));
        for tick in 0..ticks {
            let (row, share) = (tick / 100, f64::from(tick % 100) / 100.0);
            let reference = rows[row as usize] * (1.0 - share) + rows[row as usize + 1] * share;
            let estimate = load_n(1e-3 * f64::from(tick)) + 0.15 * normal();
            squares += (estimate - reference).powi(2);
            noise.push(estimate, estimate - reference, tick % 100 == 0);
        }
        let reference = of_reference.estimate().unwrap();
        (noise.estimate(reference), (squares / f64::from(ticks)).sqrt())
    }

    #[test]
    fn noise_of_a_model_without_error_is_its_error() {
        for (amplitude_n, frequency_hz) in [(0.0, 1.0), (20.0, 0.05), (20.0, 0.3), (5.0, 1.0)] {
            let load =
                |time_s: f64| amplitude_n * (std::f64::consts::TAU * frequency_hz * time_s).sin();
            let (noise, error) = found(load);
            assert!((0.95..1.05).contains(&(noise / error)), "{amplitude_n} N: {noise} {error}");
        }
    }
}
