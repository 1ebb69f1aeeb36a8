//! All sensors of a gripper fitted together: base, effects, and what the sensors share.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::base::Base;
use super::folds::{Fold, Split, everything};
use super::pool::{Witness, pool};
use super::problem::SensorProblem;
use super::rows::SensorRows;
use super::score::Tally;
use super::sensor::{self, State, held_out, judge};
use super::slot::Slot;
use super::space::{Held, KNOWN_WITHIN, variance_inflation};
use super::start::{Seeker, seek};
use super::{AxisScore, FitError, Options};
use crate::effects::Addition;

/// From this factor on, by which its variance grows because others can stand in for it, a number counts
/// as not told apart from them (the usual limit of regression).
const COLLINEAR: f64 = 10.0;

/// The fit of one sensor.
#[derive(Clone, Debug)]
pub struct SensorFit {
    /// Number of the sensor.
    pub sensor: u32,
    /// Every parameter: of the base, then of each effect.
    pub slots: Vec<Slot>,
    /// Number of the base's parameters.
    pub base_count: usize,
    /// True where the data do not tell the sensor's own offset from the field that stands around it.
    pub offset_is_open: bool,
    /// Fitted values, in the order of the slots.
    pub values: Vec<f64>,
    /// Covariance of the values.
    pub covariance: DMatrix<f64>,
    /// Whether the data know each to half its tolerance.
    pub identifiable: Vec<bool>,
    /// What was held.
    pub held: Vec<Held>,
    /// Held-out error beside the floor, each axis.
    pub scores: Vec<AxisScore>,
    /// Held-out tally of each fold.
    pub folds: Vec<Tally>,
    /// Values fitted without each fold.
    pub fold_values: Vec<Vec<f64>>,
    /// Length of the bootstrap's blocks in seconds.
    pub block_s: f64,
}

impl SensorFit {
    /// One standard deviation of a value.
    pub fn std_error(&self, slot: usize) -> f64 {
        self.covariance[(slot, slot)].max(0.0).sqrt()
    }

    /// All folds together.
    pub fn tally(&self) -> Tally {
        self.folds
            .iter()
            .fold(Tally::default(), |sum, fold| sum.with(fold))
    }
}

/// The fits of all sensors.
#[derive(Clone, Debug)]
pub struct JointFit {
    /// How the campaign was split to judge the fit.
    pub split: Split,
    /// In the order of their numbers.
    pub sensors: Vec<SensorFit>,
}

impl JointFit {
    /// Held-out errors of all sensors, fold by fold.
    pub fn folds(&self) -> Vec<Tally> {
        let count = self.sensors.first().map_or(0, |sensor| sensor.folds.len());
        let fold = |i: usize| {
            self.sensors
                .iter()
                .fold(Tally::default(), |sum, s| sum.with(&s.folds[i]))
        };
        (0..count).map(fold).collect()
    }

    /// The same fit with the values that were found without one fold.
    pub fn without(&self, fold: usize) -> Self {
        let mut other = self.clone();
        for sensor in &mut other.sensors {
            if let Some(values) = sensor.fold_values.get(fold) {
                sensor.values.clone_from(values);
            }
        }
        other
    }

    /// Held-out errors of everything.
    pub fn tally(&self) -> Tally {
        self.sensors
            .iter()
            .fold(Tally::default(), |sum, sensor| sum.with(&sensor.tally()))
    }
}

/// The fit of each sensor's base alone, from which effects depart.
pub fn bases(rows: &[SensorRows], bases: &[Box<dyn Base>]) -> Result<Vec<State>, FitError> {
    let pairs: Vec<_> = rows.iter().zip(bases).collect();
    pairs
        .par_iter()
        .map(|(rows, base)| sensor::first(&SensorProblem::new(rows, base.as_ref(), &[])))
        .collect()
}

