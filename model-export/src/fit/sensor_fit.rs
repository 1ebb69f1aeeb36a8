//! Fit of one sensor, step by step.
//!
//! Fourteen parameters describe a sensor, effects add theirs, and a recording seldom determines all of them: a
//! larger gap resembles a weaker magnet, a tilted magnet a shifted one. So a prior as wide as the manufacturing
//! tolerances is always included, and the weight of the data is lowered by the variance inflation of
//! autocorrelated or structured residuals (`noise_inflation`).
//!
//! Directions of the parameter space whose standard error exceeds half a prior width are not identifiable and
//! stay at their start. They are determined once, on all recordings; values are fitted anew in each fold.

use std::ops::RangeInclusive;

use nalgebra::{DMatrix, DVector};

use crate::fit::block_bootstrap::{self, Block};
use crate::fit::cross_validation::{ErrorSums, Fold, RowRange, all_rows, time_slices};
use crate::fit::identifiability::{FreeDirections, noise_inflation};
use crate::fit::problem::SensorProblem;
use crate::fit::rows::SensorRows;
use crate::fit::solver::{
    COARSE_TOLERANCE, FINE_TOLERANCE, FOLD_TOLERANCE, minimise, weighted_jacobian,
};
use crate::fit::{FitError, FitOptions};

/// Variance inflation of the first round, before the residuals are known.
const FIRST_INFLATION: f64 = 1e4;

/// Solution of one sensor.
#[derive(Clone, Debug)]
pub struct SensorSolution {
    /// Solution in scaled parameters.
    pub scaled: DVector<f64>,
    /// Variance inflation of the data.
    pub inflation: f64,
    /// Free directions.
    pub space: FreeDirections,
    /// Block length in seconds.
    pub length_s: f64,
    /// Longest correlation time of the residual in seconds.
    pub correlation_s: f64,
    /// Normal equations at the solution, in blocks of time.
    pub blocks: Vec<Block>,
}

/// Fit from the nominal design: with a low weight of the data to obtain residuals, then with the proper weight,
/// last with unidentifiable directions fixed.
pub fn fit_from_nominal(problem: &SensorProblem) -> Result<SensorSolution, FitError> {
    let whole = FreeDirections::except(&problem.preset(), problem.parameters.len());
    let start = DVector::zeros(problem.parameters.len());
    let all = all_rows(problem.rows);
    let low = (&start, None);
    let first = minimise(problem, &all, FIRST_INFLATION, &whole, low, COARSE_TOLERANCE)?;
    fit_identifiable_from(problem, fit_all_free(problem, &first, 1..=1)?, &[])
}

/// Offset of a base parameter from nominal, in prior widths, beyond which it probably imitates an effect.
const IMITATES: f64 = 3.0;

/// Fit of a base with effects, started at the fit of the base alone, where the priors of its parameters are centred. Where one of
/// them is far from nominal, the base may imitate the effects (tilts of 8 degrees instead of a coupling of the flexures),
/// and the priors and the directions that the data do not determine keep it there. Priors centred at nominal are then tried
/// as well; of the two fits, that with the smaller sum of squares of residuals and of distances from nominal is taken.
pub(crate) fn fit_from_base<'a>(
    problem: SensorProblem<'a>,
    values: &[f64],
) -> Result<(SensorProblem<'a>, SensorSolution), FitError> {
    let fit = |problem: &SensorProblem, values: &[f64]| {
        let near = fit_all_free(problem, &problem.to_scaled(values), FREE_ROUNDS)?;
        fit_identifiable_from(problem, near, &[])
    };
    let found = fit(&problem, values)?;
    let is_far = |index: usize| {
        let parameter = &problem.parameters[index];
        (parameter.start - problem.nominal[index]).abs() > IMITATES * parameter.scale.abs()
    };
    if !(problem.offset_count..problem.base_count).any(is_far) {
        return Ok((problem, found));
    }
    let mut nominal = problem.clone();
    nominal.set_nominal_start();
    let mut start = values.to_vec();
    start[..problem.base_count].copy_from_slice(&problem.nominal);
    let Ok(other) = fit(&nominal, &start) else {
        return Ok((problem, found));
    };
    let inflation = found.inflation.min(other.inflation);
    let squares = |problem: &SensorProblem, solution: &SensorSolution| {
        let residuals: f64 = solution.blocks.iter().map(|block| block.squares).sum();
        let distances = nominal.to_scaled(&problem.values(&solution.scaled));
        residuals / inflation + distances.norm_squared()
    };
    let is_better = squares(&nominal, &other) < squares(&problem, &found);
    Ok(if is_better { (nominal, other) } else { (problem, found) })
}

/// Rounds of a fit with all directions free, at least and at most: the weight of the data follows from the residuals of the round
/// before.
const FREE_ROUNDS: RangeInclusive<usize> = 2..=5;
/// Further rounds are made while the variance inflation falls below this share of that of the round before.
const FALLING: f64 = 0.2;

/// Scaled parameters with the normal equations of all rows there, in blocks of time.
type LinearisedAt = (DVector<f64>, Vec<Block>);

/// Fit from a nearby start with all directions free.
fn fit_all_free(
    problem: &SensorProblem,
    start: &DVector<f64>,
    rounds: RangeInclusive<usize>,
) -> Result<LinearisedAt, FitError> {
    let whole = FreeDirections::except(&problem.preset(), problem.parameters.len());
    let all = all_rows(problem.rows);
    let mut scaled = start.clone();
    let (_, mut blocks) = linearised(problem, &scaled);
    let mut before = f64::INFINITY;
    for round in 0..*rounds.end() {
        let inflation = noise_inflation(&blocks);
        if round >= *rounds.start() && inflation > FALLING * before {
            break;
        }
        before = inflation;
        let from = (&scaled, Some(sum(start.len(), &blocks)));
        scaled = minimise(problem, &all, inflation, &whole, from, COARSE_TOLERANCE)?;
        (_, blocks) = linearised(problem, &scaled);
    }
    Ok((scaled, blocks))
}

