//! One millisecond of sensing: what every sensor said, and whether it said anything.

use crate::hall::Reading;

/// Sensors on the gripper.
pub const SENSORS: usize = crate::params::SENSORS.value as usize;

/// The readings of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Start of the tick in microseconds of the board's clock, wrapping.
    pub time_us: u32,
    /// One reading for each sensor; `None` where its transfer failed.
    pub readings: [Option<Reading>; SENSORS],
}
