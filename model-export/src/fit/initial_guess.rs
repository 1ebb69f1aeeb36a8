//! Initial values of effect parameters: shapes and initial states by grid search, coefficients by least squares.
//!
//! The residual of the base fit is regressed on the derivatives to the coefficients together with those of the
//! base parameters, so that an effect gets no credit for what the base can absorb. The shape with the smallest
//! residual over all sensors is selected; a shape that spans recordings is selected by leave-one-recording-out
//! error and stays fixed.

use crate::fit::block_bootstrap::jackknife;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::effects::{EffectParameter, EffectTerm, ParameterKind};
use crate::fit::cross_validation::MAX_RECORDING_FOLDS;
use crate::fit::linearisation::{
    Linearisation, RecordingNormals, held_out_residuals, least_residual,
};
use crate::fit::problem::SensorProblem;
use crate::physics::PhysicalState;
use crate::stop;
use std::sync::Arc;

/// Rows of a recording that the search uses.
const ROWS: usize = 400;
/// Passes over several effects, and over several shapes of one effect.
const ROUNDS: usize = 2;
/// Refinement of the grid of a shape that spans recordings.
const FINE: i32 = 4;
/// Minimum step in seconds of the first search for an instant, and the maximum number of steps in a recording and in all: in longer
/// recordings an event that takes less than a step may be missed.
const INSTANT_S: f64 = 1.0;
const INSTANTS_IN_RECORDING: f64 = 100.0;
const INSTANTS: f64 = 2000.0;
/// Refinement of that step, and steps on each side of the best instant.
const INSTANT_FINE: f64 = 10.0;
const FINE_STEPS: usize = 12;
/// Minimum reduction of a sensor's squared residual by a shape of its own.
const OWN_GAIN: f64 = 0.05;
/// Scale of a coefficient without a typical value: what moves the field by this multiple of its residual.
const EXPECTED: f64 = 10.0;
/// Tried initial states: at rest, and with a slider of friction nearly at its limit.
const INITIAL_STATES: [f64; 3] = [-0.9, 0.0, 0.9];

/// Search state of one sensor: its problem and the current values.
pub struct ShapeSearch<'a> {
    /// Problem with all effects; the starts of its parameters are set here.
    pub problem: SensorProblem<'a>,
    /// Fitted values, then current values of the effects.
    pub values: Vec<f64>,
    linearisation: Linearisation,
    /// Normal equations with the coefficients of the other effects.
    normals: Arc<RecordingNormals>,
}

impl<'a> ShapeSearch<'a> {
    /// From the fitted values of the base.
    pub fn new(mut problem: SensorProblem<'a>, base_values: &[f64]) -> Self {
        problem.set_base_start(base_values);
        let values: Vec<f64> = problem.parameters.iter().map(|index| index.start).collect();
        let fixed: Vec<usize> = (0..problem.base_count).collect();
        let linearisation = Linearisation::new(&problem, &values, &fixed, ROWS);
        Self::from_linearisation(linearisation, problem, values)
    }

    /// Upon a linearisation; `problem` may have effects more, whose coefficients are zero in `values`.
    pub fn from_linearisation(
        linearisation: Linearisation,
        problem: SensorProblem<'a>,
        values: Vec<f64>,
    ) -> Self {
        Self { normals: linearisation.normals.clone(), linearisation, problem, values }
    }

    /// The same state on other rows.
    pub fn on(self, linearisation: Linearisation) -> Self {
        Self::from_linearisation(linearisation, self.problem, self.values)
    }

    /// Derivatives to the coefficients of `effect`, weighted, per prior width.
    pub fn regressors(&self, effect: usize) -> DMatrix<f64> {
        let parameters = coefficients(&self.problem, effect);
        let mut columns = self.jacobian(&parameters, &self.values);
        for (mut column, index) in columns.column_iter_mut().zip(parameters) {
            column *= self.problem.parameters[index].scale;
        }
        columns
    }

    /// The coefficients of `effect`, and the weighted derivatives to them at `values`.
    pub fn coefficient_columns(&self, effect: usize, values: &[f64]) -> (Vec<usize>, DMatrix<f64>) {
        let parameters = coefficients(&self.problem, effect);
        let columns = self.jacobian(&parameters, values);
        (parameters, columns)
    }

