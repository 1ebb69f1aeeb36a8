//! A fitted model linearised at its solution, and regressions on it recording by recording.

use crate::effects::{EffectTerm, ExcitationSeries, StateSeries};
use crate::fit::problem::SensorProblem;
use crate::fit::rows::SensorRows;
use crate::fit::tall_products::{columns, gram, products};
use crate::physics::{FieldResponse, PhysicalState};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

/// Scale of columns without a prior, in noise floors: large, so that no prior limits them.
pub(super) const COLUMN_HEIGHT: f64 = 1000.0;

/// Rows of a recording in [`Linearisation::at_solution`].
const ROWS: usize = 1000;

/// Residual and Jacobian of a fitted model on a subset of rows.
#[derive(Clone)]
pub struct Linearisation {
    pub(super) residual: DVector<f64>,
    /// Normal equations of the fitted parameters, by recording.
    pub(super) normals: Arc<RecordingNormals>,
    /// Rows with states and responses, by recording. Coefficients of candidate effects are zero here, so that
    /// these stay valid during a search.
    pub(super) rows: Arc<Vec<Vec<(usize, PhysicalState, FieldResponse)>>>,
    /// Excitation and state series of the same rows, by recording.
    covariates: Arc<Vec<(ExcitationSeries, StateSeries)>>,
}

impl Linearisation {
    /// At values where the parameters `fixed` were fitted and all other coefficients are zero, with at most
    /// `per_recording` rows of each recording.
    pub fn new(
        problem: &SensorProblem,
        values: &[f64],
        fixed: &[usize],
        per_recording: usize,
    ) -> Self {
        let scaled = problem.to_scaled(values);
        let (mut residual, mut columns) = (Vec::new(), Vec::new());
        let (mut ends, mut rows, mut covariates) = (Vec::new(), Vec::new(), Vec::new());
        for (part, of) in problem.rows.parts.iter().enumerate() {
            let (modelled, jacobian) = problem.linearise(part, &scaled);
            let acting = problem.acting(part);
            let columns_of: Vec<Option<usize>> =
                fixed.iter().map(|index| acting.binary_search(index).ok()).collect();
            let series = problem.series(part, values);
            let sampled: Vec<usize> = sampled(of.len(), per_recording).collect();
            for &row in &sampled {
                let error = of.field_g[row] - modelled.fields[row];
                let weights = problem.row_weights(part, row);
                for axis in 0..3 {
                    residual.push(error[axis] * weights[axis]);
                    let row = jacobian.row(3 * row + axis);
                    let derivative = |column: &Option<usize>| {
                        column.map_or(0.0, |column| row[column] * weights[axis])
                    };
                    columns.extend(columns_of.iter().map(derivative));
                }
            }
            let sampled_series = series.at(&sampled);
            let states = &sampled_series.states;
            let responses = problem.base.responses(&values[..problem.base_count], states);
            let of_row = sampled.iter().zip(states).zip(responses);
            rows.push(of_row.map(|((row, state), response)| (*row, *state, response)).collect());
            ends.push(residual.len());
            covariates.push((of.track.at(&sampled), sampled_series));
        }
        let fixed = DMatrix::from_row_slice(residual.len(), fixed.len(), &columns);
        let residual = DVector::from_vec(residual);
        Self {
            normals: Arc::new(RecordingNormals::new(fixed, residual.clone(), &ends)),
            residual,
            rows: Arc::new(rows),
            covariates: Arc::new(covariates),
        }
    }

    /// At values where everything was fitted, with up to `ROWS` rows of each recording.
    pub fn at_solution(problem: &SensorProblem, values: &[f64]) -> Self {
        // A parameter of a recording without rows in the sample has no derivatives.
        let parts = &problem.rows.parts;
        let filled = (0..parts.len()).filter(|&part| !parts[part].is_empty());
        let fitted: BTreeSet<usize> = filled.flat_map(|part| problem.acting(part)).collect();
        Self::new(problem, values, &fitted.into_iter().collect::<Vec<_>>(), ROWS)
    }

    /// Every `step`-th row.
    pub fn thinned(&self, step: usize) -> Self {
        let (mut entries, mut ends) = (Vec::new(), Vec::new());
        let (mut rows, mut covariates) = (Vec::new(), Vec::new());
        let mut start = 0;
        for (of, (track, series)) in self.rows.iter().zip(self.covariates.iter()) {
            let rows_kept: Vec<usize> = (0..of.len()).step_by(step.max(1)).collect();
            let first = |row: &usize| start + 3 * row;
            entries.extend(rows_kept.iter().flat_map(|row| first(row)..first(row) + 3));
            ends.push(entries.len());
            rows.push(rows_kept.iter().map(|&row| of[row]).collect());
            covariates.push((track.at(&rows_kept), series.at(&rows_kept)));
            start += 3 * of.len();
        }
        let residual = self.residual.select_rows(&entries);
        let fixed = self.fixed().select_rows(&entries);
        Self {
            normals: Arc::new(RecordingNormals::new(fixed, residual.clone(), &ends)),
            residual,
            rows: Arc::new(rows),
            covariates: Arc::new(covariates),
        }
    }

