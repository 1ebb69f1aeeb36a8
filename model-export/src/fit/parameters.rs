//! Free parameters of a fit, and those of the cylinder model with their priors and Jacobian.

use crate::effects::{EffectParameter, ParameterKind};
use crate::physics::sensor::rotation_derivative;
use crate::physics::{FieldResponse, ForwardModel, PhysicalState};
use nalgebra::Vector3;

/// A degree in rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Number of parameters of the cylinder model.
pub const COUNT: usize = 14;

/// Index of the first geometric parameter; those before are stiffnesses and act through the state alone.
pub(crate) const FIRST_OF_GEOMETRY: usize = 2;

/// One parameter of the cylinder base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CylinderParameter {
    /// Name in the model file and in JSON.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Standard deviation between grippers of one design: relative to nominal for stiffness and remanence, in
    /// [`CylinderParameter::unit`] for the rest. Assumed.
    pub tolerance: f64,
    /// Whether the tolerance is relative to nominal.
    pub relative: bool,
}

const fn relative(name: &'static str, unit: &'static str, tolerance: f64) -> CylinderParameter {
    CylinderParameter { name, unit, tolerance, relative: true }
}

const fn absolute(name: &'static str, unit: &'static str, tolerance: f64) -> CylinderParameter {
    CylinderParameter { name, unit, tolerance, relative: false }
}

/// All parameters in the order of the vectors.
///
/// The tolerances decide which combinations stay at nominal (see `fit/identifiability.rs`).
pub const PARAMETERS: [CylinderParameter; COUNT] = [
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

/// Tolerance of the parameter `name` in [`PARAMETERS`]; zero for others.
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
    let [kx, kz, remanence_t, gap_mm, x, z, ta, tc, ra, rb, rc, ba, bb, bc] = *values;
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

/// Prior widths in the parameters' units, for this nominal design.
pub fn tolerances(nominal: &ForwardModel) -> [f64; COUNT] {
    let nominal = values(nominal);
    std::array::from_fn(|i| {
        let CylinderParameter { tolerance, relative, .. } = PARAMETERS[i];
        if relative { tolerance * nominal[i].abs() } else { tolerance }
    })
}

/// Derivatives of the field to the parameters, in their units, for many states of one model.
pub struct Derivatives {
    remanence_t: f64,
    /// Change of the reading per degree of `rotation_x`, `_y`, `_z`.
    turns: [Vector3<f64>; 3],
}

impl Derivatives {
    /// Prepares for `model`.
    pub fn new(model: &ForwardModel) -> Self {
        let turns = [Vector3::x(), Vector3::y(), Vector3::z()]
            .map(|axis| rotation_derivative(model.rotation_rad, axis) * DEGREE);
        Self { remanence_t: model.remanence_t, turns }
    }

    /// Derivative to each parameter at `state`, from the model's response there. Those to the stiffnesses are zero: they act
    /// through the state.
    pub fn columns(
        &self,
        state: &PhysicalState,
        response: &FieldResponse,
    ) -> [Vector3<f64>; COUNT] {
        let per_mm = &response.per_mm;
        let [turn_x, turn_y, turn_z] =
            self.turns.map(|spin| response.per_field * spin.cross(&response.at_element_g));
        let [tilt_x, tilt_z] = response.per_tilt.map(|per_rad| per_rad * DEGREE);
        let none = Vector3::zeros();
        let per_tesla = response.per_strength * (state.strength / self.remanence_t);
        [
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
        ]
    }
}

/// Prior width of a coefficient, in typical values.
const PRIOR_WIDTH: f64 = 10.0;
/// Minimum prior width of a shape, relative.
const MIN_SHAPE_WIDTH: f64 = 0.1;

/// A parameter of one sensor. Its scaled value is the deviation from its start in prior widths.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeParameter {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Value at which the scaled value is zero.
    pub start: f64,
    /// Prior width; of the logarithm where `relative`.
    pub scale: f64,
    /// Whether the parameter is a positive shape, scaled logarithmically.
    pub relative: bool,
    /// Limits of the value; beyond, the field does not depend on it.
    pub limits: Option<(f64, f64)>,
    /// Whether it is the initial state of a memory.
    pub is_state: bool,
    /// Index of the only recording whose field depends on it, if there is one.
    pub recording: Option<usize>,
    /// Whether all sensors share the value.
    pub shared: bool,
    /// Whether each fold refits it from its start: true for coefficients and the base. Shapes and initial
    /// states start from the fit of the whole campaign.
    pub refit_per_fold: bool,
    /// Standard error in prior widths of a value that was selected by cross-validation and stays fixed.
    pub preset_sigma: Option<f64>,
}

