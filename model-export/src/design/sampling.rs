//! Sampling of the unit box: Sobol's sequence (direction numbers of Joe and Kuo, SIAM J. Sci. Comput. 30, 2008;
//! new-joe-kuo-6.21201; in Gray code order) or a full factorial grid.
//!
//! The crates `sobol` (1.0.2, last release in 2020) and `sobol-qmc` (2.5.1) give the same points (all of the first 2^18
//! compared), but as an iterator, not by index, and the latter needs a second nalgebra; `sobol_burley` only scrambles.

/// Sampling method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SamplingMethod {
    /// Sobol's sequence.
    #[default]
    Sobol,
    /// Full factorial: all combinations of a few values of each size, ends included.
    Grid,
}

impl SamplingMethod {
    /// All methods.
    pub const ALL: [Self; 2] = [Self::Sobol, Self::Grid];

    /// Name as an option.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sobol => "sobol",
            Self::Grid => "grid",
        }
    }
}

/// Sample points by index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SamplePoints {
    /// Number of points of Sobol's sequence.
    Sobol(u32),
    /// Number of values of each coordinate; a single one is in the middle of its range.
    Grid([u32; DIMENSIONS]),
}

impl SamplePoints {
    /// `count` points, on a grid the number of combinations with the ratio nearest to one. A coordinate takes
    /// `fixed` values where given (names, or a size with one value).
    pub fn of(sample: SamplingMethod, count: u32, fixed: [Option<u32>; DIMENSIONS]) -> Self {
        match sample {
            SamplingMethod::Sobol => Self::Sobol(count),
            SamplingMethod::Grid => Self::Grid(levels(count, fixed)),
        }
    }

    /// Number of points.
    pub fn count(&self) -> u32 {
        match self {
            Self::Sobol(count) => *count,
            Self::Grid(levels) => levels.iter().product(),
        }
    }

    /// Point by index. On a grid the last coordinate changes first; values are equidistant from end to end.
    pub fn at(&self, number: u32) -> [f64; DIMENSIONS] {
        match self {
            Self::Sobol(_) => sobol_point(number),
            Self::Grid(levels) => {
                let mut left = number;
                let mut point = [0.5; DIMENSIONS];
                for (at, &count) in point.iter_mut().zip(levels).rev() {
                    if count > 1 {
                        *at = f64::from(left % count) / f64::from(count - 1);
                    }
                    left /= count;
                }
                point
            }
        }
    }
}

/// Number of values of each coordinate: equal for all free ones, or one more for the first of them.
fn levels(count: u32, fixed: [Option<u32>; DIMENSIONS]) -> [u32; DIMENSIONS] {
    let mut levels = fixed.map(|fixed| fixed.unwrap_or(1).max(1));
    let free: Vec<usize> = (0..levels.len()).filter(|i| fixed[*i].is_none()).collect();
    let off = |levels: &[u32]| {
        let points: f64 = levels.iter().map(|&count| f64::from(count)).product();
        (points / f64::from(count)).ln().abs()
    };
    // Adds one value at a time, in turn, while that approaches `count`.
    for place in free.iter().cycle() {
        let mut more = levels;
        more[*place] += 1;
        if off(&more) >= off(&levels) {
            break;
        }
        levels = more;
    }
    levels
}

/// Maximum number of dimensions.
pub(crate) const DIMENSIONS: usize = 8;

/// Bits of a coordinate.
const BITS: usize = 32;

/// For the dimensions after the first: degree of the primitive polynomial, its inner coefficients, and the
/// first direction numbers.
const POLYNOMIALS: [(usize, u32, &[u32]); DIMENSIONS - 1] = [
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
];

/// Point by index in the unit box, starting at the centre: the origin is skipped.
pub(crate) fn sobol_point(number: u32) -> [f64; DIMENSIONS] {
    // Offset by half a bit, away from both ends.
    let half = 0.5 * 2.0_f64.powi(-(BITS as i32));
    coordinates(number + 1).map(|bits| f64::from(bits) * 2.0 * half + half)
}

fn coordinates(number: u32) -> [u32; DIMENSIONS] {
    let gray = number ^ (number >> 1);
    std::array::from_fn(|dimension| {
        let directions = directions(dimension);
        let set = (0..BITS).filter(|bit| gray >> bit & 1 == 1);
        set.fold(0, |sum, bit| sum ^ directions[bit])
    })
}

