//! Weights in the device's formats ([`firmware::model::formats`]), with the proof that no accumulator wraps.
//!
//! The device's sums wrap silently at 32 bits. So the maximum sum of every row over all inputs and states is
//! computed in integers, and a row that could wrap is rejected by name. The upper half of a state is truncated,
//! on average by half a bit; each bias compensates this.

use crate::gru::network::{Input, Layer, Network, OUTPUTS, ScaledInput};
use firmware::fixed_point::{Field, Force};
use firmware::model::formats::{
    CANDIDATE_BITS, FORCE_BITS, GAIN_BITS, GATES, INPUT_BITS, Input as DeviceInput, InputSource,
    OUTPUT_BITS, WEIGHT_BITS,
};
use std::fmt;

/// Maximum magnitude of an input.
pub(super) const INPUT_LIMIT: i64 = 1 << 15;
/// Maximum magnitude of the upper half of a state: the state is within ±1.
const STATE_LIMIT: i64 = 1 << INPUT_BITS;
/// Limit of the magnitude of sums.
pub(super) const SUM_LIMIT: i64 = 1 << 31;

/// Quantised rows of one layer, in the network's own order.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerRows {
    /// Inputs of the layer.
    pub inputs: usize,
    /// Units of the layer.
    pub units: usize,
    /// `GATES * units` rows of `inputs` weights.
    pub input_weights: Vec<i16>,
    /// `GATES * units` rows of `units` weights.
    pub state_weights: Vec<i16>,
    /// `GATES * units`; for reset and update the sum of both biases.
    pub bias: Vec<i32>,
    /// `units`: the candidates' recurrent biases.
    pub candidate_bias: Vec<i32>,
}

/// A network in the device's formats, proved not to overflow.
#[derive(Clone, Debug, PartialEq)]
pub struct QuantisedNetwork {
    /// Scales of the inputs.
    pub inputs: Vec<DeviceInput>,
    /// First and second.
    pub layers: [LayerRows; 2],
    /// Rows of the head.
    pub head_weights: Vec<i16>,
    /// Biases of the head.
    pub head_bias: Vec<i32>,
    /// Force of a unit output.
    pub force: [i32; 2],
}

impl QuantisedNetwork {
    /// Quantises and proves. `gauss_per_lsb` is the sensors' scale.
    pub fn new(network: &Network, gauss_per_lsb: f64) -> Result<Self, QuantiseError> {
        let units = network.hidden;
        shape("weights of the head", &network.head_weights, network.head_bias.len() * units)?;
        shape("biases of the head", &network.head_bias, network.sensors.len() * OUTPUTS)?;
        let scaled = network.inputs.iter().enumerate();
        let [first, second] = &network.layers;
        let (head_weights, head_bias) = head(network)?;
        Ok(Self {
            inputs: scaled
                .map(|(number, input)| scale(number, input, gauss_per_lsb))
                .collect::<Result<_, _>>()?,
            layers: [
                layer(0, first, network.inputs.len(), units)?,
                layer(1, second, units, units)?,
            ],
            head_weights,
            head_bias,
            force: force(network.force_n)?,
        })
    }
}

fn shape(what: &'static str, numbers: &[f32], expected: usize) -> Result<(), QuantiseError> {
    match numbers.len() {
        found if found == expected => Ok(()),
        found => Err(QuantiseError::Shape { what, found, expected }),
    }
}

/// Rounds a value to `bits` fractional bits, within `limit` either way.
fn to_fixed(
    row: WeightRow,
    what: impl Fn() -> String,
    value: f64,
    bits: u32,
    limit: i64,
    advice: &'static str,
) -> Result<i64, QuantiseError> {
    let one = f64::from(1_u32 << bits);
    let rounded = (value * one).round();
    if rounded.abs() <= limit as f64 {
        return Ok(rounded as i64);
    }
    Err(QuantiseError::Number {
        row,
        what: what(),
        value,
        format: format!("±{:.4}", limit as f64 / one),
        advice,
    })
}

fn weights(
    row: WeightRow,
    what: &str,
    values: &[f32],
    bits: u32,
) -> Result<Vec<i16>, QuantiseError> {
    let quantised = values.iter().enumerate().map(|(column, &value)| {
        let name = || match what {
            "" => format!("weight {column}"),
            what => format!("{what} weight {column}"),
        };
        let limit = i64::from(i16::MAX);
        Ok(to_fixed(row, name, f64::from(value), bits, limit, LARGE_WEIGHTS)? as i16)
    });
    quantised.collect()
}

