//! Which combinations of parameters the data tell, and which are held at their start.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::Options;
use super::blocks::{self, Block};
use super::slot::Slot;

/// A direction is held unless the data know it this well, in tolerances.
pub const KNOWN_WITHIN: f64 = 0.5;

/// A combination of parameters that the data do not tell, held at its start.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Parameters and their shares in the combination, in tolerances, largest first.
    pub shares: Vec<(String, f64)>,
    /// How well the data alone know it, in tolerances; infinite where not at all.
    pub known_within: f64,
}

/// By how much the normal equations overstate what the data tell: 1 for white noise of the size
/// of the floor, more for residuals with memory or structure.
pub fn inflation(blocks: &[Block]) -> f64 {
    let normal = normal(blocks);
    let noise = blocks::score_covariance(blocks);
    let eigen = SymmetricEigen::new(normal);
    let directions = eigen
        .eigenvectors
        .column_iter()
        .zip(eigen.eigenvalues.iter());
    // What nothing answers to tells nothing about the noise.
    let least = 1e-12 * eigen.eigenvalues.amax();
    let ratios: Vec<f64> = directions
        .filter(|(_, value)| **value > least)
        .map(|(direction, value)| direction.dot(&(&noise * direction)) / value)
        .collect();
    (ratios.iter().sum::<f64>() / ratios.len().max(1) as f64).max(1.0)
}

fn normal(blocks: &[Block]) -> DMatrix<f64> {
    let size = blocks.first().map_or(0, |block| block.score.len());
    blocks
        .iter()
        .fold(DMatrix::zeros(size, size), |sum, block| sum + &block.normal)
}

/// By how much the variance of one parameter grows because others can stand in for it; judged by the
/// answers of the field alone, without any prior.
pub fn variance_inflation(blocks: &[Block], slot: usize) -> f64 {
    let normal = normal(blocks);
    let answered: Vec<usize> = (0..normal.nrows())
        .filter(|&i| normal[(i, i)] > 0.0)
        .collect();
    let Some(own) = answered.iter().position(|&i| i == slot) else {
        return f64::INFINITY;
    };
    let scaled = DMatrix::from_fn(answered.len(), answered.len(), |i, j| {
        let (i, j) = (answered[i], answered[j]);
        normal[(i, j)] / (normal[(i, i)] * normal[(j, j)]).sqrt()
    });
    let inverse = scaled.cholesky().map(|factor| factor.inverse());
    inverse.map_or(f64::INFINITY, |inverse| inverse[(own, own)])
}

/// The directions in which the parameters may move, and those in which they are held.
#[derive(Clone, Debug)]
pub struct Space {
    /// Orthonormal columns, in tolerances.
    pub free: DMatrix<f64>,
    /// What is held at its start.
    pub held: Vec<Held>,
    held_directions: Vec<DVector<f64>>,
    /// Parameters that are set from outside and stay as they are.
    frozen: Vec<usize>,
}

impl Space {
    /// Every direction is free but those of `frozen` parameters.
    pub fn all_but(frozen: &[usize], count: usize) -> Self {
        let open: Vec<usize> = (0..count).filter(|slot| !frozen.contains(slot)).collect();
        Self {
            free: DMatrix::from_fn(count, open.len(), |i, j| f64::from(u8::from(open[j] == i))),
            held: Vec::new(),
            held_directions: Vec::new(),
            frozen: frozen.to_vec(),
        }
    }