    /// States of a recording's rows with an effect whose coefficients are zero in the linearisation.
    pub fn states_with(
        &self,
        part: usize,
        effect: &EffectTerm,
        values: &[f64],
    ) -> Vec<PhysicalState> {
        let Some((track, series)) = self.covariates.get(part) else {
            return Vec::new();
        };
        let mut series = series.clone();
        effect.apply(values, track, &mut series);
        series.states
    }

    /// Columns of a linear spline in time with `knots` knots over each recording, for each axis.
    pub fn spline_columns(&self, rows: &SensorRows, knots: usize) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(self.residual.len(), 3 * knots * self.rows.len());
        for (at, (part, row)) in self.places().enumerate() {
            let time_s = &rows.parts[part].time_s;
            let (first, last) = (time_s[0], time_s[time_s.len() - 1]);
            let place = (time_s[row] - first) / (last - first).max(f64::MIN_POSITIVE);
            let place = place * (knots - 1) as f64;
            for knot in [place.floor(), place.floor() + 1.0] {
                let height = COLUMN_HEIGHT * (1.0 - (place - knot).abs());
                for axis in 0..3 {
                    let column = 3 * (knots * part + (knot as usize).min(knots - 1)) + axis;
                    columns[(3 * at + axis, column)] += height;
                }
            }
        }
        columns
    }

    /// Normal equations of the fitted parameters, by recording.
    pub(super) fn normals(&self) -> &RecordingNormals {
        &self.normals
    }

    /// Weighted residual: x, y, z of each row.
    pub fn residual(&self) -> &DVector<f64> {
        &self.residual
    }

    /// Weighted Jacobian of the fitted parameters, per prior width.
    pub fn fixed(&self) -> &DMatrix<f64> {
        self.normals.fixed()
    }

    /// Recording, row and response of each row used.
    pub fn responses(&self) -> impl Iterator<Item = (usize, usize, &FieldResponse)> {
        let parts = self.rows.iter().enumerate();
        parts.flat_map(|(part, rows)| rows.iter().map(move |(row, _, r)| (part, *row, r)))
    }

    /// Recording and row of each row used.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> {
        let parts = self.rows.iter().enumerate();
        parts.flat_map(|(part, rows)| rows.iter().map(move |(row, ..)| (part, *row)))
    }
}

fn hstack(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let mut both = left.clone().resize_horizontally(left.ncols() + right.ncols(), 0.0);
    both.columns_mut(left.ncols(), right.ncols()).copy_from(right);
    both
}

/// Row indices, evenly spaced over a recording.
fn sampled(rows: usize, most: usize) -> impl Iterator<Item = usize> + Clone {
    (0..rows).step_by(rows.div_ceil(most).max(1))
}

/// Relative ridge for columns without sensitivity.
const RIDGE: f64 = 1e-6;

/// Normal equations of one recording.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    pub(super) matrix: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    /// Sum of squares of the target.
    squares: f64,
}

/// Target and fixed columns with their products, which are formed once.
#[derive(Clone, Debug)]
pub struct RecordingNormals {
    fixed: DMatrix<f64>,
    target: DVector<f64>,
    recordings: Vec<(Range<usize>, NormalEquations)>,
}

impl RecordingNormals {
    /// `ends` are the rows after the last of each recording.
    pub fn new(fixed: DMatrix<f64>, target: DVector<f64>, ends: &[usize]) -> Self {
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let recordings = starts
            .zip(ends)
            .filter(|(start, end)| start < *end)
            .map(|(start, &end)| (start..end, NormalEquations::of(&fixed, &target, start..end)))
            .collect();
        Self { fixed, target, recordings }
    }

    /// The fixed columns.
    pub fn fixed(&self) -> &DMatrix<f64> {
        &self.fixed
    }

    /// With these columns among the fixed ones.
    pub fn extended(&self, columns: &DMatrix<f64>) -> Self {
        let ranges = self.recordings.iter().map(|(rows, _)| rows.clone());
        Self {
            recordings: ranges.zip(self.with(columns)).collect(),
            fixed: hstack(&self.fixed, columns),
            target: self.target.clone(),
        }
    }

    /// Normal equations of each recording with these columns appended.
    pub fn with(&self, columns: &DMatrix<f64>) -> Vec<NormalEquations> {
        let recordings = self.recordings.iter();
        recordings
            .map(|(rows, inner)| inner.with(&self.fixed, columns, &self.target, rows.clone()))
            .collect()
    }
}

