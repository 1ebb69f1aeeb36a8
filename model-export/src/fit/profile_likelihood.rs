//! Shapes that the recordings do not exclude.
//!
//! Standard errors are linear at the solution. Where the residual hardly depends on a shape (the time constant of a creep that is
//! slower than the loads), coefficients depend on it by far more than that. Each shape is therefore set to the values of its grid in
//! turn, everything else is fitted again to the model linearised at the solution, and every such solution counts by its likelihood
//! (an average over models, Hoeting et al. 1999).

use std::sync::Arc;

use nalgebra::{Cholesky, DVector};
use rayon::prelude::*;

use crate::effects::{EffectTerm, ParameterKind};
use crate::fit::base_model::BaseModel;
use crate::fit::initial_guess::ShapeSearch;
use crate::fit::joint::{JointFit, SensorFit};
use crate::fit::linearisation::{Linearisation, NormalEquations};
use crate::fit::problem::SensorProblem;
use crate::fit::rows::SensorRows;
use crate::fit::shape_profile::ShapeProfile;

/// Rows of a recording that are used.
const ROWS: usize = 400;
/// Values of a grid that are tried at most.
const MAX_TRIED: usize = 8;
/// Difference of the log-likelihood from which a shape counts nothing, or alone.
const MAX_LOG: f64 = 30.0;

/// A sensor at its solution.
struct Sensor<'a> {
    fit: &'a SensorFit,
    rows: &'a SensorRows,
    problem: SensorProblem<'a>,
    /// Variance of a sum over all rows relative to that of as many independent rows at the floor as are used.
    inflation: f64,
}

/// Profiles of all shapes of the effects, which are in the order of their stages.
pub fn shape_profiles(
    (rows, bases): (&[SensorRows], &[Arc<dyn BaseModel>]),
    effects: &[EffectTerm],
    fit: &JointFit,
) -> Vec<ShapeProfile> {
    let sensors: Vec<Sensor> = rows
        .iter()
        .zip(bases)
        .zip(&fit.sensors)
        .map(|((rows, base), fit)| {
            let mut problem = SensorProblem::new(rows, base.as_ref(), effects);
            problem.parameters.clone_from(&fit.parameters);
            Sensor { fit, rows, inflation: inflation(rows, fit), problem }
        })
        .collect();
    let Some(recordings) = rows.first().map(|rows| rows.parts.len()) else { return Vec::new() };
    let mut profiles = Vec::new();
    for (place, effect) in effects.iter().enumerate() {
        let parameters = effect.parameters(recordings);
        let shapes: Vec<(usize, Vec<f64>)> = parameters
            .iter()
            .enumerate()
            .filter_map(|(j, parameter)| match &parameter.kind {
                ParameterKind::Shape { grid } if !parameter.cross_validated => {
                    let step = grid.len().div_ceil(MAX_TRIED).max(1);
                    Some((j, grid.iter().copied().step_by(step).collect()))
                }
                _ => None,
            })
            .collect();
        if shapes.is_empty() {
            continue;
        }
        let states: Vec<State> =
            sensors.par_iter().map(|sensor| State::without(sensor, place)).collect();
        for (j, grid) in shapes {
            profiles.extend(profile(&states, j, &grid));
        }
    }
    profiles
}

/// How much a sum of squares over the rows used holds less than the likelihood of all rows: their number, the residual above the
/// floor, and its autocorrelation.
fn inflation(rows: &SensorRows, fit: &SensorFit) -> f64 {
    let used: usize = rows.parts.iter().map(|part| part.len().min(ROWS)).sum();
    let spans = rows
        .parts
        .iter()
        .filter_map(|part| Some((part.time_s.last()? - part.time_s.first()?, part.len() as f64)));
    let (seconds, count) = spans.fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
    let independent = (seconds / fit.correlation_s.max(f64::MIN_POSITIVE)).min(count);
    let squares: (f64, f64) = fit.scores.iter().fold((0.0, 0.0), |(left, floor), score| {
        (left + score.fitted_rms_g.powi(2), floor + score.floor_g.powi(2))
    });
    (squares.0 / squares.1).max(1.0) * used as f64 / independent.max(1.0)
}

