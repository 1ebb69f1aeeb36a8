//! Exact scores of all terms at all points of the chain, and of single candidates with several columns.
//!
//! A term is a function of covariates; multiplied with the response of the field at a point of the chain it is a column of a
//! linear regression, in which everything fitted already is fitted anew. The products of the columns with the Jacobian are
//! matrix products over all terms at once.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::diagnose::formulas::rows::SensorRows;

/// Minimum part of a column's sum of squares that the fitted parameters leave.
const MIN_PROJECTED: f64 = 1e-4;
/// Sign flips of the significance test.
const DRAWS: usize = 999;

/// Columns of a candidate at each sensor, whitened.
pub type Columns = Vec<DMatrix<f64>>;

/// Normal equations of one sensor, by fold.
struct Normals {
    folds: Vec<(DMatrix<f64>, DVector<f64>, f64)>,
}

/// Rows of all sensors with their normal equations.
pub struct Scan {
    /// Rows of each sensor.
    pub rows: Vec<SensorRows>,
    normals: Vec<Normals>,
}

/// Squared residuals with a candidate.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// Held out, of each fold.
    pub folds: Vec<f64>,
    /// On the fitted rows.
    pub fitted: f64,
}

impl Score {
    /// Held out, over all folds.
    pub fn held_out(&self) -> f64 {
        self.folds.iter().sum()
    }
}

impl Scan {
    /// Of these rows.
    pub fn new(rows: Vec<SensorRows>) -> Self {
        let of_sensor = |rows: &SensorRows| Normals {
            folds: rows
                .folds
                .iter()
                .map(|fold| {
                    let jacobian = rows.jacobian.rows(3 * fold.start, 3 * fold.len());
                    let residual = rows.residual.rows(3 * fold.start, 3 * fold.len());
                    let transposed = jacobian.transpose();
                    (&transposed * jacobian, &transposed * residual, residual.norm_squared())
                })
                .collect(),
        };
        let normals = rows.par_iter().map(of_sensor).collect();
        Self { rows, normals }
    }

    /// Number of folds.
    pub fn folds(&self) -> usize {
        self.rows.iter().map(|rows| rows.folds.len()).max().unwrap_or(0)
    }

    /// Number of whitened entries.
    pub fn entries(&self) -> usize {
        self.rows.iter().map(|rows| rows.residual.len()).sum()
    }

    /// Score of a candidate, every coefficient fitted for each sensor.
    pub fn score(&self, columns: &[DMatrix<f64>]) -> Score {
        let of_sensor = |sensor: usize| self.score_of(sensor, columns.get(sensor));
        let scores: Vec<Score> = (0..self.rows.len()).into_par_iter().map(of_sensor).collect();
        let mut sum = Score { folds: vec![0.0; self.folds()], fitted: 0.0 };
        for score in scores {
            sum.folds.iter_mut().zip(&score.folds).for_each(|(sum, own)| *sum += own);
            sum.fitted += score.fitted;
        }
        sum
    }

    fn score_of(&self, sensor: usize, columns: Option<&DMatrix<f64>>) -> Score {
        let rows = &self.rows[sensor];
        let bordered = self.bordered(sensor, columns);
        let size = rows.prior.len() + columns.map_or(0, DMatrix::ncols);
        let solve = |without: Option<usize>| {
            let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
            for (fold, (own, target, _)) in bordered.iter().enumerate() {
                if Some(fold) != without {
                    matrix += own;
                    right += target;
                }
            }
            self.add_prior(sensor, &mut matrix);
            matrix.cholesky().map(|factor| factor.solve(&right))
        };
        let left = |fold: &(DMatrix<f64>, DVector<f64>, f64), found: &Option<DVector<f64>>| {
            let (matrix, right, squares) = fold;
            found.as_ref().map_or(*squares, |x| squares - 2.0 * x.dot(right) + x.dot(&(matrix * x)))
        };
        let folds =
            bordered.iter().enumerate().map(|(i, fold)| left(fold, &solve(Some(i)))).collect();
        let whole = solve(None);
        Score { folds, fitted: bordered.iter().map(|fold| left(fold, &whole)).sum() }
    }

