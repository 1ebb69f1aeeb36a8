//! A network's numbers in the device's formats ([`firmware::model::network`]), with the proof that no
//! accumulator wraps.
//!
//! The device's sums wrap at 32 bits without a word. So for every row the greatest sum that any input
//! and any state can give is added up in integers here, and a row that might wrap is refused by name.
//! The state's upper half, which the products see, is rounded down: on the average it is half a bit too
//! small, and each bias holds what that takes from its row.

use firmware::model::network::{
    CANDIDATE_BITS, FORCE_BITS, GATES, INPUT_BITS, Input as DeviceInput, OUTPUT_BITS, Source,
    WEIGHT_BITS,
};
use firmware::model::table::GAIN_BITS;
use firmware::units::{Field, Force};

use super::network::{Input, Layer, Network, OUTPUTS, ScaledInput};
use super::unfit::{LARGE_WEIGHTS, Row, Unfit};

/// Greatest input, either way.
pub(super) const INPUT_LIMIT: i64 = 1 << 15;
/// Greatest upper half of a state, either way: the state stays within ±1.
const STATE_LIMIT: i64 = 1 << INPUT_BITS;
/// Sums stay below this, either way.
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
    /// `GATES * units`; of reset and update both biases together.
    pub bias: Vec<i32>,
    /// `units`: the candidates' recurrent biases.
    pub candidate_bias: Vec<i32>,
}

/// A network's numbers in the device's formats, proved not to overflow.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantised {
    /// Scales of the inputs.
    pub inputs: Vec<DeviceInput>,
    /// First and second.
    pub layers: [LayerRows; 2],
    /// Rows of the head.
    pub head_weights: Vec<i16>,
    /// Biases of the head.
    pub head_bias: Vec<i32>,
    /// Force of an output of one.
    pub force: [i32; 2],
}

