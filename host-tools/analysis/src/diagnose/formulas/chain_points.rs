//! Points of the chain from force to field at which a formula can act, and the response of the field to each.

use model_export::fit::campaign::FitSetup;
use model_export::physics::FieldResponse;
use model_export::recordings::columns::Axis;
use nalgebra::{Matrix3, Vector3};

/// A point of the chain. Its name is the target of a formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChainPoint {
    /// Force on a flexure in N, without geometry: axis 0 or 2.
    Force(usize),
    /// Displacement of the magnet in micrometres.
    Displacement(usize),
    /// Compliance of a flexure: a displacement in micrometres in proportion to its force.
    Compliance(usize),
    /// External field in gauss.
    Field(usize),
    /// Gain of all axes in percent.
    Gain,
    /// Gain of one axis in percent.
    AxisGain(usize),
    /// Rotation of the Hall element in mrad.
    Rotation(usize),
    /// Tilt of the magnet in mrad: axis 0 or 2.
    Tilt(usize),
}

use ChainPoint::{AxisGain, Compliance, Displacement, Field, Force, Gain, Rotation, Tilt};

/// Points of a base with geometry.
const WITH_GEOMETRY: [ChainPoint; 17] = [
    Displacement(0),
    Displacement(1),
    Displacement(2),
    Compliance(0),
    Compliance(2),
    Field(0),
    Field(1),
    Field(2),
    Gain,
    AxisGain(0),
    AxisGain(1),
    AxisGain(2),
    Rotation(0),
    Rotation(1),
    Rotation(2),
    Tilt(0),
    Tilt(2),
];

/// Points of a polynomial of the forces.
const WITHOUT_GEOMETRY: [ChainPoint; 9] =
    [Force(0), Force(2), Field(0), Field(1), Field(2), Gain, AxisGain(0), AxisGain(1), AxisGain(2)];

/// Points at which one cause acts together, with a coefficient each.
const VECTORS: [&[ChainPoint]; 5] = [
    &[Field(0), Field(1), Field(2)],
    &[Displacement(0), Displacement(1), Displacement(2)],
    &[Compliance(0), Compliance(2)],
    &[AxisGain(0), AxisGain(1), AxisGain(2)],
    &[Rotation(0), Rotation(1), Rotation(2)],
];

impl ChainPoint {
    /// Points of a base with or without geometry; `axes`: whether a lateral and a longitudinal force were recorded. Without either, the
    /// base is a constant, and a gain acts as a field does.
    pub fn all(has_geometry: bool, axes: [bool; 2]) -> Vec<Self> {
        let points: &[Self] = if has_geometry { &WITH_GEOMETRY } else { &WITHOUT_GEOMETRY };
        let is_constant = !has_geometry && axes == [false; 2];
        let is_possible = |point: &Self| match point {
            Force(axis) => axes[axis / 2],
            Gain | AxisGain(_) => !is_constant,
            _ => true,
        };
        points.iter().copied().filter(is_possible).collect()
    }

    /// Points of a setup, and whether a lateral and a longitudinal force were recorded in it.
    pub fn of(setup: &FitSetup) -> (Vec<Self>, [bool; 2]) {
        let forces = || setup.rows.iter().flat_map(|rows| &rows.forces);
        let axes = [Axis::X, Axis::Z].map(|axis| forces().any(|(_, own)| *own == axis));
        (Self::all(setup.design.is_some(), axes), axes)
    }

    /// Sets of several points of `points`.
    pub fn vectors(points: &[Self]) -> Vec<Vec<Self>> {
        let all = VECTORS.iter().filter(|set| set.iter().all(|point| points.contains(point)));
        all.map(|set| set.to_vec()).collect()
    }

    /// Target of a formula, and the covariate by which it is multiplied.
    pub fn target(self) -> (&'static str, Option<&'static str>) {
        let by_axis = |names: [&'static str; 3], axis: usize| names[axis.min(2)];
        match self {
            Force(axis) => (by_axis(["fx_n", "fx_n", "fz_n"], axis), None),
            Displacement(axis) => (by_axis(["dx_um", "dy_um", "dz_um"], axis), None),
            Compliance(axis) => (
                by_axis(["dx_um", "dx_um", "dz_um"], axis),
                Some(by_axis(["fx_n", "fx_n", "fz_n"], axis)),
            ),
            Field(axis) => (by_axis(["bx_g", "by_g", "bz_g"], axis), None),
            Gain => ("gain_percent", None),
            AxisGain(axis) => {
                (by_axis(["gain_x_percent", "gain_y_percent", "gain_z_percent"], axis), None)
            }
            Rotation(axis) => {
                (by_axis(["rotation_x_mrad", "rotation_y_mrad", "rotation_z_mrad"], axis), None)
            }
            Tilt(axis) => (by_axis(["tilt_x_mrad", "tilt_x_mrad", "tilt_z_mrad"], axis), None),
        }
    }

    /// Change of the field in gauss per unit of this point.
    pub fn pattern(
        self,
        response: &FieldResponse,
        force_n: [f64; 2],
        stiffness: [f64; 2],
    ) -> Vector3<f64> {
        let column = |matrix: &Matrix3<f64>, axis: usize| matrix.column(axis).into_owned();
        match self {
            Force(axis) => column(&response.per_mm, axis) / stiffness[axis / 2],
            Displacement(axis) => column(&response.per_mm, axis) * 1e-3,
            Compliance(axis) => column(&response.per_mm, axis) * (1e-3 * force_n[axis / 2]),
            Field(axis) => column(&response.per_external, axis),
            Gain => response.per_gain * 0.01,
            AxisGain(axis) => {
                let mut along = Vector3::zeros();
                along[axis] = 0.01 * response.per_gain[axis];
                along
            }
            Rotation(axis) => column(&response.per_rotation, axis) * 1e-3,
            Tilt(axis) => response.per_tilt[axis / 2] * 1e-3,
        }
    }
}
