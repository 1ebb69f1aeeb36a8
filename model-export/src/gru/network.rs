//! A trained network in floating point: what training writes and quantisation reads.
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
//! Rows of a layer's weights stand in the order r, z, n, row by row.

/// Gates of a unit: reset, update, candidate.
pub const GATES: usize = 3;

/// Outputs for one sensor: mean of Fx and Fz, logarithm of the standard deviation of Fx and Fz.
pub const OUTPUTS: usize = 4;

/// What one input of the network is.
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

/// An input as the network sees it: `(value - middle) / span`, within one either way on the training
/// data.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ScaledInput {
    /// What it is.
    pub input: Input,
    /// Middle of the training data, in the input's unit.
    pub middle: f64,
    /// Half the range of the training data, in the input's unit.
    pub span: f64,
}

/// What the means of the network are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// The force itself.
    Force,
    /// What the ideal model leaves: the mean is added to its estimate.
    Rest,
}

/// Where a network has learned, for one of its sensors; see [`firmware::model::network::Guard`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Guard {
    /// Least and greatest departure of the field from its surface in training, in G.
    pub departure_g: [f64; 2],
    /// Fx and Fz that a gauss in the plane is taken for, in N.
    pub newtons_per_g: [f64; 2],
    /// Greatest difference of network and ideal model in training, Fx and Fz in N.
    pub split_n: [f64; 2],
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
    /// `GATES * hidden`; the candidate's stand inside the reset product.
    pub state_bias: Vec<f32>,
}

/// A trained network for one sensor, or for several at once.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Numbers of the sensors that it tells the forces of, in the order of its outputs.
    pub sensors: Vec<u32>,
    /// Its inputs, in order.
    pub inputs: Vec<ScaledInput>,
    /// What its means are.
    pub target: Target,
    /// Units of a layer.
    pub hidden: usize,
    /// First and second.
    pub layers: [Layer; 2],
    /// [`OUTPUTS`] rows of `hidden` weights for each sensor.
    pub head_weights: Vec<f32>,
    /// [`OUTPUTS`] for each sensor.
    pub head_bias: Vec<f32>,
    /// Newtons of an output of one, Fx and Fz, the same for every sensor. A standard deviation is
    /// this times the exponential of the output.
    pub force_n: [f64; 2],
    /// Where it has learned, one for each sensor; none: its standard deviations never grow.
    pub guards: Vec<Guard>,
}
