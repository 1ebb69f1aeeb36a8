//! Rows of a fitted model for the search: whitened residual, Jacobian, and response of the field at each point of the chain.

use std::ops::Range;

use model_export::effects::{EffectParameter, EffectTerm, ExcitationSeries};
use model_export::fit::campaign::FitSetup;
use model_export::fit::cross_validation::CvSplit;
use model_export::fit::problem::SensorProblem;
use model_export::fit::rows::RecordingRows;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;

use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::formulas::chain_points::ChainPoint;

/// Rate in Hz to which rows are averaged.
const RATE_HZ: f64 = 25.0;
/// Rows of a sensor after averaging, at least: fewer are not averaged.
const MIN_ROWS: usize = 1000;
/// Maximum number of averaged rows of a sensor; more are left out evenly.
const MAX_ROWS: usize = 4000;
/// Folds where there is one recording.
const FOLDS: usize = 6;

/// Averaged rows of one recording: ranges of its rows.
pub type Windows = Vec<Range<usize>>;

/// Windows of every recording, the same for all quantities of a sensor.
pub fn windows(setup: &FitSetup) -> Vec<Vec<Windows>> {
    let of_sensor = |rows: &model_export::fit::rows::SensorRows| {
        let period_s = rows.parts.iter().find_map(|part| {
            let span_s = part.time_s.last()? - part.time_s.first()?;
            (part.len() > 1 && span_s > 0.0).then(|| span_s / (part.len() - 1) as f64)
        });
        let count: usize = rows.parts.iter().map(|part| part.len()).sum();
        let length = period_s.map_or(1, |period_s| (1.0 / (RATE_HZ * period_s)) as usize);
        let length = length.min(count / MIN_ROWS).max(1);
        let all: usize = rows.parts.iter().map(|part| part.len() / length).sum();
        let stride = all.div_ceil(MAX_ROWS).max(1);
        let of_part = |part: &RecordingRows| {
            let count = part.len() / length;
            (0..count).step_by(stride).map(|i| length * i..length * (i + 1)).collect()
        };
        rows.parts.iter().map(of_part).collect()
    };
    setup.rows.iter().map(of_sensor).collect()
}

/// Means of a column over windows.
pub fn averaged(values: &[f64], windows: &[Range<usize>]) -> Vec<f64> {
    let mean = |rows: &Range<usize>| {
        let within = values.get(rows.clone()).unwrap_or_default();
        within.iter().sum::<f64>() / within.len().max(1) as f64
    };
    windows.iter().map(mean).collect()
}

/// One sensor of a fitted model. Entries are whitened by the noise of sensor and reference, three for each averaged row.
pub struct SensorRows {
    pub residual: DVector<f64>,
    /// Derivatives to the fitted parameters, each of unit mean square.
    pub jacobian: DMatrix<f64>,
    /// Weight of the prior of each parameter, in the scale of its derivatives.
    pub prior: DVector<f64>,
    /// Response at each point of the chain.
    pub patterns: Vec<DVector<f64>>,
    /// Rows of each fold.
    pub folds: Vec<Range<usize>>,
    /// Rows of each block of time.
    pub blocks: Vec<Range<usize>>,
}

impl SensorRows {
    /// Number of averaged rows.
    pub fn count(&self) -> usize {
        self.residual.len() / 3
    }
}

/// Rows of all sensors. Of the effects `without` the columns are left out, and the share of their coefficients is part of the
/// residual: the linearisation is that of the whole model, with its shapes. Blocks of time have at least `block_s` seconds.
pub fn of_model(
    setup: &FitSetup,
    model: &FittedModel,
    without: &[EffectTerm],
    points: &[ChainPoint],
    windows: &[Vec<Windows>],
    block_s: f64,
) -> Vec<SensorRows> {
    let mut effects = model.effects.clone();
    effects.sort_by_key(EffectTerm::stage);
    (0..setup.rows.len())
        .into_par_iter()
        .map(|sensor| {
            let problem =
                SensorProblem::new(&setup.rows[sensor], setup.bases[sensor].as_ref(), &effects);
            let values = &model.fit.sensors[sensor].values;
            of_sensor(&problem, values, without, points, &windows[sensor], block_s)
        })
        .collect()
}

