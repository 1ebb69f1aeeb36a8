//! Score test of candidate effects without refitting.
//!
//! A fitted model is linearised at its solution. A candidate is regressed together with everything fitted
//! already (Frisch and Waugh 1933), so that it gets no credit for what the others absorb; it is evaluated on
//! held-out rows; and its explained sum of squares is compared with that under random signs of residual blocks
//! (Wu's wild bootstrap).

use crate::effects::{Aggregation, EffectParameter, EffectTerm, ParameterKind};
use crate::fit::campaign::FitSetup;
use crate::fit::cross_validation::{CvSplit, Fold};
use crate::fit::held_out::{BlockChange, Folds, HeldOut, inverse};
use crate::fit::initial_guess::{ShapeSearch, search_one};
use crate::fit::joint::JointFit;
use crate::fit::linearisation::{COLUMN_HEIGHT, Linearisation, NormalEquations};
use crate::fit::problem::SensorProblem;
use crate::fit::rows::{SensorRows, pair};
use crate::fit::tall_products::{columns, gram, products};
use crate::physics::sensor::force_per_field;
use crate::physics::{FieldResponse, PhysicalState};
use crate::stop;
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3, Vector3};
use rayon::prelude::*;

/// A typical magnitude in prior widths, which are the unit of all columns.
const TYPICAL: f64 = 0.1;
/// Knots of the spline in time, over each recording.
const KNOTS: usize = 12;

/// A fitted model linearised at its solution.
pub struct ScoreTest<'a> {
    setup: &'a FitSetup,
    effects: Vec<EffectTerm>,
    values: Vec<Vec<f64>>,
    sensors: Vec<SensorScore>,
    /// Number of blocks of time.
    pub blocks: usize,
    recordings: usize,
}

/// Score test of one candidate.
pub struct CandidateScore {
    /// Held-out weighted squared residual of each fold: without the candidate, with it.
    pub folds: Vec<(f64, f64)>,
    /// Change of the held-out squared residual in each block of time.
    pub by_block: Vec<BlockChange>,
    /// Held-out mean square of the force error that the residual causes in the device's inverse, in N^2 over all sensors and measured
    /// forces: without the candidate, with it.
    pub force_n2: [f64; 2],
    /// Explained sum of squares in units of the noise variance, over all sensors.
    pub explained: f64,
    /// Number of coefficients.
    pub count: usize,
    /// Typical magnitude in standard errors.
    pub z_typical: f64,
    /// The same for white noise residuals.
    pub z_white_noise: f64,
    /// The same with nothing else fitted.
    pub z_unadjusted: f64,
    /// Upper bound in typical magnitudes: estimate and two standard errors.
    pub bound: f64,
    /// Regressors orthogonalised to the fitted columns, for each sensor.
    orthogonal: Vec<DMatrix<f64>>,
    /// Inverse of their normal equations.
    inverse: Vec<DMatrix<f64>>,
}

impl CandidateScore {
    /// Relative reduction of the held-out squared residual.
    pub fn gain(&self) -> f64 {
        let (without, with) = self.folds.iter().fold((0.0, 0.0), |(a, b), f| (a + f.0, b + f.1));
        1.0 - with / without
    }

    /// Share of the squared pattern of `other`, at its typical magnitudes and orthogonal to the fitted columns, that this
    /// candidate reproduces on the same recordings.
    pub fn reproduced_share(&self, other: &Self) -> f64 {
        let (mut reproduced, mut all) = (0.0, 0.0);
        for ((own, inverse), other) in
            self.orthogonal.iter().zip(&self.inverse).zip(&other.orthogonal)
        {
            let rows = 0..own.nrows();
            let across = products(&columns(own, rows.clone()), &columns(other, rows));
            reproduced += (across.transpose() * inverse * &across).trace();
            all += other.norm_squared();
        }
        if all > 0.0 { reproduced / all } else { 0.0 }
    }

    /// Reduction of the held-out mean square of the force error over all sensors and both forces, in N^2.
    pub fn force_reduction_n2(&self) -> f64 {
        let [without, with] = self.force_n2;
        without - with
    }