    /// Free are the directions that the blocks of a fit know well enough; `frozen` parameters are
    /// none of its business.
    pub fn known_from(blocks: &[Block], slots: &[Slot], frozen: &[usize]) -> Self {
        let count = slots.len();
        let open: Vec<usize> = (0..count).filter(|i| !frozen.contains(i)).collect();
        let noise = blocks::score_covariance(blocks)
            .select_rows(&open)
            .select_columns(&open);
        let eigen = SymmetricEigen::new(normal(blocks).select_rows(&open).select_columns(&open));
        let mut free = Vec::new();
        let (mut held, mut held_directions) = (Vec::new(), Vec::new());
        for (direction, &value) in eigen
            .eigenvectors
            .column_iter()
            .zip(eigen.eigenvalues.iter())
        {
            let variance = direction.dot(&(&noise * direction));
            let value = value.max(f64::MIN_POSITIVE);
            // No residual is quieter than the floor, whatever a direction without an answer shows.
            let known_within = (variance.sqrt() / value).max(1.0 / value.sqrt());
            let mut lifted = DVector::zeros(count);
            open.iter()
                .zip(direction.iter())
                .for_each(|(&slot, share)| lifted[slot] = *share);
            if known_within <= KNOWN_WITHIN {
                free.push(lifted);
            } else {
                held.push(Held {
                    shares: shares(&lifted, slots),
                    known_within,
                });
                held_directions.push(lifted);
            }
        }
        let free = match free.is_empty() {
            true => DMatrix::zeros(count, 0),
            false => DMatrix::from_columns(&free),
        };
        Self {
            free,
            held,
            held_directions,
            frozen: frozen.to_vec(),
        }
    }

    /// The same with these parameters, frozen so far, free as well.
    pub fn with_free(&self, slots: &[usize]) -> Self {
        let count = self.free.nrows();
        let unit = |slot: &usize| DVector::from_fn(count, |i, _| f64::from(u8::from(i == *slot)));
        let columns: Vec<DVector<f64>> = self
            .free
            .column_iter()
            .map(|column| column.into_owned())
            .chain(slots.iter().map(unit))
            .collect();
        Self {
            free: DMatrix::from_columns(&columns),
            frozen: self
                .frozen
                .iter()
                .copied()
                .filter(|slot| !slots.contains(slot))
                .collect(),
            ..self.clone()
        }
    }

    /// The part of `start` that no free direction moves: what is frozen stays, what is held is at its
    /// start.
    pub fn pinned(&self, start: &DVector<f64>) -> DVector<f64> {
        let mut pinned = DVector::zeros(start.len());
        self.frozen
            .iter()
            .for_each(|&slot| pinned[slot] = start[slot]);
        pinned
    }

    /// Covariance of all parameters, in tolerances: the bootstrap's in the free directions, one
    /// tolerance in those that are held, none in those that are frozen.
    pub fn covariance(&self, blocks: &[Block], options: Options) -> DMatrix<f64> {
        let reduced: Vec<Block> = blocks
            .iter()
            .map(|block| Block {
                normal: self.free.transpose() * &block.normal * &self.free,
                score: self.free.transpose() * &block.score,
            })
            .collect();
        let free = blocks::bootstrap_covariance(&reduced, options.draws, options.seed);
        let free = &self.free * free * self.free.transpose();
        let held = self.held_directions.iter();
        held.fold(free, |sum, direction| {
            sum + direction * direction.transpose()
        })
    }
}

fn shares(direction: &DVector<f64>, slots: &[Slot]) -> Vec<(String, f64)> {
    let mut shares: Vec<_> = slots
        .iter()
        .zip(direction.iter())
        .map(|(slot, &share)| (slot.name.clone(), share))
        .collect();
    shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    // Sign is free: let the largest be positive.
    let sign = shares.first().map_or(1.0, |first| first.1.signum());
    shares.iter_mut().for_each(|share| share.1 *= sign);
    shares.retain(|share| share.1.abs() > 0.2);
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_another_can_stand_in_for_is_not_told_apart() {
        let answers = |second: [f64; 4]| {
            let columns: Vec<f64> = [1.0; 4].into_iter().chain(second).collect();
            let jacobian = DMatrix::from_column_slice(4, 2, &columns);
            variance_inflation(&[Block::of(jacobian.as_view(), &[0.0; 4])], 0)
        };
        assert!((answers([1.0, -1.0, 1.0, -1.0]) - 1.0).abs() < 1e-9);
        assert!(answers([1.0, 1.1, 0.9, 1.0]) > 100.0);
    }
}
