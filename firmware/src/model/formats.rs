//! Formats of tables and networks: the exporter writes and the device reads the same structs.
//!
//! Scaled coordinates of the ideal model are integers of at most [`COORDINATE_LIMIT`] in magnitude, so that the squared
//! distance of two points over three axes stays below 2^31.
//!
//! Numbers of a recurrent network, stored in the order in which the kernel loads them:
//!
//! | number | type | fractional bits | range |
//! | --- | --- | --- | --- |
//! | input | i16 | 14 | ±2: twice the span of the training data, saturated |
//! | weight of an input, recurrent weight of a gate, weight of the head | i16 | 12 | ±8 |
//! | recurrent weight of a candidate | i16 | 13 | ±4 |
//! | bias, accumulator | i32 | 26 | ±32 |
//! | recurrent bias and accumulator of a candidate | i32 | 27 | ±16 |
//! | state | i32 | 30 | within ±1, see [`super::kernel::gru`] |
//! | state as a factor: its upper half, rounded down | i16 | 14 | within ±1 |
//! | reset and update gate | i32 | 31 | 0 to 1 |
//! | output | i32 | 26 | ±32 |
//!
//! Sizes count pairs, because the chip multiplies two 16-bit numbers at once. An odd number of inputs is padded by an
//! input without weight and gain, a layer by units without weights, whose state stays zero.

use crate::compensation::Compensation;
use crate::fixed_point::{Field, Force};
use crate::model::axis_map::AxisMap;

/// Maximum magnitude of a scaled coordinate: floor(sqrt(2^27)). The square of a difference is at most 2^29, and
/// the sum of three stays below 2^31.
pub const COORDINATE_LIMIT: i16 = 11_585;
/// Entries of the table of the exponential.
pub const EXP_ENTRIES: usize = 512;
/// Maximum number of pairs of centres per sensor.
pub const MOST_PAIRS: usize = 50;
/// Fractional bits of [`AxisScale::gain`] and [`Input::gain`].
pub const GAIN_BITS: u32 = 20;
/// Fractional bits of [`Linear::slope`].
pub const SLOPE_BITS: u32 = 16;

/// Ideal model and compensation of all sensors.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'a> {
    /// Identifier on the bus: the first two bytes of the hash of the inputs.
    pub id: u16,
    /// exp(-gamma d^2) in the format of [`crate::model::kernel::grbf`].
    pub exp: &'a [u32; EXP_ENTRIES],
    /// Ideal models, in any order.
    pub sensors: &'a [SensorTable],
    /// Compensations of the sensors with additional effects.
    pub compensations: &'a [Compensation<'a>],
    /// Checksum of all other fields ([`super::integrity`]).
    pub check: u32,
}

impl<'a> Tables<'a> {
    /// Compensation of sensor `number`; `None` without additional effects.
    pub fn compensation(&self, number: usize) -> Option<&'a Compensation<'a>> {
        self.compensations.iter().find(|compensation| usize::from(compensation.number) == number)
    }

    /// Ideal model of sensor `number`.
    pub fn sensor(&self, number: usize) -> Option<&SensorTable> {
        self.sensors.iter().find(|table| usize::from(table.number) == number)
    }
}

/// Ideal model of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorTable {
    /// Number of the sensor: its index in the frame.
    pub number: u8,
    /// Orientation of the sensor; all that follows is in the gripper's axes.
    pub axes: AxisMap,
    /// Scale of each axis from field to coordinate.
    pub scale: [AxisScale; 3],
    /// Saturation of the sensor in counts, for both signs.
    pub limit_counts: i16,
    /// Linear part.
    pub linear: Linear,
    /// Pairs of centres; only the first [`SensorTable::used_pairs`] count.
    pub pairs: [CentrePair; MOST_PAIRS],
    /// Number of pairs; 0 for a linear model.
    pub used_pairs: u8,
    /// Right shift of the sum over the centres to 1/1024 N, for Fx and Fz.
    pub shift: [u8; 2],
    /// Surface of the fields without disturbance.
    pub parity: Parity,
}

/// Field to scaled coordinate: `(field - offset) * gain`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisScale {
    /// Centre of the design box, in the unit of [`Field`].
    pub offset: i32,
    /// Coordinates per field unit, with [`GAIN_BITS`] fractional bits.
    pub gain: i32,
}

/// Force as a linear function of the scaled coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear {
    /// Fx and Fz at the centre of the box, in 1/1024 N.
    pub bias: [i32; 2],
    /// For Fx and Fz: 1/1024 N per coordinate, with [`SLOPE_BITS`] fractional bits.
    pub slope: [[i32; 3]; 2],
}