/// Fits every sensor with its base, whose fit alone is `alone`, and the effects (in any order).
/// `split` says how it is judged; `done` is called after each sensor, from any thread.
pub fn fit(
    rows: &[SensorRows],
    bases: &[Box<dyn Base>],
    alone: &[State],
    effects: &[Addition],
    split: Split,
    options: Options,
    done: impl Fn(u32) + Sync,
) -> Result<JointFit, FitError> {
    let mut effects = effects.to_vec();
    effects.sort_by_key(Addition::stage);
    let problems = rows
        .iter()
        .zip(bases)
        .map(|(rows, base)| SensorProblem::new(rows, base.as_ref(), &[]));
    let alone: Started = problems.zip(alone.iter().cloned()).collect();
    let folds = match effects.is_empty() {
        true => {
            let (problems, states): (Vec<_>, Vec<_>) = alone.into_iter().unzip();
            let covariances = states
                .par_iter()
                .map(|state| state.covariance(options))
                .collect();
            let folds = cross_validate(&problems, &states, split, None)?;
            (problems, states, covariances, folds)
        }
        false => {
            let (problems, states): (Vec<_>, Vec<_>) =
                with_effects(&alone, &effects)?.into_iter().unzip();
            let (states, covariances) = share(&problems, states, options)?;
            let folds = cross_validate(&problems, &states, split, Some(&alone))?;
            (problems, states, covariances, folds)
        }
    };
    let (problems, states, covariances, folds): (
        Vec<SensorProblem>,
        Vec<State>,
        Vec<DMatrix<f64>>,
        _,
    ) = folds;
    let finished = problems.par_iter().zip(&states).zip(covariances).zip(folds);
    let sensors = finished
        .map(|(((problem, state), covariance), (values, tallies))| {
            let fit = close(problem, state, covariance, values, tallies);
            done(fit.sensor);
            fit
        })
        .collect();
    Ok(JointFit { split, sensors })
}

type Started<'a> = Vec<(SensorProblem<'a>, State)>;
/// Of one sensor: values and held-out errors of each fold.
type Judged = (Vec<Vec<f64>>, Vec<Tally>);

/// The same sensors with effects, from the fits of their bases.
fn with_effects<'a>(alone: &Started<'a>, effects: &'a [Addition]) -> Result<Started<'a>, FitError> {
    let mut seekers: Vec<Seeker> = alone
        .par_iter()
        .map(|(problem, state)| {
            let base_values = problem.values(&state.departures);
            Seeker::new(
                SensorProblem::new(problem.rows, problem.base, effects),
                &base_values,
            )
        })
        .collect();
    seek(&mut seekers);
    seekers
        .into_par_iter()
        .map(|seeker| {
            let start = seeker.problem.departures(&seeker.values);
            let near = sensor::approach(&seeker.problem, &start)?;
            let state = sensor::settle(&seeker.problem, &near, &[])?;
            Ok((seeker.problem, state))
        })
        .collect()
}

fn shared_slots(problem: &SensorProblem) -> Vec<usize> {
    (0..problem.slots.len())
        .filter(|&slot| problem.slots[slot].shared && problem.slots[slot].chosen.is_none())
        .collect()
}

fn witness(departures: &DVector<f64>, covariance: &DMatrix<f64>, shared: &[usize]) -> Witness {
    Witness {
        value: DVector::from_iterator(shared.len(), shared.iter().map(|&slot| departures[slot])),
        covariance: covariance.select_rows(shared).select_columns(shared),
    }
}

/// Sets what the sensors share to one value and fits the rest again.
fn share(
    problems: &[SensorProblem],
    states: Vec<State>,
    options: Options,
) -> Result<(Vec<State>, Vec<DMatrix<f64>>), FitError> {
    let covariances: Vec<DMatrix<f64>> = states
        .par_iter()
        .map(|state| state.covariance(options))
        .collect();
    let witnesses: Vec<Witness> = problems
        .iter()
        .zip(&states)
        .zip(&covariances)
        .map(|((problem, state), covariance)| {
            witness(&state.departures, covariance, &shared_slots(problem))
        })
        .collect();
    let Some(pooled) = pool(&witnesses).filter(|pooled| !pooled.value.is_empty()) else {
        return Ok((states, covariances));
    };
    let fixed = problems
        .par_iter()
        .zip(states)
        .map(|(problem, state)| {
            let shared = shared_slots(problem);
            let mut start = state.departures;
            shared
                .iter()
                .zip(pooled.value.iter())
                .for_each(|(&slot, value)| start[slot] = *value);
            let state = sensor::settle(problem, &start, &shared)?;
            let mut covariance = state.covariance(options);
            for (i, &slot) in shared.iter().enumerate() {
                for (j, &other) in shared.iter().enumerate() {
                    covariance[(slot, other)] = pooled.covariance[(i, j)];
                }
            }
            Ok((state, covariance))
        })
        .collect::<Result<Vec<_>, FitError>>()?;
    Ok(fixed.into_iter().unzip())
}

