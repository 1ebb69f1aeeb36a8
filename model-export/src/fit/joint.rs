//! Joint fit of all sensors: base, effects, and parameters that the sensors share.

use crate::effects::EffectTerm;
use crate::fit::base_model::BaseModel;
use crate::fit::cross_validation::{CvSplit, ErrorSums, Fold, RowRange, all_rows};
use crate::fit::identifiability::{MAX_UNCERTAINTY, Unidentifiable, variance_inflation};
use crate::fit::initial_guess::{ShapeSearch, search_all};
use crate::fit::parameters::FreeParameter;
use crate::fit::problem::SensorProblem;
use crate::fit::rows::SensorRows;
use crate::fit::sensor_fit::{self, SensorSolution, add_errors, held_out_errors};
use crate::fit::shape_profile::ShapeProfile;
use crate::fit::{AxisScore, FitError, FitOptions};
use crate::physics::SensorOrientation;
use crate::recordings::columns::Axis;
use crate::recordings::in_order;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Variance inflation factor from which a parameter counts as confounded (usual limit in regression).
const MAX_VARIANCE_INFLATION: f64 = 10.0;

/// The fit of one sensor.
#[derive(Clone, Debug)]
pub struct SensorFit {
    /// Number of the sensor.
    pub sensor: u32,
    /// Forces of the fitted rows.
    pub forces: Vec<(u32, Axis)>,
    /// Its orientation.
    pub orientation: SensorOrientation,
    /// Base parameters, then those of each effect.
    pub parameters: Vec<FreeParameter>,
    /// Number of base parameters.
    pub base_count: usize,
    /// Whether the sensor's offset is confounded with the ambient field.
    pub offset_confounded: bool,
    /// Fitted values, in the order of the parameters.
    pub values: Vec<f64>,
    /// Covariance of the values.
    pub covariance: DMatrix<f64>,
    /// The part of each standard error that is of the prior: the recordings do not determine the value there.
    pub prior_errors: Vec<f64>,
    /// Whether the standard error is at most half a prior width.
    pub identifiable: Vec<bool>,
    /// Unidentifiable combinations.
    pub unidentifiable: Vec<Unidentifiable>,
    /// Held-out error and noise floor of each axis.
    pub scores: Vec<AxisScore>,
    /// Held-out errors of each fold.
    pub folds: Vec<ErrorSums>,
    /// Values fitted on the training rows of each fold.
    pub fold_values: Vec<Vec<f64>>,
    /// Bootstrap block length in seconds.
    pub block_s: f64,
    /// Longest correlation time of the residual in seconds.
    pub correlation_s: f64,
    /// Variance inflation of the data by autocorrelated or structured residuals.
    pub inflation: f64,
    /// Whether the priors of the base parameters were centred at nominal, not at the fit of the base alone.
    pub starts_nominal: bool,
}

impl SensorFit {
    /// Standard error of a value.
    pub fn std_error(&self, index: usize) -> f64 {
        self.covariance[(index, index)].max(0.0).sqrt()
    }

    /// Prior width of a value, at the value, in its unit.
    pub fn prior_width(&self, index: usize) -> f64 {
        let parameter = &self.parameters[index];
        parameter.derivative(parameter.to_scaled(self.values[index])).abs()
    }

    /// Held-out errors over all folds.
    pub fn tally(&self) -> ErrorSums {
        self.folds.iter().fold(ErrorSums::default(), |sum, fold| sum.with(fold))
    }
}

/// Fits of all sensors.
#[derive(Clone, Debug)]
pub struct JointFit {
    /// Cross-validation scheme.
    pub split: CvSplit,
    /// In ascending order of their numbers.
    pub sensors: Vec<SensorFit>,
    /// Shapes that the recordings do not exclude; empty where they were not searched ([`FitSetup::search_profiles`]).
    ///
    /// [`FitSetup::search_profiles`]: crate::fit::campaign::FitSetup::search_profiles
    pub profiles: Vec<ShapeProfile>,
}

impl JointFit {
    /// Held-out errors of all sensors, fold by fold.
    pub fn folds(&self) -> Vec<ErrorSums> {
        let count = self.sensors.first().map_or(0, |sensor| sensor.folds.len());
        let fold = |i: usize| {
            self.sensors.iter().fold(ErrorSums::default(), |sum, s| sum.with(&s.folds[i]))
        };
        (0..count).map(fold).collect()
    }

