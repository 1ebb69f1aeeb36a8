//! Which combinations of parameters the data tell, and which are held at nominal.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::Options;
use super::blocks::{self, Block};
use super::parameters::{COUNT, PARAMETERS};

/// A direction is held unless the data know it this well, in tolerances.
pub const KNOWN_WITHIN: f64 = 0.5;

/// A combination of parameters that the data do not tell, held at nominal.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Parameters and their shares in the combination, in tolerances, largest first.
    pub shares: Vec<(&'static str, f64)>,
    /// How well the data alone know it, in tolerances; infinite where not at all.
    pub known_within: f64,
}

/// By how much the normal equations overstate what the data tell: 1 for white noise of the size
/// of the floor, more for residuals with memory or structure.
pub fn inflation(blocks: &[Block]) -> f64 {
    let noise = blocks::score_covariance(blocks);
    let eigen = SymmetricEigen::new(normal(blocks));
    let directions = eigen
        .eigenvectors
        .column_iter()
        .zip(eigen.eigenvalues.iter());
    let ratios: f64 = directions
        .map(|(direction, value)| {
            direction.dot(&(&noise * direction)) / value.max(f64::MIN_POSITIVE)
        })
        .sum();
    (ratios / COUNT as f64).max(1.0)
}

fn normal(blocks: &[Block]) -> DMatrix<f64> {
    blocks
        .iter()
        .fold(DMatrix::zeros(COUNT, COUNT), |sum, block| {
            sum + &block.normal
        })
}

/// The directions in which the parameters may move, and those in which they are held.
pub struct Space {
    /// Orthonormal columns, in tolerances.
    pub free: DMatrix<f64>,
    /// What is held.
    pub held: Vec<Held>,
    held_directions: Vec<DVector<f64>>,
}

impl Space {
    /// Every direction is free.
    pub fn whole() -> Self {
        Self {
            free: DMatrix::identity(COUNT, COUNT),
            held: Vec::new(),
            held_directions: Vec::new(),
        }
    }

    /// Free are the directions that the blocks of a fit know well enough.
    pub fn known_from(blocks: &[Block]) -> Self {
        let noise = blocks::score_covariance(blocks);
        let eigen = SymmetricEigen::new(normal(blocks));
        let mut free = Vec::new();
        let (mut held, mut held_directions) = (Vec::new(), Vec::new());
        for (direction, &value) in eigen
            .eigenvectors
            .column_iter()
            .zip(eigen.eigenvalues.iter())
        {
            let variance = direction.dot(&(&noise * direction));
            let known_within = variance.sqrt() / value.max(f64::MIN_POSITIVE);
            if known_within <= KNOWN_WITHIN {
                free.push(direction.into_owned());
            } else {
                held.push(Held {
                    shares: shares(&direction.into_owned()),
                    known_within,
                });
                held_directions.push(direction.into_owned());
            }
        }
        let free = match free.is_empty() {
            true => DMatrix::zeros(COUNT, 0),
            false => DMatrix::from_columns(&free),
        };
        Self {
            free,
            held,
            held_directions,
        }
    }

    /// Covariance of all parameters, in tolerances: the bootstrap's in the free directions, one
    /// tolerance in those that are held.
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

fn shares(direction: &DVector<f64>) -> Vec<(&'static str, f64)> {
    let mut shares: Vec<_> = PARAMETERS
        .iter()
        .zip(direction.iter())
        .map(|(p, &share)| (p.name, share))
        .collect();
    shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    // Sign is free: let the largest be positive.
    let sign = shares.first().map_or(1.0, |first| first.1.signum());
    shares.iter_mut().for_each(|share| share.1 *= sign);
    shares.retain(|share| share.1.abs() > 0.2);
    shares
}
