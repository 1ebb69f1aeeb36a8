//! Where in its space a sweep looks: points of the unit box, evenly spread or on a grid.

use super::sobol;

/// How the points of a sweep are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sample {
    /// Sobol's sequence: every point another value of every size.
    #[default]
    Sobol,
    /// Full factorial: every combination of a few values of each size, ends included.
    Grid,
}

impl Sample {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Sobol, Self::Grid];

    /// As in an option.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sobol => "sobol",
            Self::Grid => "grid",
        }
    }
}

/// The points of a sweep, by their numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Points {
    /// So many of Sobol's sequence.
    Sobol(u32),
    /// Values of each coordinate; one alone lies in the middle of its range.
    Grid([u32; sobol::DIMENSIONS]),
}

impl Points {
    /// So many points, on a grid about so many: that number of combinations which is nearest to `count` by
    /// its ratio. A coordinate takes `fixed` values where that is told (names, or a size with one value), any
    /// number otherwise.
    pub fn of(sample: Sample, count: u32, fixed: [Option<u32>; sobol::DIMENSIONS]) -> Self {
        match sample {
            Sample::Sobol => Self::Sobol(count),
            Sample::Grid => Self::Grid(levels(count, fixed)),
        }
    }

    /// How many there are.
    pub fn count(&self) -> u32 {
        match self {
            Self::Sobol(count) => *count,
            Self::Grid(levels) => levels.iter().product(),
        }
    }

    /// The point of that number. On a grid the last coordinate changes first; a value lies at its share of
    /// the way from end to end.
    pub fn at(&self, number: u32) -> [f64; sobol::DIMENSIONS] {
        match self {
            Self::Sobol(_) => sobol::point(number),
            Self::Grid(levels) => {
                let mut left = number;
                let mut point = [0.5; sobol::DIMENSIONS];
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

/// Values of each coordinate: all free ones have the same number, or the first of them one more.
fn levels(count: u32, fixed: [Option<u32>; sobol::DIMENSIONS]) -> [u32; sobol::DIMENSIONS] {
    let mut levels = fixed.map(|fixed| fixed.unwrap_or(1).max(1));
    let free: Vec<usize> = (0..levels.len()).filter(|i| fixed[*i].is_none()).collect();
    let off = |levels: &[u32]| {
        let points: f64 = levels.iter().map(|&count| f64::from(count)).product();
        (points / f64::from(count)).ln().abs()
    };
    // One more value at a time, in turn, as long as that comes nearer.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Six free sizes, six materials, one coordinate unused.
    const SPACE: [Option<u32>; 8] = [None, None, None, None, None, None, Some(6), Some(1)];

    #[test]
    fn a_grid_has_about_as_many_points_as_were_asked_for() {
        for count in [16, 100, 1000, 10_000, 100_000, 1_000_000] {
            let points = Points::of(Sample::Grid, count, SPACE).count();
            // One more value of a size is a half more at these numbers, and twice as many at the least.
            let ratio = f64::from(points) / f64::from(count);
            assert!((0.6..1.5).contains(&ratio), "{count}: {points}");
        }
        let usual = Points::of(Sample::Grid, 10_000, SPACE);
        assert_eq!(usual, Points::Grid([4, 4, 4, 3, 3, 3, 6, 1]));
        assert_eq!(usual.count(), 10_368);
        assert_eq!(Points::of(Sample::Sobol, 10_000, SPACE).count(), 10_000);
    }

    #[test]
    fn a_grid_holds_every_combination_once_with_both_ends_of_every_size() {
        let points = Points::Grid([3, 2, 1, 1, 1, 1, 2, 1]);
        let mut all: Vec<_> = (0..points.count()).map(|i| points.at(i)).collect();
        assert_eq!(all[0], [0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.0, 0.5]);
        assert_eq!(all[11], [1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 1.0, 0.5]);
        all.sort_by(|a, b| a.partial_cmp(b).unwrap());
        all.dedup();
        assert_eq!(all.len(), 12);
        assert!(all.iter().any(|point| point[0] == 0.5));
    }

    #[test]
    fn where_nothing_is_free_the_grid_is_what_is_fixed() {
        let points = Points::of(Sample::Grid, 1000, [Some(1); 8]);
        assert_eq!(points.count(), 1);
        assert_eq!(points.at(0), [0.5; 8]);
    }
}
