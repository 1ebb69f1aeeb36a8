//! A trained network in floating point: output of training, input of quantisation.
//!
//! Two layers of gated recurrent units and a linear head. The equation is PyTorch's, with the reset
//! after the product:
//!
//! ```text
//! r = sigmoid(W_r x + b_r + U_r h + c_r)
//! z = sigmoid(W_z x + b_z + U_z h + c_z)
//! n = tanh(W_n x + b_n + r (U_n h + c_n))
//! h' = (1 - z) n + z h
//! ```
//!
//! Rows of a layer's weights are in the order r, z, n.

use wide::f32x8;

/// Gates of a unit: reset, update, candidate.
pub const GATES: usize = 3;

/// Outputs for one sensor: mean of Fx and Fz, logarithm of the standard deviation of Fx and Fz.
pub const OUTPUTS: usize = 4;

/// Source of a network input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Input {
    /// The compensated field of a sensor along one axis, in G.
    Field {
        /// Number of the sensor.
        sensor: u32,
        /// 0, 1, 2 for x, y, z.
        axis: usize,
    },
    /// The ideal model's force at a sensor, in N.
    Ideal {
        /// Number of the sensor.
        sensor: u32,
        /// 0, 1 for Fx, Fz.
        axis: usize,
    },
}

/// Scaled input: `(value - middle) / span`, within ±1 on the training data.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ScaledInput {
    /// Source.
    pub input: Input,
    /// Mid-range of the training data, in the input's unit.
    pub middle: f64,
    /// Half range of the training data, in the input's unit.
    pub span: f64,
}

/// Target of the predicted means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// The force itself.
    Force,
    /// Residual of the ideal model: the mean is added to its estimate.
    #[serde(rename = "rest")]
    Residual,
}

/// Range of the training data for one sensor; see the guard of [`firmware::model::formats`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainedRange {
    /// Minimum and maximum parity residual of the field in training, in G.
    #[serde(rename = "departure_g")]
    pub parity_residual_g: [f64; 2],
    /// Apparent Fx and Fz of one gauss in the plane, in N.
    pub newtons_per_g: [f64; 2],
    /// Maximum difference of network and ideal model in training, Fx and Fz in N.
    #[serde(rename = "split_n")]
    pub disagreement_n: [f64; 2],
}

/// One layer of `hidden` units over `inputs` inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// `GATES * hidden` rows of `inputs` weights.
    pub input_weights: Vec<f32>,
    /// `GATES * hidden` rows of `hidden` weights.
    pub state_weights: Vec<f32>,
    /// `GATES * hidden`.
    pub input_bias: Vec<f32>,
    /// `GATES * hidden`; the candidate's is inside the reset product.
    pub state_bias: Vec<f32>,
}

/// A trained network for one sensor, or for several at once.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Numbers of the predicted sensors, in the order of the outputs.
    pub sensors: Vec<u32>,
    /// Inputs, in order.
    pub inputs: Vec<ScaledInput>,
    /// Target of the means.
    pub target: Target,
    /// Units of a layer.
    pub hidden: usize,
    /// First and second.
    pub layers: [Layer; 2],
    /// [`OUTPUTS`] rows of `hidden` weights for each sensor.
    pub head_weights: Vec<f32>,
    /// [`OUTPUTS`] for each sensor.
    pub head_bias: Vec<f32>,
    /// Force of a unit output in newtons, Fx and Fz, the same for every sensor. A standard deviation is this
    /// times the exponential of the output.
    pub force_n: [f64; 2],
    /// Training range of each sensor; empty: standard deviations are never inflated.
    pub guards: Vec<TrainedRange>,
}

/// Units that are evaluated together.
const LANES: usize = 8;

/// A network in floating point with the states of both layers, in the precision of its weights.
#[derive(Clone, Debug)]
pub struct FloatRun<'a> {
    network: &'a Network,
    layers: [FloatLayer; 2],
    outputs: Vec<f32>,
}

/// Weights and states of a layer, by groups of units.
#[derive(Clone, Debug)]
struct FloatLayer {
    groups: Vec<UnitGroup>,
    state: Vec<f32>,
}

/// Weights of units that are evaluated together: a lane for each, for r, z and n. Lanes without a unit have no weights.
#[derive(Clone, Debug)]
struct UnitGroup {
    input_bias: [f32x8; GATES],
    state_bias: [f32x8; GATES],
    /// For each input.
    input_weights: Vec<[f32x8; GATES]>,
    /// For each unit of the layer.
    state_weights: Vec<[f32x8; GATES]>,
}

impl<'a> FloatRun<'a> {
    /// After a reset: all states are zero.
    pub fn new(network: &'a Network) -> Self {
        let [first, second] = &network.layers;
        let hidden = network.hidden;
        Self {
            network,
            layers: [
                FloatLayer::new(first, network.inputs.len(), hidden),
                FloatLayer::new(second, hidden, hidden),
            ],
            outputs: vec![0.0; network.head_bias.len()],
        }
    }

    /// Sets all states to zero.
    pub fn reset(&mut self) {
        self.layers.iter_mut().for_each(|layer| layer.state.fill(0.0));
    }

