//! Forward pass, loss and evaluation of the networks.

use crate::gru::train::dataset::ScaledSequence;
use crate::gru::train::parameters::{NetworkSize, TrainableParameters, index};
use crate::gru::train::recurrence::Recurrence;
use candle_core::{Device, Result, Tensor, Var};
use std::sync::OnceLock;

/// Lower clamp of the logarithm of the standard deviation, relative to the force scale: below 1/2000 single
/// rows would dominate the gradient.
pub const MIN_LOG_SIGMA: f64 = -7.6;
/// Upper clamp: twice the scale carries no information.
pub const MAX_LOG_SIGMA: f64 = 0.7;

/// Parameters as tensor variables, for one pass.
pub struct WeightTensors {
    /// In the order of [`index`].
    pub all: Vec<Var>,
    size: NetworkSize,
}

/// State of both layers, each `networks x streams x hidden`.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerStates(pub [Vec<f32>; 2]);

impl LayerStates {
    /// Reset state.
    pub fn zero(size: NetworkSize, streams: usize) -> Self {
        let zero = vec![0.0; size.networks * streams * size.hidden];
        Self([zero.clone(), zero])
    }
}

impl WeightTensors {
    /// Copies the parameters.
    pub fn of(parameters: &TrainableParameters) -> Result<Self> {
        let all = parameters
            .all
            .iter()
            .map(|p| Var::from_slice(&p.values, p.shape.as_slice(), &Device::Cpu));
        Ok(Self { all: all.collect::<Result<_>>()?, size: parameters.size })
    }

    /// Outputs, `networks x streams*rows x outputs`, for inputs `networks x streams*rows x inputs`; updates the
    /// state.
    pub fn forward(
        &self,
        inputs: &Tensor,
        streams: usize,
        state: &mut LayerStates,
    ) -> Result<Tensor> {
        let NetworkSize { networks, hidden, .. } = self.size;
        let rows = inputs.dim(1)? / streams;
        let mut flow = inputs.clone();
        for (parameters, state) in index::LAYERS.iter().zip(&mut state.0) {
            let [input, recurrent, bias] = parameters.map(|i| self.all[i].as_tensor());
            let operation = Recurrence {
                hidden,
                streams,
                rows,
                start: std::mem::take(state),
                saved: OnceLock::new(),
            };
            let states = flow.matmul(input)?.apply_op3(recurrent, bias, operation)?;
            *state = states.narrow(2, rows - 1, 1)?.flatten_all()?.to_vec1::<f32>()?;
            flow = states.reshape((networks, streams * rows, hidden))?;
        }
        flow.matmul(self.all[index::HEAD_WEIGHTS].as_tensor())?
            .broadcast_add(self.all[index::HEAD_BIAS].as_tensor())
    }
}

/// Negative log-likelihood of each network without its constant, in nats. Outputs are two means and two
/// logarithms of the standard deviation for each sensor; `truth` and `weight` have two forces for each sensor,
/// with weight zero without a reference.
pub fn losses(outputs: &Tensor, truth: &Tensor, weight: &Tensor) -> Result<Tensor> {
    let (networks, rows, forces) = truth.dims3()?;
    let split = outputs.reshape((networks, rows, forces / 2, 4))?;
    let half =
        |from: usize| split.narrow(3, from, 2)?.contiguous()?.reshape((networks, rows, forces));
    let log_sigma = half(2)?.clamp(MIN_LOG_SIGMA, MAX_LOG_SIGMA)?;
    let share = ((half(0)? - truth)? * log_sigma.neg()?.exp()?)?;
    let each = ((share.sqr()? * 0.5)? + log_sigma)?;
    (each * weight)?.sum((1, 2))
}

/// Rows per chunk, to limit memory.
const CHUNK_ROWS: usize = 4096;

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
        let log_sigma = self.log_sigma.clamp(MIN_LOG_SIGMA, MAX_LOG_SIGMA);
        let share = (self.truth - self.mean) * libm::exp(-log_sigma);
        0.5 * share * share + log_sigma
    }
}

/// Predictions of every network where a reference exists, from the reset state: `[network][force]`.
pub fn predict(
    parameters: &TrainableParameters,
    recording: &ScaledSequence,
) -> Result<Vec<Vec<Vec<Prediction>>>> {
    let networks = parameters.size.networks;
    let weights = WeightTensors::of(parameters)?;
    let mut state = LayerStates::zero(parameters.size, 1);
    let mut predictions = vec![vec![Vec::new(); recording.forces]; networks];
    let mut from = 0;
    while from < recording.rows {
        let rows = CHUNK_ROWS.min(recording.rows - from);
        let mut lists = [Vec::new(), Vec::new(), Vec::new()];
        for network in 0..networks {
            recording.window(network, from, rows, true, &mut lists);
        }
        let [inputs, truth, weight] = lists;
        let inputs = Tensor::from_vec(inputs, (networks, rows, recording.inputs), &Device::Cpu)?;
        let outputs = weights.forward(&inputs, 1, &mut state)?;
        let outputs = outputs.flatten_all()?.to_vec1::<f32>()?;
        let labelled = weight.iter().enumerate().filter(|(_, w)| **w > 0.0);
        for (at, _) in labelled {
            let (row, force) = (at / recording.forces, at % recording.forces);
            // Two means, two logarithms for each sensor.
            let mean = row * 2 * recording.forces + force / 2 * 4 + force % 2;
            predictions[row / rows][force].push(Prediction {
                row: from + row % rows,
                truth: f64::from(truth[at]),
                mean: f64::from(outputs[mean]),
                log_sigma: f64::from(outputs[mean + 2]),
            });
        }
        from += rows;
    }
    Ok(predictions)
}

/// Mean loss of each network, in nats for each force.
pub fn mean_losses(predictions: &[Vec<Vec<Prediction>>]) -> Vec<f64> {
    let mean = |forces: &Vec<Vec<Prediction>>| {
        let rows: usize = forces.iter().map(Vec::len).sum();
        let sum: f64 = forces.iter().flatten().map(Prediction::loss).sum();
        sum / rows as f64
    };
    predictions.iter().map(mean).collect()
}