/// A bias, without the correction for truncation.
fn bias(row: WeightRow, what: &str, value: f64, bits: u32) -> Result<i64, QuantiseError> {
    to_fixed(row, || what.to_owned(), value, bits, SUM_LIMIT - 1, LARGE_WEIGHTS)
}

/// Mean loss of a row by truncation of states.
fn rounding_loss(weights: &[i16]) -> i64 {
    weights.iter().map(|&weight| i64::from(weight)).sum::<i64>() / 2
}

/// Maximum sum of a row's products.
fn max_sum(weights: &[i16], limit: i64) -> i64 {
    weights.iter().map(|&weight| i64::from(weight).abs() * limit).sum()
}

/// The device's bias, where the maximum sum cannot wrap.
fn checked_bias(row: WeightRow, bias: i64, products: i64, bits: u32) -> Result<i32, QuantiseError> {
    let sum = bias.abs() + products;
    if sum < SUM_LIMIT {
        return Ok(bias as i32);
    }
    let one = f64::from(1_u32 << bits);
    Err(QuantiseError::Wraps { row, greatest: sum as f64 / one, limit: SUM_LIMIT as f64 / one })
}

fn layer(
    number: usize,
    layer: &Layer,
    inputs: usize,
    units: usize,
) -> Result<LayerRows, QuantiseError> {
    shape("input weights of a layer", &layer.input_weights, GATES * units * inputs)?;
    shape("recurrent weights of a layer", &layer.state_weights, GATES * units * units)?;
    shape("input biases of a layer", &layer.input_bias, GATES * units)?;
    shape("recurrent biases of a layer", &layer.state_bias, GATES * units)?;
    let mut rows = LayerRows {
        inputs,
        units,
        input_weights: Vec::new(),
        state_weights: Vec::new(),
        bias: Vec::new(),
        candidate_bias: Vec::new(),
    };
    for index in 0..GATES * units {
        let (gate, unit) = (index / units, index % units);
        let row = WeightRow::Layer { layer: number, gate, unit };
        let input =
            weights(row, "input", &layer.input_weights[index * inputs..][..inputs], WEIGHT_BITS)?;
        // The second layer's inputs are the first's states.
        let (from_inputs, input_loss) = match number {
            0 => (max_sum(&input, INPUT_LIMIT), 0),
            _ => (max_sum(&input, STATE_LIMIT), rounding_loss(&input)),
        };
        let candidate = gate == GATES - 1;
        let bits = if candidate { CANDIDATE_BITS } else { WEIGHT_BITS };
        let state =
            weights(row, "recurrent", &layer.state_weights[index * units..][..units], bits)?;
        let from_states = max_sum(&state, STATE_LIMIT);
        let [b, c] = [layer.input_bias[index], layer.state_bias[index]].map(f64::from);
        if candidate {
            let input_bias = bias(row, "bias", b, OUTPUT_BITS)? + input_loss;
            let state_bias =
                bias(row, "recurrent bias", c, OUTPUT_BITS + 1)? + rounding_loss(&state);
            rows.candidate_bias.push(checked_bias(row, state_bias, from_states, OUTPUT_BITS + 1)?);
            // After the reset gate, which is below one, half of it is added: Q27 to Q26.
            let gated = (state_bias.abs() + from_states) / 2 + 1;
            rows.bias.push(checked_bias(row, input_bias, from_inputs + gated, OUTPUT_BITS)?);
        } else {
            let both = bias(row, "bias", b + c, OUTPUT_BITS)? + input_loss + rounding_loss(&state);
            rows.bias.push(checked_bias(row, both, from_inputs + from_states, OUTPUT_BITS)?);
        }
        rows.input_weights.extend(input);
        rows.state_weights.extend(state);
    }
    Ok(rows)
}

fn head(network: &Network) -> Result<(Vec<i16>, Vec<i32>), QuantiseError> {
    let (mut all, mut biases) = (Vec::new(), Vec::new());
    let rows = network.head_weights.chunks(network.hidden.max(1));
    for (output, (values, &value)) in rows.zip(&network.head_bias).enumerate() {
        let row = WeightRow::Head { output };
        let quantised = weights(row, "", values, WEIGHT_BITS)?;
        let whole = bias(row, "bias", f64::from(value), OUTPUT_BITS)? + rounding_loss(&quantised);
        biases.push(checked_bias(row, whole, max_sum(&quantised, STATE_LIMIT), OUTPUT_BITS)?);
        all.extend(quantised);
    }
    Ok((all, biases))
}

