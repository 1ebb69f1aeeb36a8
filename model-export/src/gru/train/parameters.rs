//! Trainable parameters of several networks, their initial values, and the device's weight limits.

use crate::gru::network::{GATES, Layer};
use crate::gru::quantise::{INPUT_LIMIT, SUM_LIMIT};
use crate::gru::recurrence::transposed;
use firmware::model::formats::{INPUT_BITS, OUTPUT_BITS};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Maximum initial memory of a unit in rows: one second at the board's rate. The bias of the update gate is the
/// logarithm of the memory, drawn between one row and this; with a zero bias every unit would forget within
/// milliseconds and gradients of earlier rows would vanish.
const MAX_MEMORY_ROWS: f32 = 1000.0;

/// Size of the networks, common to all that are trained together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkSize {
    /// How many networks.
    pub networks: usize,
    /// Inputs of each.
    pub inputs: usize,
    /// Units of each layer.
    pub hidden: usize,
    /// Outputs of each.
    pub outputs: usize,
}

/// Kind of a tensor, for initialisation and limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorKind {
    /// Weights of a layer's inputs, or of the head.
    Weights,
    /// Recurrent weights of a layer.
    State,
    /// Both biases of a layer.
    LayerBias,
    /// Bias of the head.
    HeadBias,
}

/// One tensor; the first dimension is the network.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterTensor {
    /// Its name in files.
    pub name: &'static str,
    /// Kind.
    pub kind: TensorKind,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its values, the last dimension fastest.
    pub values: Vec<f32>,
}

impl ParameterTensor {
    /// Number of values of one network.
    pub fn of(&self, network: usize) -> &[f32] {
        let each = self.each();
        &self.values[network * each..][..each]
    }

    /// Mutable values of one network.
    pub(crate) fn of_mut(&mut self, network: usize) -> &mut [f32] {
        let each = self.each();
        &mut self.values[network * each..][..each]
    }

    /// Values of one network.
    pub fn each(&self) -> usize {
        self.values.len() / self.shape[0]
    }
}

/// Index of each tensor in [`TrainableParameters::all`].
#[allow(missing_docs)] // Their names say it.
pub mod index {
    pub(crate) const LAYERS: [[usize; 3]; 2] = [[0, 1, 2], [3, 4, 5]];
    pub const HEAD_WEIGHTS: usize = 6;
    pub const HEAD_BIAS: usize = 7;
}

/// All parameters of all networks.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainableParameters {
    /// How large they are.
    pub size: NetworkSize,
    /// In the order of [`index`].
    pub all: Vec<ParameterTensor>,
}

impl TrainableParameters {
    /// Zeros.
    pub fn zero(size: NetworkSize) -> Self {
        let NetworkSize { networks, inputs, hidden, outputs } = size;
        let wide = GATES * hidden;
        let shapes = [
            ("layer1.input_weights", TensorKind::Weights, vec![inputs, wide]),
            ("layer1.state_weights", TensorKind::State, vec![hidden, wide]),
            ("layer1.bias", TensorKind::LayerBias, vec![2, wide]),
            ("layer2.input_weights", TensorKind::Weights, vec![hidden, wide]),
            ("layer2.state_weights", TensorKind::State, vec![hidden, wide]),
            ("layer2.bias", TensorKind::LayerBias, vec![2, wide]),
            ("head.weights", TensorKind::Weights, vec![hidden, outputs]),
            ("head.bias", TensorKind::HeadBias, vec![1, outputs]),
        ];
        let all = shapes.map(|(name, kind, shape)| {
            let shape: Vec<usize> = std::iter::once(networks).chain(shape).collect();
            ParameterTensor { name, kind, values: vec![0.0; shape.iter().product()], shape }
        });
        Self { size, all: all.into() }
    }

    /// Initial values; each network has its own random stream, so that they do not depend on the other
    /// networks.
    pub fn random(size: NetworkSize, seed: u64, keys: &[u32]) -> Self {
        let mut parameters = Self::zero(size);
        let bound = 1.0 / (size.hidden as f32).sqrt();
        for (network, key) in keys.iter().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(1 + u64::from(*key));
            for parameter in &mut parameters.all {
                let kind = parameter.kind;
                let values = parameter.of_mut(network);
                if kind != TensorKind::HeadBias {
                    values.iter_mut().for_each(|w| *w = rng.random_range(-bound..bound));
                }
                if kind == TensorKind::LayerBias {
                    for bias in &mut values[size.hidden..2 * size.hidden] {
                        *bias = libm::logf(MAX_MEMORY_ROWS) * rng.random::<f32>();
                    }
                }
            }
        }
        parameters
    }

    /// Copies the values of one network.
    pub(crate) fn copy_network(&mut self, network: usize, from: &Self) {
        for (to, from) in self.all.iter_mut().zip(&from.all) {
            to.of_mut(network).copy_from_slice(from.of(network));
        }
    }

    /// A layer of one network in exported form.
    pub fn layer(&self, network: usize, layer: usize) -> Layer {
        let [input, state, bias] = index::LAYERS[layer].map(|i| &self.all[i]);
        let both = bias.of(network);
        let (input_bias, state_bias) = both.split_at(both.len() / 2);
        Layer {
            input_weights: transposed(input.of(network), input_bias.len()),
            state_weights: transposed(state.of(network), input_bias.len()),
            input_bias: input_bias.to_vec(),
            state_bias: state_bias.to_vec(),
        }
    }

    /// The head of one network: its weights row by row of the outputs, and its bias.
    pub fn head(&self, network: usize) -> (Vec<f32>, Vec<f32>) {
        (
            transposed(self.all[index::HEAD_WEIGHTS].of(network), self.size.outputs),
            self.all[index::HEAD_BIAS].of(network).to_vec(),
        )
    }
}

