//! Forward problem of one sensor: fields and Jacobian as a function of base and effect parameters.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, Vector3};

use crate::effects::{EffectChain, EffectTerm, MovedSeries, StateSeries};
use crate::fit::base_model::BaseModel;
use crate::fit::cross_validation::noise_variance;
use crate::fit::parameters::FreeParameter;
use crate::fit::rows::SensorRows;
use crate::physics::{FieldResponse, PhysicalState};
use crate::stop;

/// Step of numerical derivatives of the states, in prior widths.
const STEP: f64 = 1e-4;

/// Rows of a block: with its Jacobian it fits into the cache of a core.
const BLOCK_ROWS: usize = 256;

/// Prior width of the sensor offset in gauss when an effect models the ambient field, as left by calibration.
/// Where the recordings turn the sensor too little to separate the two, a free offset would absorb the ambient
/// field and fail at the next attitude.
const OFFSET_G: f64 = 0.05;

/// Rows, base model and effects of one sensor.
#[derive(Clone)]
pub struct SensorProblem<'a> {
    /// Measurements.
    pub rows: &'a SensorRows,
    /// Base model.
    pub base: &'a dyn BaseModel,
    /// Effects in the order of their stages.
    pub effects: &'a [EffectTerm],
    /// Base parameters, then those of each effect.
    pub parameters: Vec<FreeParameter>,
    /// Number of base parameters.
    pub base_count: usize,
    /// Values of the base parameters by design.
    pub nominal: Vec<f64>,
    /// Whether the base parameters start at their nominal values, not at those of the base alone.
    pub starts_nominal: bool,
    /// Number of leading parameters that are the sensor's offset next to an effect that models the ambient
    /// field; their start is zero.
    pub offset_count: usize,
    /// Reciprocal noise floor at rest of each axis.
    pub weights: Vector3<f64>,
    /// Index range of each effect's parameters.
    ranges: Vec<Range<usize>>,
}

/// Modelled fields over one recording.
pub struct ModelledFields {
    /// In gauss.
    pub fields: Vec<Vector3<f64>>,
    /// dB/dFx and dB/dFz in G/N.
    pub per_newton: Vec<[Vector3<f64>; 2]>,
}

impl ModelledFields {
    fn with_capacity(rows: usize) -> Self {
        Self { fields: Vec::with_capacity(rows), per_newton: Vec::with_capacity(rows) }
    }

    fn push(&mut self, response: &FieldResponse, [kx, kz]: [f64; 2]) {
        self.fields.push(response.field_g);
        self.per_newton.push([response.per_mm.column(0) / kx, response.per_mm.column(2) / kz]);
    }
}

/// Minimum reach of a slider in newtons: below, it slips at once.
const MIN_REACH_N: f64 = 1e-3;

impl<'a> SensorProblem<'a> {
    /// Collects the parameters.
    pub fn new(rows: &'a SensorRows, base: &'a dyn BaseModel, effects: &'a [EffectTerm]) -> Self {
        let mut parameters = base.parameters();
        let base_count = parameters.len();
        let recordings = rows.parts.len();
        let mut ranges = Vec::with_capacity(effects.len());
        let max_reach_n = rows.max_reach_n();
        for effect in effects {
            let start = parameters.len();
            for parameter in effect.parameters(recordings).iter() {
                let mut free = FreeParameter::of(parameter);
                if parameter.slips_in_range {
                    free.limits = Some((MIN_REACH_N, max_reach_n.max(MIN_REACH_N)));
                }
                parameters.push(free);
            }
            ranges.push(start..parameters.len());
        }
        let mut problem = Self {
            rows,
            base,
            effects,
            nominal: parameters[..base_count].iter().map(|index| index.start).collect(),
            starts_nominal: false,
            parameters,
            base_count,
            offset_count: if effects.iter().any(EffectTerm::includes_ambient_field) {
                base.offset_count()
            } else {
                0
            },
            weights: Vector3::repeat(1.0),
            ranges,
        };
        problem.weights = problem.axis_weights();
        for index in &mut problem.parameters[..problem.offset_count] {
            (index.start, index.scale) = (0.0, OFFSET_G);
        }
        problem
    }

