//! Products of matrices with many rows and few columns, as lists of columns. Every sum is formed in the same order on every
//! processor, since a fit must be bit-equal everywhere: the library's products select instructions by processor, and its dot
//! products, which do not, take four times as long.

use std::ops::Range;

use nalgebra::DMatrix;

/// Partial sums of each product.
const LANES: usize = 4;
/// Rows per partial product: few enough for the processor's cache.
const CACHE_ROWS: usize = 256;

/// Columns of a matrix over these rows.
pub fn columns(matrix: &DMatrix<f64>, rows: Range<usize>) -> Vec<&[f64]> {
    let (all, height) = (matrix.as_slice(), matrix.nrows());
    let of = |column: usize| height * column + rows.start..height * column + rows.end.min(height);
    (0..matrix.ncols()).map(|column| all.get(of(column)).unwrap_or_default()).collect()
}

/// Products of every column on the left with every column on the right.
pub fn products(left: &[&[f64]], right: &[&[f64]]) -> DMatrix<f64> {
    sums(left, right, |_| right.len())
}

/// Products of all pairs of columns.
pub fn gram(columns: &[&[f64]]) -> DMatrix<f64> {
    let mut sums = sums(columns, columns, |row| row + BLOCK);
    sums.fill_upper_triangle_with_lower_triangle();
    sums
}

/// Columns on each side that are multiplied at once.
const BLOCK: usize = 2;

/// Products with the first columns on the right, as many as `count` says for a column on the left.
fn sums(left: &[&[f64]], right: &[&[f64]], count: impl Fn(usize) -> usize) -> DMatrix<f64> {
    let mut sums = DMatrix::zeros(left.len(), right.len());
    let rows = left.iter().chain(right).map(|column| column.len()).min().unwrap_or(0);
    for start in (0..rows).step_by(CACHE_ROWS) {
        let range = start..(start + CACHE_ROWS).min(rows);
        for i in (0..left.len()).step_by(BLOCK) {
            for j in (0..right.len().min(count(i))).step_by(BLOCK) {
                let found = dots(pair(left, i, &range), pair(right, j, &range));
                for (a, found) in found.iter().enumerate().take(left.len() - i) {
                    for (b, found) in found.iter().enumerate().take(right.len() - j) {
                        sums[(i + a, j + b)] += found;
                    }
                }
            }
        }
    }
    sums
}

/// Columns `first` and the next, or itself where it is the last, over these rows.
fn pair<'a>(columns: &[&'a [f64]], first: usize, rows: &Range<usize>) -> [&'a [f64]; BLOCK] {
    [first, (first + 1).min(columns.len() - 1)].map(|at| &columns[at][rows.clone()])
}

/// Products of slices of equal length.
fn dots(left: [&[f64]; BLOCK], right: [&[f64]; BLOCK]) -> [[f64; BLOCK]; BLOCK] {
    let mut sums = [[[0.0; LANES]; BLOCK]; BLOCK];
    let (left_chunks, right_chunks) = (
        left.map(|column| column.as_chunks::<LANES>()),
        right.map(|column| column.as_chunks::<LANES>()),
    );
    let [(a, _), (b, _)] = left_chunks;
    let [(c, _), (d, _)] = right_chunks;
    for (((a, b), c), d) in a.iter().zip(b).zip(c).zip(d) {
        for lane in 0..LANES {
            sums[0][0][lane] += a[lane] * c[lane];
            sums[0][1][lane] += a[lane] * d[lane];
            sums[1][0][lane] += b[lane] * c[lane];
            sums[1][1][lane] += b[lane] * d[lane];
        }
    }
    let rest = |i: usize, j: usize| {
        let pairs = left_chunks[i].1.iter().zip(right_chunks[j].1);
        pairs.map(|(left, right)| left * right).sum::<f64>()
    };
    std::array::from_fn(|i| std::array::from_fn(|j| sums[i][j].iter().sum::<f64>() + rest(i, j)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |row, column| ((7 * row + 3 * column) % 11) as f64 - 4.0)
    }

    #[test]
    fn products_are_those_of_the_library() {
        // Small integers: exact in any order.
        for (rows, left, right) in [(0, 2, 2), (1, 1, 1), (7, 3, 2), (256, 2, 5), (700, 5, 4)] {
            let (one, other) = (matrix(rows, left), 2.0 * matrix(rows, right));
            let found = products(&columns(&one, 0..rows), &columns(&other, 0..rows));
            assert_eq!(found, one.transpose() * &other, "{rows} {left} {right}");
            assert_eq!(gram(&columns(&one, 0..rows)), one.transpose() * &one);
        }
    }

    #[test]
    fn rows_are_selected() {
        let one = matrix(20, 3);
        let part = one.rows(5, 9).into_owned();
        assert_eq!(gram(&columns(&one, 5..14)), part.transpose() * &part);
    }

    #[test]
    fn no_columns_give_an_empty_matrix() {
        assert_eq!(products(&[], &[&[1.0, 2.0]]).shape(), (0, 1));
        assert_eq!(gram(&[]).shape(), (0, 0));
    }
}
