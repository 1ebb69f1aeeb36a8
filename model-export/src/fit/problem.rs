//! One sensor's fields as a function of its parameters: those of the base and those of the effects.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Vector3};

use super::base::Base;
use super::rows::SensorRows;
use super::score::floor_squared;
use super::slot::Slot;
use crate::effects::{Addition, Series};
use crate::physics::State;

/// Step of the differences by which states answer to a parameter, in departures.
const STEP: f64 = 1e-4;

/// Offset of a magnetometer in gauss beside the Earth's field, as it leaves its calibration. Where the
/// recordings turn the sensor too little to tell the two apart, a free offset takes what is the field's
/// and fails at the next attitude; this prior gives the field what a plausible offset cannot be.
const OFFSET_G: f64 = 0.05;

/// A sensor's rows, the base of its model, and the effects beside it.
#[derive(Clone)]
pub struct SensorProblem<'a> {
    /// Measured.
    pub rows: &'a SensorRows,
    /// What the field is computed from.
    pub base: &'a dyn Base,
    /// In the order of their stages.
    pub effects: &'a [Addition],
    /// Every parameter: of the base, then of each effect.
    pub slots: Vec<Slot>,
    /// Number of the base's parameters.
    pub base_count: usize,
    /// The first this many slots are the sensor's own offset, beside an effect that brings the field
    /// around it: they depart from nothing.
    pub offsets: usize,
    /// One over the floor at rest of each axis.
    pub weights: Vector3<f64>,
}

/// Fields and derivatives over one recording.
pub struct Linear {
    /// Modelled fields in gauss.
    pub fields: Vec<Vector3<f64>>,
    /// dB/dFx and dB/dFz in G/N.
    pub per_newton: Vec<[Vector3<f64>; 2]>,
    /// dB/d departure: three rows for each row of the recording, one column for each slot.
    pub jacobian: DMatrix<f64>,
}

impl<'a> SensorProblem<'a> {
    /// Gathers the parameters.
    pub fn new(rows: &'a SensorRows, base: &'a dyn Base, effects: &'a [Addition]) -> Self {
        let mut slots = base.slots();
        let base_count = slots.len();
        let recordings = rows.parts.len();
        let of_effects = effects
            .iter()
            .flat_map(|effect| effect.parameters(recordings));
        slots.extend(of_effects.map(|parameter| Slot::of(&parameter)));
        let mut problem = Self {
            rows,
            base,
            effects,
            slots,
            base_count,
            offsets: match effects.iter().any(Addition::brings_standing_field) {
                true => base.offsets(),
                false => 0,
            },
            weights: Vector3::repeat(1.0),
        };
        problem.weights = problem.axis_weights();
        for slot in &mut problem.slots[..problem.offsets] {
            (slot.start, slot.scale) = (0.0, OFFSET_G);
        }
        problem
    }

    /// Lets departures of the base count from these values: what the base alone explains, no effect
    /// takes from it. (But offsets where an effect brings the field that stands around the sensor.)
    pub fn centre_base(&mut self, values: &[f64]) {
        let slots = self.slots.iter_mut().zip(values).take(self.base_count);
        slots
            .skip(self.offsets)
            .for_each(|(slot, value)| slot.start = *value);
    }

    /// Lets departures of shapes and beginnings count from these values.
    pub fn centre_shapes(&mut self, values: &[f64]) {
        let slots = self.slots.iter_mut().zip(values);
        slots
            .filter(|(slot, _)| !slot.from_scratch)
            .for_each(|(slot, value)| slot.start = *value);
    }

    /// Slots whose values were chosen and stay as they are.
    pub fn chosen(&self) -> Vec<usize> {
        let slots = 0..self.slots.len();
        slots
            .filter(|&slot| self.slots[slot].chosen.is_some())
            .collect()
    }

    /// Where each effect's parameters are among the slots.
    pub fn ranges(&self) -> Vec<Range<usize>> {
        let mut start = self.base_count;
        let recordings = self.rows.parts.len();
        let range = |effect: &Addition| {
            let end = start + effect.parameters(recordings).len();
            std::mem::replace(&mut start, end)..end
        };
        self.effects.iter().map(range).collect()
    }