fn of_sensor(
    problem: &SensorProblem,
    values: &[f64],
    without: &[EffectTerm],
    points: &[ChainPoint],
    windows: &[Windows],
    block_s: f64,
) -> SensorRows {
    let rows = problem.rows;
    let scaled = problem.to_scaled(values);
    let ranges = problem.ranges();
    let of_effects = |is_own: &dyn Fn(&EffectTerm) -> bool| -> Vec<usize> {
        let own = problem.effects.iter().zip(ranges).filter(|(effect, _)| is_own(effect));
        own.flat_map(|(_, range)| range.clone()).collect()
    };
    let left_out = of_effects(&|effect| without.contains(effect));
    let coefficients: Vec<bool> = std::iter::repeat_n(true, problem.base_count)
        .chain(problem.effects.iter().flat_map(|effect| {
            let parameters = effect.parameters(rows.parts.len());
            parameters.iter().map(EffectParameter::is_coefficient).collect::<Vec<_>>()
        }))
        .collect();
    let without_prior = of_effects(&|effect| matches!(effect, EffectTerm::Expression(_)));
    let stiffness = problem.base.stiffness(values);
    let (mut residual, mut patterns) = (Vec::new(), vec![Vec::new(); points.len()]);
    let mut jacobian: Vec<f64> = Vec::new();
    let mut folds: Vec<(Option<usize>, Range<usize>)> = Vec::new();
    let mut blocks = Vec::new();
    let (mut count, columns) = (0, problem.parameters.len());
    for (place, (part, windows)) in rows.parts.iter().zip(windows).enumerate() {
        let (modelled, part_jacobian) = problem.linearise(place, &scaled);
        let acting = problem.acting(place);
        let series = problem.series(place, values);
        let first = count;
        let mut block = first;
        for window in windows {
            let length = window.len() as f64;
            let mut sums = vec![Vector3::zeros(); 1 + points.len()];
            let mut derivatives = DMatrix::<f64>::zeros(3, columns);
            let mut covariance = Matrix3::zeros();
            let states = &series.states[window.clone()];
            let responses = problem.base.responses(&values[..problem.base_count], states);
            for (row, response) in window.clone().zip(&responses) {
                sums[0] += part.field_g[row] - modelled.fields[row];
                for (sum, point) in sums[1..].iter_mut().zip(points) {
                    *sum += point.pattern(response, series.force_n[row], stiffness);
                }
                for (&index, column) in acting.iter().zip(part_jacobian.column_iter()) {
                    let mut sum = derivatives.column_mut(index);
                    sum += column.rows(3 * row, 3);
                }
                let known = |noise: f64| if noise.is_finite() { noise } else { 0.0 };
                covariance += Matrix3::from_diagonal(&part.field_noise_g.map(|n| known(n).powi(2)));
                let slopes: Vec<Vector3<f64>> = rows.slopes(&modelled.per_newton[row]).collect();
                for (slope, noise) in slopes.iter().zip(&part.force_noise_n) {
                    covariance += slope * slope.transpose() * known(*noise).powi(2);
                }
                let jitter_n = part.jitter_n.get(row).into_iter().flatten();
                let jitter_g: Vector3<f64> = slopes.iter().zip(jitter_n).map(|(s, n)| s * *n).sum();
                covariance += jitter_g * jitter_g.transpose();
            }
            for &index in &left_out {
                let mut column = derivatives.column_mut(index);
                if coefficients.get(index).is_some_and(|is_coefficient| *is_coefficient) {
                    sums[0] += Vector3::new(column[0], column[1], column[2]) * scaled[index];
                }
                column.fill(0.0);
            }
            // Of the mean: the noise of the rows is independent.
            covariance /= length * length;
            let floor = 1e-6 * covariance.diagonal().max().max(1e-6);
            let whiten = Cholesky::new(covariance + Matrix3::identity() * floor)
                .and_then(|factor| factor.l().try_inverse())
                .unwrap_or_else(Matrix3::identity)
                / length;
            residual.extend((whiten * sums[0]).iter());
            for (pattern, sum) in patterns.iter_mut().zip(&sums[1..]) {
                pattern.extend((whiten * sum).iter());
            }
            // By rows, since entries are appended.
            let whitened = whiten * derivatives;
            for axis in 0..3 {
                jacobian.extend(whitened.row(axis).iter());
            }
            count += 1;
            let time_s = |row: usize| part.time_s[windows[row - first].start];
            if time_s(count - 1) - time_s(block) >= block_s {
                blocks.push(block..count - 1);
                block = count - 1;
            }
        }
        if block < count {
            blocks.push(block..count);
        }
        if first < count {
            let split = CvSplit::Recordings(rows.parts.len());
            match folds.last_mut() {
                // In one fold with the recording before.
                Some((last, fold)) if *last == split.fold_of(place) => fold.end = count,
                _ => folds.push((split.fold_of(place), first..count)),
            }
        }
    }
    let mut folds: Vec<Range<usize>> = folds.into_iter().map(|(_, rows)| rows).collect();
    if folds.len() < 2 {
        let edge = |fold: usize| fold * count / FOLDS;
        folds = (0..FOLDS).map(|fold| edge(fold)..edge(fold + 1)).collect();
    }
    let residual: DVector<f64> = DVector::from_vec(residual);
    let entries = (3 * count).max(1) as f64;
    // A model that is wrong is as uncertain as its residual.
    let weight = (residual.norm_squared() / entries).max(1.0);
    let mut jacobian = DMatrix::from_row_slice(3 * count, columns, &jacobian);
    let mut prior = DVector::zeros(columns);
    for (index, mut column) in jacobian.column_iter_mut().enumerate() {
        let scale = (column.norm_squared() / entries).sqrt();
        if scale > 0.0 {
            column /= scale;
        }
        if !without_prior.contains(&index) {
            // Without any effect on the field it stays where it is.
            prior[index] = weight / scale.powi(2).max(1e-12);
        }
    }
    SensorRows {
        residual,
        jacobian,
        prior,
        patterns: patterns.into_iter().map(DVector::from_vec).collect(),
        folds,
        blocks,
    }
}

/// Excitations of a sensor, by recording.
pub fn excitations(setup: &FitSetup, sensor: usize) -> impl Iterator<Item = &ExcitationSeries> {
    setup.rows[sensor].parts.iter().map(|part| &part.track)
}