    /// Regressors of each sensor, orthogonal to the fitted columns.
    pub fn regressors(&self) -> &[DMatrix<f64>] {
        &self.orthogonal
    }

    /// Number of folds in which the error falls.
    pub fn wins(&self) -> usize {
        self.folds.iter().filter(|(without, with)| with < without).count()
    }
}

/// Correlation time in seconds by which blocks are as long as recordings that are not independent need; else zero.
fn of_blocks(sensors: &[SensorRows]) -> f64 {
    sensors.iter().find_map(|rows| rows.blocks).map_or(0.0, |blocks| blocks.correlation_s)
}

impl<'a> ScoreTest<'a> {
    /// Linearises `fit` with `effects`; blocks of `block_s` seconds.
    pub fn new(setup: &'a FitSetup, effects: &[EffectTerm], fit: &JointFit, block_s: f64) -> Self {
        let mut effects = effects.to_vec();
        effects.sort_by_key(EffectTerm::stage);
        let recordings = setup.recordings();
        let values: Vec<Vec<f64>> =
            fit.sensors.iter().map(|sensor| sensor.values.clone()).collect();
        let (firsts, blocks) = first_blocks(setup, block_s);
        let sensors = (0..setup.rows.len())
            .into_par_iter()
            .map(|s| {
                let rows = &setup.rows[s];
                let problem = SensorProblem::new(rows, setup.bases[s].as_ref(), &effects);
                let linearisation = Linearisation::at_solution(&problem, &values[s]);
                let place = |(part, row): (usize, usize)| {
                    let time_s = rows.parts[part].track.time_s[row];
                    firsts[part] + (time_s / block_s) as usize
                };
                let parts = [
                    CvSplit::of(&setup.rows),
                    CvSplit::within(&setup.rows, of_blocks(&setup.rows)),
                ]
                .map(|split| part_of(&split.folds(rows, 0.0), &linearisation));
                let block = linearisation.places().map(place).collect();
                let stiffness = problem.base.stiffness(&values[s]);
                let weights = problem.base.inverse_weights();
                let is_measured = pair(&rows.forces).map(|force| force.is_some());
                let of_row = |(_, _, response): (usize, usize, &FieldResponse)| {
                    let per_newton = [
                        response.per_mm.column(0) / stiffness[0],
                        response.per_mm.column(2) / stiffness[1],
                    ];
                    // Without an inverse there is no force.
                    let mut to_force = force_per_field(&per_newton, weights).unwrap_or_default();
                    for (axis, _) in is_measured.iter().enumerate().filter(|(_, is)| !**is) {
                        to_force.row_mut(axis).fill(0.0);
                    }
                    to_force * Matrix3::from_diagonal(&problem.weights.map(|w| 1.0 / w))
                };
                let to_force = linearisation.responses().map(of_row).collect();
                SensorScore::new(linearisation, block, parts, to_force)
            })
            .collect();
        Self { setup, effects, values, sensors, blocks, recordings }
    }

