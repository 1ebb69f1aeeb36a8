//! What acts on one sensor at one instant, beside its own geometry.
//!
//! Effects never touch the magnet's formula: they change this, and the forward model turns it into
//! a field.

use nalgebra::Vector3;

/// Field along one axis in gauss at which [`State::compression`] is stated.
pub const COMPRESSION_AT_G: f64 = 1300.0;

/// The state of one sensor at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Displacement of the magnet from its rest in mm, gripper's axes. (With a base that knows no
    /// geometry: the effective forces in newtons, x and z.)
    pub displacement_mm: Vector3<f64>,
    /// The magnet leans by this about the gripper's x and z, beyond its tilt, in rad.
    pub lean_rad: [f64; 2],
    /// Remanence relative to that of the model.
    pub strength: f64,
    /// Fields of other sources at the Hall element in gauss, gripper's axes.
    pub outside_g: Vector3<f64>,
    /// Gain of the sensor relative to 1.
    pub gain: f64,
    /// Offset of the sensor beyond its bias in gauss, sensor's axes.
    pub offset_g: Vector3<f64>,
    /// Share of an axis' reading that is lost where it is [`COMPRESSION_AT_G`]; the loss grows with the
    /// square of the reading.
    pub compression: f64,
}

impl State {
    /// Displaced, and nothing else.
    pub fn displaced(displacement_mm: Vector3<f64>) -> Self {
        Self {
            displacement_mm,
            lean_rad: [0.0; 2],
            strength: 1.0,
            outside_g: Vector3::zeros(),
            gain: 1.0,
            offset_g: Vector3::zeros(),
            compression: 0.0,
        }
    }
}