fn directions(dimension: usize) -> [u32; BITS] {
    let mut directions = std::array::from_fn(|bit| 1 << (BITS - 1 - bit));
    let Some((degree, inner, first)) = dimension.checked_sub(1).map(|i| POLYNOMIALS[i]) else {
        return directions;
    };
    for bit in 0..BITS {
        directions[bit] = match first.get(bit) {
            Some(number) => number << (BITS - 1 - bit),
            None => {
                let before = directions[bit - degree];
                let terms = (1..degree).filter(|k| inner >> (degree - 1 - k) & 1 == 1);
                let inner = terms.fold(0, |sum, k| sum ^ directions[bit - k]);
                before ^ (before >> degree) ^ inner
            }
        };
    }
    directions
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six free sizes, six materials, one coordinate unused.
    const SPACE: [Option<u32>; 8] = [None, None, None, None, None, None, Some(6), Some(1)];

    #[test]
    fn grid_size_approximates_the_requested_count() {
        for count in [16, 100, 1000, 10_000, 100_000, 1_000_000] {
            let points = SamplePoints::of(SamplingMethod::Grid, count, SPACE).count();
            // One more value of a size is a factor of up to 1.5 at these numbers.
            let ratio = f64::from(points) / f64::from(count);
            assert!((0.6..1.5).contains(&ratio), "{count}: {points}");
        }
        let usual = SamplePoints::of(SamplingMethod::Grid, 10_000, SPACE);
        assert_eq!(usual, SamplePoints::Grid([4, 4, 4, 3, 3, 3, 6, 1]));
        assert_eq!(usual.count(), 10_368);
        assert_eq!(SamplePoints::of(SamplingMethod::Sobol, 10_000, SPACE).count(), 10_000);
    }

    #[test]
    fn grid_has_every_combination_once_including_ends() {
        let points = SamplePoints::Grid([3, 2, 1, 1, 1, 1, 2, 1]);
        let mut all: Vec<_> = (0..points.count()).map(|i| points.at(i)).collect();
        assert_eq!(all[0], [0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.0, 0.5]);
        assert_eq!(all[11], [1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 1.0, 0.5]);
        all.sort_by(|a, b| a.partial_cmp(b).unwrap());
        all.dedup();
        assert_eq!(all.len(), 12);
        assert!(all.iter().any(|point| point[0] == 0.5));
    }

    #[test]
    fn grid_without_free_sizes_has_one_point() {
        let points = SamplePoints::of(SamplingMethod::Grid, 1000, [Some(1); 8]);
        assert_eq!(points.count(), 1);
        assert_eq!(points.at(0), [0.5; 8]);
    }

    #[test]
    fn first_sobol_points_equal_published_ones() {
        let begins = |number: u32| {
            let all = sobol_point(number);
            [0, 1, 2].map(|i| (all[i] * 1024.0).round() / 1024.0)
        };
        assert_eq!(begins(0), [0.5, 0.5, 0.5]);
        assert_eq!(begins(1), [0.75, 0.25, 0.25]);
        assert_eq!(begins(2), [0.25, 0.75, 0.75]);
        assert_eq!(begins(3), [0.375, 0.375, 0.625]);
    }

    #[test]
    fn sobol_points_are_stratified_in_every_dimension() {
        // Of any 2^k numbers that begin at a multiple of it, each of 2^k slices holds one.
        for dimension in 0..DIMENSIONS {
            let mut slices: Vec<u32> = (1023..2047)
                .map(|number| (sobol_point(number)[dimension] * 1024.0) as u32)
                .collect();
            slices.sort_unstable();
            assert!(slices.iter().enumerate().all(|(i, slice)| *slice == i as u32));
        }
    }

    #[test]
    fn sobol_points_fill_two_dimensional_projections() {
        for other in 1..DIMENSIONS {
            let mut filled = [false; 64];
            for number in 0..1024 {
                let all = sobol_point(number);
                filled[(all[0] * 8.0) as usize * 8 + (all[other] * 8.0) as usize] = true;
            }
            assert!(filled.into_iter().all(|square| square), "{other}");
        }
    }
}