/// Each sensor judged on each fold. What is shared, and the base from which the effects depart, are
/// estimated anew in each: `alone` holds the fits of the bases, where there are effects.
fn cross_validate(
    problems: &[SensorProblem],
    states: &[State],
    split: Split,
    alone: Option<&Started>,
) -> Result<Vec<Judged>, FitError> {
    let folds: Vec<_> = problems
        .iter()
        .zip(states)
        .map(|(problem, state)| split.folds(problem.rows, state.length_s))
        .collect();
    let count = folds.first().map_or(0, Vec::len);
    let mut results: Vec<Judged> = vec![Default::default(); problems.len()];
    for i in 0..count {
        let folds: Vec<&Fold> = folds.iter().map(|folds| &folds[i]).collect();
        let judged = judge_fold(problems, states, &folds, alone)?;
        for (result, (values, tally)) in results.iter_mut().zip(judged) {
            result.0.push(values);
            result.1.push(tally);
        }
    }
    Ok(results)
}

fn judge_fold(
    problems: &[SensorProblem],
    states: &[State],
    folds: &[&Fold],
    alone: Option<&Started>,
) -> Result<Vec<(Vec<f64>, Tally)>, FitError> {
    let centred: Vec<(SensorProblem, DVector<f64>)> = (0..problems.len())
        .into_par_iter()
        .map(|s| {
            let mut problem = problems[s].clone();
            let values = problem.values(&states[s].departures);
            problem.centre_shapes(&values);
            if let Some((base, state)) = alone.and_then(|alone| alone.get(s)) {
                let found = state.refit(base, &folds[s].training, &state.departures)?;
                problem.centre_base(&base.values(&found));
            }
            let start = problem.departures(&values);
            Ok((problem, start))
        })
        .collect::<Result<_, FitError>>()?;
    let refit = |starts: &[DVector<f64>], open: bool| {
        (0..problems.len())
            .into_par_iter()
            .map(|s| {
                let (problem, training) = (&centred[s].0, &folds[s].training);
                match open {
                    false => states[s].refit(problem, training, &starts[s]),
                    true => states[s]
                        .opened(&shared_slots(problem))
                        .refit(problem, training, &starts[s]),
                }
            })
            .collect::<Result<Vec<_>, FitError>>()
    };
    let mut starts: Vec<DVector<f64>> = centred.iter().map(|(_, start)| start.clone()).collect();
    if problems
        .iter()
        .any(|problem| !shared_slots(problem).is_empty())
    {
        let opened = refit(&starts, true)?;
        let mean = |slot: usize| opened.iter().map(|d| d[slot]).sum::<f64>() / opened.len() as f64;
        for (problem, start) in problems.iter().zip(&mut starts) {
            shared_slots(problem)
                .into_iter()
                .for_each(|slot| start[slot] = mean(slot));
        }
    }
    let judged = refit(&starts, false)?
        .into_iter()
        .enumerate()
        .map(|(s, departures)| {
            let problem = &centred[s].0;
            (
                problem.values(&departures),
                held_out(problem, folds[s], &departures),
            )
        });
    Ok(judged.collect())
}

fn close(
    problem: &SensorProblem,
    state: &State,
    mut covariance: DMatrix<f64>,
    fold_values: Vec<Vec<f64>>,
    folds: Vec<Tally>,
) -> SensorFit {
    for slot in problem.chosen() {
        covariance[(slot, slot)] = problem.slots[slot]
            .chosen
            .map_or(0.0, |error| error * error);
    }
    let mut seen = Tally::default();
    judge(
        &mut seen,
        problem,
        &everything(problem.rows),
        &state.departures,
    );
    let whole = folds
        .iter()
        .fold(Tally::default(), |sum, fold| sum.with(fold));
    let slopes: Vec<f64> = problem
        .slots
        .iter()
        .zip(state.departures.iter())
        .map(|(slot, &departure)| slot.slope(departure))
        .collect();
    let size = slopes.len();
    SensorFit {
        sensor: problem.rows.sensor,
        base_count: problem.base_count,
        offset_is_open: (0..problem.offsets)
            .any(|slot| variance_inflation(&state.blocks, slot) > COLLINEAR),
        values: problem.values(&state.departures),
        identifiable: (0..size)
            .map(|i| covariance[(i, i)].max(0.0).sqrt() <= KNOWN_WITHIN)
            .collect(),
        covariance: DMatrix::from_fn(size, size, |i, j| {
            covariance[(i, j)] * slopes[i] * slopes[j]
        }),
        held: state.space.held.clone(),
        scores: whole.scores(&seen, problem.rows.sensor, problem.rows.field_span()),
        folds,
        fold_values,
        block_s: state.length_s,
        slots: problem.slots.clone(),
    }
}
