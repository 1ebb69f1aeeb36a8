//! Three-axis Hall sensors: what a reading is, and the parts that give one.

pub mod a31301;

/// One reading of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    /// Field in counts: x, y, z.
    pub field: [i16; 3],
    /// Temperature in counts; the scale is not known.
    pub temperature: i16,
}
