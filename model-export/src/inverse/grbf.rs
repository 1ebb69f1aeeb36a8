//! Gaussian radial basis functions on top of a linear part, in floating point.
//!
//! F = bias + slope s + sum w_k exp(-gamma |s - c_k|^2), with s the field scaled to -1 to 1 over the
//! box. The linear part carries most of the force; the functions add what is curved, which keeps
//! their weights small and their rounding harmless.

use nalgebra::{DMatrix, Vector3};

use super::at_rest::AtRest;
use super::design_box::{DesignBox, lattice};
use super::samples::Sample;

/// The shape of a model: what is chosen before its weights are solved for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Centres are the fields of a lattice of this many loads along each axis; none: linear.
    pub centres_across: usize,
    /// Width: exp(-gamma d^2) over coordinates of -1 to 1.
    pub gamma: f64,
    /// Penalty on the squared weights, as a share of the mean square of the functions.
    pub ridge: f64,
}

/// The inverse model of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Grbf {
    /// The coordinates' box.
    pub design: DesignBox,
    /// Width.
    pub gamma: f64,
    /// Coordinates of the centres.
    pub centres: Vec<Vector3<f64>>,
    /// Newtons for each centre and axis.
    pub weights_n: Vec<[f64; 2]>,
    /// Newtons in the middle of the box.
    pub bias_n: [f64; 2],
    /// Newtons for a coordinate of one, each axis of the force.
    pub slope_n: [Vector3<f64>; 2],
}

impl Grbf {
    /// Fits a model of `shape`; `round` puts a centre where the device can have one. `None` where the
    /// samples do not determine it.
    pub fn fit(
        model: &AtRest,
        design: &DesignBox,
        shape: Shape,
        samples: &[Sample],
        round: impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Option<Self> {
        Self::fit_ridges(model, design, shape, &[shape.ridge], samples, round).pop()?
    }

    /// Fits one model for each penalty: what does not depend on it is formed once.
    pub fn fit_ridges(
        model: &AtRest,
        design: &DesignBox,
        shape: Shape,
        ridges: &[f64],
        samples: &[Sample],
        round: impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Vec<Option<Self>> {
        let centres: Vec<Vector3<f64>> = match shape.centres_across {
            0 => Vec::new(),
            n => lattice(design.force_n, n)
                .map(|load| round(design.coordinates(&model.field(load))))
                .collect(),
        };
        let unsolved = Self {
            design: *design,
            gamma: shape.gamma,
            centres,
            weights_n: Vec::new(),
            bias_n: [0.0; 2],
            slope_n: [Vector3::zeros(); 2],
        };
        let width = 4 + unsolved.centres.len();
        let regressors = DMatrix::from_row_iterator(
            samples.len(),
            width,
            samples
                .iter()
                .flat_map(|sample| unsolved.regressors(&sample.field_g)),
        );
        let forces =
            DMatrix::from_row_iterator(samples.len(), 2, samples.iter().flat_map(|s| s.force_n));
        let normal = regressors.tr_mul(&regressors);
        let right = regressors.tr_mul(&forces);
        let solve = |ridge: &f64| {
            let mut normal = normal.clone();
            for i in 0..width {
                // The linear part is free but for a trace that keeps the matrix sound.
                let share = if i < 4 { 1e-12 } else { *ridge };
                normal[(i, i)] += share * samples.len() as f64;
            }
            Some(unsolved.clone().solved(&normal.cholesky()?.solve(&right)))
        };
        ridges.iter().map(solve).collect()
    }

    fn solved(mut self, solution: &DMatrix<f64>) -> Self {
        self.bias_n = [solution[(0, 0)], solution[(0, 1)]];
        self.slope_n = [0, 1].map(|axis| Vector3::from_fn(|i, _| solution[(1 + i, axis)]));
        self.weights_n = (4..solution.nrows())
            .map(|i| [solution[(i, 0)], solution[(i, 1)]])
            .collect();
        self
    }

    fn regressors(&self, field_g: &Vector3<f64>) -> Vec<f64> {
        let s = self.design.coordinates(field_g);
        let functions = self
            .centres
            .iter()
            .map(|centre| libm::exp(-self.gamma * (s - centre).norm_squared()));
        [1.0, s.x, s.y, s.z].into_iter().chain(functions).collect()
    }

    /// Forces in newtons at a field in gauss.
    pub fn force(&self, field_g: &Vector3<f64>) -> [f64; 2] {
        let s = self.design.coordinates(field_g);
        let mut force = [0, 1].map(|axis| self.bias_n[axis] + self.slope_n[axis].dot(&s));
        for (centre, weight) in self.centres.iter().zip(&self.weights_n) {
            let value = libm::exp(-self.gamma * (s - centre).norm_squared());
            force[0] += weight[0] * value;
            force[1] += weight[1] * value;
        }
        force
    }
}

/// Root of the mean square and the greatest of the differences, each axis of the force, in newtons.
pub fn errors(
    samples: &[Sample],
    force: impl Fn(&Vector3<f64>) -> [f64; 2],
) -> ([f64; 2], [f64; 2]) {
    let mut squares = [0.0_f64; 2];
    let mut worst = [0.0_f64; 2];
    for sample in samples {
        let found = force(&sample.field_g);
        for axis in 0..2 {
            let error = found[axis] - sample.force_n[axis];
            squares[axis] += error * error;
            worst[axis] = worst[axis].max(error.abs());
        }
    }
    let count = samples.len().max(1) as f64;
    ([0, 1].map(|axis| (squares[axis] / count).sqrt()), worst)
}
