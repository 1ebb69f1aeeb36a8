//! A quantised network in the device's order, and the sizes that the device knows.
//!
//! The device's types hold the sizes, so that an image links the code of one size and no more. Here a
//! file decides at run time: [`Packed`] is one of the sizes below, behind one interface. A network
//! takes the smallest size that holds it; inputs and units beyond its own have no weights, and such a
//! unit stays at zero.

use std::array;
use std::fmt::Debug;

use firmware::force::Estimate;
use firmware::frame::SENSORS;
use firmware::model::gru::Run;
use firmware::model::network::{
    FORCE_BITS, GATES, Guard, Head, Input, Network as DeviceNetwork, OUTPUTS, Pair, Source,
    Target as DeviceTarget, Told, UnitPair, Weights,
};
use firmware::recurrent;
use firmware::units::{Field, Force};

use super::network::{Network, Target};
use super::quantise::{LayerRows, Quantised};
use super::unfit::Unfit;
use super::warm_up;

/// A network of any size that the device knows, for the host.
pub trait Packed: Debug + Send + Sync {
    /// Pairs of inputs, pairs of units, sensors.
    fn size(&self) -> [usize; 3];
    /// A state after a reset.
    fn run(&self) -> Box<dyn Running + '_>;
    /// The device's struct as Rust source.
    fn source(&self) -> String;
}

/// A packed network with its state.
pub trait Running {
    /// Numbers of the sensors that it tells the forces of.
    fn sensors(&self) -> Vec<usize>;
    /// One step over a frame's estimates by the device's own code; see [`recurrent::apply`].
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]);
    /// One step by the device's own code; see [`Run::step`].
    fn step(&mut self, value: &dyn Fn(Source) -> i32) -> Option<Vec<Told>>;
    /// States of both layers (Q30), in the order of the units.
    fn states(&self) -> [Vec<i32>; 2];
    /// The latest outputs (Q26).
    fn outputs(&self) -> Vec<i32>;
}

