//! Quantised networks in the device's layout, for each supported size.
//!
//! The device's types contain the sizes, so that an image links the code of one size only. On the host a file
//! decides at run time: [`PackedNetwork`] covers all sizes behind one interface. A network takes the smallest
//! size that fits; surplus inputs and units have zero weights, and such a unit stays at zero.

use std::array;
use std::fmt::Debug;

use firmware::estimator::Estimate;
use firmware::estimator::gru::{self, GruInference};
use firmware::fixed_point::{Field, Force};
use firmware::model::calibration::LoadableNetwork;
use firmware::model::formats::{
    FORCE_BITS, GATES, Guard, Head, Input, InputSource, Network as DeviceNetwork, OUTPUTS, Pair,
    Prediction, Products, Target as DeviceTarget, UnitPair, Weights,
};
use firmware::sensors::hall::SENSORS;

use crate::gru::network::{self, Network, Target};
use crate::gru::quantise::{LayerRows, QuantiseError, QuantisedNetwork};

/// A network of any supported size, for the host.
pub trait PackedNetwork: Debug + Send + Sync {
    /// Pairs of inputs, pairs of units, sensors.
    fn size(&self) -> [usize; 3];
    /// Steps from a reset until its outputs are used.
    fn warm_up(&self) -> u16;
    /// A run from the reset state.
    fn run(&self) -> Box<dyn NetworkRun + '_>;
    /// The device's struct as Rust source.
    fn source(&self) -> String;
}

/// A packed network with its state.
pub trait NetworkRun: Send {
    /// Numbers of the predicted sensors.
    fn sensors(&self) -> Vec<usize>;
    /// One step over a frame's estimates by the device's own code; see [`gru::apply`].
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]);
    /// One step by the device's own code; see [`GruInference::step`].
    fn step(&mut self, value: &dyn Fn(InputSource) -> i32) -> Option<Vec<Prediction>>;
    /// States of both layers (Q30), in the order of the units.
    fn states(&self) -> [Vec<i32>; 2];
    /// The latest outputs (Q26).
    fn outputs(&self) -> Vec<i32>;
}