    /// States of one layer, in the order of the units.
    pub fn state(&self, layer: usize) -> &[f32] {
        &self.layers[layer].state
    }

    /// One step over scaled inputs; the outputs.
    pub fn step(&mut self, inputs: &[f32]) -> &[f32] {
        let [first, second] = &mut self.layers;
        first.step(inputs);
        second.step(&first.state);
        let rows = self.network.head_weights.chunks(self.network.hidden);
        for ((output, row), bias) in self.outputs.iter_mut().zip(rows).zip(&self.network.head_bias)
        {
            let products = row.iter().zip(&second.state);
            let sum: f32 = products.map(|(weight, value)| weight * value).sum();
            *output = bias + sum;
        }
        &self.outputs
    }

    fn states(&self) -> [Vec<f32>; 2] {
        [0, 1].map(|layer| self.state(layer).to_vec())
    }
}

impl FloatLayer {
    fn new(layer: &Layer, inputs: usize, units: usize) -> Self {
        let group = |first: usize| {
            let lanes = |values: &[f32], width: usize, column: usize| {
                let of_gate = |gate: usize| {
                    let value = |lane: usize| {
                        let unit = first + lane;
                        let row = gate * units + unit;
                        if unit < units { values[row * width + column] } else { 0.0 }
                    };
                    f32x8::from(std::array::from_fn::<f32, LANES, _>(value))
                };
                std::array::from_fn(of_gate)
            };
            UnitGroup {
                input_bias: lanes(&layer.input_bias, 1, 0),
                state_bias: lanes(&layer.state_bias, 1, 0),
                input_weights: (0..inputs)
                    .map(|input| lanes(&layer.input_weights, inputs, input))
                    .collect(),
                state_weights: (0..units)
                    .map(|unit| lanes(&layer.state_weights, units, unit))
                    .collect(),
            }
        };
        Self { groups: (0..units).step_by(LANES).map(group).collect(), state: vec![0.0; units] }
    }

    fn step(&mut self, inputs: &[f32]) {
        let before = self.state.clone();
        for (group, state) in self.groups.iter().zip(self.state.chunks_mut(LANES)) {
            let [input_r, input_z, input_n] =
                weighted_sums(group.input_bias, &group.input_weights, inputs);
            let [state_r, state_z, state_n] =
                weighted_sums(group.state_bias, &group.state_weights, &before);
            let reset = sigmoid(input_r + state_r);
            let update = sigmoid(input_z + state_z);
            let candidate = tanh(input_n + reset * state_n);
            let mut own = [0.0; LANES];
            own[..state.len()].copy_from_slice(state);
            let next = (f32x8::ONE - update) * candidate + update * f32x8::from(own);
            state.copy_from_slice(&next.to_array()[..state.len()]);
        }
    }
}

fn weighted_sums(
    bias: [f32x8; GATES],
    weights: &[[f32x8; GATES]],
    values: &[f32],
) -> [f32x8; GATES] {
    let mut sums = bias;
    for (weights, value) in weights.iter().zip(values) {
        let value = f32x8::splat(*value);
        for gate in 0..GATES {
            sums[gate] += weights[gate] * value;
        }
    }
    sums
}

/// Beyond it a sigmoid is zero in this precision, and the exponential overflows.
const MAX_EXPONENT: f32 = 80.0;

fn sigmoid(at: f32x8) -> f32x8 {
    f32x8::ONE / (f32x8::ONE + (-at).min(f32x8::splat(MAX_EXPONENT)).exp())
}

fn tanh(at: f32x8) -> f32x8 {
    let two = f32x8::splat(2.0);
    two * sigmoid(two * at) - f32x8::ONE
}

/// Convergence tolerance of outputs: a thousandth of the force scale.
const WARM_UP_TOLERANCE: f32 = 1e-3;
/// Maximum warm-up in steps: ten seconds at 1 kHz, also for networks with unlimited memory.
pub const MAX_WARM_UP: u16 = 10_000;

/// Warm-up in steps: until runs from reset and runs driven by every input at either end of its range agree,
/// with all inputs at zero.
pub fn warm_up_steps(network: &Network) -> u16 {
    let inputs = network.inputs.len();
    let rest = vec![0.0; inputs];
    let last_difference = |end: f32| {
        let mut driven = FloatRun::new(network);
        let driven_inputs = vec![end; inputs];
        for _ in 0..MAX_WARM_UP {
            let before = driven.states();
            driven.step(&driven_inputs);
            if driven.states() == before {
                break;
            }
        }
        let mut reset = FloatRun::new(network);
        let mut last_difference = 0;
        for step in 1..=MAX_WARM_UP {
            let pairs = reset.step(&rest).iter().zip(driven.step(&rest));
            if pairs.into_iter().any(|(a, b)| (a - b).abs() > WARM_UP_TOLERANCE) {
                last_difference = step;
            }
            // To the last bit: no later step can differ.
            if reset.states() == driven.states() {
                break;
            }
        }
        last_difference
    };
    last_difference(-1.0).max(last_difference(1.0))
}
