//! Normal equations by recording, for the many small regressions in the search for shapes.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

/// Far below any answer that counts, relative: keeps what nothing tells from running away.
const RIDGE: f64 = 1e-6;

/// Normal equations of one recording.
#[derive(Clone, Debug)]
pub struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    /// Sum of squares of what is to be explained.
    squares: f64,
}

/// What is to be explained, and the columns that always take part: their products, which cost most,
/// are formed once.
#[derive(Clone, Debug)]
pub struct Normals {
    fixed: DMatrix<f64>,
    target: DVector<f64>,
    recordings: Vec<(Range<usize>, Normal)>,
}

impl Normals {
    /// `ends` are the rows after the last of each recording.
    pub fn new(fixed: DMatrix<f64>, target: DVector<f64>, ends: &[usize]) -> Self {
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let recordings = starts
            .zip(ends)
            .map(|(start, &end)| (start..end, Normal::of(&fixed, &target, start..end)))
            .collect();
        Self {
            fixed,
            target,
            recordings,
        }
    }

    /// The columns that always take part.
    pub fn fixed(&self) -> &DMatrix<f64> {
        &self.fixed
    }

    /// The equations of each recording with these columns after the fixed ones.
    pub fn with(&self, columns: &DMatrix<f64>) -> Vec<Normal> {
        let (fixed, size) = (self.fixed.ncols(), self.fixed.ncols() + columns.ncols());
        let bordered = |(rows, inner): &(Range<usize>, Normal)| {
            let own = Normal::of(columns, &self.target, rows.clone());
            let mut matrix = DMatrix::zeros(size, size);
            matrix
                .view_mut((0, 0), (fixed, fixed))
                .copy_from(&inner.matrix);
            let last = columns.ncols();
            matrix
                .view_mut((fixed, fixed), (last, last))
                .copy_from(&own.matrix);
            for i in 0..last {
                let column = columns.column(i);
                let column = column.rows(rows.start, rows.len());
                for j in 0..fixed {
                    let other = self.fixed.column(j);
                    let product = column.dot(&other.rows(rows.start, rows.len()));
                    matrix[(fixed + i, j)] = product;
                    matrix[(j, fixed + i)] = product;
                }
            }
            let right = inner.right.iter().chain(own.right.iter()).copied();
            Normal {
                matrix,
                right: DVector::from_iterator(size, right),
                squares: inner.squares,
            }
        };
        self.recordings.iter().map(bordered).collect()
    }
}

impl Normal {
    fn of(columns: &DMatrix<f64>, target: &DVector<f64>, rows: Range<usize>) -> Self {
        let part = |column: usize| {
            columns
                .column(column)
                .rows(rows.start, rows.len())
                .clone_owned()
        };
        let target = target.rows(rows.start, rows.len());
        let parts: Vec<DVector<f64>> = (0..columns.ncols()).map(part).collect();
        let mut matrix = DMatrix::zeros(parts.len(), parts.len());
        for (i, one) in parts.iter().enumerate() {
            for (j, other) in parts.iter().enumerate().take(i + 1) {
                matrix[(i, j)] = one.dot(other);
                matrix[(j, i)] = matrix[(i, j)];
            }
        }
        Self {
            matrix,
            right: DVector::from_iterator(parts.len(), parts.iter().map(|part| part.dot(&target))),
            squares: target.norm_squared(),
        }
    }

    fn sum<'a>(of: impl Iterator<Item = &'a Self>) -> Option<Self> {
        of.cloned().reduce(|sum, next| Self {
            matrix: sum.matrix + next.matrix,
            right: sum.right + next.right,
            squares: sum.squares + next.squares,
        })
    }

    fn solve(&self) -> Option<DVector<f64>> {
        let size = self.right.len();
        let scale = self
            .matrix
            .diagonal()
            .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
        let scaled = DMatrix::from_fn(size, size, |i, j| {
            self.matrix[(i, j)] * scale[i] * scale[j] + if i == j { RIDGE } else { 0.0 }
        });
        let right = self.right.component_mul(&scale);
        Some(scaled.cholesky()?.solve(&right).component_mul(&scale))
    }

    /// Sum of squares that is left by these coefficients.
    fn left(&self, coefficients: &DVector<f64>) -> f64 {
        self.squares - 2.0 * coefficients.dot(&self.right)
            + coefficients.dot(&(&self.matrix * coefficients))
    }
}

/// What the best coefficients over all recordings leave, and these coefficients.
pub fn left_by(normals: &[Normal]) -> (f64, Vec<f64>) {
    let Some(sum) = Normal::sum(normals.iter()) else {
        return (f64::INFINITY, Vec::new());
    };
    match sum.solve() {
        Some(best) => (sum.left(&best), best.iter().copied().collect()),
        None => (f64::INFINITY, vec![0.0; sum.right.len()]),
    }
}

/// What is left of each recording by the best coefficients over all others.
pub fn left_out_by(normals: &[Normal]) -> Vec<f64> {
    let of = |(k, judged): (usize, &Normal)| {
        let others = normals.iter().enumerate().filter(|(i, _)| *i != k);
        let best = Normal::sum(others.map(|(_, normal)| normal)).and_then(|sum| sum.solve());
        best.map_or(f64::INFINITY, |best| judged.left(&best))
    };
    normals.iter().enumerate().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_left_out_has_no_say_in_the_coefficients_it_is_judged_by() {
        // Two recordings of two rows: y = 2 x in the first, y = 3 x in the second.
        let x = DMatrix::from_column_slice(4, 1, &[1.0, 2.0, 1.0, 2.0]);
        let y = DVector::from_column_slice(&[2.0, 4.0, 3.0, 6.0]);
        let none = DMatrix::zeros(4, 0);
        for normals in [
            Normals::new(none.clone(), y.clone(), &[2, 4]).with(&x),
            Normals::new(x.clone(), y.clone(), &[2, 4]).with(&none),
        ] {
            let (left, best) = left_by(&normals);
            assert!((best[0] - 2.5).abs() < 1e-5 && (left - 2.5).abs() < 1e-5);
            // Judged by the other one's slope: errors 1 and 2 in each.
            for left in left_out_by(&normals) {
                assert!((left - 5.0).abs() < 1e-3, "{left}");
            }
        }
    }
}
