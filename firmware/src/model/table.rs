//! Formats of the tables. The image links one static; the host builds the same struct in memory.
//!
//! Scaled coordinates are integers of at most [`COORDINATE_LIMIT`] either way: then the squared
//! distance of two points, over three axes, stays below 2^31.

use super::parity::Parity;
use crate::compensate::Compensation;

/// Greatest scaled coordinate, either way: floor(sqrt(2^27)). The square of a difference is then at
/// most 2^29, and three of them stay below 2^31.
pub const COORDINATE_LIMIT: i16 = 11_585;
/// Entries of the table of the exponential.
pub const EXP_ENTRIES: usize = 512;
/// Most pairs of centres in one sensor's model.
pub const MOST_PAIRS: usize = 50;
/// Fractional bits of [`AxisScale::gain`].
pub const GAIN_BITS: u32 = 20;
/// Fractional bits of [`Linear::slope`].
pub const SLOPE_BITS: u32 = 16;

/// Everything that a set of sensors needs to turn fields into forces.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'a> {
    /// Identifies the tables on the bus: the first two bytes of the inputs' hash.
    pub id: u16,
    /// exp(-gamma d^2), as [`crate::model::grbf`] reads it.
    pub exp: &'a [u32; EXP_ENTRIES],
    /// One for each sensor that the model knows, in any order.
    pub sensors: &'a [SensorTable],
    /// What is undone around the ideal model, for each sensor that has effects.
    pub compensations: &'a [Compensation<'a>],
    /// Checksum of all other fields ([`super::check`]).
    pub check: u32,
}

impl<'a> Tables<'a> {
    /// The same with their checksum.
    pub fn checked(self) -> Self {
        Self {
            check: super::check::sum(&self),
            ..self
        }
    }

    /// What is undone at the sensor with this number; nothing where it has no effects.
    pub fn compensation(&self, number: usize) -> Option<&'a Compensation<'a>> {
        self.compensations
            .iter()
            .find(|compensation| usize::from(compensation.number) == number)
    }

    /// The table of the sensor with this number, if the model knows it.
    pub fn sensor(&self, number: usize) -> Option<&SensorTable> {
        self.sensors
            .iter()
            .find(|table| usize::from(table.number) == number)
    }
}

/// The ideal model of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorTable {
    /// Number of the sensor: its place in the frame, whatever other sensors the model knows.
    pub number: u8,
    /// Field to scaled coordinate, each axis.
    pub scale: [AxisScale; 3],
    /// The sensor saturates at these counts, either way.
    pub limit_counts: i16,
    /// Linear part: all of it where there are no centres.
    pub linear: Linear,
    /// Pairs of centres; only the first [`SensorTable::used_pairs`] count.
    pub pairs: [CentrePair; MOST_PAIRS],
    /// How many pairs there are.
    pub used_pairs: u8,
    /// The sum over the centres is shifted right by this to give 1/1024 N: Fx, Fz.
    pub shift: [u8; 2],
    /// The surface on which the fields lie.
    pub parity: Parity,
}

/// Field to scaled coordinate: `(field - offset) * gain`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisScale {
    /// Middle of the design box, in the unit of [`crate::units::Field`].
    pub offset: i32,
    /// Coordinates for each unit of field, with [`GAIN_BITS`] fractional bits.
    pub gain: i32,
}

/// Force as a linear function of the scaled coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Linear {
    /// Fx, Fz at the middle of the box, in 1/1024 N.
    pub bias: [i32; 2],
    /// For Fx and Fz: 1/1024 N for each coordinate, with [`SLOPE_BITS`] fractional bits.
    pub slope: [[i32; 3]; 2],
}

/// Two centres and their weights, in the order in which a kernel loads them: five words.
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
    pub const NONE: Self = Self {
        xy: [[0; 2]; 2],
        z: [0; 2],
        weight: [[0; 2]; 2],
    };
}

/// Fills up a list of pairs to the table's size.
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
