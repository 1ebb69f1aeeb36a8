//! Identifiability: the combinations of parameters that the data determine; the others stay at their start.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::fit::FitOptions;
use crate::fit::block_bootstrap::{self, Block, add_normal};

/// A direction is free if its standard error is at most this, in prior widths.
pub const MAX_UNCERTAINTY: f64 = 0.5;
/// Share of the prior's information that a draw of blocks has. The free directions have at least four times the prior's, of which all of it
/// would hide a fifth of their errors.
const PRIOR: f64 = 0.1;

/// A combination of parameters that the data do not determine, fixed at its start.
#[derive(Clone, Debug, PartialEq)]
pub struct Unidentifiable {
    /// Indices of parameters and their weights in the combination, in prior widths, largest first.
    pub shares: Vec<(usize, f64)>,
    /// Standard error from the data alone, in prior widths; infinite where the field does not depend on it.
    pub uncertainty: f64,
}

/// Variance inflation of the scores: 1 for white noise of the floor's magnitude, more for autocorrelated or
/// structured residuals.
pub fn noise_inflation(blocks: &[Block]) -> f64 {
    let normal = normal(blocks);
    let noise = block_bootstrap::score_covariance(blocks);
    let eigen = SymmetricEigen::new(normal);
    let directions = eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter());
    // Directions without sensitivity carry no information about the noise.
    let floor = 1e-12 * eigen.eigenvalues.amax();
    let ratios: Vec<f64> = directions
        .filter(|(_, value)| **value > floor)
        .map(|(direction, value)| direction.dot(&(&noise * direction)) / value)
        .collect();
    (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).max(1.0)
}

fn normal(blocks: &[Block]) -> DMatrix<f64> {
    let size = blocks.first().map_or(0, |block| block.score.len());
    let mut sum = DMatrix::zeros(size, size);
    blocks.iter().for_each(|block| add_normal(&mut sum, block));
    sum
}

/// Variance inflation factor of one parameter by collinearity, from the Jacobian alone, without a prior.
pub fn variance_inflation(blocks: &[Block], index: usize) -> f64 {
    let normal = normal(blocks);
    let answered: Vec<usize> = (0..normal.nrows()).filter(|&i| normal[(i, i)] > 0.0).collect();
    let Some(own) = answered.iter().position(|&i| i == index) else {
        return f64::INFINITY;
    };
    let scaled = DMatrix::from_fn(answered.len(), answered.len(), |i, j| {
        let (i, j) = (answered[i], answered[j]);
        normal[(i, j)] / (normal[(i, i)] * normal[(j, j)]).sqrt()
    });
    let inverse = scaled.cholesky().map(|factor| factor.inverse());
    inverse.map_or(f64::INFINITY, |inverse| inverse[(own, own)])
}

/// Subspace of the parameters that a fit may move.
#[derive(Clone, Debug)]
pub struct FreeDirections {
    /// Orthonormal columns, in prior widths.
    pub free: DMatrix<f64>,
    /// Combinations that stay at their start.
    pub unidentifiable: Vec<Unidentifiable>,
    unidentifiable_directions: Vec<DVector<f64>>,
    /// Parameters with externally set values.
    frozen: Vec<usize>,
}

impl FreeDirections {
    /// All directions are free except those of `frozen` parameters.
    pub fn except(frozen: &[usize], count: usize) -> Self {
        let open: Vec<usize> = (0..count).filter(|index| !frozen.contains(index)).collect();
        Self {
            free: DMatrix::from_fn(count, open.len(), |i, j| f64::from(u8::from(open[j] == i))),
            unidentifiable: Vec::new(),
            unidentifiable_directions: Vec::new(),
            frozen: frozen.to_vec(),
        }
    }

