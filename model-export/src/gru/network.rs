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

/// States of both layers.
#[derive(Clone, Debug, PartialEq)]
pub struct FloatState([Vec<f64>; 2]);

impl FloatState {
    /// All units of both layers at `value`; zero after a reset.
    pub fn at(network: &Network, value: f64) -> Self {
        Self([vec![value; network.hidden], vec![value; network.hidden]])
    }

    /// Of one layer, in order.
    pub fn layer(&self, layer: usize) -> &[f64] {
        &self.0[layer]
    }

    /// One step over scaled inputs; the outputs.
    pub fn step(&mut self, network: &Network, inputs: &[f64]) -> Vec<f64> {
        let [first, second] = &mut self.0;
        *first = next(&network.layers[0], inputs, first);
        *second = next(&network.layers[1], first, second);
        let rows = network.head_weights.chunks(network.hidden);
        let outputs = rows.zip(&network.head_bias);
        outputs.map(|(row, &bias)| f64::from(bias) + dot(row, second)).collect()
    }
}

fn next(layer: &Layer, inputs: &[f64], state: &[f64]) -> Vec<f64> {
    let units = state.len();
    let input = |row: usize| {
        let weights = &layer.input_weights[row * inputs.len()..][..inputs.len()];
        f64::from(layer.input_bias[row]) + dot(weights, inputs)
    };
    let recurrent = |row: usize| {
        let weights = &layer.state_weights[row * units..][..units];
        f64::from(layer.state_bias[row]) + dot(weights, state)
    };
    (0..units)
        .map(|unit| {
            let [reset_row, update_row, candidate_row] = [unit, units + unit, 2 * units + unit];
            let reset = sigmoid(input(reset_row) + recurrent(reset_row));
            let update = sigmoid(input(update_row) + recurrent(update_row));
            let candidate = libm::tanh(input(candidate_row) + reset * recurrent(candidate_row));
            (1.0 - update) * candidate + update * state[unit]
        })
        .collect()
}

fn dot(weights: &[f32], values: &[f64]) -> f64 {
    let products = weights.iter().zip(values);
    products.map(|(&weight, value)| f64::from(weight) * value).sum()
}

fn sigmoid(at: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-at))
}

/// Convergence tolerance of outputs: a thousandth of the force scale.
const WARM_UP_TOLERANCE: f64 = 1e-3;
/// Maximum warm-up in steps: ten seconds at 1 kHz, also for networks with unlimited memory.
pub const MAX_WARM_UP: u16 = 10_000;

/// Warm-up in steps: until runs from reset and runs driven by every input at either end of its range agree,
/// with all inputs at zero.
pub fn warm_up_steps(network: &Network) -> u16 {
    let inputs = network.inputs.len();
    let driven = [-1.0, 1.0].map(|end| {
        let mut state = FloatState::at(network, 0.0);
        let driven_inputs = vec![end; inputs];
        (0..MAX_WARM_UP).for_each(|_| drop(state.step(network, &driven_inputs)));
        state
    });
    let rest = vec![0.0; inputs];
    let slowest = driven.into_iter().map(|mut driven| {
        let mut reset = FloatState::at(network, 0.0);
        let mut last_difference = 0;
        for step in 1..=MAX_WARM_UP {
            let pairs = reset.step(network, &rest).into_iter().zip(driven.step(network, &rest));
            if pairs.into_iter().any(|(a, b)| (a - b).abs() > WARM_UP_TOLERANCE) {
                last_difference = step;
            }
        }
        last_difference
    });
    slowest.max().unwrap_or(0)
}