    /// Normal equations of every fold with these columns appended.
    fn bordered(
        &self,
        sensor: usize,
        columns: Option<&DMatrix<f64>>,
    ) -> Vec<(DMatrix<f64>, DVector<f64>, f64)> {
        let rows = &self.rows[sensor];
        let Some(columns) = columns.filter(|columns| columns.ncols() > 0) else {
            return self.normals[sensor].folds.clone();
        };
        let folds = rows.folds.iter().zip(&self.normals[sensor].folds);
        folds
            .map(|(fold, (matrix, right, squares))| {
                let range = |matrix: &DMatrix<f64>| {
                    matrix.rows(3 * fold.start, 3 * fold.len()).into_owned()
                };
                let own = range(columns).transpose();
                let across = &own * rows.jacobian.rows(3 * fold.start, 3 * fold.len());
                let inner = &own * columns.rows(3 * fold.start, 3 * fold.len());
                let target = &own * rows.residual.rows(3 * fold.start, 3 * fold.len());
                let (base, added) = (matrix.nrows(), columns.ncols());
                let mut all = DMatrix::zeros(base + added, base + added);
                all.view_mut((0, 0), (base, base)).copy_from(matrix);
                all.view_mut((base, 0), (added, base)).copy_from(&across);
                all.view_mut((0, base), (base, added)).copy_from(&across.transpose());
                all.view_mut((base, base), (added, added)).copy_from(&inner);
                let mut rights = DVector::zeros(base + added);
                rights.rows_mut(0, base).copy_from(right);
                rights.rows_mut(base, added).copy_from(&target);
                (all, rights, *squares)
            })
            .collect()
    }

    /// Adds the prior of the parameters, and a relative ridge to the columns of a candidate.
    fn add_prior(&self, sensor: usize, matrix: &mut DMatrix<f64>) {
        let prior = &self.rows[sensor].prior;
        for i in 0..matrix.nrows() {
            let ridge = 1e-9 * matrix[(i, i)] + 1e-12;
            matrix[(i, i)] += prior.get(i).copied().unwrap_or(0.0) + ridge;
        }
    }

    /// Reduction of the held-out squared residual by each term (row) at each point of the chain (column), by fold. `terms` are
    /// the values of the terms at each sensor: a row for each term, a column for each averaged row.
    pub fn gains(&self, terms: &[DMatrix<f64>]) -> Vec<DMatrix<f64>> {
        let points = self.rows.first().map_or(0, |rows| rows.patterns.len());
        let pairs: Vec<(usize, usize)> = (0..self.rows.len())
            .flat_map(|sensor| (0..points).map(move |point| (sensor, point)))
            .collect();
        let squares: Vec<DMatrix<f64>> =
            terms.par_iter().map(|terms| terms.component_mul(terms)).collect();
        let found: Vec<Vec<DVector<f64>>> = pairs
            .par_iter()
            .map(|&(sensor, point)| self.gains_at(sensor, point, &terms[sensor], &squares[sensor]))
            .collect();
        let count = terms.first().map_or(0, DMatrix::nrows);
        let mut sums = vec![DMatrix::zeros(count, points); self.folds()];
        for ((_, point), gains) in pairs.into_iter().zip(found) {
            for (sum, gain) in sums.iter_mut().zip(gains) {
                let mut column = sum.column_mut(point);
                column += gain;
            }
        }
        sums
    }

    fn gains_at(
        &self,
        sensor: usize,
        point: usize,
        terms: &DMatrix<f64>,
        squares: &DMatrix<f64>,
    ) -> Vec<DVector<f64>> {
        let rows = &self.rows[sensor];
        let products: Vec<PointProducts> = rows
            .folds
            .iter()
            .map(|fold| PointProducts::of(rows, point, fold.clone(), terms, squares))
            .collect();
        let Some(whole) = PointProducts::sum(&products) else {
            return Vec::new();
        };
        let normals = &self.normals[sensor].folds;
        (0..products.len())
            .map(|h| {
                let own = &products[h];
                let training = whole.without(own);
                let size = rows.prior.len();
                let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
                for (_, (other, target, _)) in normals.iter().enumerate().filter(|(f, _)| *f != h) {
                    matrix += other;
                    right += target;
                }
                self.add_prior(sensor, &mut matrix);
                let Some(inverse) = matrix.cholesky().map(|factor| factor.inverse()) else {
                    return DVector::zeros(terms.nrows());
                };
                let base = &inverse * right;
                let adjusted = &training.across * &inverse;
                let (held, target, _) = &normals[h];
                let rest = target - held * &base;
                let curved = &adjusted * held;
                let slope = &own.target - &own.across * &base - &adjusted * rest;
                let signal = &training.target - &training.across * &base;
                let row_dot = |left: &DMatrix<f64>, right: &DMatrix<f64>| {
                    let mut sums = DVector::zeros(left.nrows());
                    for (a, b) in left.column_iter().zip(right.column_iter()) {
                        sums += a.component_mul(&b);
                    }
                    sums
                };
                let explained = row_dot(&training.across, &adjusted);
                let quadratic = row_dot(&adjusted, &curved) - row_dot(&adjusted, &own.across) * 2.0
                    + &own.squares;
                DVector::from_fn(terms.nrows(), |i, _| {
                    let left = training.squares[i] - explained[i];
                    if left < MIN_PROJECTED * training.squares[i] || left <= 0.0 {
                        return 0.0;
                    }
                    let coefficient = signal[i] / left;
                    coefficient * (2.0 * slope[i] - coefficient * quadratic[i])
                })
            })
            .collect()
    }