    /// Score of `candidate`; `None` where the field does not depend on it.
    pub fn score(&self, candidate: &EffectTerm) -> Option<CandidateScore> {
        stop::check();
        let mut effects = self.effects.clone();
        effects.push(candidate.clone());
        effects.sort_by_key(EffectTerm::stage);
        let place = effects.iter().position(|effect| effect == candidate)?;
        let mut searches: Vec<ShapeSearch> = (0..self.sensors.len())
            .into_par_iter()
            .map(|s| {
                let rows = &self.setup.rows[s];
                let problem = SensorProblem::new(rows, self.setup.bases[s].as_ref(), &effects);
                let values = self.start_values(&problem, place, &self.values[s]);
                ShapeSearch::from_linearisation(self.sensors[s].coarse.clone(), problem, values)
            })
            .collect();
        search_one(&mut searches, place);
        let regressors: Vec<DMatrix<f64>> = searches
            .into_par_iter()
            .zip(&self.sensors)
            .map(|(search, sensor)| search.on(sensor.linearisation.clone()).regressors(place))
            .collect();
        let within = self.is_within(candidate);
        let count = regressors.first()?.ncols();
        let scored: Vec<_> = self
            .sensors
            .par_iter()
            .zip(&regressors)
            .map(|(sensor, regressors)| sensor.evaluate(regressors, within))
            .collect();
        let mut folds: Vec<(f64, f64)> = Vec::new();
        let mut by_block = vec![BlockChange::default(); self.blocks];
        let mut force_n2 = [0.0; 2];
        for (_, _, own) in &scored {
            folds.resize(folds.len().max(own.len()), (0.0, 0.0));
            folds.iter_mut().zip(own).for_each(|(sum, own)| {
                sum.0 += own.field.0;
                sum.1 += own.field.1;
            });
            for (block, change) in own.iter().flat_map(|fold| &fold.blocks) {
                by_block[*block].add(*change);
            }
            let forces: f64 = own.iter().map(|fold| fold.forces).sum();
            for (mean, of) in
                force_n2.iter_mut().zip([|f: &HeldOut| f.force_n2.0, |f: &HeldOut| f.force_n2.1])
            {
                *mean += own.iter().map(of).sum::<f64>() / forces.max(1.0) / scored.len() as f64;
            }
        }
        folds.retain(|(without, _)| *without > 0.0);
        let (orthogonal, inverse): (Vec<_>, Vec<_>) =
            scored.into_iter().map(|(orthogonal, inverse, _)| (orthogonal, inverse)).unzip();
        let mut score = CandidateScore {
            folds,
            by_block,
            force_n2,
            explained: 0.0,
            count,
            z_typical: 0.0,
            z_white_noise: 0.0,
            z_unadjusted: 0.0,
            bound: f64::INFINITY,
            orthogonal,
            inverse,
        };
        let signs = vec![1.0; self.blocks];
        score.explained = self.explained(&score, &self.block_scores(&score, None), &signs);
        self.set_significance(&mut score, candidate, &regressors);
        Some(score)
    }

    /// Significance of a change of the measurement after orthogonalisation to the model, in standard errors of
    /// white noise. `change(sensor, recording, row)` returns the change of the field in gauss and of the
    /// reference forces in newtons.
    pub fn change_significance(
        &self,
        change: impl Fn(usize, usize, usize) -> (Vector3<f64>, [f64; 2]),
    ) -> f64 {
        let mut squares = 0.0;
        for (s, sensor) in self.sensors.iter().enumerate() {
            let rows = &self.setup.rows[s];
            let base = self.setup.bases[s].as_ref();
            let problem = SensorProblem::new(rows, base, &self.effects);
            let [kx, kz] = base.stiffness(&self.values[s]);
            let of_row = |(part, row, response): (usize, usize, &FieldResponse)| {
                let (field, [fx, fz]) = change(s, part, row);
                let moved = Vector3::new(fx / kx, 0.0, fz / kz);
                <[f64; 3]>::from(
                    (field - response.per_mm * moved)
                        .component_mul(&problem.row_weights(part, row)),
                )
            };
            let entries: Vec<f64> = sensor.linearisation.responses().flat_map(of_row).collect();
            let all: usize = rows.parts.iter().map(|part| part.len()).sum();
            let rows_per_entry = 3.0 * all as f64 / entries.len().max(1) as f64;
            let orthogonal = sensor.orthogonal(&DMatrix::from_vec(entries.len(), 1, entries));
            squares += rows_per_entry * orthogonal.norm_squared();
        }
        squares.sqrt()
    }

    /// Squared residual of the rows of which `is_counted(recording, time in seconds)` after one more linear step of the fitted
    /// parameters, relative to the noise variance of all rows. A value counts as its noise variance at most: where a load changes
    /// within a few rows, sampling and smoothing change the residual as much.
    pub fn mean_square_in(&self, is_counted: impl Fn(usize, f64) -> bool) -> f64 {
        let of_sensor = |(sensor, rows): (&SensorScore, &SensorRows)| -> f64 {
            let entries = sensor.linearisation.places().zip(sensor.residual.as_slice().chunks(3));
            let counted = entries.filter(|((recording, row), _)| {
                is_counted(*recording, rows.parts[*recording].track.time_s[*row])
            });
            counted.flat_map(|(_, entries)| entries).map(|entry| (entry * entry).min(1.0)).sum()
        };
        let squares: f64 = self.sensors.iter().zip(&self.setup.rows).map(of_sensor).sum();
        let entries: usize = self.sensors.iter().map(|s| s.residual.len()).sum();
        squares / entries.max(1) as f64
    }

