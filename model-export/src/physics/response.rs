//! The state of a sensor that effects modify, the sensor's transfer function, and the derivatives of its reading
//! with respect to the state.

use nalgebra::{Matrix3, Vector3};

/// Reading and its derivatives, in the sensor's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldResponse {
    /// Reading in gauss.
    pub field_g: Vector3<f64>,
    /// Field at the Hall element, before gain, bias and compression, in gauss.
    pub at_element_g: Vector3<f64>,
    /// With respect to the field at the element.
    pub per_field: Matrix3<f64>,
    /// With respect to the magnet's displacement in G/mm: column j for axis j of the gripper.
    pub per_mm: Matrix3<f64>,
    /// With respect to the magnet's tilt about the gripper's x and z in G/rad.
    pub per_tilt: [Vector3<f64>; 2],
    /// With respect to the relative remanence in gauss.
    pub per_strength: Vector3<f64>,
    /// With respect to the external field: column j for axis j of the gripper.
    pub per_external: Matrix3<f64>,
    /// With respect to the relative gain in gauss: each axis to its own.
    pub per_gain: Vector3<f64>,
    /// With respect to a rotation of the element in G/rad: column j about axis j of the sensor.
    pub per_rotation: Matrix3<f64>,
    /// With respect to the offset.
    pub per_offset: Matrix3<f64>,
    /// With respect to the compression in gauss.
    pub per_compression: Vector3<f64>,
}

impl FieldResponse {
    /// First-order change of the reading between two states.
    pub fn change(&self, from: &PhysicalState, to: &PhysicalState) -> Vector3<f64> {
        let components = from.components().into_iter().zip(to.components()).enumerate();
        // Most effects change few of them: the comparison costs less than the product.
        let changed = components.filter(|(_, (from, to))| from != to);
        changed.fold(Vector3::zeros(), |change, (component, (from, to))| {
            change + self.per_component(component) * (to - from)
        })
    }

    /// Derivative of the reading with respect to a component of the state ([`PhysicalState::components`]), in gauss per its unit.
    pub(crate) fn per_component(&self, component: usize) -> Vector3<f64> {
        let along = |axis: usize| Vector3::ith(axis, self.per_gain[axis]);
        match component {
            0..3 => self.per_mm.column(component).into(),
            3..6 => self.per_external.column(component - 3).into(),
            6..9 => self.per_rotation.column(component - 6).into(),
            9..12 => self.per_offset.column(component - 9).into(),
            12..15 => along(component - 12),
            15 => self.per_tilt[0],
            16 => self.per_tilt[1],
            17 => self.per_strength,
            _ => self.per_compression,
        }
    }
}

/// Reading of the sensor and its derivatives.
pub(crate) struct Reading {
    /// Reading in gauss.
    pub(crate) field_g: Vector3<f64>,
    /// d reading / d field at the element.
    pub(crate) per_field: Matrix3<f64>,
    /// d reading / d offset.
    pub(crate) per_offset: Matrix3<f64>,
    /// d reading / d gain.
    pub(crate) per_gain: Vector3<f64>,
    /// d reading / d rotation.
    pub(crate) per_rotation: Matrix3<f64>,
    /// d reading / d compression.
    pub(crate) per_compression: Vector3<f64>,
}

/// Applies rotation, gain, bias, offset and compression to the field `at_element_g` (sensor's axes). Each axis has its
/// own plate and amplifier, so its compression depends on its reading alone. The rotation is of first order: it is of
/// milliradians.
pub(crate) fn reading_of(
    at_element_g: Vector3<f64>,
    bias_g: Vector3<f64>,
    state: &PhysicalState,
) -> Reading {
    let (turned, linear, loss) = stages_of(at_element_g, bias_g, state);
    let per_offset = Matrix3::from_diagonal(&loss.map(|s| 1.0 - 3.0 * state.compression * s));
    let per_turned = per_offset * Matrix3::from_diagonal(&state.gain);
    Reading {
        field_g: compressed(linear, loss, state),
        per_field: per_turned * (Matrix3::identity() + state.rotation_rad.cross_matrix()),
        per_offset,
        per_gain: per_offset * turned,
        // A rotation w adds w x B, and its derivative to w is -[B]x.
        per_rotation: -per_turned * at_element_g.cross_matrix(),
        per_compression: -linear.component_mul(&loss),
    }
}