    /// Number of folds with values of their own.
    pub(crate) fn fold_count(&self) -> usize {
        self.sensors.iter().map(|sensor| sensor.fold_values.len()).min().unwrap_or(0)
    }

    /// The same fit with the values of one fold's training rows.
    pub fn without(&self, fold: usize) -> Self {
        let of_fold = |sensor: &SensorFit| sensor.fold_values.get(fold).cloned();
        self.with_values(self.sensors.iter().map(of_fold))
    }

    /// The same fit with other values of the sensors.
    pub fn with_values(&self, values: impl Iterator<Item = Option<Vec<f64>>>) -> Self {
        let with = |(sensor, values): (&SensorFit, Option<Vec<f64>>)| SensorFit {
            values: values.unwrap_or_else(|| sensor.values.clone()),
            ..sensor.clone()
        };
        Self {
            sensors: self.sensors.iter().zip(values).map(with).collect(),
            split: self.split,
            profiles: Vec::new(),
        }
    }

    /// Mean square over all channels on the fitted rows, in gauss squared.
    pub fn fitted_mean_square(&self) -> f64 {
        let scores = || self.sensors.iter().flat_map(|sensor| &sensor.scores);
        let squares: f64 = scores().map(|score| score.fitted_rms_g.powi(2)).sum();
        squares / scores().count().max(1) as f64
    }

    /// Held-out errors over all sensors and folds.
    pub fn tally(&self) -> ErrorSums {
        self.sensors.iter().fold(ErrorSums::default(), |sum, sensor| sum.with(&sensor.tally()))
    }
}

/// Fits of the sensors without effects, from which every fit with effects starts.
pub struct BaseFits {
    solutions: Vec<SensorSolution>,
    /// Of each sensor: values fitted on the training rows of a fold.
    of_training: Vec<Mutex<HashMap<Vec<RowRange>, Vec<f64>>>>,
}

impl BaseFits {
    /// Fits every sensor.
    ///
    /// # Errors
    /// A fit fails.
    pub fn new(rows: &[SensorRows], bases: &[Arc<dyn BaseModel>]) -> Result<Self, FitError> {
        let pairs: Vec<_> = rows.iter().zip(bases).collect();
        let solutions = in_order(pairs.par_iter().map(|(rows, base)| {
            sensor_fit::fit_from_nominal(&SensorProblem::new(rows, base.as_ref(), &[]))
        }))?;
        let of_training = solutions.iter().map(|_| Mutex::default()).collect();
        Ok(Self { solutions, of_training })
    }

    /// Values of one sensor on these rows: fitted once for all models.
    fn on(
        &self,
        sensor: usize,
        problem: &SensorProblem,
        training: &[RowRange],
    ) -> Result<Vec<f64>, FitError> {
        let known = || self.of_training[sensor].lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(values) = known().get(training) {
            return Ok(values.clone());
        }
        let solution = &self.solutions[sensor];
        let start = (&solution.scaled, solution.normal_equations(problem.rows, training));
        let scaled = solution.refit(problem, training, start)?;
        let values = problem.values(&scaled);
        known().insert(training.to_vec(), values.clone());
        Ok(values)
    }
}

/// Fits every sensor with its base and the effects (in any order), starting from `base_fits` without
/// effects, or from a fit `near` of the same effects to other rows of these recordings. `done` is called after each sensor,
/// from any thread.
pub fn fit(
    rows: &[SensorRows],
    bases: &[Arc<dyn BaseModel>],
    base_fits: &BaseFits,
    effects: &[EffectTerm],
    near: Option<&JointFit>,
    (split, options): (CvSplit, FitOptions),
    done: impl Fn(u32) + Sync,
) -> Result<JointFit, FitError> {
    let mut effects = effects.to_vec();
    effects.sort_by_key(EffectTerm::stage);
    let alone: Vec<SensorProblem> = rows
        .iter()
        .zip(bases)
        .map(|(rows, base)| SensorProblem::new(rows, base.as_ref(), &[]))
        .collect();
    let folds = if effects.is_empty() {
        let states = base_fits.solutions.clone();
        let covariances = states.par_iter().map(|state| state.covariance(options)).collect();
        let folds = cross_validate(&alone, &states, split, None)?;
        (alone, states, covariances, folds)
    } else {
        let states = match near {
            Some(near) => from_near(&alone, base_fits, &effects, near)?,
            None => with_effects(&alone, base_fits, &effects)?,
        };
        let (problems, states): (Vec<_>, Vec<_>) = states.into_iter().unzip();
        let (states, covariances) = pool_shared(&problems, states, options)?;
        let folds = cross_validate(&problems, &states, split, Some((base_fits, &alone[..])))?;
        (problems, states, covariances, folds)
    };
    let (problems, states, covariances, folds): (
        Vec<SensorProblem>,
        Vec<SensorSolution>,
        Vec<DMatrix<f64>>,
        _,
    ) = folds;
    let finished = problems.par_iter().zip(&states).zip(covariances).zip(folds);
    let sensors = finished
        .map(|(((problem, state), covariance), (values, tallies))| {
            let fit = sensor_result(problem, state, covariance, values, tallies);
            done(fit.sensor);
            fit
        })
        .collect();
    Ok(JointFit { split, sensors, profiles: Vec::new() })
}