    /// Relative reduction of the held-out squared residual, by interleaved slices, by a spline in time for each
    /// axis, sensor and recording.
    ///
    /// Transient effects can only be evaluated within recordings, where neighbouring rows predict any slow
    /// noise: such an effect counts only if it explains about as much as this spline.
    pub fn time_spline_gain(&self) -> f64 {
        let scored = self.sensors.par_iter().enumerate().map(|(s, sensor)| {
            let columns = sensor.linearisation.spline_columns(&self.setup.rows[s], KNOTS);
            let folds = sensor.folds[1].with(&columns);
            folds.iter().fold((0.0, 0.0), |(a, b), f| (a + f.field.0, b + f.field.1))
        });
        let (without, with) = scored.reduce(|| (0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        1.0 - with / without
    }

    /// Relative reduction of the held-out squared residual by other forms of a fitted effect (see `form_columns`), each with a
    /// coefficient for each sensor.
    pub fn form_gain(&self, effect: &EffectTerm) -> f64 {
        let Some(place) = self.effects.iter().position(|own| own == effect) else {
            return 0.0;
        };
        let scored = self.sensors.par_iter().enumerate().map(|(s, sensor)| {
            let (rows, base) = (&self.setup.rows[s], self.setup.bases[s].as_ref());
            let problem = SensorProblem::new(rows, base, &self.effects);
            let columns = form_columns(&sensor.linearisation, &problem, &self.values[s], place);
            let folds = sensor.folds[self.is_within(effect)].with(&columns);
            folds.iter().fold((0.0, 0.0), |(a, b), f| (a + f.field.0, b + f.field.1))
        });
        let (without, with) = scored.reduce(|| (0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        if without > 0.0 { 1.0 - with / without } else { 0.0 }
    }

    /// Index of the cross-validation of a model with `effect`: within recordings where a held-out recording carries no information
    /// on one of its effects, as in a full fit.
    fn is_within(&self, effect: &EffectTerm) -> usize {
        let is_transient =
            effect.is_transient() || self.effects.iter().any(EffectTerm::is_transient);
        usize::from(is_transient)
    }

    /// Values of a model with one more effect than fitted.
    fn start_values(&self, problem: &SensorProblem, place: usize, values: &[f64]) -> Vec<f64> {
        let own = problem.ranges()[place].clone();
        let mut all: Vec<f64> = problem.parameters.iter().map(|index| index.start).collect();
        let others = (0..all.len()).filter(|index| !own.contains(index));
        for (index, value) in others.zip(values) {
            all[index] = *value;
        }
        all
    }

    /// Scores of a candidate against the residual (after removing `best`), block by block, for each sensor.
    fn block_scores(
        &self,
        score: &CandidateScore,
        best: Option<&CandidateScore>,
    ) -> Vec<Vec<DVector<f64>>> {
        let one = |s: usize| {
            let sensor = &self.sensors[s];
            let mut residual = sensor.residual.clone();
            if let Some(fitted) = best {
                let orthogonal = &fitted.orthogonal[s];
                let coefficients = &fitted.inverse[s] * orthogonal.tr_mul(&residual);
                residual -= orthogonal * coefficients;
            }
            let orthogonal = &score.orthogonal[s];
            let mut block_scores = vec![DVector::zeros(orthogonal.ncols()); self.blocks];
            for (row, &block) in sensor.block.iter().enumerate() {
                for entry in 3 * row..3 * row + 3 {
                    for (j, score) in block_scores[block].iter_mut().enumerate() {
                        *score += orthogonal[(entry, j)] * residual[entry];
                    }
                }
            }
            block_scores
        };
        (0..self.sensors.len()).into_par_iter().map(one).collect()
    }

    /// Explained sum of squares with these block signs.
    fn explained(
        &self,
        score: &CandidateScore,
        block_scores: &[Vec<DVector<f64>>],
        signs: &[f64],
    ) -> f64 {
        let mut sum = 0.0;
        for (block_scores, inverse) in block_scores.iter().zip(&score.inverse) {
            let mut score = DVector::zeros(score.count);
            for (of_block, sign) in block_scores.iter().zip(signs) {
                score.axpy(*sign, of_block, 1.0);
            }
            sum += score.dot(&(inverse * &score));
        }
        sum
    }

    /// Explained sum of squares of two candidates together, in units of the noise variance, over all sensors.
    pub fn explained_together(&self, one: &CandidateScore, other: &CandidateScore) -> f64 {
        let of_sensor = |(s, sensor): (usize, &SensorScore)| {
            let (one, other) = (&one.orthogonal[s], &other.orthogonal[s]);
            let mut both = one.clone().resize_horizontally(one.ncols() + other.ncols(), 0.0);
            both.columns_mut(one.ncols(), other.ncols()).copy_from(other);
            let normal = gram(&columns(&both, 0..both.nrows()));
            let score = both.tr_mul(&sensor.residual);
            score.dot(&(inverse(normal, sensor.prior) * &score))
        };
        self.sensors.iter().enumerate().map(of_sensor).sum()
    }

    /// Explained sum of squares of the residual after removing `best`, for each draw of signs.
    pub fn resampled(
        &self,
        score: &CandidateScore,
        best: &CandidateScore,
        draws: &[Vec<f64>],
    ) -> Vec<f64> {
        let block_scores = self.block_scores(score, Some(best));
        let draw = |signs: &Vec<f64>| self.explained(score, &block_scores, signs);
        draws.par_iter().map(draw).collect()
    }

    /// Normal equations of the candidate's coefficients in typical magnitudes, common to all sensors: their matrix, and the scores
    /// of each block.
    fn common_coefficients(&self, score: &CandidateScore) -> (DMatrix<f64>, Vec<DVector<f64>>) {
        let mut normal = DMatrix::zeros(score.count, score.count);
        for orthogonal in &score.orthogonal {
            normal += TYPICAL * TYPICAL * gram(&columns(orthogonal, 0..orthogonal.nrows()));
        }
        let mut by_block = vec![DVector::zeros(score.count); self.blocks];
        for of_sensor in self.block_scores(score, None) {
            by_block.iter_mut().zip(&of_sensor).for_each(|(sum, own)| sum.axpy(TYPICAL, own, 1.0));
        }
        (normal, by_block)
    }

    /// Sets the significance of the typical magnitude (block residuals, white noise, nothing else fitted) and
    /// the upper bound.
    fn set_significance(
        &self,
        score: &mut CandidateScore,
        candidate: &EffectTerm,
        regressors: &[DMatrix<f64>],
    ) {
        let parameters = candidate.parameters(self.recordings);
        let typical: Vec<f64> = parameters
            .iter()
            .filter(|parameter| parameter.is_coefficient())
            .map(|parameter| parameter.typical)
            .collect();
        let mut singles = Vec::new();
        let (mut in_noise, mut alone) = (Vec::new(), Vec::new());
        let (normal, by_block) = self.common_coefficients(score);
        for j in 0..score.count {
            if typical.get(j).is_none_or(|typical| typical.is_nan()) {
                continue;
            }
            let norm = normal[(j, j)].sqrt();
            let squares: f64 = regressors.iter().map(|a| a.column(j).norm_squared()).sum();
            in_noise.push(norm);
            alone.push(TYPICAL * squares.sqrt());
            let block_norm = by_block.iter().map(|score| score[j] * score[j]).sum::<f64>().sqrt();
            if norm > 0.0 {
                // No residual is below white noise of the floor's magnitude.
                singles.push(norm / (block_norm / norm).max(1.0));
            }
        }
        let combine = |singles: &[f64]| match candidate.size().aggregation {
            Aggregation::Norm => {
                let squares: f64 = singles.iter().map(|z| z * z).sum();
                (squares / singles.len().max(1) as f64).sqrt()
            }
            _ => singles.iter().copied().fold(0.0, f64::max),
        };
        score.z_typical = combine(&singles);
        score.z_white_noise = combine(&in_noise);
        score.z_unadjusted = combine(&alone);
        let first = candidate.size().first;
        let magnitudes = if first == 0 { typical.len() } else { first };
        score.bound = upper_bound(&normal, &by_block, magnitudes);
    }
}

/// 95 % upper bound of the first `count` coefficients, in typical magnitudes: the largest estimate and two of its standard errors by
/// the scores of the blocks (not below those of white noise), next to the other coefficients and with the prior of the fit.
fn upper_bound(normal: &DMatrix<f64>, by_block: &[DVector<f64>], count: usize) -> f64 {
    let covariance = inverse(normal.clone(), TYPICAL * TYPICAL);
    let mut estimate = DVector::zeros(normal.nrows());
    let mut variance = DVector::<f64>::zeros(normal.nrows());
    for score in by_block {
        let change = &covariance * score;
        variance += change.component_mul(&change);
        estimate += change;
    }
    let bound =
        |j: usize| estimate[j].abs() + 2.0 * variance[j].max(covariance[(j, j)]).max(0.0).sqrt();
    (0..count.min(normal.nrows())).map(bound).fold(0.0, f64::max)
}

/// Columns of other forms of the effect with this index: its field times both forces, their magnitudes and squares (another
/// stiffness or exponent), and the change of its field where each of its shapes is half and twice as large. Their scale is large,
/// so that no prior limits them.
fn form_columns(
    linearisation: &Linearisation,
    problem: &SensorProblem,
    values: &[f64],
    effect: usize,
) -> DMatrix<f64> {
    let recordings = problem.rows.parts.len();
    let range = problem.ranges()[effect].clone();
    let parameters = problem.effects[effect].parameters(recordings);
    let own = || range.clone().zip(&parameters);
    let mut without = values.to_vec();
    own().filter(|(_, p)| p.is_coefficient()).for_each(|(index, _)| without[index] = 0.0);
    let mut others = vec![without];
    let is_shape = |p: &EffectParameter| matches!(p.kind, ParameterKind::Shape { .. });
    for (index, _) in own().filter(|(_, parameter)| is_shape(parameter)) {
        let parameter = &problem.parameters[index];
        for sign in [-1.0, 1.0] {
            let mut moved = values.to_vec();
            moved[index] = if parameter.relative {
                values[index] * f64::powf(2.0, sign)
            } else {
                values[index] + sign * parameter.scale
            };
            others.push(moved);
        }
    }
    let spans = problem.rows.force_spans();
    let largest = spans.iter().map(|(low, high)| low.abs().max(high.abs())).fold(0.0, f64::max);
    let mut columns = DMatrix::zeros(linearisation.residual().len(), 5 + others.len());
    let mut at = 0;
    for (part, rows) in linearisation.rows.iter().enumerate() {
        let states: Vec<Vec<PhysicalState>> =
            others.iter().map(|values| problem.states(part, values)).collect();
        for (row, state, response) in rows {
            let [fx, fz] =
                problem.rows.parts[part].track.force_n[*row].map(|f| f / largest.max(1e-9));
            let weights = problem.row_weights(part, *row);
            let changes = states
                .iter()
                .map(|states| response.change(&states[*row], state).component_mul(&weights));
            let changes: Vec<Vector3<f64>> = changes.collect();
            let modulated = [fx, fz, fx.abs(), fz.abs(), fx * fx, fz * fz];
            let modulated = modulated.iter().map(|factor| changes[0] * *factor);
            let all = modulated.chain(changes[1..].iter().copied());
            for (column, change) in all.enumerate() {
                (0..3).for_each(|axis| columns[(at + axis, column)] = change[axis]);
            }
            at += 3;
        }
    }
    for mut column in columns.column_iter_mut() {
        let rms = (column.norm_squared() / column.len().max(1) as f64).sqrt();
        if rms > 0.0 {
            column *= COLUMN_HEIGHT / rms;
        }
    }
    columns
}

/// Index of the first block of each recording, and the number of blocks.
fn first_blocks(setup: &FitSetup, block_s: f64) -> (Vec<usize>, usize) {
    let recordings = setup.recordings();
    let (mut firsts, mut next) = (Vec::new(), 0);
    for recording in 0..recordings {
        let last = setup.rows.iter().filter_map(|rows| rows.parts[recording].track.time_s.last());
        let blocks = last.map(|time| (time / block_s) as usize + 1).max().unwrap_or(0);
        firsts.push(next);
        next += blocks;
    }
    (firsts, next)
}

/// Fold in which each row is held out.
fn part_of(folds: &[Fold], linearisation: &Linearisation) -> Vec<usize> {
    let find = |(part, row): (usize, usize)| {
        let holds = |fold: &Fold| {
            fold.test.iter().any(|range| range.part == part && range.rows.contains(&row))
        };
        folds.iter().position(holds).unwrap_or(0)
    };
    linearisation.places().map(find).collect()
}

/// Row stride of the search for shapes.
const COARSE: usize = 3;

/// Linearised model of one sensor.
pub(super) struct SensorScore {
    pub(super) linearisation: Linearisation,
    /// Subsampled for the search of shapes.
    pub(super) coarse: Linearisation,
    /// Inverse normal equations of the fitted columns, prior included.
    inverse: DMatrix<f64>,
    /// Block of each row (three entries of the residual).
    pub(super) block: Vec<usize>,
    /// By recordings, and within them.
    folds: [Folds; 2],
    /// After one more linear step of the fitted parameters.
    residual: DVector<f64>,
    /// Weight of the prior: rows per independent row.
    prior: f64,
}

impl SensorScore {
    /// `to_force` converts the weighted residual of each row to an error of both forces in newtons.
    pub(super) fn new(
        linearisation: Linearisation,
        block: Vec<usize>,
        fold_of: [Vec<usize>; 2],
        to_force: Vec<Matrix2x3<f64>>,
    ) -> Self {
        let (residual, fixed) = (linearisation.residual(), linearisation.fixed());
        let mean_square = residual.norm_squared() / residual.len().max(1) as f64;
        let prior = mean_square.max(1.0);
        let normal = NormalEquations::of(fixed, residual, 0..residual.len());
        let inverse = inverse(normal.matrix, prior);
        let left = residual - fixed * (&inverse * normal.right);
        Self {
            inverse,
            residual: left,
            folds: fold_of
                .map(|fold_of| Folds::new(&linearisation, (&fold_of, &block), &to_force, prior)),
            coarse: linearisation.thinned(COARSE),
            linearisation,
            block,
            prior,
        }
    }

    /// Component orthogonal to the fitted columns.
    pub(super) fn orthogonal(&self, regressors: &DMatrix<f64>) -> DMatrix<f64> {
        let fixed = self.linearisation.fixed();
        let all = |matrix| columns(matrix, 0..regressors.nrows());
        regressors - fixed * (&self.inverse * products(&all(fixed), &all(regressors)))
    }

    /// Orthogonalised regressors, their inverse normal equations, and the held-out squares by fold.
    pub(super) fn evaluate(
        &self,
        regressors: &DMatrix<f64>,
        kind: usize,
    ) -> (DMatrix<f64>, DMatrix<f64>, Vec<HeldOut>) {
        let orthogonal = self.orthogonal(regressors);
        let inverse = inverse(gram(&columns(&orthogonal, 0..orthogonal.nrows())), self.prior);
        (orthogonal, inverse, self.folds[kind].with(regressors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_bound_holds_for_coefficients_that_compensate_each_other() {
        // Two collinear coefficients, 0.5 and -0.4, in two blocks of equal rows.
        let normal = DMatrix::from_row_slice(2, 2, &[100.0, 90.0, 90.0, 100.0]);
        let score = &normal * DVector::from_row_slice(&[0.25, -0.2]);
        let bound = upper_bound(&normal, &[score.clone(), score], 1);
        // Alone, the first would be (100 * 0.5 - 90 * 0.4) / 100 = 0.14. Jointly it is 0.5, and its standard error by the two
        // blocks the root of 0.25^2 + 0.25^2.
        assert!((bound - (0.5 + 2.0 * 0.125_f64.sqrt())).abs() < 0.002, "{bound}");
    }
}
