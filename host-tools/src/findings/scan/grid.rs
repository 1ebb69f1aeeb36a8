//! The steps in which a column's values lie.

use std::collections::HashSet;

/// A column with more distinct values than this is no coarse one.
pub const FEW: usize = 1000;

/// Collects distinct values, up to [`FEW`], and the common divisor of whole numbers.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    distinct: HashSet<u64>,
    full: bool,
    first: Option<f64>,
    divisor: u64,
    whole: bool,
}

impl Grid {
    /// Takes the next value.
    pub fn push(&mut self, value: f64) {
        match self.first {
            None => (self.first, self.whole) = (Some(value), value.fract() == 0.0),
            Some(first) if self.whole && self.divisor != 1 => {
                let difference = (value - first).abs();
                self.whole = difference.fract() == 0.0;
                self.divisor = gcd(self.divisor, difference as u64);
            }
            Some(_) => {}
        }
        if !self.full {
            // Adding zero makes one number of 0 and -0.
            self.distinct.insert((value + 0.0).to_bits());
            self.full = self.distinct.len() > FEW;
        }
    }

    /// Number of distinct values; `None` above [`FEW`].
    pub fn distinct(&self) -> Option<usize> {
        (!self.full).then_some(self.distinct.len())
    }

    /// Smallest difference of two values (of the first [`FEW`] distinct ones); 0 for a single value.
    pub fn step(&self) -> f64 {
        let mut values: Vec<f64> = self
            .distinct
            .iter()
            .map(|bits| f64::from_bits(*bits))
            .collect();
        values.sort_by(f64::total_cmp);
        let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
        steps.reduce(f64::min).unwrap_or(0.0)
    }

    /// The whole number of which all differences are multiples; `None` where values are no whole
    /// numbers or do not differ.
    pub fn divisor(&self) -> Option<u64> {
        (self.whole && self.divisor > 0).then_some(self.divisor)
    }
}

fn gcd(a: u64, b: u64) -> u64 {
    match b {
        0 => a,
        _ => gcd(b, a % b),
    }
}
