//! The parameters of the cylinder base: names, tolerances, and how the field answers to each.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use crate::physics::{ForwardModel, Frames, Response};

/// Number of parameters of one sensor.
pub const COUNT: usize = 14;

/// One column of the Jacobian for each parameter, one row for each axis.
pub type Jacobian = SMatrix<f64, 3, COUNT>;
/// Departures from nominal, each in units of its tolerance.
pub type Departures = SVector<f64, COUNT>;

/// One parameter of the cylinder base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name in the model file and in JSON.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// By how much two grippers of one design plausibly differ (one standard deviation): relative
    /// to nominal for stiffness and remanence, in [`Parameter::unit`] for the rest. Assumed.
    pub tolerance: f64,
    /// Whether the tolerance is relative to nominal.
    pub relative: bool,
}

const fn relative(name: &'static str, unit: &'static str, tolerance: f64) -> Parameter {
    Parameter {
        name,
        unit,
        tolerance,
        relative: true,
    }
}

const fn absolute(name: &'static str, unit: &'static str, tolerance: f64) -> Parameter {
    Parameter {
        name,
        unit,
        tolerance,
        relative: false,
    }
}

/// All parameters, in the order of the vectors.
///
/// The tolerances only decide what is held at nominal (see [`super::cylinder`]): a combination
/// that the data know no better than this.
pub const PARAMETERS: [Parameter; COUNT] = [
    // A wire-cut beam's thickness enters with its third power: 0.1 mm of 5 mm is 6 %.
    relative("stiffness_x", "N/mm", 0.10),
    relative("stiffness_z", "N/mm", 0.10),
    // Suppliers give a grade's remanence within about 3 %.
    relative("remanence", "T", 0.03),
    absolute("gap", "mm", 0.1),
    absolute("offset_x", "mm", 0.1),
    absolute("offset_z", "mm", 0.1),
    absolute("tilt_x", "deg", 1.5),
    absolute("tilt_z", "deg", 1.5),
    absolute("rotation_x", "deg", 1.5),
    absolute("rotation_y", "deg", 1.5),
    absolute("rotation_z", "deg", 1.5),
    absolute("bias_x", "G", 5.0),
    absolute("bias_y", "G", 5.0),
    absolute("bias_z", "G", 5.0),
];

/// A model's parameters in their units, in the order of [`PARAMETERS`].
pub fn values(model: &ForwardModel) -> [f64; COUNT] {
    let rotation = model.rotation_rad.map(f64::to_degrees);
    [
        model.stiffness_n_per_mm[0],
        model.stiffness_n_per_mm[1],
        model.remanence_t,
        model.gap_mm,
        model.offset_mm[0],
        model.offset_mm[1],
        model.tilt_rad[0].to_degrees(),
        model.tilt_rad[1].to_degrees(),
        rotation.x,
        rotation.y,
        rotation.z,
        model.bias_g.x,
        model.bias_g.y,
        model.bias_g.z,
    ]
}

/// `model` with these values, in the order of [`PARAMETERS`].
pub fn with_values(model: &ForwardModel, values: &[f64; COUNT]) -> ForwardModel {
    let [
        kx,
        kz,
        remanence_t,
        gap_mm,
        x,
        z,
        ta,
        tc,
        ra,
        rb,
        rc,
        ba,
        bb,
        bc,
    ] = *values;
    ForwardModel {
        stiffness_n_per_mm: [kx, kz],
        remanence_t,
        gap_mm,
        offset_mm: [x, z],
        tilt_rad: [ta.to_radians(), tc.to_radians()],
        rotation_rad: Vector3::new(ra, rb, rc).map(f64::to_radians),
        bias_g: Vector3::new(ba, bb, bc),
        ..*model
    }
}

/// The tolerances in the parameters' units, for this nominal design.
pub fn tolerances(nominal: &ForwardModel) -> [f64; COUNT] {
    let nominal = values(nominal);
    std::array::from_fn(|i| {
        let Parameter {
            tolerance,
            relative,
            ..
        } = PARAMETERS[i];
        if relative {
            tolerance * nominal[i].abs()
        } else {
            tolerance
        }
    })
}

/// `nominal`, departed from by `departures` tolerances.
pub fn depart(nominal: &ForwardModel, departures: &Departures) -> ForwardModel {
    let (start, scale) = (values(nominal), tolerances(nominal));
    let moved = std::array::from_fn(|i| start[i] + scale[i] * departures[i]);
    with_values(nominal, &moved)
}