/// Two centres and their weights, five words in the order in which the kernel loads them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct CentrePair {
    /// x and y of the first, then of the second centre.
    pub xy: [[i16; 2]; 2],
    /// z of the first and the second.
    pub z: [i16; 2],
    /// For Fx and Fz: weight of the first and the second.
    pub weight: [[i16; 2]; 2],
}

impl CentrePair {
    /// Two centres without weight.
    pub const NONE: Self = Self { xy: [[0; 2]; 2], z: [0; 2], weight: [[0; 2]; 2] };
}

/// Pads a list of pairs to the size of the table.
pub const fn padded<const N: usize>(pairs: [CentrePair; N]) -> [CentrePair; MOST_PAIRS] {
    let mut all = [CentrePair::NONE; MOST_PAIRS];
    let (mut rest, mut from): (&mut [CentrePair], &[CentrePair]) = (&mut all, &pairs);
    while let (Some((to, further)), Some((pair, others))) =
        (rest.split_first_mut(), from.split_first())
    {
        *to = *pair;
        (rest, from) = (further, others);
    }
    all
}

/// Degree of the polynomial of [`Parity`].
pub const PARITY_DEGREE: usize = 6;
/// Terms of the polynomial.
pub const PARITY_TERMS: usize = (PARITY_DEGREE + 1) * (PARITY_DEGREE + 2) / 2;
/// Fractional bits of the polynomial's arguments, the scaled coordinates.
pub const PARITY_ARGUMENT_BITS: u32 = 13;
/// Additional fractional bits of a term relative to [`Field`].
pub const PARITY_TERM_BITS: u32 = 8;
/// Additional fractional bits of [`Parity::sigma`] relative to [`Field`].
pub const PARITY_SIGMA_BITS: u32 = 8;

/// Surface of a sensor's undisturbed fields ([`crate::estimator::parity`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parity {
    /// Axis predicted from the other two, u and v in their order.
    pub axis: u8,
    /// Coefficients of u^i v^j in descending order of i, then of j.
    pub terms: [i32; PARITY_TERMS],
    /// Standard deviation of the fit's residual, with [`PARITY_SIGMA_BITS`]; 0 if unknown.
    pub sigma: i32,
}

impl Parity {
    /// No surface: residuals have no meaning.
    pub const NONE: Self = Self { axis: 1, terms: [0; PARITY_TERMS], sigma: 0 };
}

/// Gates of a unit: reset, update, candidate.
pub const GATES: usize = 3;
/// Outputs per sensor: means of Fx and Fz, logarithms of their standard deviations.
pub const OUTPUTS: usize = 4;
/// Fractional bits of an input, and of the state's upper half.
pub const INPUT_BITS: u32 = 14;
/// Fractional bits of a weight.
pub const WEIGHT_BITS: u32 = 12;
/// Fractional bits of a candidate's recurrent weight.
pub const CANDIDATE_BITS: u32 = 13;
/// Fractional bits of the state.
pub const STATE_BITS: u32 = 30;
/// Fractional bits of an output, and of every accumulator except a candidate's recurrent one.
pub const OUTPUT_BITS: u32 = INPUT_BITS + WEIGHT_BITS;

/// Two factors of a dual multiplication.
pub type Pair = [i16; 2];
/// Weights of the gates of two units for a pair of inputs.
pub type Products = [[Pair; GATES]; 2];

/// Two units of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct UnitPair<const INPUTS: usize, const HIDDEN: usize> {
    /// Biases of reset, update and candidate; those of the gates are the sum of PyTorch's two.
    pub bias: [[i32; GATES]; 2],
    /// Weights of each pair of inputs.
    pub input: [Products; INPUTS],
    /// Recurrent biases of the candidates, which the reset gate scales.
    pub state_bias: [i32; 2],
    /// Weights of each pair of units.
    pub state: [Products; HIDDEN],
}

/// Output layer of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Head<const HIDDEN: usize> {
    /// Biases.
    pub bias: [i32; OUTPUTS],
    /// Weights of each pair of units.
    pub weights: [[Pair; OUTPUTS]; HIDDEN],
}

/// All weights: `INPUTS` pairs of inputs, two layers of `HIDDEN` pairs of units, `SENSORS` heads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Weights<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// First layer.
    pub first: [UnitPair<INPUTS, HIDDEN>; HIDDEN],
    /// Second layer, on the first.
    pub second: [UnitPair<HIDDEN, HIDDEN>; HIDDEN],
    /// Output layers, on the second.
    pub heads: [Head<HIDDEN>; SENSORS],
}