    /// Sets the start of the base parameters: effects take nothing from what the base alone explains. Offsets
    /// next to an ambient field effect keep their start.
    pub(crate) fn set_base_start(&mut self, values: &[f64]) {
        let parameters = self.parameters.iter_mut().zip(values).take(self.base_count);
        parameters.skip(self.offset_count).for_each(|(index, value)| index.start = *value);
    }

    /// Sets the start of the base parameters to their nominal values.
    pub(crate) fn set_nominal_start(&mut self) {
        let nominal = self.nominal.clone();
        self.set_base_start(&nominal);
        self.starts_nominal = true;
    }

    /// Sets the start of shapes and initial states.
    pub(crate) fn set_shape_start(&mut self, values: &[f64]) {
        let parameters = self.parameters.iter_mut().zip(values);
        parameters
            .filter(|(index, _)| !index.refit_per_fold)
            .for_each(|(index, value)| index.start = *value);
    }

    /// Indices of parameters with preset values.
    pub(crate) fn preset(&self) -> Vec<usize> {
        let parameters = 0..self.parameters.len();
        parameters.filter(|&index| self.parameters[index].preset_sigma.is_some()).collect()
    }

    /// Index range of each effect's parameters.
    pub fn ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Values in their units.
    pub fn values(&self, scaled: &DVector<f64>) -> Vec<f64> {
        self.parameters
            .iter()
            .zip(scaled.iter())
            .map(|(index, &scaled)| index.value(scaled))
            .collect()
    }

    /// Scaled values.
    pub fn to_scaled(&self, values: &[f64]) -> DVector<f64> {
        DVector::from_iterator(
            self.parameters.len(),
            self.parameters.iter().zip(values).map(|(index, &value)| index.to_scaled(value)),
        )
    }

    /// The states over a recording.
    pub fn states(&self, part: usize, values: &[f64]) -> Vec<PhysicalState> {
        self.series(part, values).states
    }

    /// Forces, opening and states over a recording.
    pub fn series(&self, part: usize, values: &[f64]) -> StateSeries {
        let (track, stiffness) = (&self.rows.parts[part].track, self.base.stiffness(values));
        StateSeries::of(track, stiffness, &self.effects_with(values))
    }