    /// Free are the directions of `count` parameters that the blocks of a fit determine well enough, apart from `frozen` parameters.
    pub fn from_data(blocks: &[Block], count: usize, frozen: &[usize]) -> Self {
        let open: Vec<usize> = (0..count).filter(|i| !frozen.contains(i)).collect();
        let noise =
            block_bootstrap::score_covariance(blocks).select_rows(&open).select_columns(&open);
        let eigen = SymmetricEigen::new(normal(blocks).select_rows(&open).select_columns(&open));
        let mut free = Vec::new();
        let (mut unidentifiable, mut unidentifiable_directions) = (Vec::new(), Vec::new());
        for (direction, &value) in eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter()) {
            let variance = direction.dot(&(&noise * direction));
            let value = value.max(f64::MIN_POSITIVE);
            // No residual is below the noise floor.
            let uncertainty = (variance.sqrt() / value).max(1.0 / value.sqrt());
            let mut lifted = DVector::zeros(count);
            open.iter().zip(direction.iter()).for_each(|(&index, share)| lifted[index] = *share);
            if uncertainty <= MAX_UNCERTAINTY {
                free.push(lifted);
            } else {
                unidentifiable.push(Unidentifiable { shares: shares(&lifted), uncertainty });
                unidentifiable_directions.push(lifted);
            }
        }
        let free =
            if free.is_empty() { DMatrix::zeros(count, 0) } else { DMatrix::from_columns(&free) };
        Self { free, unidentifiable, unidentifiable_directions, frozen: frozen.to_vec() }
    }

    /// The same with these frozen parameters freed.
    pub fn with_freed(&self, parameters: &[usize]) -> Self {
        let count = self.free.nrows();
        let unit = |index: &usize| DVector::from_fn(count, |i, _| f64::from(u8::from(i == *index)));
        let columns: Vec<DVector<f64>> = self
            .free
            .column_iter()
            .map(|column| column.into_owned())
            .chain(parameters.iter().map(unit))
            .collect();
        Self {
            free: DMatrix::from_columns(&columns),
            frozen: self
                .frozen
                .iter()
                .copied()
                .filter(|index| !parameters.contains(index))
                .collect(),
            ..self.clone()
        }
    }

    /// Component of `start` outside the free directions: frozen parameters keep their value, unidentifiable
    /// directions are zero.
    pub fn fixed_part(&self, start: &DVector<f64>) -> DVector<f64> {
        let mut pinned = DVector::zeros(start.len());
        self.frozen.iter().for_each(|&index| pinned[index] = start[index]);
        pinned
    }

    /// Covariance of all parameters, in prior widths: bootstrap in the free directions, the prior in
    /// unidentifiable ones, zero in frozen ones.
    pub fn covariance(&self, blocks: &[Block], options: FitOptions) -> DMatrix<f64> {
        let reduced: Vec<Block> = blocks
            .iter()
            .map(|block| {
                let free = self.free.select_rows(&block.acting);
                Block {
                    acting: (0..free.ncols()).collect(),
                    normal: free.transpose() * &block.normal * &free,
                    score: self.free.transpose() * &block.score,
                    squares: block.squares,
                }
            })
            .collect();
        let free =
            block_bootstrap::bootstrap_covariance(&reduced, PRIOR, options.draws, options.seed);
        let free = &self.free * free * self.free.transpose();
        let unidentifiable = self.unidentifiable_directions.iter();
        unidentifiable.fold(free, |sum, direction| sum + direction * direction.transpose())
    }

    /// Standard deviation of each parameter by the prior in the unidentifiable directions, in prior widths.
    pub fn prior_deviations(&self) -> Vec<f64> {
        let squares = |index: usize| {
            let shares = self.unidentifiable_directions.iter().map(|direction| direction[index]);
            shares.map(|share| share * share).sum::<f64>()
        };
        (0..self.free.nrows()).map(|index| squares(index).sqrt()).collect()
    }
}

fn shares(direction: &DVector<f64>) -> Vec<(usize, f64)> {
    let mut shares: Vec<(usize, f64)> = direction.iter().copied().enumerate().collect();
    shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    // The sign is arbitrary: the largest weight is positive.
    let sign = shares.first().map_or(1.0, |first| first.1.signum());
    shares.iter_mut().for_each(|share| share.1 *= sign);
    shares.retain(|share| share.1.abs() > 0.2);
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variance_inflation_detects_collinear_columns() {
        let answers = |second: [f64; 4]| {
            let columns: Vec<f64> = [1.0; 4].into_iter().chain(second).collect();
            let jacobian = DMatrix::from_column_slice(4, 2, &columns);
            variance_inflation(&[Block::of((&jacobian, &[0, 1], 2), &[0.0; 4], 0..4)], 0)
        };
        assert!((answers([1.0, -1.0, 1.0, -1.0]) - 1.0).abs() < 1e-9);
        assert!(answers([1.0, 1.1, 0.9, 1.0]) > 100.0);
    }
}