type SensorStates<'a> = Vec<(SensorProblem<'a>, SensorSolution)>;
/// Values and held-out errors of each fold, of one sensor.
type FoldResults = (Vec<Vec<f64>>, Vec<ErrorSums>);

/// Adds effects to the fits of the bases.
fn with_effects<'a>(
    bases: &[SensorProblem<'a>],
    base_fits: &BaseFits,
    effects: &'a [EffectTerm],
) -> Result<SensorStates<'a>, FitError> {
    let mut searches: Vec<ShapeSearch> = bases
        .par_iter()
        .zip(&base_fits.solutions)
        .map(|(problem, state)| {
            let base_values = problem.values(&state.scaled);
            ShapeSearch::new(SensorProblem::new(problem.rows, problem.base, effects), &base_values)
        })
        .collect();
    search_all(&mut searches);
    let fits = searches.into_par_iter();
    in_order(fits.map(|search| sensor_fit::fit_from_base(search.problem, &search.values)))
}

/// Fits the effects from a fit of them to other rows, whose shapes are kept.
fn from_near<'a>(
    bases: &[SensorProblem<'a>],
    base_fits: &BaseFits,
    effects: &'a [EffectTerm],
    near: &JointFit,
) -> Result<SensorStates<'a>, FitError> {
    bases
        .par_iter()
        .zip(&base_fits.solutions)
        .zip(&near.sensors)
        .map(|((base, state), near)| {
            let mut problem = SensorProblem::new(base.rows, base.base, effects);
            if near.starts_nominal {
                problem.set_nominal_start();
            } else {
                problem.set_base_start(&base.values(&state.scaled));
            }
            let of_effects = problem.base_count..;
            problem.parameters[of_effects.clone()].clone_from_slice(&near.parameters[of_effects]);
            let start = problem.to_scaled(&near.values);
            let solution = sensor_fit::fit_identifiable(&problem, &start, &[])?;
            Ok((problem, solution))
        })
        .collect()
}

fn shared_slots(problem: &SensorProblem) -> Vec<usize> {
    (0..problem.parameters.len())
        .filter(|&index| {
            problem.parameters[index].shared && problem.parameters[index].preset_sigma.is_none()
        })
        .collect()
}

fn shared_estimate(
    scaled: &DVector<f64>,
    covariance: &DMatrix<f64>,
    shared: &[usize],
) -> SensorEstimate {
    SensorEstimate {
        value: DVector::from_iterator(shared.len(), shared.iter().map(|&index| scaled[index])),
        covariance: covariance.select_rows(shared).select_columns(shared),
    }
}

/// Pools the shared parameters, fixes them and fits the rest again.
fn pool_shared(
    problems: &[SensorProblem],
    states: Vec<SensorSolution>,
    options: FitOptions,
) -> Result<(Vec<SensorSolution>, Vec<DMatrix<f64>>), FitError> {
    let covariances: Vec<DMatrix<f64>> =
        states.par_iter().map(|state| state.covariance(options)).collect();
    let estimates: Vec<SensorEstimate> = problems
        .iter()
        .zip(&states)
        .zip(&covariances)
        .map(|((problem, state), covariance)| {
            shared_estimate(&state.scaled, covariance, &shared_slots(problem))
        })
        .collect();
    let Some(pooled) = pool_estimates(&estimates).filter(|pooled| !pooled.value.is_empty()) else {
        return Ok((states, covariances));
    };
    let fixed = problems
        .par_iter()
        .zip(states)
        .map(|(problem, state)| {
            let shared = shared_slots(problem);
            let mut start = state.scaled;
            shared
                .iter()
                .zip(pooled.value.iter())
                .for_each(|(&index, value)| start[index] = *value);
            let state = sensor_fit::fit_identifiable(problem, &start, &shared)?;
            let mut covariance = state.covariance(options);
            for (i, &index) in shared.iter().enumerate() {
                for (j, &other) in shared.iter().enumerate() {
                    covariance[(index, other)] = pooled.covariance[(i, j)];
                }
            }
            Ok((state, covariance))
        })
        .collect::<Result<Vec<_>, FitError>>()?;
    Ok(fixed.into_iter().unzip())
}