    /// Derivatives of the field to these parameters at `values`, weighted, in units of the parameter.
    fn jacobian(&self, parameters: &[usize], values: &[f64]) -> DMatrix<f64> {
        let problem = &self.problem;
        let mut columns = DMatrix::zeros(self.linearisation.residual.len(), parameters.len());
        let mut at = 0;
        for (part, rows) in self.linearisation.rows.iter().enumerate() {
            for (column, &index) in parameters.iter().enumerate() {
                let step = 1e-3 * problem.parameters[index].scale.abs().max(1e-9);
                let mut moved = values.to_vec();
                moved[index] += step;
                let moved = self.states(part, index, &moved);
                for (i, ((row, state, response), moved)) in rows.iter().zip(&moved).enumerate() {
                    let weights = problem.row_weights(part, *row);
                    let change = response.change(state, moved).component_mul(&weights) / step;
                    (0..3).for_each(|axis| columns[(at + 3 * i + axis, column)] = change[axis]);
                }
            }
            at += 3 * rows.len();
        }
        columns
    }

    /// States of a recording's rows with the parameter `index` changed.
    fn states(&self, part: usize, index: usize, moved: &[f64]) -> Vec<PhysicalState> {
        let ranges = self.problem.ranges().iter();
        let mut of_effects = self.problem.effects.iter().zip(ranges);
        let own = of_effects.find(|(_, range)| range.contains(&index));
        if let Some((effect, range)) = own.filter(|(effect, _)| effect.is_pointwise()) {
            return self.linearisation.states_with(part, effect, &moved[range.clone()]);
        }
        let states = self.problem.states(part, moved);
        let rows = self.linearisation.rows[part].iter();
        rows.map(|(row, ..)| states[*row]).collect()
    }

    /// Squared residual with parameter `j` of `effect` at `value`, all coefficients fitted: over all
    /// recordings, or (`left_out`) held out recording by recording.
    fn residuals(&self, effect: usize, j: usize, value: f64, left_out: bool) -> Vec<f64> {
        let mut values = self.values.clone();
        values[self.problem.ranges()[effect].start + j] = value;
        let own = self.jacobian(&coefficients(&self.problem, effect), &values);
        let normals = self.normals.with(&own);
        if left_out { held_out_residuals(&normals) } else { vec![least_residual(&normals).0] }
    }

    /// Sets the other effects whose coefficients are fitted.
    fn set_others(&mut self, others: &[usize]) {
        let parameters: Vec<usize> =
            others.iter().flat_map(|&i| coefficients(&self.problem, i)).collect();
        let columns = self.jacobian(&parameters, &self.values);
        self.normals = Arc::new(self.linearisation.normals.extended(&columns));
    }
}

/// Sets the start of all effect parameters, in the order of the effects.
pub fn search_all(searches: &mut [ShapeSearch]) {
    let Some(first) = searches.first() else {
        return;
    };
    let recordings = first.problem.rows.parts.len();
    let effects = first.problem.effects;
    // In the first pass an effect may absorb the others: hence several passes.
    for pass in 0..if effects.len() > 1 { ROUNDS } else { 1 } {
        for (i, effect) in effects.iter().enumerate() {
            let others: Vec<usize> =
                (0..effects.len()).filter(|&other| other != i && (pass > 0 || other < i)).collect();
            searches.par_iter_mut().for_each(|s| s.set_others(&others));
            search_effect(searches, i, &effect.parameters(recordings));
        }
    }
    searches.par_iter_mut().for_each(start_coefficients);
}

/// Searches the shapes of one additional effect.
pub fn search_one(searches: &mut [ShapeSearch], effect: usize) {
    let Some(first) = searches.first() else {
        return;
    };
    let recordings = first.problem.rows.parts.len();
    let parameters = first.problem.effects[effect].parameters(recordings);
    search_effect(searches, effect, &parameters);
}

