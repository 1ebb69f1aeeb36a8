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

    /// Score of a candidate at one sensor.
    pub fn score_of(&self, sensor: usize, columns: Option<&DMatrix<f64>>) -> Score {
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

    /// Residual with everything fitted.
    fn residual(&self, sensor: usize) -> DVector<f64> {
        let rows = &self.rows[sensor];
        let size = rows.prior.len();
        let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for (own, target, _) in &self.normals[sensor].folds {
            matrix += own;
            right += target;
        }
        self.add_prior(sensor, &mut matrix);
        match matrix.cholesky() {
            Some(factor) => &rows.residual - &rows.jacobian * factor.solve(&right),
            None => rows.residual.clone(),
        }
    }
}

/// All terms of a dictionary at all points of the chain.
pub struct TermScan<'a> {
    scan: &'a Scan,
    /// Values of the terms at each sensor: a row for each term, a column for each averaged row.
    terms: &'a [DMatrix<f64>],
    /// Of each sensor, by fold.
    products: Vec<Vec<TermProducts>>,
}

impl<'a> TermScan<'a> {
    /// Multiplies all terms with Jacobian and residual.
    pub fn new(scan: &'a Scan, terms: &'a [DMatrix<f64>]) -> Self {
        let products = scan
            .rows
            .par_iter()
            .zip(terms)
            .map(|(rows, terms)| {
                let squares = terms.component_mul(terms);
                let folds = rows.folds.par_iter();
                folds.map(|fold| TermProducts::of(rows, fold.clone(), terms, &squares)).collect()
            })
            .collect();
        Self { scan, terms, products }
    }

    fn count(&self) -> usize {
        self.terms.first().map_or(0, DMatrix::nrows)
    }

    fn points(&self) -> usize {
        self.scan.rows.first().map_or(0, |rows| rows.patterns.len())
    }

    /// Reduction of the held-out squared residual by each term (row) at each point of the chain (column), by fold.
    pub fn gains(&self) -> Vec<DMatrix<f64>> {
        let pairs: Vec<(usize, usize)> = (0..self.scan.rows.len())
            .flat_map(|sensor| (0..self.points()).map(move |point| (sensor, point)))
            .collect();
        let found: Vec<Vec<DVector<f64>>> =
            pairs.par_iter().map(|&(sensor, point)| self.gains_at(sensor, point)).collect();
        let mut sums = vec![DMatrix::zeros(self.count(), self.points()); self.scan.folds()];
        for ((_, point), gains) in pairs.into_iter().zip(found) {
            for (sum, gain) in sums.iter_mut().zip(gains) {
                let mut column = sum.column_mut(point);
                column += gain;
            }
        }
        sums
    }

