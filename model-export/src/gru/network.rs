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

use crate::gru::recurrence::{LayerTape, LayerWeights, transposed, weighted_sums};

pub use firmware::model::formats::{GATES, OUTPUTS};

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

/// A network in floating point with the states of both layers, in the precision of its weights.
#[derive(Clone, Debug)]
pub struct FloatRun {
    layers: [FloatLayer; 2],
    /// `hidden x outputs`.
    head: Vec<f32>,
    head_bias: Vec<f32>,
    outputs: Vec<f32>,
}

/// Weights of a layer as [`LayerWeights`] has them, and its state.
#[derive(Clone, Debug)]
struct FloatLayer {
    input: Vec<f32>,
    state: Vec<f32>,
    bias: Vec<f32>,
    tape: LayerTape,
}

impl FloatRun {
    /// After a reset: all states are zero.
    pub fn new(network: &Network) -> Self {
        let [first, second] = &network.layers;
        let hidden = network.hidden;
        Self {
            layers: [
                FloatLayer::new(first, network.inputs.len(), hidden),
                FloatLayer::new(second, hidden, hidden),
            ],
            head: transposed(&network.head_weights, hidden),
            head_bias: network.head_bias.clone(),
            outputs: vec![0.0; network.head_bias.len()],
        }
    }

    /// Sets all states to zero.
    pub fn reset(&mut self) {
        self.layers.iter_mut().for_each(|layer| layer.tape.reset());
    }

    /// States of one layer, in the order of the units.
    pub fn state(&self, layer: usize) -> &[f32] {
        self.layers[layer].tape.states()
    }

    /// One step over scaled inputs; the outputs.
    pub fn step(&mut self, inputs: &[f32]) -> &[f32] {
        let [first, second] = &mut self.layers;
        first.step(inputs);
        second.step(first.tape.states());
        weighted_sums(&mut self.outputs, &self.head_bias, second.tape.states(), &self.head);
        &self.outputs
    }

    fn states(&self) -> [Vec<f32>; 2] {
        [0, 1].map(|layer| self.state(layer).to_vec())
    }
}

impl FloatLayer {
    fn new(layer: &Layer, inputs: usize, units: usize) -> Self {
        Self {
            input: transposed(&layer.input_weights, inputs),
            state: transposed(&layer.state_weights, units),
            bias: [&layer.input_bias[..], &layer.state_bias[..]].concat(),
            tape: LayerTape::new(units, 1),
        }
    }

    fn step(&mut self, inputs: &[f32]) {
        self.tape.carry_state();
        let weights = LayerWeights { input: &self.input, state: &self.state, bias: &self.bias };
        self.tape.predict(weights, inputs);
    }
}

/// Convergence tolerance of outputs: a thousandth of the force scale.
const WARM_UP_TOLERANCE: f32 = 1e-3;
/// Maximum warm-up in steps: ten seconds at 1 kHz, also for networks with unlimited memory.
pub(crate) const MAX_WARM_UP: u16 = 10_000;

/// Warm-up in steps: until runs from reset and runs driven by every input at either end of its range agree,
/// with all inputs at zero.
pub(crate) fn warm_up_steps(network: &Network) -> u16 {
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