/// Fit from a close start with new weights and free directions. `frozen` parameters keep their values.
pub(crate) fn fit_identifiable(
    problem: &SensorProblem,
    start: &DVector<f64>,
    frozen: &[usize],
) -> Result<SensorSolution, FitError> {
    let (_, blocks) = linearised(problem, start);
    fit_identifiable_from(problem, (start.clone(), blocks), frozen)
}

fn fit_identifiable_from(
    problem: &SensorProblem,
    (start, blocks): LinearisedAt,
    frozen: &[usize],
) -> Result<SensorSolution, FitError> {
    let inflation = noise_inflation(&blocks);
    let frozen: Vec<usize> = frozen.iter().copied().chain(problem.preset()).collect();
    let space = FreeDirections::from_data(&blocks, problem.parameters.len(), &frozen);
    if space.free.ncols() == 0 {
        return Err(FitError::NotConverged {
            sensor: problem.rows.sensor,
            reason: "these recordings do not determine any of its parameters".to_owned(),
        });
    }
    let all = all_rows(problem.rows);
    let from = (&start, Some(sum(start.len(), &blocks)));
    let scaled = minimise(problem, &all, inflation, &space, from, FINE_TOLERANCE)?;
    let ((length_s, correlation_s), blocks) = linearised(problem, &scaled);
    Ok(SensorSolution { scaled, inflation, space, length_s, correlation_s, blocks })
}

impl SensorSolution {
    /// Fit of other rows, with the same inflation and directions, from a start and its normal equations, where they are known.
    pub fn refit(
        &self,
        problem: &SensorProblem,
        training: &[RowRange],
        start: (&DVector<f64>, Option<Block>),
    ) -> Result<DVector<f64>, FitError> {
        minimise(problem, training, self.inflation, &self.space, start, FOLD_TOLERANCE)
    }

    /// Normal equations of these rows at the solution; `None` where they are not whole recordings.
    pub(crate) fn normal_equations(
        &self,
        rows: &SensorRows,
        training: &[RowRange],
    ) -> Option<Block> {
        if training.iter().any(|range| range.rows != (0..rows.parts[range.part].len())) {
            return None;
        }
        let parts = rows.parts.iter().enumerate();
        let part_of_block = parts.flat_map(|(place, part)| {
            time_slices(&part.time_s, self.length_s).into_iter().map(move |_| place)
        });
        let is_used = |part: usize| training.iter().any(|range| range.part == part);
        let blocks = self.blocks.iter().zip(part_of_block);
        Some(sum(
            self.scaled.len(),
            blocks.filter(|(_, part)| is_used(*part)).map(|(block, _)| block),
        ))
    }

    /// The same with these frozen parameters freed.
    pub(crate) fn with_freed(&self, parameters: &[usize]) -> Self {
        Self { space: self.space.with_freed(parameters), ..self.clone() }
    }

    /// Covariance of the scaled parameters.
    pub fn covariance(&self, options: FitOptions) -> DMatrix<f64> {
        self.space.covariance(&self.blocks, options)
    }
}

/// Adds the errors of the model over some rows.
pub(crate) fn add_errors(
    tally: &mut ErrorSums,
    problem: &SensorProblem,
    ranges: &[RowRange],
    scaled: &DVector<f64>,
) {
    // Each recording is evaluated once for all its row ranges.
    for ranges in ranges.chunk_by(|a, b| a.part == b.part) {
        let Some(place) = ranges.iter().find(|s| !s.rows.is_empty()) else {
            continue;
        };
        let part = &problem.rows.parts[place.part];
        let modelled = problem.predict(place.part, scaled);
        for row in ranges.iter().flat_map(|range| range.rows.clone()) {
            let residual = part.field_g[row] - modelled.fields[row];
            tally.add((part, row), residual, problem.rows.slopes(&modelled.per_newton[row]));
        }
    }
}

/// Held-out errors of a fold.
pub(crate) fn held_out_errors(
    problem: &SensorProblem,
    fold: &Fold,
    scaled: &DVector<f64>,
) -> ErrorSums {
    let mut tally = ErrorSums::default();
    add_errors(&mut tally, problem, &fold.test, scaled);
    tally
}

/// Sum over blocks of this many parameters.
fn sum<'b>(size: usize, blocks: impl IntoIterator<Item = &'b Block>) -> Block {
    let mut sum = Block::zeros(size);
    blocks.into_iter().for_each(|block| sum += block);
    sum
}

/// Block length and correlation time of the residual, and normal equations in blocks of time.
fn linearised(problem: &SensorProblem, scaled: &DVector<f64>) -> ((f64, f64), Vec<Block>) {
    let rows: &SensorRows = problem.rows;
    let evaluated: Vec<(DMatrix<f64>, Vec<f64>)> =
        (0..rows.parts.len()).map(|part| weighted_jacobian(problem, part, scaled)).collect();
    let (length_s, correlation_s) = block_bootstrap::block_length_s(rows, |part, axis| {
        evaluated[part].1.iter().skip(axis).step_by(3).copied().collect()
    });
    let mut list = Vec::new();
    for (place, (part, (jacobian, residuals))) in rows.parts.iter().zip(&evaluated).enumerate() {
        let acting = problem.acting(place);
        let derivatives = (jacobian, &acting[..], scaled.len());
        for range in time_slices(&part.time_s, length_s) {
            list.push(Block::of(derivatives, residuals, 3 * range.start..3 * range.end));
        }
    }
    ((length_s, correlation_s), list)
}