fn scale(
    number: usize,
    input: &ScaledInput,
    gauss_per_lsb: f64,
) -> Result<DeviceInput, QuantiseError> {
    let row = WeightRow::Input { number };
    let small = |what, value: usize| {
        let limit = i64::from(u8::MAX);
        let advice = "the device supports sensors 0 to 255";
        Ok::<u8, QuantiseError>(to_fixed(
            row,
            || String::from(what),
            value as f64,
            0,
            limit,
            advice,
        )? as u8)
    };
    let (source, units) = match input.input {
        Input::Field { sensor, axis } => (
            InputSource::Field {
                sensor: small("sensor", sensor as usize)?,
                axis: small("axis", axis)?,
            },
            f64::from(1_u32 << Field::BITS) / gauss_per_lsb,
        ),
        Input::Ideal { sensor, axis } => (
            InputSource::Ideal {
                sensor: small("sensor", sensor as usize)?,
                axis: small("axis", axis)?,
            },
            Force::PER_NEWTON,
        ),
    };
    let advice = "the training data hardly move along it: leave the input out, or record more";
    let limit = i64::from(i32::MAX);
    let offset = to_fixed(row, || "middle".to_owned(), input.middle * units, 0, limit, advice)?;
    let per_unit = f64::from(1_u32 << INPUT_BITS) / (input.span * units);
    let gain = to_fixed(row, || "gain".to_owned(), per_unit, GAIN_BITS, limit, advice)?;
    Ok(DeviceInput { source, offset: offset as i32, gain: gain as i32 })
}

fn force(force_n: [f64; 2]) -> Result<[i32; 2], QuantiseError> {
    let mut units = [0; 2];
    for (axis, (units, newtons)) in units.iter_mut().zip(force_n).enumerate() {
        let advice = "a force scale is above zero and at most 8191 N";
        let name = || "newtons of an output of one".to_owned();
        let limit = i64::from(i32::MAX);
        // Zero and negative values are invalid.
        let newtons = if newtons > 0.0 { newtons } else { f64::NAN };
        let bits = Force::BITS + FORCE_BITS;
        *units = to_fixed(WeightRow::Force { axis }, name, newtons, bits, limit, advice)? as i32;
    }
    Ok(units)
}

const GATE_NAMES: [&str; GATES] = ["reset", "update", "candidate"];

/// Location of a row in messages. Indices count from zero; layers are printed from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Their names and the text below say it.
pub enum WeightRow {
    Layer { layer: usize, gate: usize, unit: usize },
    Head { output: usize },
    Input { number: usize },
    Force { axis: usize },
}

impl fmt::Display for WeightRow {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match *self {
            Self::Layer { layer, gate, unit } => {
                write!(f, "layer {}, {} row {unit}", layer + 1, GATE_NAMES[gate])
            }
            Self::Head { output } => write!(f, "head, row {output}"),
            Self::Input { number } => write!(f, "input {number}"),
            Self::Force { axis } => write!(f, "force of F{}", ["x", "z"][axis]),
        }
    }
}

/// A network that does not fit the device's integers.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum QuantiseError {
    #[error("{row}: {what} {value:.4e} does not fit {format}; {advice}")]
    Number { row: WeightRow, what: String, value: f64, format: String, advice: &'static str },
    #[error(
        "{row}: its sum may reach {greatest:.2}, beyond the accumulator limit of {limit:.0}; {LARGE_WEIGHTS}"
    )]
    Wraps { row: WeightRow, greatest: f64, limit: f64 },
    #[error("{what}: {found} numbers where {expected} are expected")]
    Shape { what: &'static str, found: usize, expected: usize },
    #[error(
        "{inputs} inputs, {hidden} units and {sensors} sensors: the device supports up to 16 inputs, 32 units and 4 sensors"
    )]
    Size { inputs: usize, hidden: usize, sensors: usize },
    #[error(
        "{inputs} inputs, {hidden} units and {sensors} sensors: a board loads networks of one sensor with up to 4 inputs and 16 \
         units; write others into the image with `cargo magpie dev export` and `cargo flash-image`"
    )]
    NotLoadable { inputs: usize, hidden: usize, sensors: usize },
}

/// Remedy for large weights.
pub(super) const LARGE_WEIGHTS: &str = "train with weight decay, or clip weights while training";