/// State of a network and outputs of its latest step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct GruState<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// Inputs of the next step.
    pub input: [Pair; INPUTS],
    /// Upper halves of both layers' states.
    pub upper: [[Pair; HIDDEN]; 2],
    /// Both layers' states.
    pub full: [[[i32; 2]; HIDDEN]; 2],
    /// Latest outputs.
    pub outputs: [[i32; OUTPUTS]; SENSORS],
    /// Accumulators of the next step after the recurrent products: those of the gates with their biases, the candidate's recurrent
    /// one.
    pub recurrent: [[[[i32; GATES]; 2]; HIDDEN]; 2],
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>
    GruState<INPUTS, HIDDEN, SENSORS>
{
    /// State after a reset: all zero.
    pub const RESET: Self = Self {
        input: [[0; 2]; INPUTS],
        upper: [[[0; 2]; HIDDEN]; 2],
        full: [[[0; 2]; HIDDEN]; 2],
        outputs: [[0; OUTPUTS]; SENSORS],
        recurrent: [[[[0; GATES]; 2]; HIDDEN]; 2],
    };
}

/// Source of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputSource {
    /// Padding of a pair.
    None,
    /// Compensated field of a sensor, as [`Field`].
    Field {
        /// Number of the sensor.
        sensor: u8,
        /// 0, 1, 2 for x, y, z.
        axis: u8,
    },
    /// Force of the ideal model at a sensor, as [`Force`].
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
    /// Scaled quantity.
    pub source: InputSource,
    /// Centre of the training data, in the source's unit.
    pub offset: i32,
    /// Input per unit of the source, with [`GAIN_BITS`] fractional bits.
    pub gain: i32,
}

/// Quantity predicted by a network's means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The force.
    Force,
    /// The residual of the ideal model: the mean is added to its force.
    Rest,
}

/// Training range of a network. Outside it the predicted standard deviations are increased by the possible error of the
/// forces, because the likelihood of the training holds only inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guard {
    /// Minimum and maximum parity residual in training ([`crate::estimator::parity`]).
    pub residual: [Field; 2],
    /// Force, Fx and Fz, per unit of field in the plane, with [`FORCE_BITS`] fractional bits: a foreign field is
    /// expected to be of the same size in the plane as normal to it.
    pub force: [i32; 2],
    /// Maximum deviation of the network from the ideal model in training, Fx and Fz.
    pub deviation: [Force; 2],
}

impl Guard {
    /// Unlimited range.
    pub const NONE: Self = Self {
        residual: [Field(i32::MIN), Field(i32::MAX)],
        force: [0; 2],
        deviation: [Force(i32::MAX); 2],
    };
}

/// Fractional bits of [`Network::force`] and [`Guard::force`].
pub const FORCE_BITS: u32 = 8;

/// A quantised network with its scales.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// Numbers of the predicted sensors.
    pub sensors: [u8; SENSORS],
    /// Predicted quantity.
    pub target: Target,
    /// Inputs in pairs.
    pub inputs: [[Input; 2]; INPUTS],
    /// Force for an output of one, Fx and Fz, in the unit of [`Force`] with [`FORCE_BITS`] fractional bits.
    pub force: [i32; 2],
    /// Steps after a reset until the initial state is forgotten and the outputs are usable.
    pub warm_up: u16,
    /// Training range of each sensor.
    pub guards: [Guard; SENSORS],
    /// Weights.
    pub weights: Weights<INPUTS, HIDDEN, SENSORS>,
    /// Checksum of all other fields ([`super::integrity`]).
    pub check: u32,
}

impl<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize> Network<INPUTS, HIDDEN, HEADS> {
    /// Whether every input is of one of these sensors.
    pub fn depends_only_on(&self, sensors: [bool; crate::sensors::hall::SENSORS]) -> bool {
        self.inputs.iter().flatten().all(|input| match input.source {
            InputSource::None => true,
            InputSource::Field { sensor, .. } | InputSource::Ideal { sensor, .. } => {
                sensors.get(usize::from(sensor)) == Some(&true)
            }
        })
    }
}

/// Prediction of a network for one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prediction {
    /// Mean of Fx and Fz.
    pub mean: [Force; 2],
    /// Their standard deviations.
    pub sigma: [Force; 2],
}
