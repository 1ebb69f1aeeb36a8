//! Held-out residuals of a linearised model, without and with more regressors.

use crate::fit::linearisation::{Linearisation, NormalEquations};
use nalgebra::{DMatrix, DVector, Matrix2x3};

/// Held-out sums of squares of one fold, without more regressors and with them.
#[derive(Clone, Debug)]
pub(super) struct HeldOut {
    /// Of the weighted residual.
    pub(super) field: (f64, f64),
    /// Of the force errors in N^2.
    pub(super) force_n2: (f64, f64),
    /// Number of force errors.
    pub(super) forces: f64,
    /// Of each block of time with rows in this fold: its index, and its change.
    pub(super) blocks: Vec<(usize, BlockChange)>,
}

/// Change of the held-out weighted residual of one block of time by more regressors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockChange {
    /// Squared residual without them.
    pub without: f64,
    /// Reduction of the squared residual.
    pub reduction: f64,
    /// Product of the residual with them and of what they change.
    pub product: f64,
}

impl BlockChange {
    /// Adds the change of another sensor in the same block.
    pub(super) fn add(&mut self, other: Self) {
        self.without += other.without;
        self.reduction += other.reduction;
        self.product += other.product;
    }
}

/// The folds of one cross-validation.
pub(super) struct Folds {
    folds: Vec<FoldRows>,
    /// Weight of the prior.
    prior: f64,
}

impl Folds {
    /// `fold_of` and `block_of` are the fold and the block of time of each row; `to_force` converts the weighted residual of each row
    /// to an error of both forces in newtons.
    pub(super) fn new(
        linearisation: &Linearisation,
        (fold_of, block_of): (&[usize], &[usize]),
        to_force: &[Matrix2x3<f64>],
        prior: f64,
    ) -> Self {
        let count = fold_of.iter().max().map_or(0, |last| last + 1);
        let of_fold = |fold: usize| {
            let rows = fold_of.iter().enumerate().filter(|(_, own)| **own == fold);
            let rows: Vec<usize> = rows.map(|(row, _)| row).collect();
            FoldRows::new(linearisation, &rows, block_of, to_force)
        };
        let mut folds: Vec<FoldRows> = (0..count).map(of_fold).collect();
        let normals: Vec<&FoldNormals> = folds.iter().map(|fold| &fold.normals).collect();
        let all: Vec<DVector<f64>> =
            (0..count).map(|k| others_coefficients(&normals, k, prior)).collect();
        for (fold, coefficients) in folds.iter_mut().zip(all) {
            fold.held_out = &fold.residual - &fold.fixed * &coefficients;
            fold.held_out_n2 = fold.normals.force.residual_squares(&coefficients);
        }
        Self { folds, prior }
    }

    /// Held-out squares without and with these regressors, by fold.
    pub(super) fn with(&self, regressors: &DMatrix<f64>) -> Vec<HeldOut> {
        let own = self.folds.iter().map(|fold| regressors.select_rows(&fold.entries));
        let own: Vec<DMatrix<f64>> = own.collect();
        let bordered: Vec<FoldNormals> =
            self.folds.iter().zip(&own).map(|(fold, own)| fold.normals_with(own)).collect();
        let normals: Vec<&FoldNormals> = bordered.iter().collect();
        let held_out = |(k, (fold, own)): (usize, (&FoldRows, &DMatrix<f64>))| {
            let coefficients = others_coefficients(&normals, k, self.prior);
            let split = fold.fixed.ncols();
            let left = &fold.residual
                - &fold.fixed * coefficients.rows(0, split)
                - own * coefficients.rows(split, own.ncols());
            HeldOut {
                field: (fold.held_out.norm_squared(), left.norm_squared()),
                force_n2: (fold.held_out_n2, bordered[k].force.residual_squares(&coefficients)),
                forces: fold.forces(),
                blocks: fold.block_changes(&left),
            }
        };
        self.folds.iter().zip(&own).enumerate().map(held_out).collect()
    }
}

/// Coefficients fitted to the fields of all folds but one.
fn others_coefficients(folds: &[&FoldNormals], k: usize, prior: f64) -> DVector<f64> {
    let others = folds.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, fold)| &fold.field);
    let sum = NormalEquations::sum(others)
        .unwrap_or_else(|| NormalEquations::zeros(folds[k].field.right.len()));
    inverse(sum.matrix, prior) * sum.right
}

