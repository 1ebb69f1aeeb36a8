//! Block bootstrap of a least-squares solution.
//!
//! Residuals of a real sensor are autocorrelated, so that error bars for independent rows are far too small.
//! Whole blocks of time are drawn with replacement (Künsch 1989). Each draw solves the problem linearised at
//! the solution: one small matrix instead of a new fit.

use std::ops::{AddAssign, Range};

use nalgebra::{Cholesky, DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fit::rows::SensorRows;
use crate::fit::tall_products::{columns, gram, products};
use crate::recordings::noise::autocorrelation_rows;

/// Contribution of a block of rows to the normal equations `H = J'J` and `g = J'r`.
#[derive(Clone, Debug)]
pub struct Block {
    /// Parameters on which the field of the block depends, ascending.
    pub acting: Vec<usize>,
    /// `J'J` over the rows of the block, of these parameters.
    pub normal: DMatrix<f64>,
    /// `J'r` over the rows of the block, of all parameters; `r` measured minus modelled.
    pub score: DVector<f64>,
    /// `r'r` over the rows of the block.
    pub squares: f64,
}

impl AddAssign<&Block> for Block {
    /// Adds a block of the same parameters; this one must have the normal equations of all of them.
    fn add_assign(&mut self, other: &Block) {
        add_normal(&mut self.normal, other);
        self.score += &other.score;
        self.squares += other.squares;
    }
}

/// Adds the normal equations of a block to those of all parameters.
pub(crate) fn add_normal(sum: &mut DMatrix<f64>, block: &Block) {
    for (&column, from) in block.acting.iter().zip(block.normal.column_iter()) {
        let mut to = sum.column_mut(column);
        block.acting.iter().zip(from.iter()).for_each(|(&row, value)| to[row] += value);
    }
}

impl Block {
    /// From these rows of weighted derivatives to the parameters `acting` out of `count`, and of residuals.
    pub fn of(
        (jacobian, acting, count): (&DMatrix<f64>, &[usize], usize),
        residuals: &[f64],
        rows: Range<usize>,
    ) -> Self {
        let columns = columns(jacobian, rows.clone());
        let residuals = residuals.get(rows).unwrap_or_default();
        let scores = products(&columns, &[residuals]);
        let mut score = DVector::zeros(count);
        acting.iter().zip(scores.iter()).for_each(|(&place, value)| score[place] = *value);
        let squares = residuals.iter().map(|r| r * r).sum();
        Self { acting: acting.to_vec(), normal: gram(&columns), score, squares }
    }

    /// Empty block of all parameters.
    pub fn zeros(count: usize) -> Self {
        Self {
            acting: (0..count).collect(),
            normal: DMatrix::zeros(count, count),
            score: DVector::zeros(count),
            squares: 0.0,
        }
    }
}

/// Minimum number of blocks for a useful error bar.
pub const MIN_BLOCKS: usize = 12;

/// Maximum number of blocks: their matrices are kept, and drawn again and again.
const MAX_BLOCKS: usize = 300;

/// Minimum block length in seconds.
const MIN_BLOCK_S: f64 = 1.0;

/// Block length in seconds, and the longest correlation time of the residuals (by recording and axis) in seconds. A block is three
/// times as long, at least `MIN_BLOCK_S` and what leaves `MAX_BLOCKS` blocks, at most what leaves `MIN_BLOCKS` blocks.
pub(crate) fn block_length_s(
    rows: &SensorRows,
    residuals: impl Fn(usize, usize) -> Vec<f64>,
) -> (f64, f64) {
    let (mut longest_s, mut duration_s) = (0.0_f64, 0.0);
    for (i, part) in rows.parts.iter().enumerate() {
        let (Some(first), Some(last)) = (part.time_s.first(), part.time_s.last()) else {
            continue;
        };
        let period_s = (last - first) / part.len() as f64;
        duration_s += last - first;
        for axis in 0..3 {
            longest_s = longest_s.max(period_s * autocorrelation_rows(&residuals(i, axis)));
        }
    }
    let shortest_s = MIN_BLOCK_S.max(duration_s / MAX_BLOCKS as f64);
    ((3.0 * longest_s).max(shortest_s).min(duration_s / MIN_BLOCKS as f64), longest_s)
}

/// Jackknife standard error of an estimate from the estimates without each part of the data.
pub(crate) fn jackknife(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    ((count - 1.0) / count * squares).sqrt()
}

/// Covariance of the sum of scores, autocorrelation included.
pub(crate) fn score_covariance(blocks: &[Block]) -> DMatrix<f64> {
    let size = blocks.first().map_or(0, |block| block.score.len());
    let count = blocks.len() as f64;
    let sum = blocks.iter().fold(DVector::zeros(size), |sum, block| sum + &block.score);
    let mean = sum / count;
    // n/(n-1): the mean was estimated from the same blocks.
    let weight = count / (count - 1.0).max(1.0);
    let mut scatter = DMatrix::zeros(size, size);
    for block in blocks {
        let d = &block.score - &mean;
        scatter.ger(weight, &d, &d, 1.0);
    }
    scatter
}

/// Draws whose normal equations are held at once.
const DRAWS_AT_ONCE: usize = 32;

/// Bootstrap covariance of the solution from blocks of the same parameters; zero where it cannot be solved. `known` is the information
/// on each parameter besides the blocks: a draw without the blocks of an event does not determine it.
///
/// The normal equations of a draw are the sum of those of the blocks, each as often as it was drawn: over all draws, a product of
/// two matrices.
pub(crate) fn bootstrap_covariance(
    blocks: &[Block],
    known: f64,
    draws: usize,
    seed: u64,
) -> DMatrix<f64> {
    let size = blocks.first().map_or(0, |block| block.score.len());
    let of_blocks = |value: &dyn Fn(&Block) -> f64| blocks.iter().map(value).collect::<Vec<f64>>();
    let triangle: Vec<(usize, usize)> =
        (0..size).flat_map(|column| (column..size).map(move |row| (row, column))).collect();
    let entries: Vec<Vec<f64>> = triangle
        .iter()
        .map(|place| of_blocks(&|block| block.normal[*place]))
        .chain((0..size).map(|row| of_blocks(&|block| block.score[row])))
        .collect();
    let entries: Vec<&[f64]> = entries.iter().map(Vec::as_slice).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || {
        let mut times = vec![0.0; blocks.len()];
        (0..blocks.len()).for_each(|_| times[rng.random_range(0..blocks.len())] += 1.0);
        times
    };
    let mut steps: Vec<DVector<f64>> = Vec::with_capacity(draws);
    for first in (0..draws).step_by(DRAWS_AT_ONCE) {
        let times: Vec<Vec<f64>> =
            (first..draws.min(first + DRAWS_AT_ONCE)).map(|_| draw()).collect();
        let times: Vec<&[f64]> = times.iter().map(Vec::as_slice).collect();
        for sums in products(&entries, &times).column_iter() {
            let mut normal = DMatrix::from_diagonal_element(size, size, known);
            for ((row, column), sum) in triangle.iter().zip(sums.iter()) {
                normal[(*row, *column)] += *sum;
                if row != column {
                    normal[(*column, *row)] += *sum;
                }
            }
            let score = DVector::from_iterator(size, sums.iter().skip(triangle.len()).copied());
            if let Some(factor) = Cholesky::new(normal) {
                steps.push(factor.solve(&score));
            }
        }
    }
    let count = steps.len().max(2) as f64;
    let mean = steps.iter().fold(DVector::zeros(size), |sum, step| sum + step) / count;
    let mut scatter = DMatrix::zeros(size, size);
    for step in &steps {
        let d = step - &mean;
        scatter.ger(1.0 / (count - 1.0), &d, &d, 1.0);
    }
    scatter
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A standard normal number from twelve uniform ones.
    fn gauss(rng: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
    }

    #[test]
    fn jackknife_of_means_is_the_standard_error_of_the_mean() {
        // Of 1, 2, 6: mean 3, variance 7, standard error sqrt(7 / 3). Means of two: 4, 3.5, 1.5.
        assert!((jackknife(&[4.0, 3.5, 1.5]) - 1.527_525).abs() < 1e-6);
    }

    fn first_order(rng: &mut ChaCha8Rng, memory: f64, n: usize) -> Vec<f64> {
        let mut state = 0.0;
        (0..n)
            .map(|_| {
                state = memory * state + gauss(rng);
                state
            })
            .collect()
    }

    #[test]
    fn bootstrap_error_covers_autocorrelated_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let values = first_order(&mut rng, 0.9, 20_000);
        let blocks: Vec<Block> = values
            .chunks(200)
            .map(|chunk| Block {
                acting: vec![0],
                normal: DMatrix::from_element(1, 1, chunk.len() as f64),
                score: DVector::from_element(1, chunk.iter().sum()),
                squares: 0.0,
            })
            .collect();
        let error = bootstrap_covariance(&blocks, 0.0, 400, 1)[(0, 0)].sqrt();
        // 1 / (1 - a) / sqrt(n) = 0.0707; without autocorrelation it would be 0.016.
        assert!((0.055..0.087).contains(&error), "{error}");
    }
}