    /// Family-wise p-value of a candidate: its reduction of the squared residual on the fitted rows against the largest
    /// reduction by any single term, where blocks of the residual that the candidate leaves have random signs (the same for
    /// all sensors).
    pub fn p_value(&self, columns: &[DMatrix<f64>], terms: &[DMatrix<f64>], seed: u64) -> f64 {
        let reduction = self.score(&[]).fitted - self.score(columns).fitted;
        let blocks = self.rows.iter().map(|rows| rows.blocks.len()).max().unwrap_or(0);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let signs =
            DMatrix::from_fn(blocks, DRAWS, |_, _| if rng.random::<bool>() { 1.0 } else { -1.0 });
        let residuals: Vec<DVector<f64>> = (0..self.rows.len())
            .into_par_iter()
            .map(|sensor| self.residual_after(sensor, columns.get(sensor)))
            .collect();
        let points = self.rows.first().map_or(0, |rows| rows.patterns.len());
        let squares: Vec<DMatrix<f64>> =
            terms.par_iter().map(|terms| terms.component_mul(terms)).collect();
        let maxima: Vec<DVector<f64>> = (0..points)
            .into_par_iter()
            .map(|point| {
                let scores: Vec<DMatrix<f64>> = (0..self.rows.len())
                    .map(|sensor| {
                        let (terms, squares) = (&terms[sensor], &squares[sensor]);
                        self.block_scores(sensor, point, terms, squares, &residuals[sensor])
                    })
                    .collect();
                largest_flipped(&scores, &signs, reduction)
            })
            .collect();
        let exceeds = |draw: usize| maxima.iter().any(|maxima| maxima[draw] >= reduction);
        let beyond = (0..DRAWS).filter(|draw| exceeds(*draw)).count();
        (1 + beyond) as f64 / (1 + DRAWS) as f64
    }

    /// Residual with everything fitted, the candidate included.
    fn residual_after(&self, sensor: usize, columns: Option<&DMatrix<f64>>) -> DVector<f64> {
        let rows = &self.rows[sensor];
        let bordered = self.bordered(sensor, columns);
        let size = rows.prior.len() + columns.map_or(0, DMatrix::ncols);
        let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for (own, target, _) in &bordered {
            matrix += own;
            right += target;
        }
        self.add_prior(sensor, &mut matrix);
        let Some(found) = matrix.cholesky().map(|factor| factor.solve(&right)) else {
            return rows.residual.clone();
        };
        let base = rows.prior.len();
        let mut residual = &rows.residual - &rows.jacobian * found.rows(0, base);
        if let Some(columns) = columns.filter(|columns| columns.ncols() > 0) {
            residual -= columns * found.rows(base, columns.ncols());
        }
        residual
    }