/// Steps every network over the estimates of one frame, as [`recurrent::apply`] does with networks of
/// one size: each sees the estimates as they were.
pub fn apply(running: &mut [Box<dyn Running + '_>], estimates: &mut [Estimate; SENSORS]) {
    let seen = *estimates;
    for running in running {
        let mut told = seen;
        running.apply(&mut told);
        for sensor in running.sensors() {
            if let (Some(to), Some(from)) = (estimates.get_mut(sensor), told.get(sensor)) {
                *to = *from;
            }
        }
    }
}

/// Packs a network into the smallest size that holds it.
pub fn pack(network: &Network, gauss_per_lsb: f64) -> Result<Box<dyn Packed>, Unfit> {
    let [inputs, hidden, sensors] = [network.inputs.len(), network.hidden, network.sensors.len()];
    let size = Unfit::Size {
        inputs,
        hidden,
        sensors,
    };
    if inputs == 0 || hidden == 0 || sensors == 0 {
        return Err(size);
    }
    let quantised = Quantised::new(network, gauss_per_lsb)?;
    let numbers = network
        .sensors
        .iter()
        .map(|&number| u8::try_from(number).ok());
    let numbers: Option<Vec<u8>> = numbers.collect();
    let numbers = numbers.ok_or_else(|| size.clone())?;
    let around = Around {
        numbers,
        target: network.target,
        warm_up: warm_up::steps(network),
        guards: guards(network, gauss_per_lsb),
    };
    sized(
        inputs.div_ceil(2),
        hidden.div_ceil(2),
        sensors,
        &quantised,
        &around,
    )
    .ok_or(size)
}

/// What stands around the weights.
struct Around {
    numbers: Vec<u8>,
    target: Target,
    warm_up: u16,
    guards: Vec<Guard>,
}

/// Where the network has learned, in the device's units; numbers beyond the range stay at its end.
fn guards(network: &Network, gauss_per_lsb: f64) -> Vec<Guard> {
    let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
    let per_force = f64::from(1_u32 << FORCE_BITS) * Force::PER_NEWTON / units;
    let guard = |guard: &super::network::Guard| Guard {
        departure: guard.departure_g.map(|g| Field((g * units).round() as i32)),
        force: guard.newtons_per_g.map(|n| (n * per_force).round() as i32),
        split: guard
            .split_n
            .map(|n| Force((n * Force::PER_NEWTON).round() as i32)),
    };
    network.guards.iter().map(guard).collect()
}

/// The sizes that the device knows: pairs of units, pairs of inputs and sensors, from the smallest up.
fn sized(
    inputs: usize,
    hidden: usize,
    sensors: usize,
    rows: &Quantised,
    around: &Around,
) -> Option<Box<dyn Packed>> {
    match hidden {
        ..=4 => with_hidden::<4>(inputs, sensors, rows, around),
        5..=8 => with_hidden::<8>(inputs, sensors, rows, around),
        9..=12 => with_hidden::<12>(inputs, sensors, rows, around),
        13..=16 => with_hidden::<16>(inputs, sensors, rows, around),
        _ => None,
    }
}

fn with_hidden<const HIDDEN: usize>(
    inputs: usize,
    sensors: usize,
    rows: &Quantised,
    around: &Around,
) -> Option<Box<dyn Packed>> {
    match inputs {
        1 => with_inputs::<1, HIDDEN>(sensors, rows, around),
        2 => with_inputs::<2, HIDDEN>(sensors, rows, around),
        3 => with_inputs::<3, HIDDEN>(sensors, rows, around),
        4 => with_inputs::<4, HIDDEN>(sensors, rows, around),
        5 | 6 => with_inputs::<6, HIDDEN>(sensors, rows, around),
        7 | 8 => with_inputs::<8, HIDDEN>(sensors, rows, around),
        _ => None,
    }
}

fn with_inputs<const INPUTS: usize, const HIDDEN: usize>(
    sensors: usize,
    rows: &Quantised,
    around: &Around,
) -> Option<Box<dyn Packed>> {
    match sensors {
        1 => Some(Box::new(device::<INPUTS, HIDDEN, 1>(rows, around))),
        2 => Some(Box::new(device::<INPUTS, HIDDEN, 2>(rows, around))),
        3 => Some(Box::new(device::<INPUTS, HIDDEN, 3>(rows, around))),
        4 => Some(Box::new(device::<INPUTS, HIDDEN, 4>(rows, around))),
        _ => None,
    }
}

fn device<const INPUTS: usize, const HIDDEN: usize, const TOLD: usize>(
    rows: &Quantised,
    around: &Around,
) -> DeviceNetwork<INPUTS, HIDDEN, TOLD> {
    let none = Input {
        source: Source::None,
        offset: 0,
        gain: 0,
    };
    let input = |number: usize| rows.inputs.get(number).copied().unwrap_or(none);
    let [first, second] = &rows.layers;
    DeviceNetwork {
        sensors: array::from_fn(|sensor| around.numbers.get(sensor).copied().unwrap_or(u8::MAX)),
        target: match around.target {
            Target::Force => DeviceTarget::Force,
            Target::Rest => DeviceTarget::Rest,
        },
        inputs: array::from_fn(|pair| [input(2 * pair), input(2 * pair + 1)]),
        force: rows.force,
        warm_up: around.warm_up,
        guards: array::from_fn(|sensor| around.guards.get(sensor).copied().unwrap_or(Guard::NONE)),
        weights: Weights {
            first: array::from_fn(|pair| unit_pair(first, pair)),
            second: array::from_fn(|pair| unit_pair(second, pair)),
            heads: array::from_fn(|sensor| head(rows, sensor)),
        },
        check: 0,
    }
    .checked()
}

fn unit_pair<const INPUTS: usize, const HIDDEN: usize>(
    layer: &LayerRows,
    pair: usize,
) -> UnitPair<INPUTS, HIDDEN> {
    let units = [2 * pair, 2 * pair + 1];
    // Of a gate's row; nothing for units beyond the layer's own.
    let row = |gate: usize, unit: usize| (unit < layer.units).then_some(gate * layer.units + unit);
    let products = |weights: &[i16], columns: usize, column: usize| {
        units.map(|unit| {
            [0, 1, 2]
                .map(|gate| [0, 1].map(|k| weight(weights, row(gate, unit), columns, column + k)))
        })
    };
    UnitPair {
        bias: units.map(|unit| {
            array::from_fn::<_, GATES, _>(|gate| row(gate, unit).map_or(0, |row| layer.bias[row]))
        }),
        input: array::from_fn(|k| products(&layer.input_weights, layer.inputs, 2 * k)),
        state_bias: units.map(|unit| layer.candidate_bias.get(unit).copied().unwrap_or(0)),
        state: array::from_fn(|k| products(&layer.state_weights, layer.units, 2 * k)),
    }
}

/// A weight, zero beyond the matrix.
fn weight(weights: &[i16], row: Option<usize>, columns: usize, column: usize) -> i16 {
    match row {
        Some(row) if column < columns => weights[row * columns + column],
        _ => 0,
    }
}

fn head<const HIDDEN: usize>(rows: &Quantised, sensor: usize) -> Head<HIDDEN> {
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

impl<const INPUTS: usize, const HIDDEN: usize, const TOLD: usize> Packed
    for DeviceNetwork<INPUTS, HIDDEN, TOLD>
{
    fn size(&self) -> [usize; 3] {
        [INPUTS, HIDDEN, TOLD]
    }

    fn run(&self) -> Box<dyn Running + '_> {
        Box::new((self, Run::RESET))
    }

    fn source(&self) -> String {
        super::emit::network(self)
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const TOLD: usize> Running
    for (
        &DeviceNetwork<INPUTS, HIDDEN, TOLD>,
        Run<INPUTS, HIDDEN, TOLD>,
    )
{
    fn sensors(&self) -> Vec<usize> {
        self.0.sensors.map(usize::from).into()
    }

    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        let (network, run) = self;
        recurrent::apply(array::from_ref(*network), array::from_mut(run), estimates);
    }

    fn step(&mut self, value: &dyn Fn(Source) -> i32) -> Option<Vec<Told>> {
        let (network, run) = self;
        run.step(network, |source| Some(value(source)))
            .map(Vec::from)
    }

    fn states(&self) -> [Vec<i32>; 2] {
        self.1.state.full.map(|layer| layer.as_flattened().to_vec())
    }

    fn outputs(&self) -> Vec<i32> {
        self.1.state.outputs.as_flattened().to_vec()
    }
}