/// Normal equations of one fold: of the weighted residual, and of the force errors that it causes.
struct FoldNormals {
    field: NormalEquations,
    force: NormalEquations,
}

/// Rows of one fold, with the normal equations of the fitted columns.
struct FoldRows {
    entries: Vec<usize>,
    fixed: DMatrix<f64>,
    residual: DVector<f64>,
    /// Block of time of each row.
    block_of: Vec<usize>,
    to_force: Vec<Matrix2x3<f64>>,
    /// Fixed columns and residual as errors of the forces.
    fixed_n: DMatrix<f64>,
    residual_n: DVector<f64>,
    normals: FoldNormals,
    /// Residual with the fixed columns fitted to the other folds.
    held_out: DVector<f64>,
    /// Sum of squares of the force errors that it causes.
    held_out_n2: f64,
}

impl FoldRows {
    fn new(
        linearisation: &Linearisation,
        rows: &[usize],
        block_of: &[usize],
        to_force: &[Matrix2x3<f64>],
    ) -> Self {
        let to_force: Vec<Matrix2x3<f64>> = rows.iter().map(|row| to_force[*row]).collect();
        let entries: Vec<usize> = rows.iter().flat_map(|row| 3 * row..3 * row + 3).collect();
        let fixed = linearisation.fixed().select_rows(&entries);
        let residual = linearisation.residual().select_rows(&entries);
        let fixed_n = as_forces(&fixed, &to_force);
        let residual_n =
            as_forces(&DMatrix::from_columns(std::slice::from_ref(&residual)), &to_force)
                .column(0)
                .into_owned();
        let normals = FoldNormals {
            field: NormalEquations::of(&fixed, &residual, 0..entries.len()),
            force: NormalEquations::of(&fixed_n, &residual_n, 0..residual_n.len()),
        };
        Self {
            block_of: rows.iter().map(|row| block_of[*row]).collect(),
            held_out: residual.clone(),
            held_out_n2: 0.0,
            entries,
            fixed,
            residual,
            to_force,
            fixed_n,
            residual_n,
            normals,
        }
    }

    /// Number of measured forces in all rows.
    fn forces(&self) -> f64 {
        let rows = self.to_force.iter().flat_map(|of| [of.row(0).amax(), of.row(1).amax()]);
        rows.filter(|largest| *largest > 0.0).count() as f64
    }

    /// Normal equations with these columns of the same rows appended.
    fn normals_with(&self, own: &DMatrix<f64>) -> FoldNormals {
        let own_n = as_forces(own, &self.to_force);
        let (rows, forces) = (0..self.entries.len(), 0..self.residual_n.len());
        FoldNormals {
            field: self.normals.field.with(&self.fixed, own, &self.residual, rows),
            force: self.normals.force.with(&self.fixed_n, &own_n, &self.residual_n, forces),
        }
    }

    /// Changes by block from the held-out residual of the fixed columns to `left`.
    fn block_changes(&self, left: &DVector<f64>) -> Vec<(usize, BlockChange)> {
        let mut changes: Vec<(usize, BlockChange)> = Vec::new();
        for (row, &block) in self.block_of.iter().enumerate() {
            if changes.last().is_none_or(|(last, _)| *last != block) {
                changes.push((block, BlockChange::default()));
            }
            let Some((_, change)) = changes.last_mut() else { continue };
            for entry in 3 * row..3 * row + 3 {
                let (without, with) = (self.held_out[entry], left[entry]);
                change.add(BlockChange {
                    without: without * without,
                    reduction: without * without - with * with,
                    product: with * (without - with),
                });
            }
        }
        changes
    }
}

/// Columns over the axes of the field in each row, as errors of both forces.
fn as_forces(columns: &DMatrix<f64>, to_force: &[Matrix2x3<f64>]) -> DMatrix<f64> {
    let mut forces = DMatrix::zeros(2 * to_force.len(), columns.ncols());
    for (row, to_force) in to_force.iter().enumerate() {
        let of_row = to_force * columns.rows(3 * row, 3);
        forces.rows_mut(2 * row, 2).copy_from(&of_row);
    }
    forces
}

/// Inverse of normal equations with a prior of one width on each parameter.
pub(super) fn inverse(mut normal: DMatrix<f64>, prior: f64) -> DMatrix<f64> {
    for i in 0..normal.nrows() {
        normal[(i, i)] += prior;
    }
    let size = normal.nrows();
    normal.cholesky().map_or_else(|| DMatrix::zeros(size, size), |factor| factor.inverse())
}