    /// Score of every term (row) in every block of time (column), in standard deviations of white noise.
    fn block_scores(
        &self,
        sensor: usize,
        point: usize,
        terms: &DMatrix<f64>,
        squares: &DMatrix<f64>,
        residual: &DVector<f64>,
    ) -> DMatrix<f64> {
        let rows = &self.rows[sensor];
        let whole = PointProducts::of(rows, point, 0..rows.len(), terms, squares);
        let size = rows.prior.len();
        let mut matrix = DMatrix::zeros(size, size);
        self.normals[sensor].folds.iter().for_each(|(own, ..)| matrix += own);
        self.add_prior(sensor, &mut matrix);
        let Some(inverse) = matrix.cholesky().map(|factor| factor.inverse()) else {
            return DMatrix::zeros(terms.nrows(), rows.blocks.len());
        };
        let adjusted = &whole.across * inverse;
        let mut scores = DMatrix::zeros(terms.nrows(), rows.blocks.len());
        for (block, range) in rows.blocks.iter().enumerate() {
            let within =
                |vector: &DVector<f64>| vector.rows(3 * range.start, 3 * range.len()).into_owned();
            let (left, pattern) = (within(residual), within(&rows.patterns[point]));
            let along = DVector::from_fn(range.len(), |row, _| {
                left.rows(3 * row, 3).dot(&pattern.rows(3 * row, 3))
            });
            let jacobian = rows.jacobian.rows(3 * range.start, 3 * range.len());
            let of_base = jacobian.transpose() * left;
            let own = terms.columns(range.start, range.len()) * along - &adjusted * of_base;
            scores.set_column(block, &own);
        }
        for (i, mut row) in scores.row_iter_mut().enumerate() {
            let explained = whole.across.row(i).dot(&adjusted.row(i));
            let left = whole.squares[i] - explained;
            if left < MIN_PROJECTED * whole.squares[i] || left <= 0.0 {
                row.fill(0.0);
            } else {
                row /= left.sqrt();
            }
        }
        scores
    }
}

/// Largest squared score over all terms for each draw of signs; terms that reach `least` with no signs are left out.
fn largest_flipped(scores: &[DMatrix<f64>], signs: &DMatrix<f64>, least: f64) -> DVector<f64> {
    let terms = scores.first().map_or(0, DMatrix::nrows);
    let bound = |term: usize| -> f64 {
        scores.iter().map(|scores| scores.row(term).lp_norm(1).powi(2)).sum()
    };
    let reaching: Vec<usize> = (0..terms).filter(|term| bound(*term) >= least).collect();
    let mut sums = DMatrix::zeros(reaching.len(), signs.ncols());
    for scores in scores {
        let flipped = scores.select_rows(&reaching) * signs.rows(0, scores.ncols());
        sums += flipped.map(|value| value * value);
    }
    let largest = sums.column_iter().map(|column| column.iter().copied().fold(0.0, f64::max));
    DVector::from_iterator(signs.ncols(), largest)
}

/// Products of all terms at one point of the chain with Jacobian and residual, over a range of rows.
#[derive(Clone)]
struct PointProducts {
    /// With the Jacobian: a row for each term.
    across: DMatrix<f64>,
    /// With the residual.
    target: DVector<f64>,
    /// With itself.
    squares: DVector<f64>,
}

impl PointProducts {
    fn of(
        rows: &SensorRows,
        point: usize,
        range: Range<usize>,
        terms: &DMatrix<f64>,
        squares: &DMatrix<f64>,
    ) -> Self {
        let (first, count) = (range.start, range.len());
        let pattern = rows.patterns[point].rows(3 * first, 3 * count);
        let columns = rows.prior.len();
        // One column for each parameter, and the residual last.
        let mut along = DMatrix::zeros(count, columns + 1);
        for column in 0..columns {
            let own = rows.jacobian.column(column);
            let own = own.rows(3 * first, 3 * count);
            for row in 0..count {
                along[(row, column)] = own[3 * row] * pattern[3 * row]
                    + own[3 * row + 1] * pattern[3 * row + 1]
                    + own[3 * row + 2] * pattern[3 * row + 2];
            }
        }
        let residual = rows.residual.rows(3 * first, 3 * count);
        let mut power = DVector::zeros(count);
        for row in 0..count {
            let (p, r) = (pattern.fixed_rows::<3>(3 * row), residual.fixed_rows::<3>(3 * row));
            along[(row, columns)] = p.dot(&r);
            power[row] = p.norm_squared();
        }
        let products = terms.columns(first, count) * along;
        Self {
            across: products.columns(0, columns).into_owned(),
            target: products.column(columns).into_owned(),
            squares: squares.columns(first, count) * power,
        }
    }

    fn sum(of: &[Self]) -> Option<Self> {
        let (first, rest) = of.split_first()?;
        let mut sum = first.clone();
        for other in rest {
            sum.across += &other.across;
            sum.target += &other.target;
            sum.squares += &other.squares;
        }
        Some(sum)
    }

    fn without(&self, other: &Self) -> Self {
        Self {
            across: &self.across - &other.across,
            target: &self.target - &other.target,
            squares: &self.squares - &other.squares,
        }
    }
}
