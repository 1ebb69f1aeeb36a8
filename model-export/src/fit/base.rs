//! What the field is computed from: the exact cylinder, or a polynomial where no geometry is known.

use nalgebra::{Matrix3, Vector3};

use super::parameters::{
    COUNT, Derivatives, FIRST_OF_GEOMETRY, PARAMETERS, tolerances, values, with_values,
};
use super::polynomial::Polynomial;
use super::slot::Slot;
use crate::physics::{ForwardModel, Response, State};
use crate::recordings::columns::Axis;

/// Field at a state.
pub type FieldAt<'a> = Box<dyn Fn(&State) -> Vector3<f64> + 'a>;
/// Response at a state, and the field's derivative to each of the base's values.
pub type LinearAt<'a> = Box<dyn Fn(&State, &mut [Vector3<f64>]) -> Response + 'a>;

/// The base of one sensor's model, as a fit sees it.
pub trait Base: Sync {
    /// Its parameters.
    fn slots(&self) -> Vec<Slot>;

    /// The first this many act through the state alone: the stiffnesses.
    fn mechanical(&self) -> usize;

    /// The first this many are nothing but the sensor's own offset and whatever field stands around it;
    /// none where a magnet's field is in them or where they have a prior of their own.
    fn offsets(&self) -> usize {
        0
    }

    /// Stiffness of both flexures in N/mm; 1 where forces take the place of displacements.
    fn stiffness(&self, values: &[f64]) -> [f64; 2];

    /// The field, for many states of one set of values.
    fn field(&self, values: &[f64]) -> FieldAt<'_>;

    /// The response, for many states of one set of values.
    fn linear(&self, values: &[f64]) -> LinearAt<'_>;
}

/// The exact cylinder on two flexures, departing from a nominal design.
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

impl Base for CylinderBase {
    fn slots(&self) -> Vec<Slot> {
        let (start, scale) = (values(&self.nominal), tolerances(&self.nominal));
        let slot = |i: usize| Slot {
            name: PARAMETERS[i].name.to_owned(),
            unit: PARAMETERS[i].unit.to_owned(),
            start: start[i],
            scale: scale[i],
            relative: false,
            shared: false,
            from_scratch: true,
            chosen: None,
        };
        (0..COUNT).map(slot).collect()
    }

    fn mechanical(&self) -> usize {
        FIRST_OF_GEOMETRY
    }

    fn stiffness(&self, values: &[f64]) -> [f64; 2] {
        [values[0], values[1]]
    }

    fn field(&self, values: &[f64]) -> FieldAt<'_> {
        let model = self.model(values);
        let frames = model.frames();
        Box::new(move |state| model.field_in(&frames, state))
    }

    fn linear(&self, values: &[f64]) -> LinearAt<'_> {
        let derivatives = Derivatives::new(&self.model(values));
        Box::new(move |state, columns| {
            let (response, jacobian) = derivatives.at(state);
            for (to, from) in columns.iter_mut().zip(jacobian.column_iter()) {
                *to = from.into_owned();
            }
            response
        })
    }
}

/// A polynomial of the forces, each axis on its own: displacements are forces in newtons here.
#[derive(Clone, Debug)]
pub struct PolynomialBase {
    polynomial: Polynomial,
    /// Which of the gripper's axes each force lies along.
    axes: Vec<usize>,
    /// Width of the prior of a coefficient in gauss.
    width_g: f64,
}

impl PolynomialBase {
    /// Departing from a fitted polynomial whose field spans `width_g`; `None` where more than one
    /// force acts along an axis, since an effect would not know which it belongs to.
    pub fn new(polynomial: Polynomial, width_g: f64) -> Option<Self> {
        let axis = |force: &(u32, Axis)| match force.1 {
            Axis::X => Some(0),
            Axis::Z => Some(2),
            Axis::Y => None,
        };
        let axes: Vec<usize> = polynomial.forces.iter().map(axis).collect::<Option<_>>()?;
        let distinct = axes
            .iter()
            .enumerate()
            .all(|(i, axis)| !axes[..i].contains(axis));
        distinct.then_some(Self {
            polynomial,
            axes,
            width_g,
        })
    }

    /// The polynomial of these values.
    pub fn model(&self, values: &[f64]) -> Polynomial {
        let mut polynomial = self.polynomial.clone();
        for (i, value) in values
            .iter()
            .enumerate()
            .take(polynomial.coefficients_g.len())
        {
            polynomial.coefficients_g[(i / 3, i % 3)] = *value;
        }
        polynomial
    }

    fn forces(axes: &[usize], state: &State) -> Vec<f64> {
        axes.iter()
            .map(|&axis| state.displacement_mm[axis])
            .collect()
    }
}

impl Base for PolynomialBase {
    fn slots(&self) -> Vec<Slot> {
        let terms = self.polynomial.coefficients_g.nrows();
        let slot = |i: usize| Slot {
            name: format!("term_{}_{}", i / 3, ["x", "y", "z"][i % 3]),
            unit: "G".to_owned(),
            start: self.polynomial.coefficients_g[(i / 3, i % 3)],
            scale: self.width_g,
            relative: false,
            shared: false,
            from_scratch: true,
            chosen: None,
        };
        (0..3 * terms).map(slot).collect()
    }

    fn mechanical(&self) -> usize {
        0
    }

    fn offsets(&self) -> usize {
        // Without a force nothing pushes a magnet about; the constants are the three first slots.
        if self.axes.is_empty() { 3 } else { 0 }
    }

    fn stiffness(&self, _: &[f64]) -> [f64; 2] {
        [1.0; 2]
    }

    fn field(&self, values: &[f64]) -> FieldAt<'_> {
        let model = self.model(values);
        Box::new(move |state| {
            let clean = model.field(&Self::forces(&self.axes, state));
            crate::physics::response::read(clean + state.outside_g, Vector3::zeros(), state).field_g
        })
    }

    fn linear(&self, values: &[f64]) -> LinearAt<'_> {
        let model = self.model(values);
        Box::new(move |state, columns| {
            let forces = Self::forces(&self.axes, state);
            let at_element_g = model.field(&forces) + state.outside_g;
            let reading = crate::physics::response::read(at_element_g, Vector3::zeros(), state);
            let mut per_mm = Matrix3::zeros();
            for (&axis, slope) in self.axes.iter().zip(model.per_newton(&forces)) {
                per_mm.set_column(axis, &(reading.per_field * slope));
            }
            for (i, value) in model.basis(&forces).into_iter().enumerate() {
                for axis in 0..3 {
                    if let Some(column) = columns.get_mut(3 * i + axis) {
                        *column = reading.per_field.column(axis) * value;
                    }
                }
            }
            Response {
                field_g: reading.field_g,
                at_element_g,
                per_field: reading.per_field,
                per_mm,
                per_lean: [Vector3::zeros(); 2],
                per_strength: Vector3::zeros(),
                per_outside: reading.per_field,
                per_gain: reading.per_gain,
                per_offset: reading.per_offset,
                per_compression: reading.per_compression,
            }
        })
    }
}
