//! Harmonics of the rotor's turn by which a formula can be made.

use model_export::fit::campaign::FitSetup;
use model_export::recordings::harmonics::{TURN, standing_out};
use nalgebra::Vector3;

use crate::diagnose::formulas::rows::{Windows, excitations};
use crate::diagnose::residuals::residuals_against;
use crate::diagnose::selection::FittedModel;

/// Harmonics that are always tried: one to four, and the pole pairs.
pub const USUAL: [u32; 5] = [1, 2, 3, 4, 7];
/// Maximum number of further harmonics.
const MAX_FURTHER: usize = 12;

/// The usual harmonics, and the others that stand out in the residual of `model`.
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
    let found = standing_out(&sensors, window).into_iter();
    let further = found.filter(|harmonic| !USUAL.contains(harmonic)).take(MAX_FURTHER);
    USUAL.into_iter().chain(further).collect()
}
