//! Base models of the field: the exact cylinder magnet, or a polynomial of the forces where the geometry is
//! unknown.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use crate::fit::parameters::{
    COUNT, Derivatives, FIRST_OF_GEOMETRY, FreeParameter, PARAMETERS, tolerances, values,
    with_values,
};
use crate::fit::polynomial::Polynomial;
use crate::physics::sensor::CYLINDER_WEIGHTS;
use crate::physics::{FieldResponse, ForwardModel, PhysicalState};
use crate::recordings::columns::Axis;

/// Base model of the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BaseKind {
    /// Closed-form magnet on two flexures.
    Cylinder,
    /// Polynomial of the forces.
    Polynomial,
}

/// The base of one sensor's model, as a fit sees it.
pub trait BaseModel: Send + Sync {
    /// Free parameters with start and prior width.
    fn parameters(&self) -> Vec<FreeParameter>;

    /// Number of leading parameters that act through the state alone: the stiffnesses.
    fn stiffness_count(&self) -> usize;

    /// Number of leading parameters that are a pure sensor offset plus ambient field; zero where a magnet's
    /// field is included or they have a prior of their own.
    fn offset_count(&self) -> usize {
        0
    }

    /// Stiffness of both flexures in N/mm; 1 where displacements are forces.
    fn stiffness(&self, values: &[f64]) -> [f64; 2];

    /// Weights of the field axes in the inversion from field to forces.
    fn inverse_weights(&self) -> Vector3<f64>;

    /// The field in gauss at each of many states.
    fn fields(&self, values: &[f64], states: &[PhysicalState]) -> Vec<Vector3<f64>>;

    /// The response at each of many states.
    fn responses(&self, values: &[f64], states: &[PhysicalState]) -> Vec<FieldResponse>;

    /// Calls `each` with the response at each of many states, and with the derivative of the field to each base parameter.
    fn linearise(
        &self,
        values: &[f64],
        states: &[PhysicalState],
        each: &mut dyn FnMut(FieldResponse, &[Vector3<f64>]),
    );
}

/// Exact cylinder magnet on two flexures, parametrised around a nominal design.
#[derive(Clone, Copy, Debug)]
pub struct CylinderBase {
    /// The design.
    pub nominal: ForwardModel,
}

impl CylinderBase {
    /// The forward model of these values.
    pub fn model(&self, found: &[f64]) -> ForwardModel {
        let mut all = values(&self.nominal);
        all.iter_mut().zip(found).for_each(|(to, from)| *to = *from);
        with_values(&self.nominal, &all)
    }
}

impl BaseModel for CylinderBase {
    fn parameters(&self) -> Vec<FreeParameter> {
        let (start, scale) = (values(&self.nominal), tolerances(&self.nominal));
        let index = |i: usize| FreeParameter {
            name: PARAMETERS[i].name.to_owned(),
            unit: PARAMETERS[i].unit.to_owned(),
            start: start[i],
            scale: scale[i],
            relative: false,
            shared: false,
            refit_per_fold: true,
            limits: None,
            is_state: false,
            recording: None,
            preset_sigma: None,
        };
        (0..COUNT).map(index).collect()
    }

    fn stiffness_count(&self) -> usize {
        FIRST_OF_GEOMETRY
    }

    fn stiffness(&self, values: &[f64]) -> [f64; 2] {
        [values[0], values[1]]
    }

    fn inverse_weights(&self) -> Vector3<f64> {
        CYLINDER_WEIGHTS
    }

    fn fields(&self, values: &[f64], states: &[PhysicalState]) -> Vec<Vector3<f64>> {
        let model = self.model(values);
        model.fields_at(&model.frames(), states)
    }

    fn responses(&self, values: &[f64], states: &[PhysicalState]) -> Vec<FieldResponse> {
        let model = self.model(values);
        model.responses_at(&model.frames(), states)
    }

    fn linearise(
        &self,
        values: &[f64],
        states: &[PhysicalState],
        each: &mut dyn FnMut(FieldResponse, &[Vector3<f64>]),
    ) {
        let derivatives = Derivatives::new(&self.model(values));
        for (state, response) in states.iter().zip(self.responses(values, states)) {
            let columns = derivatives.columns(state, &response);
            each(response, &columns[..values.len()]);
        }
    }
}

/// Polynomial of the forces for each field axis: displacements are forces in newtons here.
#[derive(Clone, Debug, PartialEq)]
pub struct PolynomialBase {
    polynomial: Polynomial,
    /// Gripper axis (0, 1, 2) of each force.
    axes: Vec<usize>,
    /// Width of the prior of a coefficient in gauss.
    width_g: f64,
}

