//! Products of matrices with many rows and few columns, as lists of columns. Every sum is formed in the same order on every
//! processor, since a fit must be bit-equal everywhere: the library's products select instructions by processor, and its dot
//! products, which do not, take four times as long.

#![allow(unsafe_code)] // Instructions that not every processor has, loads and stores of four numbers at once.

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
    sums(left, right, false)
}

/// Products of all pairs of columns.
pub fn gram(columns: &[&[f64]]) -> DMatrix<f64> {
    let mut sums = sums(columns, columns, true);
    sums.fill_upper_triangle_with_lower_triangle();
    sums
}

/// Columns on each side that are multiplied at once.
const BLOCK: usize = 3;

/// Products with the columns on the right, only the first of them up to the same place where both sides are the `same`.
fn sums(left: &[&[f64]], right: &[&[f64]], same: bool) -> DMatrix<f64> {
    let mut sums = DMatrix::zeros(left.len(), right.len());
    let rows = left.iter().chain(right).map(|column| column.len()).min().unwrap_or(0);
    for start in (0..rows).step_by(CACHE_ROWS) {
        let range = start..(start + CACHE_ROWS).min(rows);
        for i in (0..left.len()).step_by(BLOCK) {
            let end = if same { right.len().min(i + BLOCK) } else { right.len() };
            for j in (0..end).step_by(BLOCK) {
                let found = dots(block(left, i, &range), block(right, j, &range));
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

/// Columns from `first` on over these rows; the last one again where there are no more.
fn block<'a>(columns: &[&'a [f64]], first: usize, rows: &Range<usize>) -> [&'a [f64]; BLOCK] {
    std::array::from_fn(|i| &columns[(first + i).min(columns.len() - 1)][rows.clone()])
}

/// Products of slices of equal length.
fn dots(left: [&[f64]; BLOCK], right: [&[f64]; BLOCK]) -> [[f64; BLOCK]; BLOCK] {
    let (left, right) =
        (left.map(|c| c.as_chunks::<LANES>()), right.map(|c| c.as_chunks::<LANES>()));
    let sums = lane_sums(left.map(|(chunks, _)| chunks), right.map(|(chunks, _)| chunks));
    let rest = |i: usize, j: usize| {
        let pairs = left[i].1.iter().zip(right[j].1);
        pairs.map(|(left, right)| left * right).sum::<f64>()
    };
    std::array::from_fn(|i| std::array::from_fn(|j| sums[i][j].iter().sum::<f64>() + rest(i, j)))
}

type Chunks<'a> = [&'a [[f64; LANES]]; BLOCK];
type LaneSums = [[[f64; LANES]; BLOCK]; BLOCK];

fn lane_sums(left: Chunks, right: Chunks) -> LaneSums {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has these instructions.
        return unsafe { lane_sums_avx2(left, right) };
    }
    lane_sums_portable(left, right)
}

fn lane_sums_portable(left: Chunks, right: Chunks) -> LaneSums {
    let mut sums = LaneSums::default();
    for (sums, left) in sums.iter_mut().zip(left) {
        for (sums, right) in sums.iter_mut().zip(right) {
            for (left, right) in left.iter().zip(right) {
                for lane in 0..LANES {
                    sums[lane] += left[lane] * right[lane];
                }
            }
        }
    }
    sums
}

/// The same sums, to the bit: products are rounded before they are added, without fused instructions.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn lane_sums_avx2(left: Chunks, right: Chunks) -> LaneSums {
    use std::arch::x86_64::{
        _mm256_add_pd, _mm256_loadu_pd, _mm256_mul_pd, _mm256_setzero_pd, _mm256_storeu_pd,
    };
    let count = left.iter().chain(&right).map(|chunks| chunks.len()).min().unwrap_or(0);
    let (left, right) = (left.map(|chunks| &chunks[..count]), right.map(|chunks| &chunks[..count]));
    let mut sums = [[_mm256_setzero_pd(); BLOCK]; BLOCK];
    // Loops, since closures would not be compiled with these instructions.
    for at in 0..count {
        let (mut a, mut b) = ([_mm256_setzero_pd(); BLOCK], [_mm256_setzero_pd(); BLOCK]);
        for i in 0..BLOCK {
            // SAFETY: four numbers are read from an array of four.
            unsafe {
                a[i] = _mm256_loadu_pd(left[i][at].as_ptr());
                b[i] = _mm256_loadu_pd(right[i][at].as_ptr());
            }
        }
        for i in 0..BLOCK {
            for j in 0..BLOCK {
                sums[i][j] = _mm256_add_pd(sums[i][j], _mm256_mul_pd(a[i], b[j]));
            }
        }
    }
    let mut lanes = LaneSums::default();
    for i in 0..BLOCK {
        for j in 0..BLOCK {
            // SAFETY: four numbers are written to an array of four.
            unsafe { _mm256_storeu_pd(lanes[i][j].as_mut_ptr(), sums[i][j]) };
        }
    }
    lanes
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

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn wide_instructions_give_the_same_bits() {
        if !std::arch::is_x86_feature_detected!("avx2") {
            eprintln!("left out: this processor has no AVX2");
            return;
        }
        let one = DMatrix::from_fn(256, 6, |row, column| (1.0 + (7 * row + column) as f64).sqrt());
        let all = columns(&one, 0..256);
        let (left, right) = (block(&all, 0, &(0..256)), block(&all, 3, &(0..256)));
        let of = |columns: [_; BLOCK]| columns.map(|column: &[f64]| column.as_chunks::<LANES>().0);
        // SAFETY: checked above.
        let wide = unsafe { lane_sums_avx2(of(left), of(right)) };
        assert_eq!(wide, lane_sums_portable(of(left), of(right)));
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