/// Sets the start of one effect's parameters.
fn search_effect(searches: &mut [ShapeSearch], i: usize, parameters: &[EffectParameter]) {
    let shapes = parameters.iter().filter(|p| !p.is_coefficient()).count();
    for round in 0..if shapes > 1 { ROUNDS } else { 1 } {
        for (j, parameter) in parameters.iter().enumerate() {
            let now = first_value(searches, i, j);
            let tried = grid(parameter, searches, round, now);
            if !tried.is_empty() {
                let across = parameter.cross_validated && recordings_with_rows(searches) > 1;
                select_value(searches, i, j, &tried, across);
            }
        }
    }
    scale_unknown(searches, i, parameters);
}

/// Number of recordings with rows of at least one sensor.
fn recordings_with_rows(searches: &[ShapeSearch]) -> usize {
    searches.iter().map(|search| search.problem.rows.filled_parts()).max().unwrap_or(0)
}

/// Current value of parameter `j` of effect `i`, the same for every sensor during the search.
fn first_value(searches: &[ShapeSearch], i: usize, j: usize) -> f64 {
    searches.first().map_or(0.0, |search| search.values[search.problem.ranges()[i].start + j])
}

fn grid(parameter: &EffectParameter, searches: &[ShapeSearch], round: usize, now: f64) -> Vec<f64> {
    match &parameter.kind {
        ParameterKind::Coefficient => Vec::new(),
        // Once: the second round searches the shapes that belong to them. Each takes as long as a shape, so not in a campaign of
        // more recordings than effects are selected on.
        ParameterKind::InitialState => {
            let has_rows = |recording: usize| {
                searches
                    .iter()
                    .any(|s| s.problem.rows.parts.get(recording).is_some_and(|p| !p.is_empty()))
            };
            let is_searched = round == 0
                && parameter.recording.is_some_and(has_rows)
                && recordings_with_rows(searches) <= MAX_RECORDING_FOLDS;
            if is_searched { INITIAL_STATES.to_vec() } else { Vec::new() }
        }
        ParameterKind::Shape { grid } if parameter.cross_validated => refined(grid),
        ParameterKind::Shape { grid } if parameter.slips_in_range => {
            let reaches = searches.iter().map(|s| s.problem.rows.max_reach_n());
            let max_n = reaches.fold(grid[0], f64::max);
            grid.iter().copied().filter(|value| *value <= max_n).collect()
        }
        ParameterKind::Shape { grid } => grid.to_vec(),
        ParameterKind::Instant => {
            let parts = searches.iter().flat_map(|s| &s.problem.rows.parts);
            let ends =
                parts.filter_map(|part| Some((part.track.before_s, *part.track.time_s.last()?)));
            let (longest_s, end_s) = ends
                .fold((0.0_f64, 0.0_f64), |(longest, end), (before, own)| {
                    (longest.max(own), end.max(before + own))
                });
            let step_s = INSTANT_S.max(longest_s / INSTANTS_IN_RECORDING).max(end_s / INSTANTS);
            if round > 0 {
                let offset = |k: usize| step_s / INSTANT_FINE * (k as f64 - FINE_STEPS as f64);
                (0..=2 * FINE_STEPS).map(|k| now + offset(k)).collect()
            } else {
                (1..(end_s / step_s) as usize).map(|k| step_s * k as f64).collect()
            }
        }
    }
}

/// Grid refined by a constant ratio.
fn refined(grid: &[f64]) -> Vec<f64> {
    let between = |pair: &[f64]| {
        let ratio = pair[1] / pair[0];
        let from = pair[0];
        (0..FINE).map(move |k| from * libm::pow(ratio, f64::from(k) / f64::from(FINE)))
    };
    grid.windows(2).flat_map(between).chain(grid.last().copied()).collect()
}