impl PolynomialBase {
    /// Parametrised around a fitted polynomial whose field spans `width_g`; `None` where several forces act
    /// along one axis, since effects could not be assigned.
    pub fn new(polynomial: Polynomial, width_g: f64) -> Option<Self> {
        let axis = |force: &(u32, Axis)| match force.1 {
            Axis::X => Some(0),
            Axis::Z => Some(2),
            Axis::Y => None,
        };
        let axes: Vec<usize> = polynomial.forces.iter().map(axis).collect::<Option<_>>()?;
        let distinct = axes.iter().enumerate().all(|(i, axis)| !axes[..i].contains(axis));
        distinct.then_some(Self { polynomial, axes, width_g })
    }

    /// The polynomial with these coefficients.
    pub fn model(&self, values: &[f64]) -> Polynomial {
        let mut polynomial = self.polynomial.clone();
        for (i, value) in values.iter().enumerate().take(polynomial.coefficients_g.len()) {
            polynomial.coefficients_g[(i / 3, i % 3)] = *value;
        }
        polynomial
    }

    fn forces(axes: &[usize], state: &PhysicalState) -> Vec<f64> {
        axes.iter().map(|&axis| state.displacement_mm[axis]).collect()
    }
}

impl BaseModel for PolynomialBase {
    fn parameters(&self) -> Vec<FreeParameter> {
        let terms = self.polynomial.coefficients_g.nrows();
        let index = |i: usize| FreeParameter {
            name: format!("term_{}_{}", i / 3, ["x", "y", "z"][i % 3]),
            unit: "G".to_owned(),
            start: self.polynomial.coefficients_g[(i / 3, i % 3)],
            scale: self.width_g,
            relative: false,
            shared: false,
            refit_per_fold: true,
            limits: None,
            is_state: false,
            recording: None,
            preset_sigma: None,
        };
        (0..3 * terms).map(index).collect()
    }

    fn stiffness_count(&self) -> usize {
        0
    }

    fn offset_count(&self) -> usize {
        // Without forces the first three parameters are constants.
        if self.axes.is_empty() { 3 } else { 0 }
    }

    fn stiffness(&self, _: &[f64]) -> [f64; 2] {
        [1.0; 2]
    }

    fn inverse_weights(&self) -> Vector3<f64> {
        Vector3::repeat(1.0)
    }

    fn fields(&self, values: &[f64], states: &[PhysicalState]) -> Vec<Vector3<f64>> {
        let model = self.model(values);
        let basis = model.basis();
        let field = |state: &PhysicalState| {
            let clean = model.combine(&basis.values(&Self::forces(&self.axes, state)));
            crate::physics::response::field_of(clean + state.external_g, Vector3::zeros(), state)
        };
        states.iter().map(field).collect()
    }

    fn responses(&self, values: &[f64], states: &[PhysicalState]) -> Vec<FieldResponse> {
        let mut responses = Vec::with_capacity(states.len());
        self.linearise(values, states, &mut |response, _| responses.push(response));
        responses
    }

    fn linearise(
        &self,
        values: &[f64],
        states: &[PhysicalState],
        each: &mut dyn FnMut(FieldResponse, &[Vector3<f64>]),
    ) {
        let model = self.model(values);
        let basis = model.basis();
        let mut columns = vec![Vector3::zeros(); values.len()];
        for state in states {
            let at = basis.linearise(&Self::forces(&self.axes, state));
            let at_element_g = model.combine(&at.values) + state.external_g;
            let reading =
                crate::physics::response::reading_of(at_element_g, Vector3::zeros(), state);
            let mut per_mm = Matrix3::zeros();
            for (&axis, slopes) in self.axes.iter().zip(&at.per_newton) {
                per_mm.set_column(axis, &(reading.per_field * model.combine(slopes)));
            }
            for (i, value) in at.values.into_iter().enumerate() {
                for axis in 0..3 {
                    if let Some(column) = columns.get_mut(3 * i + axis) {
                        *column = reading.per_field.column(axis) * value;
                    }
                }
            }
            let response = FieldResponse {
                field_g: reading.field_g,
                at_element_g,
                per_field: reading.per_field,
                per_mm,
                per_tilt: [Vector3::zeros(); 2],
                per_strength: Vector3::zeros(),
                per_external: reading.per_field,
                per_gain: reading.per_gain,
                per_rotation: reading.per_rotation,
                per_offset: reading.per_offset,
                per_compression: reading.per_compression,
            };
            each(response, &columns);
        }
    }
}