/// Derivatives of the field to [`Departures`], for many rows of one model.
pub struct Derivatives {
    model: ForwardModel,
    scale: [f64; COUNT],
    frames: Frames,
    /// How the magnet turns about the sensor's axes for each degree of `tilt_x`, `tilt_z`.
    tilts: [Vector3<f64>; 2],
    /// How the reading turns for each degree of `rotation_x`, `_y`, `_z`.
    turns: [Vector3<f64>; 3],
}

impl Derivatives {
    /// Prepares for `model`, a departure from `nominal`.
    pub fn new(model: &ForwardModel, nominal: &ForwardModel) -> Self {
        let frames = model.frames();
        let [x, z] = model.tilt_rad;
        let tilt = Vector3::new(x, 0.0, z);
        let tilts = [Vector3::x(), Vector3::z()].map(|axis| frames.element * spin(tilt, axis));
        let turns =
            [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| spin(model.rotation_rad, axis));
        Self {
            model: *model,
            scale: tolerances(nominal),
            frames,
            tilts,
            turns,
        }
    }

    /// The response under `force_n`, and the derivatives of its field.
    pub fn at(&self, force_n: [f64; 2]) -> (Response, Jacobian) {
        let model = &self.model;
        let displacement = model.displacement(force_n);
        let response = model.respond_in(&self.frames, displacement);
        let [kx, kz] = model.stiffness_n_per_mm;
        let per_mm = &response.per_mm;
        let unbiased = response.unit_field_g * model.remanence_t;
        // A turn of the magnet turns its field, and carries the element to another place in it.
        let [tilt_x, tilt_z] = self.tilts.map(|spin| {
            spin.cross(&unbiased) + self.carried(per_mm, spin.cross(&response.element_mm))
        });
        let [turn_x, turn_y, turn_z] = self.turns.map(|spin| spin.cross(&unbiased));
        let identity: Matrix3<f64> = Matrix3::identity();
        let mut jacobian = Jacobian::from_columns(&[
            per_mm.column(0) * (-displacement.x / kx),
            per_mm.column(2) * (-displacement.z / kz),
            response.unit_field_g,
            per_mm.column(1).into_owned(),
            per_mm.column(0).into_owned(),
            per_mm.column(2).into_owned(),
            tilt_x,
            tilt_z,
            turn_x,
            turn_y,
            turn_z,
            identity.column(0).into_owned(),
            identity.column(1).into_owned(),
            identity.column(2).into_owned(),
        ]);
        for (mut column, scale) in jacobian.column_iter_mut().zip(self.scale) {
            column *= scale;
        }
        (response, jacobian)
    }

    /// `per_mm` takes displacements in the gripper's axes; `move_mm` is in the sensor's.
    fn carried(&self, per_mm: &Matrix3<f64>, move_mm: Vector3<f64>) -> Vector3<f64> {
        per_mm * (self.frames.element.inverse() * move_mm)
    }
}

/// The turn per degree along `axis` of the rotation vector `at`, as a vector to cross with.
fn spin(at: Vector3<f64>, axis: Vector3<f64>) -> Vector3<f64> {
    let step = 1e-5;
    let ahead = Rotation3::from_scaled_axis(at + axis * step);
    let behind = Rotation3::from_scaled_axis(at - axis * step);
    // The antisymmetric part of a small rotation is its vector; its angle by way of the cosine
    // would lose half the digits.
    let between = (ahead * behind.inverse()).into_inner();
    let turned = Vector3::new(
        between[(2, 1)] - between[(1, 2)],
        between[(0, 2)] - between[(2, 0)],
        between[(1, 0)] - between[(0, 1)],
    );
    turned / (4.0 * step) * 1.0_f64.to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recordings::description::Design;
    use proptest::prelude::*;

    fn nominal() -> ForwardModel {
        ForwardModel::nominal(&Design::magpie())
    }

    proptest! {
        #[test]
        fn each_derivative_is_that_of_the_field(
            departures in proptest::array::uniform14(-2.0..2.0_f64),
            fx in -250.0..250.0_f64,
            fz in -250.0..250.0_f64,
        ) {
            let departures = Departures::from(departures);
            let model = depart(&nominal(), &departures);
            let (response, jacobian) = Derivatives::new(&model, &nominal()).at([fx, fz]);
            prop_assert!((response.field_g - model.field([fx, fz])).amax() < 1e-9);
            for i in 0..COUNT {
                let mut step = Departures::zeros();
                step[i] = 1e-4;
                let ahead = depart(&nominal(), &(departures + step)).field([fx, fz]);
                let behind = depart(&nominal(), &(departures - step)).field([fx, fz]);
                let plain = (ahead - behind) / 2e-4;
                let error = (plain - jacobian.column(i)).amax();
                prop_assert!(error < 1e-5 * (1.0 + plain.amax()), "{}: {error}", PARAMETERS[i].name);
            }
        }
    }
}