/// Cross-validates every sensor. Shared parameters and the base (`base_fits` with their problems, where there are effects) are
/// estimated anew in each fold.
fn cross_validate(
    problems: &[SensorProblem],
    states: &[SensorSolution],
    split: CvSplit,
    base_fits: Option<(&BaseFits, &[SensorProblem])>,
) -> Result<Vec<FoldResults>, FitError> {
    let folds: Vec<_> = problems
        .iter()
        .zip(states)
        .map(|(problem, state)| split.folds(problem.rows, state.length_s))
        .collect();
    let count = folds.first().map_or(0, Vec::len);
    let mut results: Vec<FoldResults> = vec![Default::default(); problems.len()];
    for i in 0..count {
        let folds: Vec<&Fold> = folds.iter().map(|folds| &folds[i]).collect();
        let results_of_fold = cross_validate_fold(problems, states, &folds, base_fits)?;
        for (result, (values, tally)) in results.iter_mut().zip(results_of_fold) {
            result.0.push(values);
            result.1.push(tally);
        }
    }
    Ok(results)
}

fn cross_validate_fold(
    problems: &[SensorProblem],
    states: &[SensorSolution],
    folds: &[&Fold],
    base_fits: Option<(&BaseFits, &[SensorProblem])>,
) -> Result<Vec<(Vec<f64>, ErrorSums)>, FitError> {
    let prepared: Vec<(SensorProblem, DVector<f64>)> = (0..problems.len())
        .into_par_iter()
        .map(|s| {
            let mut problem = problems[s].clone();
            let values = problem.values(&states[s].scaled);
            problem.set_shape_start(&values);
            if let Some((base_fits, bases)) = base_fits.filter(|_| !problem.starts_nominal) {
                problem.set_base_start(&base_fits.on(s, &bases[s], &folds[s].training)?);
            }
            let start = problem.to_scaled(&values);
            Ok((problem, start))
        })
        .collect::<Result<_, FitError>>()?;
    let for_all = |refit: &(dyn Fn(usize) -> Result<DVector<f64>, FitError> + Sync)| {
        in_order((0..problems.len()).into_par_iter().map(refit))
    };
    let fitted = if problems.iter().any(|problem| !shared_slots(problem).is_empty()) {
        let opened = for_all(&|s| {
            let (problem, start) = &prepared[s];
            let freed = states[s].with_freed(&shared_slots(problem));
            let known = freed.normal_equations(problem.rows, &folds[s].training);
            freed.refit(problem, &folds[s].training, (start, known))
        })?;
        let mean =
            |index: usize| opened.iter().map(|d| d[index]).sum::<f64>() / opened.len() as f64;
        for_all(&|s| {
            let (problem, start) = &prepared[s];
            let mut start = start.clone();
            shared_slots(problem).into_iter().for_each(|index| start[index] = mean(index));
            states[s].refit(problem, &folds[s].training, (&start, None))
        })?
    } else {
        for_all(&|s| {
            let (problem, start) = &prepared[s];
            let known = states[s].normal_equations(problem.rows, &folds[s].training);
            states[s].refit(problem, &folds[s].training, (start, known))
        })?
    };
    let results_of_fold = fitted.into_par_iter().enumerate().map(|(s, scaled)| {
        let problem = &prepared[s].0;
        (problem.values(&scaled), held_out_errors(problem, folds[s], &scaled))
    });
    Ok(results_of_fold.collect())
}