/// The field of [`reading_of`] alone.
pub(crate) fn field_of(
    at_element_g: Vector3<f64>,
    bias_g: Vector3<f64>,
    state: &PhysicalState,
) -> Vector3<f64> {
    let (_, linear, loss) = stages_of(at_element_g, bias_g, state);
    compressed(linear, loss, state)
}

/// Field after the rotation, after gain and offsets, and its relative loss per compression.
fn stages_of(
    at_element_g: Vector3<f64>,
    bias_g: Vector3<f64>,
    state: &PhysicalState,
) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let turned = at_element_g + state.rotation_rad.cross(&at_element_g);
    let linear = turned.component_mul(&state.gain) + bias_g + state.offset_g;
    let loss = linear.map(|b| (b / COMPRESSION_REFERENCE_G).powi(2));
    (turned, linear, loss)
}

fn compressed(linear: Vector3<f64>, loss: Vector3<f64>, state: &PhysicalState) -> Vector3<f64> {
    linear.zip_map(&loss, |b, s| b * (1.0 - state.compression * s))
}

/// Field along one axis in gauss at which [`PhysicalState::compression`] is specified.
pub const COMPRESSION_REFERENCE_G: f64 = 1300.0;

/// State of one sensor at one instant. Effects modify the state; the forward model converts it to a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalState {
    /// Displacement of the magnet from its rest position in mm, gripper's axes. (With a base without
    /// geometry: the effective forces in newtons, x and z.)
    pub displacement_mm: Vector3<f64>,
    /// Tilt of the magnet about the gripper's x and z in addition to its mounting tilt, in rad.
    pub extra_tilt_rad: [f64; 2],
    /// Remanence relative to that of the model.
    pub strength: f64,
    /// Field of other sources at the Hall element in gauss, gripper's axes.
    pub external_g: Vector3<f64>,
    /// Gain of each axis of the sensor relative to 1.
    pub gain: Vector3<f64>,
    /// Rotation of the Hall element in addition to its orientation: rotation vector in rad, sensor's axes.
    pub rotation_rad: Vector3<f64>,
    /// Offset of the sensor in addition to its bias in gauss, sensor's axes.
    pub offset_g: Vector3<f64>,
    /// Relative loss of an axis' reading at [`COMPRESSION_REFERENCE_G`]; proportional to the square of the
    /// reading.
    pub compression: f64,
}

impl PhysicalState {
    /// Number of components.
    pub(crate) const COMPONENTS: usize = 19;

    /// Displacement, external field, rotation, offset, gain, tilt, strength, compression.
    pub fn components(&self) -> [f64; Self::COMPONENTS] {
        let [dx, dy, dz] = self.displacement_mm.into();
        let [ex, ey, ez] = self.external_g.into();
        let [rx, ry, rz] = self.rotation_rad.into();
        let [ox, oy, oz] = self.offset_g.into();
        let [gx, gy, gz] = self.gain.into();
        let [tx, tz] = self.extra_tilt_rad;
        let (strength, compression) = (self.strength, self.compression);
        [dx, dy, dz, ex, ey, ez, rx, ry, rz, ox, oy, oz, gx, gy, gz, tx, tz, strength, compression]
    }

    /// The nominal state at this displacement in mm.
    pub fn displaced(displacement_mm: Vector3<f64>) -> Self {
        Self {
            displacement_mm,
            extra_tilt_rad: [0.0; 2],
            strength: 1.0,
            external_g: Vector3::zeros(),
            gain: Vector3::repeat(1.0),
            rotation_rad: Vector3::zeros(),
            offset_g: Vector3::zeros(),
            compression: 0.0,
        }
    }
}