impl Quantised {
    /// Quantises and proves. `gauss_per_lsb` is the sensors' scale.
    pub fn new(network: &Network, gauss_per_lsb: f64) -> Result<Self, Unfit> {
        let units = network.hidden;
        shape(
            "weights of the head",
            &network.head_weights,
            network.head_bias.len() * units,
        )?;
        shape(
            "biases of the head",
            &network.head_bias,
            network.sensors.len() * OUTPUTS,
        )?;
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

fn shape(what: &'static str, numbers: &[f32], expected: usize) -> Result<(), Unfit> {
    match numbers.len() {
        found if found == expected => Ok(()),
        found => Err(Unfit::Shape {
            what,
            found,
            expected,
        }),
    }
}

/// A number with fractional bits, rounded, within `limit` either way.
fn fit(
    row: Row,
    what: impl Fn() -> String,
    value: f64,
    bits: u32,
    limit: i64,
    advice: &'static str,
) -> Result<i64, Unfit> {
    let one = f64::from(1_u32 << bits);
    let rounded = (value * one).round();
    if rounded.abs() <= limit as f64 {
        return Ok(rounded as i64);
    }
    Err(Unfit::Number {
        row,
        what: what(),
        value,
        format: format!("±{:.4}", limit as f64 / one),
        advice,
    })
}

fn weights(row: Row, what: &str, values: &[f32], bits: u32) -> Result<Vec<i16>, Unfit> {
    let quantised = values.iter().enumerate().map(|(column, &value)| {
        let name = || match what {
            "" => format!("weight {column}"),
            what => format!("{what} weight {column}"),
        };
        let limit = i64::from(i16::MAX);
        Ok(fit(row, name, f64::from(value), bits, limit, LARGE_WEIGHTS)? as i16)
    });
    quantised.collect()
}

/// A bias; what rounding down takes from the products with states is added later.
fn bias(row: Row, what: &str, value: f64, bits: u32) -> Result<i64, Unfit> {
    fit(
        row,
        || what.to_owned(),
        value,
        bits,
        SUM_LIMIT - 1,
        LARGE_WEIGHTS,
    )
}

/// What rounding states down takes from a row on the average.
fn lost(weights: &[i16]) -> i64 {
    weights.iter().map(|&weight| i64::from(weight)).sum::<i64>() / 2
}

/// The greatest sum of a row's products.
fn greatest(weights: &[i16], limit: i64) -> i64 {
    weights
        .iter()
        .map(|&weight| i64::from(weight).abs() * limit)
        .sum()
}

/// The bias as the device holds it, where `sum` (its size included) cannot wrap.
fn proved(row: Row, bias: i64, products: i64, bits: u32) -> Result<i32, Unfit> {
    let sum = bias.abs() + products;
    if sum < SUM_LIMIT {
        return Ok(bias as i32);
    }
    let one = f64::from(1_u32 << bits);
    Err(Unfit::Wraps {
        row,
        greatest: sum as f64 / one,
        limit: SUM_LIMIT as f64 / one,
    })
}

fn layer(number: usize, layer: &Layer, inputs: usize, units: usize) -> Result<LayerRows, Unfit> {
    shape(
        "input weights of a layer",
        &layer.input_weights,
        GATES * units * inputs,
    )?;
    shape(
        "recurrent weights of a layer",
        &layer.state_weights,
        GATES * units * units,
    )?;
    shape("input biases of a layer", &layer.input_bias, GATES * units)?;
    shape(
        "recurrent biases of a layer",
        &layer.state_bias,
        GATES * units,
    )?;
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
        let row = Row::Layer {
            layer: number,
            gate,
            unit,
        };
        let input = weights(
            row,
            "input",
            &layer.input_weights[index * inputs..][..inputs],
            WEIGHT_BITS,
        )?;
        // The second layer's inputs are the first's states.
        let (from_inputs, lost_inputs) = match number {
            0 => (greatest(&input, INPUT_LIMIT), 0),
            _ => (greatest(&input, STATE_LIMIT), lost(&input)),
        };
        let candidate = gate == GATES - 1;
        let bits = if candidate {
            CANDIDATE_BITS
        } else {
            WEIGHT_BITS
        };
        let state = weights(
            row,
            "recurrent",
            &layer.state_weights[index * units..][..units],
            bits,
        )?;
        let from_states = greatest(&state, STATE_LIMIT);
        let [b, c] = [layer.input_bias[index], layer.state_bias[index]].map(f64::from);
        if candidate {
            let input_bias = bias(row, "bias", b, OUTPUT_BITS)? + lost_inputs;
            let state_bias = bias(row, "recurrent bias", c, OUTPUT_BITS + 1)? + lost(&state);
            rows.candidate_bias
                .push(proved(row, state_bias, from_states, OUTPUT_BITS + 1)?);
            // Behind the reset gate, which is below one, half of it is added: Q27 to Q26.
            let gated = (state_bias.abs() + from_states) / 2 + 1;
            rows.bias
                .push(proved(row, input_bias, from_inputs + gated, OUTPUT_BITS)?);
        } else {
            let both = bias(row, "bias", b + c, OUTPUT_BITS)? + lost_inputs + lost(&state);
            rows.bias
                .push(proved(row, both, from_inputs + from_states, OUTPUT_BITS)?);
        }
        rows.input_weights.extend(input);
        rows.state_weights.extend(state);
    }
    Ok(rows)
}

fn head(network: &Network) -> Result<(Vec<i16>, Vec<i32>), Unfit> {
    let (mut all, mut biases) = (Vec::new(), Vec::new());
    let rows = network.head_weights.chunks(network.hidden.max(1));
    for (output, (values, &value)) in rows.zip(&network.head_bias).enumerate() {
        let row = Row::Head { output };
        let quantised = weights(row, "", values, WEIGHT_BITS)?;
        let whole = bias(row, "bias", f64::from(value), OUTPUT_BITS)? + lost(&quantised);
        biases.push(proved(
            row,
            whole,
            greatest(&quantised, STATE_LIMIT),
            OUTPUT_BITS,
        )?);
        all.extend(quantised);
    }
    Ok((all, biases))
}

fn scale(number: usize, input: &ScaledInput, gauss_per_lsb: f64) -> Result<DeviceInput, Unfit> {
    let row = Row::Input { number };
    let small = |what, value: usize| {
        let limit = i64::from(u8::MAX);
        let advice = "the device knows sensors 0 to 255";
        Ok::<u8, Unfit>(fit(row, || String::from(what), value as f64, 0, limit, advice)? as u8)
    };
    let (source, units) = match input.input {
        Input::Field { sensor, axis } => (
            Source::Field {
                sensor: small("sensor", sensor as usize)?,
                axis: small("axis", axis)?,
            },
            f64::from(1_u32 << Field::BITS) / gauss_per_lsb,
        ),
        Input::Ideal { sensor, axis } => (
            Source::Ideal {
                sensor: small("sensor", sensor as usize)?,
                axis: small("axis", axis)?,
            },
            Force::PER_NEWTON,
        ),
    };
    let advice = "the training data hardly move along it: leave the input out, or record more";
    let limit = i64::from(i32::MAX);
    let offset = fit(
        row,
        || "middle".to_owned(),
        input.middle * units,
        0,
        limit,
        advice,
    )?;
    let per_unit = f64::from(1_u32 << INPUT_BITS) / (input.span * units);
    let gain = fit(
        row,
        || "gain".to_owned(),
        per_unit,
        GAIN_BITS,
        limit,
        advice,
    )?;
    Ok(DeviceInput {
        source,
        offset: offset as i32,
        gain: gain as i32,
    })
}

fn force(force_n: [f64; 2]) -> Result<[i32; 2], Unfit> {
    let mut units = [0; 2];
    for (axis, (units, newtons)) in units.iter_mut().zip(force_n).enumerate() {
        let advice = "a force scale is above zero and at most 8191 N";
        let name = || "newtons of an output of one".to_owned();
        let limit = i64::from(i32::MAX);
        // Zero and less fit no scale either.
        let newtons = if newtons > 0.0 { newtons } else { f64::NAN };
        let bits = Force::BITS + FORCE_BITS;
        *units = fit(Row::Force { axis }, name, newtons, bits, limit, advice)? as i32;
    }
    Ok(units)
}