impl NormalEquations {
    /// Of no rows.
    pub(super) fn zeros(size: usize) -> Self {
        Self { matrix: DMatrix::zeros(size, size), right: DVector::zeros(size), squares: 0.0 }
    }

    /// Of columns and a target over these rows.
    pub(super) fn of(matrix: &DMatrix<f64>, target: &DVector<f64>, rows: Range<usize>) -> Self {
        let target = &target.as_slice()[rows.clone()];
        let columns = columns(matrix, rows);
        Self {
            matrix: gram(&columns),
            right: products(&columns, &[target]).column(0).into_owned(),
            squares: target.iter().map(|value| value * value).sum(),
        }
    }

    /// Those of `fixed` and more columns, over the same rows.
    pub(super) fn with(
        &self,
        fixed: &DMatrix<f64>,
        more: &DMatrix<f64>,
        target: &DVector<f64>,
        rows: Range<usize>,
    ) -> Self {
        let (first, count) = (fixed.ncols(), more.ncols());
        let own = Self::of(more, target, rows.clone());
        let across = products(&columns(more, rows.clone()), &columns(fixed, rows));
        let mut matrix = DMatrix::zeros(first + count, first + count);
        matrix.view_mut((0, 0), (first, first)).copy_from(&self.matrix);
        matrix.view_mut((first, first), (count, count)).copy_from(&own.matrix);
        matrix.view_mut((first, 0), (count, first)).copy_from(&across);
        matrix.view_mut((0, first), (first, count)).copy_from(&across.transpose());
        let right = self.right.iter().chain(own.right.iter()).copied();
        Self { matrix, right: DVector::from_iterator(first + count, right), squares: self.squares }
    }

    pub(super) fn sum<'a>(of: impl Iterator<Item = &'a Self>) -> Option<Self> {
        of.cloned().reduce(|sum, next| Self {
            matrix: sum.matrix + next.matrix,
            right: sum.right + next.right,
            squares: sum.squares + next.squares,
        })
    }

    fn solve(&self) -> Option<DVector<f64>> {
        let size = self.right.len();
        let scale = self.matrix.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
        let scaled = DMatrix::from_fn(size, size, |i, j| {
            self.matrix[(i, j)] * scale[i] * scale[j] + if i == j { RIDGE } else { 0.0 }
        });
        let right = self.right.component_mul(&scale);
        Some(scaled.cholesky()?.solve(&right).component_mul(&scale))
    }

    /// Residual sum of squares with these coefficients.
    pub(super) fn residual_squares(&self, coefficients: &DVector<f64>) -> f64 {
        self.squares - 2.0 * coefficients.dot(&self.right)
            + coefficients.dot(&(&self.matrix * coefficients))
    }
}

/// Residual sum of squares over all recordings, and the coefficients.
pub fn least_residual(normals: &[NormalEquations]) -> (f64, Vec<f64>) {
    let Some(sum) = NormalEquations::sum(normals.iter()) else {
        return (f64::INFINITY, Vec::new());
    };
    match sum.solve() {
        Some(best) => (sum.residual_squares(&best), best.iter().copied().collect()),
        None => (f64::INFINITY, vec![0.0; sum.right.len()]),
    }
}

/// Residual sum of squares of each recording with the coefficients fitted to all others.
pub fn held_out_residuals(normals: &[NormalEquations]) -> Vec<f64> {
    let of = |(k, own): (usize, &NormalEquations)| {
        let others = normals.iter().enumerate().filter(|(i, _)| *i != k);
        let best =
            NormalEquations::sum(others.map(|(_, normal)| normal)).and_then(|sum| sum.solve());
        best.map_or(f64::INFINITY, |best| own.residual_squares(&best))
    };
    normals.iter().enumerate().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_out_residual_uses_coefficients_of_other_recordings() {
        // Two recordings of two rows: y = 2 x in the first, y = 3 x in the second.
        let x = DMatrix::from_column_slice(4, 1, &[1.0, 2.0, 1.0, 2.0]);
        let y = DVector::from_column_slice(&[2.0, 4.0, 3.0, 6.0]);
        let none = DMatrix::zeros(4, 0);
        for normals in [
            RecordingNormals::new(none.clone(), y.clone(), &[2, 4]).with(&x),
            RecordingNormals::new(x.clone(), y.clone(), &[2, 4]).with(&none),
        ] {
            let (left, best) = least_residual(&normals);
            assert!((best[0] - 2.5).abs() < 1e-5 && (left - 2.5).abs() < 1e-5);
            // With the other recording's slope: errors 1 and 2 in each.
            for left in held_out_residuals(&normals) {
                assert!((left - 5.0).abs() < 1e-3, "{left}");
            }
        }
    }
}