/// Selects the value of parameter `j` of effect `i` with the smallest residual over all sensors; with `across`
/// by leave-one-recording-out error, and fixes it. A sensor has another value of a user-defined effect where that leaves clearly
/// less there: the load at which a joint closes differs from finger to finger. So does an initial state.
fn select_value(searches: &mut [ShapeSearch], i: usize, j: usize, tried: &[f64], across: bool) {
    let by_sensor: Vec<Vec<Vec<f64>>> = tried
        .par_iter()
        .map(|&value| {
            stop::check();
            searches.iter().map(|s| s.residuals(i, j, value, across)).collect()
        })
        .collect();
    let sum = |of_sensors: &Vec<Vec<f64>>| {
        let mut sum: Vec<f64> = Vec::new();
        for left in of_sensors {
            sum.resize(left.len(), 0.0);
            sum.iter_mut().zip(left).for_each(|(sum, own)| *sum += own);
        }
        sum
    };
    let left: Vec<Vec<f64>> = by_sensor.iter().map(sum).collect();
    let Some(place) = argmin(&left, None) else {
        return;
    };
    // Of the logarithm.
    let logs = (0..left[place].len()).filter_map(|k| Some(tried[argmin(&left, Some(k))?].ln()));
    let std_error = across.then(|| jackknife(&logs.collect::<Vec<f64>>()));
    for (sensor, search) in searches.iter_mut().enumerate() {
        let mut value = tried[place];
        let index = search.problem.ranges()[i].start + j;
        let is_own = matches!(search.problem.effects[i], EffectTerm::Expression(_))
            || search.problem.parameters[index].is_state;
        if !across && is_own {
            let own = |place: usize| by_sensor[place][sensor].iter().sum::<f64>();
            let best = (0..tried.len()).min_by(|a, b| own(*a).total_cmp(&own(*b)));
            let is_better = |best: &usize| own(*best) < (1.0 - OWN_GAIN) * own(place);
            value = best.filter(is_better).map_or(value, |best| tried[best]);
        }
        search.values[index] = value;
        // The prior of an initial state stays at rest.
        if !search.problem.parameters[index].is_state {
            search.problem.parameters[index].start = value;
        }
        search.problem.parameters[index].preset_sigma =
            std_error.map(|std_error| std_error / search.problem.parameters[index].scale);
    }
}

/// Place of the smallest residual over all recordings except `without`.
fn argmin(left: &[Vec<f64>], without: Option<usize>) -> Option<usize> {
    let sum = |left: &Vec<f64>| -> f64 {
        let counted = left.iter().enumerate().filter(|(k, _)| Some(*k) != without);
        counted.map(|(_, left)| left).sum()
    };
    let sums: Vec<f64> = left.iter().map(sum).collect();
    (0..sums.len()).min_by(|a, b| sums[*a].total_cmp(&sums[*b]))
}

fn coefficients(problem: &SensorProblem, effect: usize) -> Vec<usize> {
    let parameters = problem.effects[effect].parameters(problem.rows.parts.len());
    let start = problem.ranges()[effect].start;
    let is_coefficient =
        |(j, parameter): (usize, &EffectParameter)| parameter.is_coefficient().then_some(start + j);
    parameters.iter().enumerate().filter_map(is_coefficient).collect()
}

/// Sets the scale of coefficients without a typical value from the data.
fn scale_unknown(searches: &mut [ShapeSearch], effect: usize, parameters: &[EffectParameter]) {
    for (j, _) in
        parameters.iter().enumerate().filter(|(_, p)| p.is_coefficient() && p.typical.is_nan())
    {
        for search in searches.iter_mut() {
            let index = search.problem.ranges()[effect].start + j;
            search.problem.parameters[index].scale = 1.0;
            let sensitivity = search.jacobian(&[index], &search.values).norm();
            let scale = EXPECTED * search.linearisation.residual.norm() / sensitivity;
            search.problem.parameters[index].scale = if scale.is_finite() { scale } else { 1.0 };
        }
    }
}

fn start_coefficients(search: &mut ShapeSearch) {
    let effects = 0..search.problem.effects.len();
    let parameters: Vec<usize> = effects.flat_map(|i| coefficients(&search.problem, i)).collect();
    let columns = search.jacobian(&parameters, &search.values);
    let (_, found) = least_residual(&search.linearisation.normals.with(&columns));
    let found = found.into_iter().skip(search.problem.base_count);
    for (index, value) in parameters.into_iter().zip(found) {
        // Initial values stay within the prior scale.
        let limit = search.problem.parameters[index].scale.abs();
        search.values[index] = value.clamp(-limit, limit);
    }
}
