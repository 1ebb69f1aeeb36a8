//! Where in the box an inverse errs.

use super::at_rest::AtRest;
use super::design_box::lattice;
use nalgebra::Vector3;

/// Errors over a lattice of loads.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// The loads along each axis in newtons.
    pub loads_n: Vec<f64>,
    /// Length of the error vector in newtons; a row for each longitudinal load, a column for each
    /// lateral one.
    pub errors_n: Vec<Vec<f64>>,
}

impl ErrorMap {
    /// The map of `inverse` on `across` by `across` loads up to `force_n`.
    pub fn of(
        model: &AtRest,
        force_n: [f64; 2],
        across: usize,
        inverse: impl Fn(&Vector3<f64>) -> [f64; 2],
    ) -> Self {
        let error = |load: [f64; 2]| {
            let found = inverse(&model.field(load));
            (found[0] - load[0]).hypot(found[1] - load[1])
        };
        let errors: Vec<f64> = lattice(force_n, across).map(error).collect();
        Self {
            loads_n: lattice(force_n, across)
                .take(across)
                .map(|load| load[0])
                .collect(),
            errors_n: errors.chunks(across).map(<[f64]>::to_vec).collect(),
        }
    }

    /// The greatest error.
    pub fn worst_n(&self) -> f64 {
        self.errors_n.iter().flatten().copied().fold(0.0, f64::max)
    }
}