/// Steps every network over the estimates of one frame, as [`gru::apply`] does with networks of
/// one size: each sees the estimates as they were.
pub fn apply(running: &mut [Box<dyn NetworkRun + '_>], estimates: &mut [Estimate; SENSORS]) {
    let seen = *estimates;
    for running in running {
        let mut updated = seen;
        running.apply(&mut updated);
        for sensor in running.sensors() {
            if let (Some(to), Some(from)) = (estimates.get_mut(sensor), updated.get(sensor)) {
                *to = *from;
            }
        }
    }
}

/// Packs a network into the smallest size that fits.
pub fn pack(
    network: &Network,
    gauss_per_lsb: f64,
) -> Result<Box<dyn PackedNetwork>, QuantiseError> {
    let [inputs, hidden, sensors] = [network.inputs.len(), network.hidden, network.sensors.len()];
    let (quantised, meta) = prepare(network, gauss_per_lsb)?;
    sized(inputs.div_ceil(2), hidden.div_ceil(2), sensors, &quantised, &meta)
        .ok_or(QuantiseError::Size { inputs, hidden, sensors })
}

/// Quantised weights, and the rest in the device's units.
fn prepare(
    network: &Network,
    gauss_per_lsb: f64,
) -> Result<(QuantisedNetwork, Metadata), QuantiseError> {
    let [inputs, hidden, sensors] = [network.inputs.len(), network.hidden, network.sensors.len()];
    let size = QuantiseError::Size { inputs, hidden, sensors };
    if inputs == 0 || hidden == 0 || sensors == 0 {
        return Err(size);
    }
    let quantised = QuantisedNetwork::new(network, gauss_per_lsb)?;
    let numbers = network.sensors.iter().map(|&number| u8::try_from(number).ok());
    let numbers: Option<Vec<u8>> = numbers.collect();
    let meta = Metadata {
        numbers: numbers.ok_or(size)?,
        target: network.target,
        warm_up: network::warm_up_steps(network),
        guards: guards(network, gauss_per_lsb),
    };
    Ok((quantised, meta))
}

/// Packs networks into the size that a device can load without a new image.
pub(crate) fn pack_loadable(
    networks: &[Network],
    gauss_per_lsb: f64,
) -> Result<Vec<LoadableNetwork>, QuantiseError> {
    let pack = |network: &Network| {
        let [inputs, hidden, sensors] =
            [network.inputs.len(), network.hidden, network.sensors.len()];
        if inputs > 4 || hidden > 16 || sensors != 1 {
            return Err(QuantiseError::NotLoadable { inputs, hidden, sensors });
        }
        let (quantised, meta) = prepare(network, gauss_per_lsb)?;
        Ok(device_network(&quantised, &meta))
    };
    networks.iter().map(pack).collect()
}

/// Data of a network other than weights.
struct Metadata {
    numbers: Vec<u8>,
    target: Target,
    warm_up: u16,
    guards: Vec<Guard>,
}

/// Training range in the device's units, saturated.
fn guards(network: &Network, gauss_per_lsb: f64) -> Vec<Guard> {
    let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
    let per_force = f64::from(1_u32 << FORCE_BITS) * Force::PER_NEWTON / units;
    let guard = |guard: &network::TrainedRange| Guard {
        residual: guard.parity_residual_g.map(|g| Field((g * units).round() as i32)),
        force: guard.newtons_per_g.map(|n| (n * per_force).round() as i32),
        deviation: guard.disagreement_n.map(|n| Force((n * Force::PER_NEWTON).round() as i32)),
    };
    network.guards.iter().map(guard).collect()
}

/// Selects the smallest supported size: pairs of units, pairs of inputs, sensors.
fn sized(
    inputs: usize,
    hidden: usize,
    sensors: usize,
    rows: &QuantisedNetwork,
    meta: &Metadata,
) -> Option<Box<dyn PackedNetwork>> {
    match hidden {
        ..=4 => with_hidden::<4>(inputs, sensors, rows, meta),
        5..=8 => with_hidden::<8>(inputs, sensors, rows, meta),
        9..=12 => with_hidden::<12>(inputs, sensors, rows, meta),
        13..=16 => with_hidden::<16>(inputs, sensors, rows, meta),
        _ => None,
    }
}

fn with_hidden<const HIDDEN: usize>(
    inputs: usize,
    sensors: usize,
    rows: &QuantisedNetwork,
    meta: &Metadata,
) -> Option<Box<dyn PackedNetwork>> {
    match inputs {
        1 => with_inputs::<1, HIDDEN>(sensors, rows, meta),
        2 => with_inputs::<2, HIDDEN>(sensors, rows, meta),
        3 => with_inputs::<3, HIDDEN>(sensors, rows, meta),
        4 => with_inputs::<4, HIDDEN>(sensors, rows, meta),
        5 | 6 => with_inputs::<6, HIDDEN>(sensors, rows, meta),
        7 | 8 => with_inputs::<8, HIDDEN>(sensors, rows, meta),
        _ => None,
    }
}

fn with_inputs<const INPUTS: usize, const HIDDEN: usize>(
    sensors: usize,
    rows: &QuantisedNetwork,
    meta: &Metadata,
) -> Option<Box<dyn PackedNetwork>> {
    match sensors {
        1 => Some(Box::new(device_network::<INPUTS, HIDDEN, 1>(rows, meta))),
        2 => Some(Box::new(device_network::<INPUTS, HIDDEN, 2>(rows, meta))),
        3 => Some(Box::new(device_network::<INPUTS, HIDDEN, 3>(rows, meta))),
        4 => Some(Box::new(device_network::<INPUTS, HIDDEN, 4>(rows, meta))),
        _ => None,
    }
}

// Each function below has only the sizes that it needs: this one is compiled 96 times.
fn device_network<const INPUTS: usize, const HIDDEN: usize, const SENSOR_COUNT: usize>(
    rows: &QuantisedNetwork,
    meta: &Metadata,
) -> DeviceNetwork<INPUTS, HIDDEN, SENSOR_COUNT> {
    let [first, second] = &rows.layers;
    DeviceNetwork {
        sensors: padded(&meta.numbers, u8::MAX),
        target: match meta.target {
            Target::Force => DeviceTarget::Force,
            Target::Residual => DeviceTarget::Rest,
        },
        inputs: inputs(rows),
        force: rows.force,
        warm_up: meta.warm_up,
        guards: padded(&meta.guards, Guard::NONE),
        weights: Weights { first: layer(first), second: layer(second), heads: heads(rows) },
        check: 0,
    }
    .checked()
}

fn padded<T: Copy, const N: usize>(values: &[T], padding: T) -> [T; N] {
    array::from_fn(|index| values.get(index).copied().unwrap_or(padding))
}

fn inputs<const INPUTS: usize>(rows: &QuantisedNetwork) -> [[Input; 2]; INPUTS] {
    let unused = Input { source: InputSource::None, offset: 0, gain: 0 };
    let input = |number: usize| rows.inputs.get(number).copied().unwrap_or(unused);
    array::from_fn(|pair| [input(2 * pair), input(2 * pair + 1)])
}

fn layer<const INPUTS: usize, const HIDDEN: usize>(
    rows: &LayerRows,
) -> [UnitPair<INPUTS, HIDDEN>; HIDDEN] {
    array::from_fn(|pair| unit_pair(rows, pair))
}

fn unit_pair<const INPUTS: usize, const HIDDEN: usize>(
    layer: &LayerRows,
    pair: usize,
) -> UnitPair<INPUTS, HIDDEN> {
    const NONE: Products = [[[0; 2]; GATES]; 2];
    let units = [2 * pair, 2 * pair + 1];
    let (bias, state_bias) = biases(layer, units);
    let mut packed = UnitPair { bias, input: [NONE; INPUTS], state_bias, state: [NONE; HIDDEN] };
    // Not generic: compiled once for all sizes.
    set_products(&mut packed.input, layer, units, &layer.input_weights, layer.inputs);
    set_products(&mut packed.state, layer, units, &layer.state_weights, layer.units);
    packed
}

/// Biases of the gates, and of the candidate's recurrent part.
fn biases(layer: &LayerRows, units: [usize; 2]) -> ([[i32; GATES]; 2], [i32; 2]) {
    let gates =
        |unit| array::from_fn(|gate| row(layer, gate, unit).map_or(0, |row| layer.bias[row]));
    let candidate = |unit: usize| layer.candidate_bias.get(unit).copied().unwrap_or(0);
    (units.map(gates), units.map(candidate))
}

/// Row of a gate; `None` for surplus units.
fn row(layer: &LayerRows, gate: usize, unit: usize) -> Option<usize> {
    (unit < layer.units).then_some(gate * layer.units + unit)
}

fn set_products(
    products: &mut [Products],
    layer: &LayerRows,
    units: [usize; 2],
    weights: &[i16],
    columns: usize,
) {
    for (k, products) in products.iter_mut().enumerate() {
        for (products, unit) in products.iter_mut().zip(units) {
            for (gate, products) in products.iter_mut().enumerate() {
                let row = row(layer, gate, unit);
                *products = [2 * k, 2 * k + 1].map(|column| weight(weights, row, columns, column));
            }
        }
    }
}

/// A weight, zero beyond the matrix.
fn weight(weights: &[i16], row: Option<usize>, columns: usize, column: usize) -> i16 {
    match row {
        Some(row) if column < columns => weights[row * columns + column],
        _ => 0,
    }
}

fn heads<const HIDDEN: usize, const SENSOR_COUNT: usize>(
    rows: &QuantisedNetwork,
) -> [Head<HIDDEN>; SENSOR_COUNT] {
    array::from_fn(|sensor| head(rows, sensor))
}

fn head<const HIDDEN: usize>(rows: &QuantisedNetwork, sensor: usize) -> Head<HIDDEN> {
    let units = rows.layers[1].units;
    let row = |output: usize| sensor * OUTPUTS + output;
    let pair = |output: usize, column: usize| -> Pair {
        [0, 1].map(|k| weight(&rows.head_weights, Some(row(output)), units, column + k))
    };
    Head {
        bias: array::from_fn(|output| rows.head_bias[row(output)]),
        weights: array::from_fn(|k| array::from_fn(|output| pair(output, 2 * k))),
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSOR_COUNT: usize> PackedNetwork
    for DeviceNetwork<INPUTS, HIDDEN, SENSOR_COUNT>
{
    fn size(&self) -> [usize; 3] {
        [INPUTS, HIDDEN, SENSOR_COUNT]
    }

    fn warm_up(&self) -> u16 {
        self.warm_up
    }

    fn run(&self) -> Box<dyn NetworkRun + '_> {
        Box::new((self, GruInference::RESET))
    }

    fn source(&self) -> String {
        rust_source(self)
    }
}

/// The debug form is Rust's own notation except for the names of the enums.
fn rust_source(network: &dyn Debug) -> String {
    format!("{network:?}")
        .replace("target: ", "target: Target::")
        .replace("source: ", "source: InputSource::")
        .replace("UnitPair {", "\nUnitPair {")
        .replace("Head {", "\nHead {")
}

/// As a function, because a closure where it is called would have another type for each size.
fn reader(value: &dyn Fn(InputSource) -> i32) -> impl Fn(InputSource) -> Option<i32> {
    move |source| Some(value(source))
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSOR_COUNT: usize> NetworkRun
    for (&DeviceNetwork<INPUTS, HIDDEN, SENSOR_COUNT>, GruInference<INPUTS, HIDDEN, SENSOR_COUNT>)
{
    fn sensors(&self) -> Vec<usize> {
        self.0.sensors.map(usize::from).into()
    }

    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        let (network, run) = self;
        gru::apply(array::from_ref(*network), array::from_mut(run), &mut [None], estimates);
    }

    fn step(&mut self, value: &dyn Fn(InputSource) -> i32) -> Option<Vec<Prediction>> {
        let (network, run) = self;
        run.step(network, reader(value)).map(Vec::from)
    }

    fn states(&self) -> [Vec<i32>; 2] {
        let [first, second] = &self.1.state.full;
        [first.as_flattened().to_vec(), second.as_flattened().to_vec()]
    }

    fn outputs(&self) -> Vec<i32> {
        self.1.state.outputs.as_flattened().to_vec()
    }
}