impl FreeParameter {
    /// From the parameter of an effect.
    pub fn of(parameter: &EffectParameter) -> Self {
        let (start, scale, relative) = match &parameter.kind {
            // Replaced by the search for initial values.
            ParameterKind::Coefficient if parameter.typical.is_nan() => (0.0, 1.0, false),
            ParameterKind::Coefficient => (0.0, PRIOR_WIDTH * parameter.typical.abs(), false),
            ParameterKind::InitialState => (0.0, parameter.typical, false),
            ParameterKind::Instant => (0.0, 0.5, false),
            ParameterKind::Shape { grid } => {
                let (first, last) = (grid[0], grid[grid.len() - 1]);
                let step = (last / first).ln() / (grid.len() - 1) as f64;
                if first > 0.0 {
                    (grid[grid.len() / 2], step.max(MIN_SHAPE_WIDTH), true)
                } else {
                    (grid[grid.len() / 2], (last - first) / (grid.len() - 1) as f64, false)
                }
            }
        };
        Self {
            name: parameter.name.to_string(),
            unit: parameter.unit.to_string(),
            start,
            scale,
            relative,
            limits: parameter.limits,
            is_state: parameter.kind == ParameterKind::InitialState,
            recording: parameter.recording,
            shared: parameter.shared,
            refit_per_fold: parameter.is_coefficient(),
            preset_sigma: None,
        }
    }

    /// Value in its unit.
    pub fn value(&self, scaled: f64) -> f64 {
        let value = if self.relative {
            self.start * libm::exp(self.scale * scaled)
        } else {
            self.start + self.scale * scaled
        };
        self.limits.map_or(value, |(low, high)| value.clamp(low, high))
    }

    /// Scaled value of a value.
    pub fn to_scaled(&self, value: f64) -> f64 {
        if self.relative {
            (value / self.start).ln() / self.scale
        } else {
            (value - self.start) / self.scale
        }
    }

    /// The scaled value, within its limits.
    pub(crate) fn within_limits(&self, scaled: f64) -> f64 {
        if self.limits.is_some() { self.to_scaled(self.value(scaled)) } else { scaled }
    }

    /// Whether the value is nearer to its upper limit: there a derivative is taken downwards, since the field does not change beyond.
    pub(crate) fn is_near_upper_limit(&self, scaled: f64) -> bool {
        self.limits
            .is_some_and(|(low, high)| scaled > 0.5 * (self.to_scaled(low) + self.to_scaled(high)))
    }

    /// Derivative of the value to the scaled value.
    pub(crate) fn derivative(&self, scaled: f64) -> f64 {
        if self.relative { self.scale * self.value(scaled) } else { self.scale }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recordings::description::NominalDesign;
    use proptest::prelude::*;

    #[test]
    fn a_limited_shape_stays_within_its_limits() {
        let shape = EffectParameter::shape("time", "s", &[0.5, 1.0, 2.0]).within(0.2, 500.0);
        let free = FreeParameter::of(&shape);
        assert_eq!([free.value(-50.0), free.value(50.0)], [0.2, 500.0]);
        assert!((free.value(free.within_limits(-50.0)) - 0.2).abs() < 1e-12);
        let scaled = free.to_scaled(3.0);
        assert!((free.within_limits(scaled) - scaled).abs() < 1e-12);
        // Their geometric mean is 10 s.
        let is_near = |value: f64| free.is_near_upper_limit(free.to_scaled(value));
        assert!(!is_near(9.0) && is_near(11.0));
    }

    fn nominal() -> ForwardModel {
        ForwardModel::nominal(&NominalDesign::magpie())
    }

    proptest! {
        #[test]
        fn derivatives_equal_finite_differences_of_the_field(
            scaled in proptest::array::uniform14(-2.0..2.0_f64),
            fx in -250.0..250.0_f64,
            fz in -250.0..250.0_f64,
        ) {
            let (start, scale) = (values(&nominal()), tolerances(&nominal()));
            let at = |i: usize, by: f64| {
                let mut moved: [f64; COUNT] = std::array::from_fn(|i| start[i] + scaled[i] * scale[i]);
                moved[i] += by * scale[i];
                with_values(&nominal(), &moved)
            };
            let model = at(0, 0.0);
            let state = PhysicalState::displaced(model.displacement([fx, fz]));
            let response = model.response_at(&model.frames(), &state);
            let columns = Derivatives::new(&model).columns(&state, &response);
            prop_assert!((response.field_g - model.field([fx, fz])).amax() < 1e-9);
            for i in FIRST_OF_GEOMETRY..COUNT {
                let (ahead, behind) = (at(i, 1e-4).field([fx, fz]), at(i, -1e-4).field([fx, fz]));
                let plain = (ahead - behind) / (2e-4 * scale[i]);
                let error = (plain - columns[i]).amax() * scale[i];
                prop_assert!(error < 1e-5 * (1.0 + plain.amax() * scale[i]), "{}: {error}", PARAMETERS[i].name);
            }
        }
    }
}
