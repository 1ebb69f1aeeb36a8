//! A design's own inverse sensitivity: the forces that explain a small shift of the field.

use nalgebra::{Matrix2x3, Matrix3x2, Vector3};

use crate::physics::ForwardModel;
use crate::physics::sensor::GAP_WEIGHT;

/// Forces in newtons for each gauss, about one load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse {
    /// `None` where the field does not tell both forces.
    n_per_g: Option<Matrix2x3<f64>>,
}

impl Inverse {
    /// About these forces in newtons, by weighted least squares: the gap axis counts as little as where
    /// the tables are fitted.
    pub fn at(model: &ForwardModel, force_n: [f64; 2]) -> Self {
        let response = model.respond(model.displacement(force_n));
        let answer = Matrix3x2::from_columns(&model.per_newton(&response));
        let weight = Vector3::new(1.0, GAP_WEIGHT, 1.0);
        let weighted = Matrix2x3::from_fn(|i, j| answer[(j, i)] * weight[j]);
        let normal = weighted * answer;
        // Two forces that look alike to a part in a million are told by noise alone.
        let blind = normal.determinant() <= 1e-12 * (normal[(0, 0)] * normal[(1, 1)]).abs();
        let n_per_g = match blind {
            true => None,
            false => normal.try_inverse().map(|inverse| inverse * weighted),
        };
        Self { n_per_g }
    }

    /// The greater of the forces that explain a shift in gauss, without its sign.
    pub fn greatest_n(&self, shift_g: Vector3<f64>) -> f64 {
        self.n_per_g
            .map_or(f64::INFINITY, |n_per_g| (n_per_g * shift_g).amax())
    }

    /// The same for the worst vector that `basis` makes of one on the unit sphere: of a field of one
    /// gauss from anywhere with the identity.
    pub fn greatest_of<const N: usize>(&self, basis: &nalgebra::SMatrix<f64, 3, N>) -> f64 {
        let rows = |n_per_g: Matrix2x3<f64>| {
            let both = n_per_g * basis;
            both.row(0).norm().max(both.row(1).norm())
        };
        self.n_per_g.map_or(f64::INFINITY, rows)
    }
}