/// Maximum weight on the device (Q3).
pub(crate) const MAX_WEIGHT: f32 = 7.99;
/// The same for the candidate's recurrent weights (Q2).
pub(crate) const MAX_CANDIDATE_WEIGHT: f32 = 3.99;

/// Allowance for rounding of a sum.
const ROUNDING: f32 = 0.1;
/// Allowance for calibration of sigma in a head bias: the logarithm of a factor of twenty.
const CALIBRATION: f32 = 3.0;
/// Maximum sum of a gate, of a candidate, and of the head.
const MAX_SUM: f32 = (SUM_LIMIT >> OUTPUT_BITS) as f32 - ROUNDING;
/// Maximum of a candidate's recurrent sum, which has one more fractional bit.
const MAX_CANDIDATE_SUM: f32 = (SUM_LIMIT >> (OUTPUT_BITS + 1)) as f32 - ROUNDING;
/// Maximum input of the first layer; the second's inputs are states within one.
const MAX_INPUT: f32 = (INPUT_LIMIT >> INPUT_BITS) as f32;

impl TrainableParameters {
    /// Clips weights and scales rows to what the device can represent: the exporter rejects rows whose sum
    /// could wrap ([`crate::gru::quantise`]). A row is scaled together with its biases, so that its direction
    /// and the point of the half-open gate remain.
    pub(crate) fn clip_to_device(&mut self) {
        self.all.iter_mut().for_each(ParameterTensor::clip_to_device);
        for network in 0..self.size.networks {
            for (layer, max_input) in [MAX_INPUT, 1.0].into_iter().enumerate() {
                for column in 0..GATES * self.size.hidden {
                    self.scale_row(network, layer, column, max_input);
                }
            }
            let head = [index::HEAD_WEIGHTS, index::HEAD_BIAS];
            for output in 0..self.size.outputs {
                let sum: f32 = head.iter().map(|&i| self.all[i].size(network, output)).sum();
                let factor = factor(MAX_SUM - CALIBRATION, sum);
                head.iter().for_each(|&i| self.all[i].scale(network, output, factor));
            }
        }
    }

    /// Scales one row of a layer.
    fn scale_row(&mut self, network: usize, layer: usize, column: usize, max_input: f32) {
        let [input, state, bias] = index::LAYERS[layer];
        let from_inputs = max_input * self.all[input].size(network, column);
        let from_states = self.all[state].size(network, column);
        // Input and state bias.
        let biases = &self.all[bias];
        let (input_bias, state_bias) = biases.biases(network, column);
        let sum = from_inputs + from_states + input_bias + state_bias;
        let candidate = column >= (GATES - 1) * self.size.hidden;
        let factor = if candidate {
            factor(MAX_SUM, sum).min(factor(MAX_CANDIDATE_SUM, from_states + state_bias))
        } else {
            factor(MAX_SUM, sum)
        };
        for part in [input, state, bias] {
            self.all[part].scale(network, column, factor);
        }
    }
}

/// Factor that limits a sum; at most one.
fn factor(limit: f32, sum: f32) -> f32 {
    if sum > limit { limit / sum } else { 1.0 }
}

impl ParameterTensor {
    fn columns(&self) -> usize {
        self.shape.last().copied().unwrap_or(1)
    }

    /// Absolute sum of a column.
    fn size(&self, network: usize, column: usize) -> f32 {
        let values = self.of(network).iter().skip(column).step_by(self.columns());
        values.map(|value| value.abs()).sum()
    }

    /// Magnitudes of a column's two values.
    fn biases(&self, network: usize, column: usize) -> (f32, f32) {
        let values = self.of(network);
        let at = |row: usize| values.get(row * self.columns() + column).copied();
        (at(0).unwrap_or(0.0).abs(), at(1).unwrap_or(0.0).abs())
    }

    fn scale(&mut self, network: usize, column: usize, factor: f32) {
        if factor < 1.0 {
            let columns = self.columns();
            let values = self.of_mut(network).iter_mut().skip(column);
            values.step_by(columns).for_each(|value| *value *= factor);
        }
    }

    /// Clips single weights.
    fn clip_to_device(&mut self) {
        let columns = self.columns();
        let candidate = columns - columns / GATES;
        match self.kind {
            TensorKind::Weights => {
                self.values.iter_mut().for_each(|w| *w = w.clamp(-MAX_WEIGHT, MAX_WEIGHT))
            }
            TensorKind::State => {
                for row in self.values.chunks_exact_mut(columns) {
                    for (column, w) in row.iter_mut().enumerate() {
                        let limit =
                            if column < candidate { MAX_WEIGHT } else { MAX_CANDIDATE_WEIGHT };
                        *w = w.clamp(-limit, limit);
                    }
                }
            }
            TensorKind::LayerBias | TensorKind::HeadBias => {}
        }
    }
}
