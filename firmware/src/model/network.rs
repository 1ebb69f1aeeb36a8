//! Formats of a recurrent network: what the exporter packs and the device reads, word for word in the
//! order in which the kernel loads it.
//!
//! | number | type | fractional bits | range |
//! | --- | --- | --- | --- |
//! | input | i16 | 14 | ±2: twice the span of the training data, saturated beyond |
//! | weight of an input, recurrent weight of a gate, weight of the head | i16 | 12 | ±8 |
//! | recurrent weight of a candidate | i16 | 13 | ±4 |
//! | bias, accumulator | i32 | 26 | ±32 |
//! | recurrent bias and accumulator of a candidate | i32 | 27 | ±16 |
//! | state | i32 | 30 | within ±1, see [`super::gru`] |
//! | state as the products see it: its upper half, rounded down | i16 | 14 | within ±1 |
//! | reset and update gate | i32 | 31 | 0 to 1 |
//! | output | i32 | 26 | ±32 |
//!
//! Sizes count pairs: the chip multiplies two numbers of 16 bits at once. An odd last input is
//! followed by one with neither weight nor gain, and units without weights fill a layer up: they stay
//! at zero.

use crate::units::{Field, Force};

/// Gates of a unit: reset, update, candidate.
pub const GATES: usize = 3;
/// Outputs for a sensor: means of Fx and Fz, logarithms of their standard deviations.
pub const OUTPUTS: usize = 4;
/// Fractional bits of an input, and of the state's upper half.
pub const INPUT_BITS: u32 = 14;
/// Fractional bits of a weight.
pub const WEIGHT_BITS: u32 = 12;
/// Fractional bits of a candidate's recurrent weight.
pub const CANDIDATE_BITS: u32 = 13;
/// Fractional bits of the state.
pub const STATE_BITS: u32 = 30;
/// Fractional bits of an output, and of every accumulator but a candidate's recurrent one.
pub const OUTPUT_BITS: u32 = INPUT_BITS + WEIGHT_BITS;

/// Two numbers that are multiplied at once.
pub type Pair = [i16; 2];
/// For each of two units the weights of its three gates for a pair of inputs.
pub type Products = [[Pair; GATES]; 2];

/// Two units of a layer.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct UnitPair<const INPUTS: usize, const HIDDEN: usize> {
    /// Biases of reset, update and candidate; the gates' hold both of PyTorch's.
    pub bias: [[i32; GATES]; 2],
    /// Weights of each pair of inputs.
    pub input: [Products; INPUTS],
    /// The candidates' recurrent biases: they stand inside the reset product.
    pub state_bias: [i32; 2],
    /// Weights of each pair of units.
    pub state: [Products; HIDDEN],
}

/// The outputs of one sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Head<const HIDDEN: usize> {
    /// Biases.
    pub bias: [i32; OUTPUTS],
    /// Weights of each pair of units.
    pub weights: [[Pair; OUTPUTS]; HIDDEN],
}

/// All weights: `INPUTS` pairs of inputs, two layers of `HIDDEN` pairs of units, `SENSORS` heads.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Weights<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// First layer.
    pub first: [UnitPair<INPUTS, HIDDEN>; HIDDEN],
    /// Second layer, over the first.
    pub second: [UnitPair<HIDDEN, HIDDEN>; HIDDEN],
    /// Over the second.
    pub heads: [Head<HIDDEN>; SENSORS],
}

/// What a network remembers, and the outputs of its latest step. Apart from the weights: one set of
/// weights may serve several states.
#[derive(Clone, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct State<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// Inputs of the next step, then of the latest.
    pub input: [Pair; INPUTS],
    /// Upper halves of both layers' states.
    pub upper: [[Pair; HIDDEN]; 2],
    /// Both layers' states.
    pub full: [[[i32; 2]; HIDDEN]; 2],
    /// The latest outputs.
    pub outputs: [[i32; OUTPUTS]; SENSORS],
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>
    State<INPUTS, HIDDEN, SENSORS>
{
    /// After a reset: nothing is remembered.
    pub const RESET: Self = Self {
        input: [[0; 2]; INPUTS],
        upper: [[[0; 2]; HIDDEN]; 2],
        full: [[[0; 2]; HIDDEN]; 2],
        outputs: [[0; OUTPUTS]; SENSORS],
    };
}

/// Where an input comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// From nowhere: it fills up a pair.
    None,
    /// The compensated field of a sensor along an axis, as [`crate::units::Field`].
    Field {
        /// Number of the sensor.
        sensor: u8,
        /// 0, 1, 2 for x, y, z.
        axis: u8,
    },
    /// The ideal model's force at a sensor, as [`crate::units::Force`].
    Ideal {
        /// Number of the sensor.
        sensor: u8,
        /// 0, 1 for Fx, Fz.
        axis: u8,
    },
}

/// An input and its scale: `(value - offset) * gain`, saturated to 16 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Input {
    /// What is scaled.
    pub source: Source,
    /// Middle of the training data, in the source's unit.
    pub offset: i32,
    /// Input for each unit of the source, with [`super::table::GAIN_BITS`] fractional bits.
    pub gain: i32,
}

/// What the means of a network are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The force itself.
    Force,
    /// What the ideal model leaves: the mean is added to its estimate.
    Rest,
}

/// Where a network has learned: beyond it its standard deviations grow by as much as the forces may be
/// off. The likelihood by which it learned says nothing there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guard {
    /// Least and greatest departure of the field from its surface in training
    /// ([`crate::force::Beside`]).
    pub departure: [Field; 2],
    /// Force, Fx and Fz, that a unit of field in the plane is taken for, with [`FORCE_BITS`] fractional
    /// bits: a foreign field has no reason to be smaller in the plane than beside it.
    pub force: [i32; 2],
    /// Greatest difference of network and ideal model in training, Fx and Fz.
    pub split: [Force; 2],
}

impl Guard {
    /// Nothing is beyond it.
    pub const NONE: Self = Self {
        departure: [Field(i32::MIN), Field(i32::MAX)],
        force: [0; 2],
        split: [Force(i32::MAX); 2],
    };
}

/// Fractional bits of [`Network::force`].
pub const FORCE_BITS: u32 = 8;

/// A network with all that stands around its weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Network<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// Numbers of the sensors that it tells the forces of.
    pub sensors: [u8; SENSORS],
    /// What its means are.
    pub target: Target,
    /// Its inputs, two by two.
    pub inputs: [[Input; 2]; INPUTS],
    /// Force of an output of one, Fx and Fz, in the unit of [`Force`] with [`FORCE_BITS`] fractional
    /// bits.
    pub force: [i32; 2],
    /// Steps after a reset until the outputs count: then a start from anywhere has been forgotten.
    pub warm_up: u16,
    /// Where it has learned, for each of its sensors.
    pub guards: [Guard; SENSORS],
    /// The weights.
    pub weights: Weights<INPUTS, HIDDEN, SENSORS>,
    /// Checksum of all other fields ([`super::check`]).
    pub check: u32,
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>
    Network<INPUTS, HIDDEN, SENSORS>
{
    /// The same with its checksum.
    pub fn checked(self) -> Self {
        Self {
            check: super::check::sum(&self),
            ..self
        }
    }
}

/// What a network tells of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Told {
    /// Mean of Fx and Fz.
    pub mean: [Force; 2],
    /// Their standard deviations.
    pub sigma: [Force; 2],
}