/// A sensor linearised at its solution without one effect.
struct State<'a> {
    sensor: &'a Sensor<'a>,
    place: usize,
    search: ShapeSearch<'a>,
    linearisation: Linearisation,
    others: Vec<usize>,
}

impl<'a> State<'a> {
    fn without(sensor: &'a Sensor<'a>, place: usize) -> Self {
        let problem = &sensor.problem;
        let own = problem.ranges()[place].clone();
        let mut values = sensor.fit.values.clone();
        let of_effect = problem.effects[place].parameters(sensor.rows.parts.len());
        for (value, parameter) in values[own.clone()].iter_mut().zip(&of_effect) {
            if parameter.is_coefficient() {
                *value = 0.0;
            }
        }
        let parts = &sensor.rows.parts;
        let acts = |index: &usize| {
            let mut filled = (0..parts.len()).filter(|&part| !parts[part].is_empty());
            filled.any(|part| problem.acting(part).binary_search(index).is_ok())
        };
        let others: Vec<usize> = (0..problem.parameters.len())
            .filter(|index| !own.contains(index) && acts(index))
            .collect();
        let linearisation = Linearisation::new(problem, &values, &others, ROWS);
        let search =
            ShapeSearch::from_linearisation(linearisation.clone(), problem.clone(), values);
        Self { sensor, place, search, linearisation, others }
    }

    /// Log-likelihood and values with parameter `j` of the effect at `value`, or as fitted.
    fn refitted(&self, j: usize, value: Option<f64>) -> Option<(f64, Vec<f64>)> {
        let start = self.search.problem.ranges()[self.place].start;
        let mut values = self.search.values.clone();
        if let Some(value) = value {
            values[start + j] = value;
        }
        let (own, columns) = self.search.coefficient_columns(self.place, &values);
        let sum = NormalEquations::sum(self.linearisation.normals().with(&columns).iter())?;
        // What the recordings do not determine stays at its prior, which the solution is taken for.
        let mut matrix = sum.matrix.clone();
        for i in 0..self.others.len() {
            matrix[(i, i)] += self.sensor.inflation;
        }
        let best: DVector<f64> = Cholesky::new(matrix)?.solve(&sum.right);
        let squares = sum.residual_squares(&best);
        let problem = &self.search.problem;
        let scaled = problem.to_scaled(&self.sensor.fit.values);
        for (&index, change) in self.others.iter().zip(best.iter()) {
            values[index] = problem.parameters[index].value(scaled[index] + change);
        }
        for (&index, coefficient) in own.iter().zip(best.iter().skip(self.others.len())) {
            values[index] = *coefficient;
        }
        Some((-0.5 * squares / self.sensor.inflation, values))
    }
}

/// The profile of parameter `j` of the effect; `None` where it cannot be solved.
fn profile(states: &[State], j: usize, grid: &[f64]) -> Option<ShapeProfile> {
    let solved = |value: Option<f64>| -> Option<(f64, Vec<Vec<f64>>)> {
        let of_sensors: Vec<Option<(f64, Vec<f64>)>> =
            states.par_iter().map(|state| state.refitted(j, value)).collect();
        let of_sensors: Vec<(f64, Vec<f64>)> = of_sensors.into_iter().collect::<Option<_>>()?;
        let likelihood = of_sensors.iter().map(|(likelihood, _)| likelihood).sum();
        Some((likelihood, of_sensors.into_iter().map(|(_, values)| values).collect()))
    };
    let (likelihood, fitted) = solved(None)?;
    let others = grid.iter().filter_map(|&value| {
        let (own, values) = solved(Some(value))?;
        Some(((own - likelihood).clamp(-MAX_LOG, MAX_LOG).exp(), values))
    });
    Some(ShapeProfile { others: others.collect(), fitted })
}
