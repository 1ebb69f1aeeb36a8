//! The fit of one sensor, step by step.
//!
//! Fourteen parameters describe a sensor, effects add theirs, and a recording seldom tells all of
//! them apart: a larger gap looks like a weaker magnet, a tilted magnet like a shifted one. Left
//! alone, such a fit runs away, above all when the model lacks an effect. So a prior as wide as the
//! manufacturing tolerances stays on throughout, and it is weighed against what the data really
//! tell: where the residual has memory or structure, a thousand rows are no thousand witnesses, and
//! the data's weight is lowered by that factor ([`inflation`]).
//!
//! Every direction in the space of parameters (in tolerances) is then judged by the residual
//! itself: one whose error bar is wider than half a tolerance is not known from these data and is
//! held at its start while the others are fitted. Which directions are held is decided once, on all
//! recordings; the values are fitted anew for each recording left out.

use nalgebra::{DMatrix, DVector, Vector3};

use super::blocks::{self, Block};
use super::folds::{Fold, Stretch, everything, stretches};
use super::problem::SensorProblem;
use super::rows::SensorRows;
use super::score::Tally;
use super::solve::{NEAR, THERE, solve, weighted};
use super::space::{Space, inflation};
use super::{FitError, Options};

/// Lowers the data's weight in the first round, before their residual is known.
const FIRST_INFLATION: f64 = 1e4;

/// Where the fit of a sensor stands.
#[derive(Clone, Debug)]
pub struct State {
    /// Solution, in departures.
    pub departures: DVector<f64>,
    /// Weight of each axis that the data deserve.
    pub weights: Vector3<f64>,
    /// What may move.
    pub space: Space,
    /// Length of a block in seconds.
    pub length_s: f64,
    /// The normal equations at the solution, in blocks of time.
    pub blocks: Vec<Block>,
}

/// From nothing known: with the data's weight low, to see their residual; then with the weight that
/// it deserves; last with what the data do not tell held at its start.
pub fn first(problem: &SensorProblem) -> Result<State, FitError> {
    let whole = Space::all_but(&problem.chosen(), problem.slots.len());
    let start = DVector::zeros(problem.slots.len());
    let all = everything(problem.rows);
    let low = problem.weights / FIRST_INFLATION.sqrt();
    let first = solve(problem, &all, low, &whole, &start, NEAR)?;
    let (_, blocks) = linearised(problem, &first);
    let second = solve(
        problem,
        &all,
        problem.weights / inflation(&blocks).sqrt(),
        &whole,
        &first,
        NEAR,
    )?;
    settle(problem, &second, &[])
}

/// From a start that is near: everything free, so that the residual shows what the data can tell.
pub fn approach(problem: &SensorProblem, start: &DVector<f64>) -> Result<DVector<f64>, FitError> {
    let whole = Space::all_but(&problem.chosen(), problem.slots.len());
    let all = everything(problem.rows);
    let mut departures = start.clone();
    for _ in 0..2 {
        let (_, blocks) = linearised(problem, &departures);
        let weights = problem.weights / inflation(&blocks).sqrt();
        departures = solve(problem, &all, weights, &whole, &departures, NEAR)?;
    }
    Ok(departures)
}

/// From a start close by: weights and held directions anew, then the solution. `frozen` parameters
/// stay as they are.
pub fn settle(
    problem: &SensorProblem,
    start: &DVector<f64>,
    frozen: &[usize],
) -> Result<State, FitError> {
    let (_, blocks) = linearised(problem, start);
    let weights = problem.weights / inflation(&blocks).sqrt();
    let frozen: Vec<usize> = frozen.iter().copied().chain(problem.chosen()).collect();
    let space = Space::known_from(&blocks, &problem.slots, &frozen);
    if space.free.ncols() == 0 {
        return Err(FitError::NotConverged {
            sensor: problem.rows.sensor,
            reason: "these recordings tell none of its parameters".to_owned(),
        });
    }
    let all = everything(problem.rows);
    let departures = solve(problem, &all, weights, &space, start, THERE)?;
    let (length_s, blocks) = linearised(problem, &departures);
    Ok(State {
        departures,
        weights,
        space,
        length_s,
        blocks,
    })
}

impl State {
    /// The solution on other rows, with the same weights and the same directions.
    pub fn refit(
        &self,
        problem: &SensorProblem,
        training: &[Stretch],
        start: &DVector<f64>,
    ) -> Result<DVector<f64>, FitError> {
        solve(problem, training, self.weights, &self.space, start, THERE)
    }

    /// The same with these parameters, frozen so far, free to move.
    pub fn opened(&self, slots: &[usize]) -> Self {
        Self {
            space: self.space.with_free(slots),
            ..self.clone()
        }
    }

    /// Covariance of the departures.
    pub fn covariance(&self, options: Options) -> DMatrix<f64> {
        self.space.covariance(&self.blocks, options)
    }
}

/// Adds the errors of `departures` over some rows to a tally.
pub fn judge(
    tally: &mut Tally,
    problem: &SensorProblem,
    stretches: &[Stretch],
    departures: &DVector<f64>,
) {
    // A recording is evaluated once, however many stretches of it are judged.
    for stretches in stretches.chunk_by(|a, b| a.part == b.part) {
        let Some(place) = stretches.iter().find(|s| !s.rows.is_empty()) else {
            continue;
        };
        let part = &problem.rows.parts[place.part];
        let linear = problem.linear(place.part, departures);
        for row in stretches.iter().flat_map(|stretch| stretch.rows.clone()) {
            let residual = part.field_g[row] - linear.fields[row];
            tally.add(part, residual, problem.rows.slopes(&linear.per_newton[row]));
        }
    }
}

/// Held-out errors of a fold.
pub fn held_out(problem: &SensorProblem, fold: &Fold, departures: &DVector<f64>) -> Tally {
    let mut tally = Tally::default();
    judge(&mut tally, problem, &fold.test, departures);
    tally
}

/// The normal equations at `departures`, in blocks of time; and the length of a block in seconds.
fn linearised(problem: &SensorProblem, departures: &DVector<f64>) -> (f64, Vec<Block>) {
    let rows: &SensorRows = problem.rows;
    let evaluated: Vec<(DMatrix<f64>, Vec<f64>)> = (0..rows.parts.len())
        .map(|part| weighted(problem, part, departures, &problem.weights))
        .collect();
    let length_s = blocks::length_s(rows, |part, axis| {
        evaluated[part]
            .1
            .iter()
            .skip(axis)
            .step_by(3)
            .copied()
            .collect()
    });
    let mut list = Vec::new();
    for (part, (jacobian, residuals)) in rows.parts.iter().zip(&evaluated) {
        for range in stretches(&part.time_s, length_s) {
            let rows = 3 * range.start..3 * range.end;
            list.push(Block::of(
                jacobian.rows_range(rows.clone()),
                &residuals[rows],
            ));
        }
    }
    (length_s, list)
}