    fn gains_at(&self, sensor: usize, point: usize) -> Vec<DVector<f64>> {
        let size = self.scan.rows[sensor].prior.len();
        let of_point = self.products[sensor].iter().map(|products| products.at(point, size));
        let products: Vec<PointProducts> = of_point.collect();
        let Some(whole) = PointProducts::sum(&products) else {
            return Vec::new();
        };
        let normals = &self.scan.normals[sensor].folds;
        (0..products.len())
            .map(|h| {
                let own = &products[h];
                let training = whole.without(own);
                let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
                for (_, (other, target, _)) in normals.iter().enumerate().filter(|(f, _)| *f != h) {
                    matrix += other;
                    right += target;
                }
                self.scan.add_prior(sensor, &mut matrix);
                let Some(inverse) = matrix.cholesky().map(|factor| factor.inverse()) else {
                    return DVector::zeros(self.count());
                };
                let base = &inverse * right;
                let adjusted = &training.across * &inverse;
                let (held, target, _) = &normals[h];
                let rest = target - held * &base;
                let curved = &adjusted * held;
                let slope = &own.target - &own.across * &base - &adjusted * rest;
                let signal = &training.target - &training.across * &base;
                let explained = row_products(&training.across, &adjusted);
                let quadratic = row_products(&adjusted, &curved)
                    - row_products(&adjusted, &own.across) * 2.0
                    + &own.squares;
                DVector::from_fn(self.count(), |i, _| {
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

    /// Family-wise p-value of a candidate, which has these columns at every sensor: its reduction of the squared residual on the
    /// fitted rows against the largest reduction by any single term, where blocks of the residual have random signs (the same
    /// for all sensors). The share of the candidate stays in the residual: without it, the test would be wrong three times as
    /// often as it states, since the best of many terms is also the one that fits the most noise.
    pub fn p_value(&self, columns: &[DMatrix<f64>], seed: u64) -> f64 {
        let scan = self.scan;
        let reduction = scan.score(&[]).fitted - scan.score(columns).fitted;
        let blocks = scan.rows.iter().map(|rows| rows.blocks.len()).max().unwrap_or(0);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let signs =
            DMatrix::from_fn(blocks, DRAWS, |_, _| if rng.random::<bool>() { 1.0 } else { -1.0 });
        let scores: Vec<Vec<DMatrix<f64>>> = (0..scan.rows.len())
            .into_par_iter()
            .map(|sensor| self.block_scores(sensor, &scan.residual(sensor)))
            .collect();
        let maxima: Vec<DVector<f64>> = (0..self.points())
            .into_par_iter()
            .map(|point| {
                let of_point: Vec<&DMatrix<f64>> =
                    scores.iter().map(|scores| &scores[point]).collect();
                largest_flipped(&of_point, &signs, reduction)
            })
            .collect();
        let exceeds = |draw: usize| maxima.iter().any(|maxima| maxima[draw] >= reduction);
        let beyond = (0..DRAWS).filter(|draw| exceeds(*draw)).count();
        (1 + beyond) as f64 / (1 + DRAWS) as f64
    }

    /// At every point of the chain: score of every term (row) in every block of time (column), in standard deviations of
    /// white noise.
    fn block_scores(&self, sensor: usize, residual: &DVector<f64>) -> Vec<DMatrix<f64>> {
        let rows = &self.scan.rows[sensor];
        let (size, blocks) = (rows.prior.len(), rows.blocks.len());
        let mut matrix = DMatrix::zeros(size, size);
        self.scan.normals[sensor].folds.iter().for_each(|(own, ..)| matrix += own);
        self.scan.add_prior(sensor, &mut matrix);
        let Some(inverse) = matrix.cholesky().map(|factor| factor.inverse()) else {
            return vec![DMatrix::zeros(self.count(), blocks); self.points()];
        };
        let mut of_base = DMatrix::zeros(size, blocks);
        let mut of_terms = Vec::with_capacity(blocks);
        for (block, range) in rows.blocks.iter().enumerate() {
            let (first, count) = (3 * range.start, 3 * range.len());
            let left = residual.rows(first, count);
            let jacobian = rows.jacobian.rows(first, count);
            of_base.set_column(block, &(jacobian.transpose() * left));
            let along = DMatrix::from_fn(range.len(), self.points(), |row, point| {
                left.rows(3 * row, 3).dot(&rows.patterns[point].rows(first + 3 * row, 3))
            });
            of_terms.push(self.terms[sensor].columns(range.start, range.len()) * along);
        }
        let of_point = |point: usize| {
            let of_folds = self.products[sensor].iter().map(|products| products.at(point, size));
            let Some(whole) = PointProducts::sum(&of_folds.collect::<Vec<_>>()) else {
                return DMatrix::zeros(self.count(), blocks);
            };
            let adjusted = &whole.across * &inverse;
            let mut scores = -(&adjusted * &of_base);
            for (mut column, of_terms) in scores.column_iter_mut().zip(&of_terms) {
                column += of_terms.column(point);
            }
            let explained = row_products(&whole.across, &adjusted);
            for (i, mut row) in scores.row_iter_mut().enumerate() {
                let left = whole.squares[i] - explained[i];
                if left < MIN_PROJECTED * whole.squares[i] || left <= 0.0 {
                    row.fill(0.0);
                } else {
                    row /= left.sqrt();
                }
            }
            scores
        };
        (0..self.points()).map(of_point).collect()
    }
}

fn row_products(left: &DMatrix<f64>, right: &DMatrix<f64>) -> DVector<f64> {
    let mut sums = DVector::zeros(left.nrows());
    for (left, right) in left.column_iter().zip(right.column_iter()) {
        sums += left.component_mul(&right);
    }
    sums
}

/// Largest squared score over all terms for each draw of signs; terms that reach `least` with no signs are left out.
fn largest_flipped(scores: &[&DMatrix<f64>], signs: &DMatrix<f64>, least: f64) -> DVector<f64> {
    let terms = scores.first().map_or(0, |scores| scores.nrows());
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

/// Products of all terms at all points of the chain with Jacobian and residual, over a range of rows.
struct TermProducts {
    /// A row for each term; for each point a column for each parameter, and one for the residual.
    across: DMatrix<f64>,
    /// With themselves: a row for each term, a column for each point.
    squares: DMatrix<f64>,
}

impl TermProducts {
    fn of(
        rows: &SensorRows,
        range: Range<usize>,
        terms: &DMatrix<f64>,
        squares: &DMatrix<f64>,
    ) -> Self {
        let (first, count) = (range.start, range.len());
        let (points, columns) = (rows.patterns.len(), rows.prior.len() + 1);
        let mut along = DMatrix::zeros(count, points * columns);
        let mut power = DMatrix::zeros(count, points);
        let within = |values: &[f64], column: usize| -> Vec<[f64; 3]> {
            let all = &values[column * rows.residual.len()..][3 * first..3 * (first + count)];
            all.as_chunks::<3>().0.to_vec()
        };
        let product = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        for (point, pattern) in rows.patterns.iter().enumerate() {
            let pattern = within(pattern.as_slice(), 0);
            let mut set = |column: usize, values: &[[f64; 3]]| {
                let products =
                    pattern.iter().zip(values).map(|(pattern, own)| product(pattern, own));
                let mut column = along.column_mut(point * columns + column);
                column.iter_mut().zip(products).for_each(|(entry, product)| *entry = product);
            };
            for column in 0..columns - 1 {
                set(column, &within(rows.jacobian.as_slice(), column));
            }
            set(columns - 1, &within(rows.residual.as_slice(), 0));
            let squared = pattern.iter().map(|pattern| product(pattern, pattern));
            power.column_mut(point).iter_mut().zip(squared).for_each(|(entry, own)| *entry = own);
        }
        Self {
            across: terms.columns(first, count) * along,
            squares: squares.columns(first, count) * power,
        }
    }

    /// At one point, with `size` parameters.
    fn at(&self, point: usize, size: usize) -> PointProducts {
        let first = point * (size + 1);
        PointProducts {
            across: self.across.columns(first, size).into_owned(),
            target: self.across.column(first + size).into_owned(),
            squares: self.squares.column(point).into_owned(),
        }
    }
}

/// Products of all terms at one point of the chain with Jacobian and residual.
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

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: usize = 120;

    /// A sensor with three parameters and two points of the chain; the residual is noise of unit variance.
    fn sensor(rng: &mut ChaCha8Rng) -> SensorRows {
        let mut normal = || -> f64 {
            let uniform: [f64; 12] = rng.random();
            uniform.iter().sum::<f64>() - 6.0
        };
        let mut vector = |length: usize| DVector::from_fn(length, |_, _| normal());
        SensorRows {
            residual: vector(3 * ROWS),
            jacobian: DMatrix::from_columns(&[
                vector(3 * ROWS),
                vector(3 * ROWS),
                vector(3 * ROWS),
            ]),
            prior: DVector::from_vec(vec![0.0, 5.0, 100.0]),
            patterns: vec![vector(3 * ROWS), vector(3 * ROWS)],
            folds: (0..3).map(|fold| 40 * fold..40 * (fold + 1)).collect(),
            blocks: (0..12).map(|block| 10 * block..10 * (block + 1)).collect(),
        }
    }

    fn terms(rng: &mut ChaCha8Rng) -> DMatrix<f64> {
        DMatrix::from_fn(5, ROWS, |_, _| 2.0 * rng.random::<f64>() - 1.0)
    }

    /// Column of a term at a point of the chain.
    fn column(rows: &SensorRows, terms: &DMatrix<f64>, term: usize, point: usize) -> DMatrix<f64> {
        let pattern = &rows.patterns[point];
        DMatrix::from_fn(3 * ROWS, 1, |entry, _| pattern[entry] * terms[(term, entry / 3)])
    }

    #[test]
    fn gain_of_every_term_is_that_of_its_own_regression() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut rows = vec![sensor(&mut rng), sensor(&mut rng)];
        let terms = vec![terms(&mut rng), terms(&mut rng)];
        // Something to be found, by one of the terms at one of the points.
        for (rows, terms) in rows.iter_mut().zip(&terms) {
            rows.residual += 0.8 * column(rows, terms, 3, 1).column(0);
        }
        let scan = Scan::new(rows);
        let gains = TermScan::new(&scan, &terms).gains();
        let before = scan.score(&[]);
        let mut largest = (0, 0, 0.0);
        for term in 0..5 {
            for point in 0..2 {
                let columns: Columns = scan
                    .rows
                    .iter()
                    .zip(&terms)
                    .map(|(rows, terms)| column(rows, terms, term, point))
                    .collect();
                let score = scan.score(&columns);
                for (fold, of_fold) in gains.iter().enumerate() {
                    // A term that shares its coefficient with the base parameters is as good as both fitted at once.
                    let gain = before.folds[fold] - score.folds[fold];
                    let error = (of_fold[(term, point)] - gain).abs();
                    assert!(error < 1e-6 * before.folds[fold], "{term} {point} {fold}: {error}");
                }
                let gain = before.held_out() - score.held_out();
                if gain > largest.2 {
                    largest = (term, point, gain);
                }
            }
        }
        assert_eq!((largest.0, largest.1), (3, 1));
    }

    #[test]
    fn score_is_that_of_a_regression_without_the_fold() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let rows = sensor(&mut rng);
        let terms = terms(&mut rng);
        let own = column(&rows, &terms, 0, 0);
        let all = DMatrix::from_fn(3 * ROWS, 4, |row, at| {
            if at < 3 { rows.jacobian[(row, at)] } else { own[(row, 0)] }
        });
        let prior = DMatrix::from_diagonal(&DVector::from_vec(vec![0.0, 5.0, 100.0, 0.0]));
        let expected: Vec<f64> = rows
            .folds
            .iter()
            .map(|fold| {
                let held = 3 * fold.start..3 * fold.end;
                let others: Vec<usize> = (0..3 * ROWS).filter(|row| !held.contains(row)).collect();
                let (matrix, target) =
                    (all.select_rows(&others), rows.residual.select_rows(&others));
                let normal = matrix.transpose() * &matrix + &prior;
                let found = normal.lu().solve(&(matrix.transpose() * target)).unwrap();
                let held: Vec<usize> = held.collect();
                let left = rows.residual.select_rows(&held) - all.select_rows(&held) * found;
                left.norm_squared()
            })
            .collect();
        let score = Scan::new(vec![rows]).score(&[own]);
        for (own, expected) in score.folds.iter().zip(expected) {
            assert!((own / expected - 1.0).abs() < 1e-6, "{own} {expected}");
        }
    }

    #[test]
    fn p_value_of_the_best_term_on_noise_is_uniform() {
        // The best of 10 terms is taken in each of 200 draws. Family-wise, 10 of them are expected below 0.05, with a standard
        // deviation of 3; without account for the choice it would be 80.
        let mut below = 0;
        for seed in 0..200 {
            let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
            let scan = Scan::new(vec![sensor(&mut rng)]);
            let terms = vec![terms(&mut rng)];
            let before = scan.score(&[]).fitted;
            let candidates = (0..5).flat_map(|term| [(term, 0), (term, 1)]);
            let all =
                candidates.map(|(term, point)| vec![column(&scan.rows[0], &terms[0], term, point)]);
            let gain = |columns: &Columns| before - scan.score(columns).fitted;
            let best = all.max_by(|a, b| gain(a).total_cmp(&gain(b))).unwrap();
            let p_value = TermScan::new(&scan, &terms).p_value(&best, seed);
            below += usize::from(p_value < 0.05);
        }
        assert!((1..=19).contains(&below), "{below}");
    }

    #[test]
    fn p_value_of_a_real_term_is_the_least_possible() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut rows = sensor(&mut rng);
        let terms = terms(&mut rng);
        let own = column(&rows, &terms, 2, 0);
        rows.residual += &own.column(0) * 1.0;
        let (scan, terms) = (Scan::new(vec![rows]), [terms]);
        let p_value = TermScan::new(&scan, &terms).p_value(&[own], 7);
        assert!((p_value - 1.0 / 1000.0).abs() < 1e-12, "{p_value}");
    }
}
