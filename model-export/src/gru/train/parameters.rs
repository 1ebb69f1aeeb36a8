//! Everything that training changes: the weights of several networks side by side.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::network::{GATES, Layer};

/// Longest memory, in rows, that a unit begins with: a second at the board's rate. The bias of the
/// update gate is the logarithm of the memory, so that it begins between one row and this; with a
/// bias of zero every unit would forget within a few milliseconds, and the slope towards what was
/// earlier would be too small to find any.
const LONGEST_MEMORY_ROWS: f32 = 1000.0;

/// How large the networks are; all that are trained together have the same size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// How many networks.
    pub networks: usize,
    /// Inputs of each.
    pub inputs: usize,
    /// Units of each layer.
    pub hidden: usize,
    /// Outputs of each.
    pub outputs: usize,
}

/// What a parameter is, which tells how it begins and where it must stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Weights of a layer's inputs, or of the head.
    Weights,
    /// Recurrent weights of a layer.
    State,
    /// Both biases of a layer.
    LayerBias,
    /// Bias of the head.
    HeadBias,
}

/// One tensor; its first dimension counts the networks.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name in files.
    pub name: &'static str,
    /// What it is.
    pub kind: Kind,
    /// Its dimensions.
    pub shape: Vec<usize>,
    /// Its values, the last dimension fastest.
    pub values: Vec<f32>,
}

impl Parameter {
    /// The part of one network.
    pub fn of(&self, network: usize) -> &[f32] {
        let each = self.each();
        &self.values[network * each..][..each]
    }

    /// The same, to be changed.
    pub fn of_mut(&mut self, network: usize) -> &mut [f32] {
        let each = self.each();
        &mut self.values[network * each..][..each]
    }

    /// Values of one network.
    pub fn each(&self) -> usize {
        self.values.len() / self.shape[0]
    }
}

/// Place of each parameter in [`Parameters::all`].
#[allow(missing_docs)] // Their names say it.
pub mod place {
    pub const LAYERS: [[usize; 3]; 2] = [[0, 1, 2], [3, 4, 5]];
    pub const HEAD_WEIGHTS: usize = 6;
    pub const HEAD_BIAS: usize = 7;
}

/// All parameters of all networks.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// How large they are.
    pub size: Size,
    /// In the order of [`place`].
    pub all: Vec<Parameter>,
}

impl Parameters {
    /// Zeros.
    pub fn zero(size: Size) -> Self {
        let Size {
            networks,
            inputs,
            hidden,
            outputs,
        } = size;
        let wide = GATES * hidden;
        let shapes = [
            ("layer1.input_weights", Kind::Weights, vec![inputs, wide]),
            ("layer1.state_weights", Kind::State, vec![hidden, wide]),
            ("layer1.bias", Kind::LayerBias, vec![2, wide]),
            ("layer2.input_weights", Kind::Weights, vec![hidden, wide]),
            ("layer2.state_weights", Kind::State, vec![hidden, wide]),
            ("layer2.bias", Kind::LayerBias, vec![2, wide]),
            ("head.weights", Kind::Weights, vec![hidden, outputs]),
            ("head.bias", Kind::HeadBias, vec![1, outputs]),
        ];
        let all = shapes.map(|(name, kind, shape)| {
            let shape: Vec<usize> = std::iter::once(networks).chain(shape).collect();
            Parameter {
                name,
                kind,
                values: vec![0.0; shape.iter().product()],
                shape,
            }
        });
        Self {
            size,
            all: all.into(),
        }
    }

    /// As training begins; each network draws from its own stream of numbers, so that it begins the
    /// same whichever others are trained beside it.
    pub fn random(size: Size, seed: u64, keys: &[u32]) -> Self {
        let mut parameters = Self::zero(size);
        let bound = 1.0 / (size.hidden as f32).sqrt();
        for (network, key) in keys.iter().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(1 + u64::from(*key));
            for parameter in &mut parameters.all {
                let kind = parameter.kind;
                let values = parameter.of_mut(network);
                if kind != Kind::HeadBias {
                    values
                        .iter_mut()
                        .for_each(|w| *w = rng.random_range(-bound..bound));
                }
                if kind == Kind::LayerBias {
                    for bias in &mut values[size.hidden..2 * size.hidden] {
                        *bias = libm::logf(LONGEST_MEMORY_ROWS) * rng.random::<f32>();
                    }
                }
            }
        }
        parameters
    }

    /// Takes one network's values from another set.
    pub fn copy_network(&mut self, network: usize, from: &Self) {
        for (to, from) in self.all.iter_mut().zip(&from.all) {
            to.of_mut(network).copy_from_slice(from.of(network));
        }
    }

    /// A layer of one network as the device's side knows it.
    pub fn layer(&self, network: usize, layer: usize) -> Layer {
        let [input, state, bias] = place::LAYERS[layer].map(|i| &self.all[i]);
        let both = bias.of(network);
        let (input_bias, state_bias) = both.split_at(both.len() / 2);
        Layer {
            input_weights: turned(input.of(network), input_bias.len()),
            state_weights: turned(state.of(network), input_bias.len()),
            input_bias: input_bias.to_vec(),
            state_bias: state_bias.to_vec(),
        }
    }

    /// The head of one network: its weights row by row of the outputs, and its bias.
    pub fn head(&self, network: usize) -> (Vec<f32>, Vec<f32>) {
        (
            turned(self.all[place::HEAD_WEIGHTS].of(network), self.size.outputs),
            self.all[place::HEAD_BIAS].of(network).to_vec(),
        )
    }
}

/// Rows of `columns` values turned into as many rows.
fn turned(values: &[f32], columns: usize) -> Vec<f32> {
    (0..columns)
        .flat_map(|column| values.iter().skip(column).step_by(columns).copied())
        .collect()
}
