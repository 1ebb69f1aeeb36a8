//! The field at one state, and how it answers to a change of each part of that state.

use nalgebra::{Matrix3, Vector3};

use super::state::{COMPRESSION_AT_G, State};

/// Field and derivatives; every vector is in the sensor's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// What the sensor reads, in gauss.
    pub field_g: Vector3<f64>,
    /// The field at its element, before gain, bias and compression, in gauss.
    pub at_element_g: Vector3<f64>,
    /// Answer to a field at the element, sensor's axes.
    pub per_field: Matrix3<f64>,
    /// Answer to a displacement of the magnet in G/mm: column j for axis j of the gripper.
    pub per_mm: Matrix3<f64>,
    /// Answer to a lean of the magnet about the gripper's x and z, in G/rad.
    pub per_lean: [Vector3<f64>; 2],
    /// Answer to the relative remanence, in gauss.
    pub per_strength: Vector3<f64>,
    /// Answer to a field from outside: column j for axis j of the gripper.
    pub per_outside: Matrix3<f64>,
    /// Answer to the relative gain, in gauss.
    pub per_gain: Vector3<f64>,
    /// Answer to an offset.
    pub per_offset: Matrix3<f64>,
    /// Answer to the compression, in gauss.
    pub per_compression: Vector3<f64>,
}

impl Response {
    /// The change of the field, to first order, where the state changes.
    pub fn change(&self, from: &State, to: &State) -> Vector3<f64> {
        let lean = [0, 1].map(|i| self.per_lean[i] * (to.lean_rad[i] - from.lean_rad[i]));
        self.per_mm * (to.displacement_mm - from.displacement_mm)
            + lean[0]
            + lean[1]
            + self.per_strength * (to.strength - from.strength)
            + self.per_outside * (to.outside_g - from.outside_g)
            + self.per_gain * (to.gain - from.gain)
            + self.per_offset * (to.offset_g - from.offset_g)
            + self.per_compression * (to.compression - from.compression)
    }
}

/// What the sensor makes of the field at its element.
pub(crate) struct Reading {
    /// In gauss.
    pub(crate) field_g: Vector3<f64>,
    /// d reading / d field at the element, sensor's axes.
    pub(crate) per_field: Matrix3<f64>,
    /// d reading / d offset.
    pub(crate) per_offset: Matrix3<f64>,
    /// d reading / d gain.
    pub(crate) per_gain: Vector3<f64>,
    /// d reading / d compression.
    pub(crate) per_compression: Vector3<f64>,
}

/// Gain, bias, offset and compression of a sensor in the field `at_element_g` (sensor's axes). Each axis
/// has a plate and an amplifier of its own, and is compressed by what it reads itself.
pub(crate) fn read(at_element_g: Vector3<f64>, bias_g: Vector3<f64>, state: &State) -> Reading {
    let full = at_element_g * state.gain + bias_g + state.offset_g;
    let share = full.map(|b| (b / COMPRESSION_AT_G).powi(2));
    let per_offset = Matrix3::from_diagonal(&share.map(|s| 1.0 - 3.0 * state.compression * s));
    Reading {
        field_g: full.zip_map(&share, |b, s| b * (1.0 - state.compression * s)),
        per_field: per_offset * state.gain,
        per_offset,
        per_gain: per_offset * at_element_g,
        per_compression: -full.component_mul(&share),
    }
}