    /// The effects in their order, each with its values.
    fn effects_with<'v>(&'v self, values: &'v [f64]) -> Vec<(&'v EffectTerm, &'v [f64])> {
        let effects = self.effects.iter().zip(self.ranges());
        effects.map(|(effect, range)| (effect, &values[range.clone()])).collect()
    }

    /// Modelled fields over a recording.
    pub fn fields(&self, part: usize, scaled: &DVector<f64>) -> Vec<Vector3<f64>> {
        let values = self.values(scaled);
        self.base.fields(&values[..self.base_count], &self.states(part, &values))
    }

    /// Fields over a recording, with their derivatives to the forces.
    pub fn predict(&self, part: usize, scaled: &DVector<f64>) -> ModelledFields {
        let values = self.values(scaled);
        let states = self.states(part, &values);
        let stiffness = self.base.stiffness(&values);
        let mut modelled = ModelledFields::with_capacity(states.len());
        for states in states.chunks(BLOCK_ROWS) {
            stop::check();
            let responses = self.base.responses(&values[..self.base_count], states);
            responses.iter().for_each(|response| modelled.push(response, stiffness));
        }
        modelled
    }

    /// Parameters on which the field of a recording can depend: all but those of other recordings.
    pub fn acting(&self, part: usize) -> Vec<usize> {
        let here = self.rows.parts[part].track.recording;
        let acts = |index: &usize| self.parameters[*index].recording.is_none_or(|own| own == here);
        (0..self.parameters.len()).filter(acts).collect()
    }

    /// Fields over a recording, and their derivatives to the acting scaled parameters ([`SensorProblem::acting`]): three rows for
    /// each row of the recording, one column for each parameter.
    pub fn linearise(&self, part: usize, scaled: &DVector<f64>) -> (ModelledFields, DMatrix<f64>) {
        let rows = self.rows.parts[part].len();
        let stiffness = self.base.stiffness(&self.values(scaled));
        let mut modelled = ModelledFields::with_capacity(rows);
        let mut jacobian = DMatrix::zeros(3 * rows, self.acting(part).len());
        self.linearise_in_blocks(part, scaled, |rows, responses, block| {
            responses.iter().for_each(|response| modelled.push(response, stiffness));
            let (first, count) = (3 * rows.start, 3 * rows.len());
            jacobian.rows_mut(first, count).copy_from(&block.rows(0, count));
        });
        (modelled, jacobian)
    }

    /// The same in blocks of consecutive rows, which stay in the processor's cache: for each its rows, their responses, and the
    /// Jacobian, three rows for each of these.
    pub(crate) fn linearise_in_blocks(
        &self,
        part: usize,
        scaled: &DVector<f64>,
        mut each: impl FnMut(Range<usize>, &[FieldResponse], &mut DMatrix<f64>),
    ) {
        let values = self.values(scaled);
        let track = &self.rows.parts[part].track;
        let chain =
            EffectChain::new(track, self.base.stiffness(&values), self.effects_with(&values));
        let acting = self.acting(part);
        let derivatives: Vec<f64> = self
            .parameters
            .iter()
            .zip(scaled.iter())
            .map(|(index, &d)| index.derivative(d))
            .collect();
        // At a limit the field depends on the parameter only inwards.
        let step = |index: usize| {
            let inwards = self.parameters[index].is_near_upper_limit(scaled[index]);
            if inwards { -STEP } else { STEP }
        };
        let moved = |index: usize| {
            let mut moved = scaled.clone();
            moved[index] += step(index);
            self.values(&moved)
        };
        // Column of the Jacobian, step, and what it moves.
        let mut numeric: Vec<(usize, f64, MovedSeries)> = Vec::new();
        for index in 0..self.base.stiffness_count() {
            let stiffness = self.base.stiffness(&moved(index));
            numeric.push((index, step(index), chain.moved_stiffness(stiffness)));
        }
        for (place, range) in self.ranges().iter().enumerate() {
            for index in range.clone() {
                let Ok(column) = acting.binary_search(&index) else { continue };
                let values = &moved(index)[range.clone()];
                numeric.push((column, step(index), chain.moved(place, values)));
            }
        }
        let states = chain.states();
        let mut jacobian = DMatrix::zeros(3 * BLOCK_ROWS.min(states.len()), acting.len());
        let mut responses = Vec::with_capacity(BLOCK_ROWS);
        for (block, states) in states.chunks(BLOCK_ROWS).enumerate() {
            stop::check();
            responses.clear();
            let base_values = &values[..self.base_count];
            self.base.linearise(base_values, states, &mut |response, columns| {
                for (index, column) in columns.iter().enumerate() {
                    set_column(&mut jacobian, responses.len(), index, column * derivatives[index]);
                }
                responses.push(response);
            });
            let first = BLOCK_ROWS * block;
            for (column, step, moved) in &numeric {
                for (row, change) in moved.changes(first, &responses).enumerate() {
                    set_column(&mut jacobian, row, *column, change / *step);
                }
            }
            each(first..first + states.len(), &responses, &mut jacobian);
        }
    }

    /// Reciprocal noise floor of a row, each axis.
    pub(crate) fn row_weights(&self, part: usize, row: usize) -> Vector3<f64> {
        self.weights * self.rows.parts[part].weight(row).sqrt()
    }

    fn axis_weights(&self) -> Vector3<f64> {
        let values: Vec<f64> = self.parameters.iter().map(|index| index.start).collect();
        let [kx, kz] = self.base.stiffness(&values);
        let at_rest = [PhysicalState::displaced(Vector3::zeros())];
        let rest = self.base.responses(&values[..self.base_count], &at_rest);
        let per_newton = [rest[0].per_mm.column(0) / kx, rest[0].per_mm.column(2) / kz];
        let part = self.rows.parts.iter().max_by_key(|part| part.len());
        let floor = part.map_or_else(Vector3::zeros, |part| {
            noise_variance(part, None, self.rows.slopes(&per_newton))
        });
        // Without noise (a synthetic recording) all axes have equal weight.
        floor.map(|variance| 1.0 / variance.sqrt().max(1e-3))
    }
}

fn set_column(jacobian: &mut DMatrix<f64>, row: usize, index: usize, column: Vector3<f64>) {
    for axis in 0..3 {
        jacobian[(3 * row + axis, index)] = column[axis];
    }
}