    /// Values at these departures.
    pub fn values(&self, departures: &DVector<f64>) -> Vec<f64> {
        self.slots
            .iter()
            .zip(departures.iter())
            .map(|(slot, &departure)| slot.value(departure))
            .collect()
    }

    /// Departures of these values.
    pub fn departures(&self, values: &[f64]) -> DVector<f64> {
        DVector::from_iterator(
            self.slots.len(),
            self.slots
                .iter()
                .zip(values)
                .map(|(slot, &value)| slot.departure(value)),
        )
    }

    /// The states over a recording.
    pub fn states(&self, part: usize, values: &[f64]) -> Vec<State> {
        self.series(part, values).states
    }

    /// Forces, opening and states over a recording.
    pub fn series(&self, part: usize, values: &[f64]) -> Series {
        let effects: Vec<(&Addition, &[f64])> = self
            .effects
            .iter()
            .zip(self.ranges())
            .map(|(effect, range)| (effect, &values[range]))
            .collect();
        Series::of(
            &self.rows.parts[part].track,
            self.base.stiffness(values),
            &effects,
        )
    }

    /// Modelled fields over a recording.
    pub fn fields(&self, part: usize, departures: &DVector<f64>) -> Vec<Vector3<f64>> {
        let values = self.values(departures);
        let field = self.base.field(&values[..self.base_count]);
        self.states(part, &values).iter().map(field).collect()
    }

    /// Fields and derivatives over a recording.
    pub fn linear(&self, part: usize, departures: &DVector<f64>) -> Linear {
        let values = self.values(departures);
        let states = self.states(part, &values);
        let [kx, kz] = self.base.stiffness(&values);
        let at = self.base.linear(&values[..self.base_count]);
        let mut linear = Linear {
            fields: Vec::with_capacity(states.len()),
            per_newton: Vec::with_capacity(states.len()),
            jacobian: DMatrix::zeros(3 * states.len(), self.slots.len()),
        };
        let slopes: Vec<f64> = self
            .slots
            .iter()
            .zip(departures.iter())
            .map(|(slot, &d)| slot.slope(d))
            .collect();
        let mut columns = vec![Vector3::zeros(); self.base_count];
        let mut responses = Vec::with_capacity(states.len());
        for (row, state) in states.iter().enumerate() {
            let response = at(state, &mut columns);
            for (slot, column) in columns.iter().enumerate() {
                put(&mut linear.jacobian, row, slot, column * slopes[slot]);
            }
            linear.fields.push(response.field_g);
            linear.per_newton.push([
                response.per_mm.column(0) / kx,
                response.per_mm.column(2) / kz,
            ]);
            responses.push(response);
        }
        for slot in (0..self.base.mechanical()).chain(self.base_count..self.slots.len()) {
            let mut moved = departures.clone();
            moved[slot] += STEP;
            let moved = self.states(part, &self.values(&moved));
            for (row, response) in responses.iter().enumerate() {
                let change = response.change(&states[row], &moved[row]) / STEP;
                put(&mut linear.jacobian, row, slot, change);
            }
        }
        linear
    }

    fn axis_weights(&self) -> Vector3<f64> {
        let values: Vec<f64> = self.slots.iter().map(|slot| slot.start).collect();
        let [kx, kz] = self.base.stiffness(&values);
        let mut columns = vec![Vector3::zeros(); self.base_count];
        let rest = self.base.linear(&values[..self.base_count])(
            &State::displaced(Vector3::zeros()),
            &mut columns,
        );
        let per_newton = [rest.per_mm.column(0) / kx, rest.per_mm.column(2) / kz];
        let part = self.rows.parts.iter().max_by_key(|part| part.len());
        let floor = part.map_or_else(Vector3::zeros, |part| {
            floor_squared(part, self.rows.slopes(&per_newton))
        });
        // Without any noise (a made-up recording) all axes count alike.
        floor.map(|variance| 1.0 / variance.sqrt().max(1e-3))
    }
}

fn put(jacobian: &mut DMatrix<f64>, row: usize, slot: usize, column: Vector3<f64>) {
    for axis in 0..3 {
        jacobian[(3 * row + axis, slot)] = column[axis];
    }
}
