//! The parameters of the cylinder base: names, tolerances, and how the field answers to each.

use nalgebra::{SMatrix, Vector3};

use crate::physics::sensor::spin;
use crate::physics::{ForwardModel, Frames, Response, State};

/// A degree in rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Number of parameters of one sensor.
pub const COUNT: usize = 14;

/// The parameters before this one are the stiffnesses: they act through the state alone.
pub const FIRST_OF_GEOMETRY: usize = 2;

/// One column of the Jacobian for each parameter, one row for each axis.
pub type Jacobian = SMatrix<f64, 3, COUNT>;

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
/// The tolerances only decide what is held at nominal (see [`super::space`]): a combination
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

/// Tolerance of the parameter of that name, as it stands in [`PARAMETERS`]; none of others.
pub fn tolerance(name: &str) -> f64 {
    let parameter = PARAMETERS.iter().find(|parameter| parameter.name == name);
    parameter.map_or(0.0, |parameter| parameter.tolerance)
}

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

/// Derivatives of the field to the parameters, in their units, for many rows of one model.
pub struct Derivatives {
    model: ForwardModel,
    frames: Frames,
    /// How the reading turns for each degree of `rotation_x`, `_y`, `_z`.
    turns: [Vector3<f64>; 3],
}

impl Derivatives {
    /// Prepares for `model`.
    pub fn new(model: &ForwardModel) -> Self {
        let turns = [Vector3::x(), Vector3::y(), Vector3::z()]
            .map(|axis| spin(model.rotation_rad, axis) * DEGREE);
        Self {
            model: *model,
            frames: model.frames(),
            turns,
        }
    }

    /// The response at `state`, and the derivatives of its field. The stiffnesses act through the
    /// state alone: their columns are zero here and are filled by who made the state.
    pub fn at(&self, state: &State) -> (Response, Jacobian) {
        let response = self.model.respond_in(&self.frames, state);
        let per_mm = &response.per_mm;
        let [turn_x, turn_y, turn_z] = self
            .turns
            .map(|spin| response.per_field * spin.cross(&response.at_element_g));
        let [tilt_x, tilt_z] = response.per_lean.map(|lean| lean * DEGREE);
        let none = Vector3::zeros();
        let per_tesla = response.per_strength * (state.strength / self.model.remanence_t);
        let jacobian = Jacobian::from_columns(&[
            none,
            none,
            per_tesla,
            per_mm.column(1).into_owned(),
            per_mm.column(0).into_owned(),
            per_mm.column(2).into_owned(),
            tilt_x,
            tilt_z,
            turn_x,
            turn_y,
            turn_z,
            response.per_offset.column(0).into_owned(),
            response.per_offset.column(1).into_owned(),
            response.per_offset.column(2).into_owned(),
        ]);
        (response, jacobian)
    }
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
            let (start, scale) = (values(&nominal()), tolerances(&nominal()));
            let at = |i: usize, by: f64| {
                let mut moved: [f64; COUNT] = std::array::from_fn(|i| start[i] + departures[i] * scale[i]);
                moved[i] += by * scale[i];
                with_values(&nominal(), &moved)
            };
            let model = at(0, 0.0);
            let state = State::displaced(model.displacement([fx, fz]));
            let (response, jacobian) = Derivatives::new(&model).at(&state);
            prop_assert!((response.field_g - model.field([fx, fz])).amax() < 1e-9);
            for i in FIRST_OF_GEOMETRY..COUNT {
                let (ahead, behind) = (at(i, 1e-4).field([fx, fz]), at(i, -1e-4).field([fx, fz]));
                let plain = (ahead - behind) / (2e-4 * scale[i]);
                let error = (plain - jacobian.column(i)).amax() * scale[i];
                prop_assert!(error < 1e-5 * (1.0 + plain.amax() * scale[i]), "{}: {error}", PARAMETERS[i].name);
            }
        }
    }
}
