//! Predictions of trained networks where a reference exists, and their loss.

use rayon::prelude::*;

use crate::gru::train::backprop::{
    MAX_LOG_SIGMA, MIN_LOG_SIGMA, NetworkWeights, StreamPass, mean_output,
};
use crate::gru::train::dataset::ScaledSequence;
use crate::gru::train::parameters::TrainableParameters;

/// Rows per window, to limit memory.
const WINDOW_ROWS: usize = 1024;

/// Prediction of one force in one row, relative to the force scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Row of the board.
    pub row: usize,
    /// The force.
    pub truth: f64,
    /// Predicted mean.
    pub mean: f64,
    /// Logarithm of the predicted standard deviation.
    pub log_sigma: f64,
}

impl Prediction {
    /// Negative log-likelihood without its constant, in nats.
    pub fn loss(&self) -> f64 {
        let limits = (f64::from(MIN_LOG_SIGMA), f64::from(MAX_LOG_SIGMA));
        let log_sigma = self.log_sigma.clamp(limits.0, limits.1);
        let share = (self.truth - self.mean) * libm::exp(-log_sigma);
        0.5 * share * share + log_sigma
    }
}

/// Predictions of every network where a reference exists, from the reset state: `[network][force]`.
pub fn predict(
    parameters: &TrainableParameters,
    recording: &ScaledSequence,
) -> Vec<Vec<Vec<Prediction>>> {
    let networks = (0..parameters.size.networks).into_par_iter();
    networks.map(|network| predict_network(parameters, network, recording)).collect()
}

fn predict_network(
    parameters: &TrainableParameters,
    network: usize,
    recording: &ScaledSequence,
) -> Vec<Vec<Prediction>> {
    let weights = NetworkWeights::of(parameters, network);
    let mut pass = StreamPass::new(parameters, WINDOW_ROWS);
    let mut predictions = vec![Vec::new(); recording.forces];
    for from in (0..recording.rows).step_by(WINDOW_ROWS) {
        recording.window(network, from, WINDOW_ROWS, true, &mut pass.rows);
        pass.predict(&weights);
        let labelled = pass.rows.weight.iter().zip(&pass.rows.truth).enumerate();
        for (at, (_, &truth)) in labelled.filter(|(_, (weight, _))| **weight > 0.0) {
            let (row, force) = (at / recording.forces, at % recording.forces);
            let mean = row * parameters.size.outputs + mean_output(force);
            predictions[force].push(Prediction {
                row: from + row,
                truth: f64::from(truth),
                mean: f64::from(pass.outputs[mean]),
                log_sigma: f64::from(pass.outputs[mean + 2]),
            });
        }
    }
    predictions
}

/// Mean loss of each network, in nats for each force.
pub(crate) fn mean_losses(predictions: &[Vec<Vec<Prediction>>]) -> Vec<f64> {
    let mean = |forces: &Vec<Vec<Prediction>>| {
        let rows: usize = forces.iter().map(Vec::len).sum();
        let sum: f64 = forces.iter().flatten().map(Prediction::loss).sum();
        sum / rows as f64
    };
    predictions.iter().map(mean).collect()
}