fn sensor_result(
    problem: &SensorProblem,
    state: &SensorSolution,
    mut covariance: DMatrix<f64>,
    fold_values: Vec<Vec<f64>>,
    folds: Vec<ErrorSums>,
) -> SensorFit {
    for index in problem.preset() {
        covariance[(index, index)] =
            problem.parameters[index].preset_sigma.map_or(0.0, |error| error * error);
    }
    let mut training = ErrorSums::default();
    add_errors(&mut training, problem, &all_rows(problem.rows), &state.scaled);
    let whole = folds.iter().fold(ErrorSums::default(), |sum, fold| sum.with(fold));
    let derivatives: Vec<f64> = problem
        .parameters
        .iter()
        .zip(state.scaled.iter())
        .map(|(index, &scaled)| index.derivative(scaled))
        .collect();
    let size = derivatives.len();
    SensorFit {
        sensor: problem.rows.sensor,
        forces: problem.rows.forces.clone(),
        orientation: problem.rows.orientation,
        base_count: problem.base_count,
        offset_confounded: (0..problem.offset_count)
            .any(|index| variance_inflation(&state.blocks, index) > MAX_VARIANCE_INFLATION),
        values: problem.values(&state.scaled),
        prior_errors: state
            .space
            .prior_deviations()
            .iter()
            .zip(&derivatives)
            .map(|(deviation, derivative)| (deviation * derivative).abs())
            .collect(),
        identifiable: (0..size)
            .map(|i| covariance[(i, i)].max(0.0).sqrt() <= MAX_UNCERTAINTY)
            .collect(),
        covariance: DMatrix::from_fn(size, size, |i, j| {
            covariance[(i, j)] * derivatives[i] * derivatives[j]
        }),
        unidentifiable: state.space.unidentifiable.clone(),
        scores: whole.scores(&training, problem.rows.sensor, problem.rows.field_span()),
        folds,
        fold_values,
        block_s: state.length_s,
        correlation_s: state.correlation_s,
        inflation: state.inflation,
        starts_nominal: problem.starts_nominal,
        parameters: problem.parameters.clone(),
    }
}

/// Estimate of the shared parameters by one sensor, with covariance, in prior widths.
#[derive(Clone, Debug)]
pub struct SensorEstimate {
    /// Estimates.
    pub value: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
}

/// Inverse-covariance weighted mean of all sensors, with its covariance. Scatter between sensors beyond their
/// error bars widens it (Birge 1932).
pub(crate) fn pool_estimates(estimates: &[SensorEstimate]) -> Option<SensorEstimate> {
    let size = estimates.first()?.value.len();
    let mut precision = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    let mut weights = Vec::new();
    for estimate in estimates {
        let ridge = DMatrix::identity(size, size) * 1e-12;
        let weight = (&estimate.covariance + ridge).cholesky()?.inverse();
        precision += &weight;
        right += &weight * &estimate.value;
        weights.push(weight);
    }
    let covariance = precision.cholesky()?.inverse();
    let value = &covariance * right;
    let scatter: f64 = estimates
        .iter()
        .zip(&weights)
        .map(|(estimate, weight)| {
            let off = &estimate.value - &value;
            off.dot(&(weight * &off))
        })
        .sum();
    let freedom = (size * (estimates.len() - 1)) as f64;
    let birge = if freedom > 0.0 { (scatter / freedom).max(1.0) } else { 1.0 };
    Some(SensorEstimate { value, covariance: covariance * birge })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shared_estimate(value: f64, error: f64) -> SensorEstimate {
        SensorEstimate {
            value: DVector::from_element(1, value),
            covariance: DMatrix::from_element(1, 1, error * error),
        }
    }

    #[test]
    fn pooling_weights_by_precision_and_scatter_widens_the_error() {
        // 1/4 and 1 are the weights of errors 2 and 1: (0.25 * 10 + 1 * 5) / 1.25 = 6.
        let pooled =
            pool_estimates(&[shared_estimate(10.0, 2.0), shared_estimate(5.0, 1.0)]).unwrap();
        assert!((pooled.value[0] - 6.0).abs() < 1e-9);
        // Chi squared (4/2)^2 + (1/1)^2 = 5 for one degree of freedom: variance 5 / 1.25.
        assert!((pooled.covariance[(0, 0)] - 4.0).abs() < 1e-6);
        let agreeing =
            pool_estimates(&[shared_estimate(5.0, 2.0), shared_estimate(5.0, 1.0)]).unwrap();
        assert!((agreeing.covariance[(0, 0)] - 0.8).abs() < 1e-6);
    }
}
