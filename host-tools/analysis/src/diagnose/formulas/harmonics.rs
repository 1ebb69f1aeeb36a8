//! Harmonics of the rotor's turn by which a formula can be made: those whose power in a residual exceeds that of noise.

use std::f64::consts::{PI, TAU};

use model_export::fit::campaign::FitSetup;
use nalgebra::{Complex, Vector3};
use rayon::prelude::*;

use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::formulas::rows::{Windows, excitations};
use crate::diagnose::residuals::residuals_against;

/// Column of the rotor's angle.
pub const TURN: &str = "motor_angle_rad";
/// Harmonics that are always tried: one to four, and the pole pairs.
pub const USUAL: [u32; 5] = [1, 2, 3, 4, 7];
/// Maximum number of further harmonics.
const MAX_FURTHER: usize = 12;
/// Highest harmonic.
const HIGHEST: usize = 128;
/// Rows for each harmonic, at least.
const ROWS: usize = 8;
/// Power of a harmonic relative to the median over all harmonics, at least. Of noise, where powers have an exponential distribution, one
/// of 10,000 is above.
const MIN_POWER: f64 = 14.0;

/// The usual harmonics, and the others in the residual of `model`.
pub fn of_residual(setup: &FitSetup, model: &FittedModel, windows: &[Vec<Windows>]) -> Vec<u32> {
    let tables = residuals_against(setup, model, &[]);
    let mut sensors: Vec<(Vec<f64>, &[Vector3<f64>])> = Vec::new();
    for (sensor, table) in tables.iter().enumerate() {
        let angles = excitations(setup, sensor).filter_map(|series| series.covariate(TURN));
        let angles: Vec<f64> = angles.flatten().collect();
        if angles.len() != table.residual.len() {
            return USUAL.to_vec();
        }
        sensors.push((angles, &table.residual));
    }
    let window = windows.iter().flatten().flatten().map(|window| window.len()).max().unwrap_or(1);
    let found = harmonics(&sensors, window).into_iter();
    let further = found.filter(|harmonic| !USUAL.contains(harmonic)).take(MAX_FURTHER);
    USUAL.into_iter().chain(further).collect()
}

/// Harmonics of these angles in rad, by the fields in gauss of the same rows, the strongest first, up to the limit of the sampling: of an
/// angle that moves on by more than half of a period within `window` rows, nothing is left in a mean over them.
fn harmonics(sensors: &[(Vec<f64>, &[Vector3<f64>])], window: usize) -> Vec<u32> {
    let rows = sensors.iter().map(|(angles, _)| angles.len()).max().unwrap_or(0);
    let moved = |angles: &[f64]| {
        let moved = match (angles.first(), angles.last()) {
            (Some(first), Some(last)) => (last - first).rem_euclid(TAU),
            _ => 0.0,
        };
        moved.min(TAU - moved)
    };
    let steps = sensors.iter().flat_map(|(angles, _)| angles.windows(window + 1).map(moved));
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    let step = steps.get(steps.len() / 2).copied().unwrap_or(PI);
    let limit = ((PI / step) as usize).min(rows / ROWS).min(HIGHEST) as u32;
    let power = |harmonic: u32| -> f64 {
        let of_sensor = |(angles, fields): &(Vec<f64>, &[Vector3<f64>])| -> f64 {
            let mut sums = [Complex::new(0.0, 0.0); 3];
            for (angle, field) in angles.iter().zip(fields.iter()) {
                let turn = Complex::from_polar(1.0, f64::from(harmonic) * angle);
                sums.iter_mut().zip(field.iter()).for_each(|(sum, b)| *sum += turn * *b);
            }
            sums.iter().map(|sum| sum.norm_sqr()).sum()
        };
        sensors.iter().map(of_sensor).sum()
    };
    let powers: Vec<f64> = (1..=limit).into_par_iter().map(power).collect();
    let mut sorted = powers.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let mut found: Vec<(u32, f64)> =
        (1..).zip(powers).filter(|(_, power)| *power > MIN_POWER * median).collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    found.into_iter().map(|(harmonic, _)| harmonic).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Two turns of 600 rows, with noise of 0.1 G and these harmonics, and amplitudes in gauss.
    fn found(waves: &[(f64, f64)], window: usize) -> Vec<u32> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        // Variance of the sum of 12 uniform numbers is 1.
        let mut noise = || 0.1 * (0..12).map(|_| rng.random::<f64>() - 0.5).sum::<f64>();
        let angles: Vec<f64> = (0..1200).map(|row| f64::from(row) * TAU / 600.0).collect();
        let field = |angle: &f64| {
            let all = waves.iter().map(|(harmonic, g)| g * (harmonic * angle + 0.3).sin());
            let wave: f64 = all.sum();
            Vector3::new(wave, 0.5 * wave, 0.0).map(|b| b + noise())
        };
        let fields: Vec<Vector3<f64>> = angles.iter().map(field).collect();
        harmonics(&[(angles.iter().map(|angle| angle % TAU).collect(), &fields)], window)
    }

    #[test]
    fn harmonics_are_found_in_the_order_of_their_power() {
        assert_eq!(found(&[(7.0, 1.0), (28.0, 0.5), (84.0, 0.1)], 1), [7, 28, 84]);
        assert!(found(&[], 1).is_empty());
    }

    #[test]
    fn harmonics_beyond_the_window_are_not_sought() {
        // Ten rows are 6 degrees: half a period of the 30th harmonic.
        assert_eq!(found(&[(7.0, 1.0), (84.0, 0.5)], 10), [7]);
    }
}
