//! The Earth's field, which turns with the gripper.
//!
//! The paper takes it for 0.5 uT and negligible. It is 25 to 65 uT, five counts of the sensor, and a
//! tare holds only until the gripper is turned.

use firmware::params::{Constant, stated};
use nalgebra::Matrix3;

use super::{Inverse, Sensed, Shift, Surroundings};

/// The least on the Earth's surface, over the South Atlantic.
pub const LEAST: Constant = stated("Earth's field, least", 0.25, "G", "IGRF-13: 22 to 67 uT");
/// The greatest, near the magnetic poles.
pub const GREATEST: Constant = stated("Earth's field, greatest", 0.65, "G", "IGRF-13: 22 to 67 uT");

/// From whichever side it hurts most.
pub fn shift(sensed: &Sensed, rest: &Inverse, around: &Surroundings) -> Shift {
    let newtons = around.earth_g * rest.greatest_of(&Matrix3::identity());
    Shift::new(
        ("Earth", "either way, from the worst side"),
        (around.earth_g, newtons),
        sensed,
    )
}
