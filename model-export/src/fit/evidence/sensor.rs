//! One sensor around a fitted model: what is left in it, and what of a candidate nothing fitted already
//! stands in for.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::super::ground::Ground;

/// Every so-manieth row takes part in the search of shapes.
const COARSE: usize = 4;

/// One sensor: what is left and what it answers to.
pub(super) struct Sensor {
    pub(super) ground: Ground,
    /// Fewer rows, for the search of shapes.
    pub(super) coarse: Ground,
    /// Inverse of the fixed columns' products, prior included.
    inverse: DMatrix<f64>,
    /// For each row (three entries of the residual): its block, and its part of each kind of split.
    pub(super) block: Vec<usize>,
    parts: [Vec<usize>; 2],
    /// Rows' weight of the prior: of how many rows one witness is worth.
    prior: f64,
}

impl Sensor {
    pub(super) fn new(ground: Ground, block: Vec<usize>, parts: [Vec<usize>; 2]) -> Self {
        let (residual, fixed) = (ground.residual(), ground.fixed());
        let mean_square = residual.norm_squared() / residual.len().max(1) as f64;
        let prior = mean_square.max(1.0);
        let normal = fixed.tr_mul(fixed);
        Self {
            inverse: inverse(normal, prior),
            coarse: ground.thinned(COARSE),
            ground,
            block,
            parts,
            prior,
        }
    }

    /// What is left where everything fitted already may move once more.
    pub(super) fn left(&self) -> DVector<f64> {
        let coefficients = &self.inverse * self.ground.fixed().tr_mul(self.ground.residual());
        self.ground.residual() - self.ground.fixed() * coefficients
    }

    /// What of these answers nothing that is fitted already stands in for.
    pub(super) fn apart(&self, answers: &DMatrix<f64>) -> DMatrix<f64> {
        let stood_in = &self.inverse * self.ground.fixed().tr_mul(answers);
        answers - self.ground.fixed() * stood_in
    }

    /// A candidate's answers that nothing fixed stands in for, the inverse of their products, and the
    /// squares left out, part by part.
    pub(super) fn judge(
        &self,
        answers: &DMatrix<f64>,
        kind: usize,
    ) -> (DMatrix<f64>, DMatrix<f64>, Vec<(f64, f64)>) {
        let apart = self.apart(answers);
        let inverse = inverse(apart.tr_mul(&apart), self.prior);
        (apart, inverse, self.left_out(answers, kind))
    }

    /// Squares left out without and with these answers, part by part.
    pub(super) fn left_out(&self, answers: &DMatrix<f64>, kind: usize) -> Vec<(f64, f64)> {
        let all = DMatrix::from_columns(
            &self
                .ground
                .fixed()
                .column_iter()
                .chain(answers.column_iter())
                .collect::<Vec<_>>(),
        );
        let parts = self.parts[kind].iter().max().map_or(0, |last| last + 1);
        let size = all.ncols();
        let mut sums = vec![(DMatrix::zeros(size, size), DVector::zeros(size), 0.0); parts];
        let mut by_part: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (row, part) in self.parts[kind].iter().enumerate() {
            by_part
                .entry(*part)
                .or_default()
                .extend(3 * row..3 * row + 3);
        }
        for (part, entries) in by_part {
            let own = all.select_rows(&entries);
            let left = self.ground.residual().select_rows(&entries);
            sums[part] = (own.tr_mul(&own), own.tr_mul(&left), left.norm_squared());
        }
        let base = self.ground.fixed().ncols();
        let one = |k: usize| {
            let mut normal = DMatrix::zeros(size, size);
            let mut right = DVector::zeros(size);
            for (i, (n, r, _)) in sums.iter().enumerate() {
                if i != k {
                    normal += n;
                    right += r;
                }
            }
            let judged = |count: usize| {
                let n = normal.view((0, 0), (count, count)).into_owned();
                let x = inverse(n, self.prior) * right.rows(0, count);
                let own = sums[k].0.view((0, 0), (count, count));
                sums[k].2 - 2.0 * x.dot(&sums[k].1.rows(0, count)) + x.dot(&(own * &x))
            };
            (judged(base), judged(size))
        };
        (0..parts).map(one).collect()
    }
}

/// Inverse of normal equations with a prior of one departure on each number.
fn inverse(mut normal: DMatrix<f64>, prior: f64) -> DMatrix<f64> {
    for i in 0..normal.nrows() {
        normal[(i, i)] += prior;
    }
    let size = normal.nrows();
    normal
        .cholesky()
        .map_or_else(|| DMatrix::zeros(size, size), |factor| factor.inverse())
}
