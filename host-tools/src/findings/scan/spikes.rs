//! Single rows that stand out, and a noise that they do not disturb.

use std::collections::BTreeMap;

/// Bins in a doubling: a quantile is known to 9 %.
const PER_OCTAVE: f64 = 8.0;
/// Median of the size of a normal variable, in standard deviations.
const MEDIAN_SIZE: f64 = 0.6745;
/// Root of the sum of squares of the weights 1, -3, 3, -1.
const THIRD_DIFFERENCE: f64 = 4.472_135_955;

/// Counts sizes in bins of equal ratio.
#[derive(Clone, Debug, Default)]
struct Sizes {
    zeros: u64,
    bins: BTreeMap<i32, u64>,
}

impl Sizes {
    fn push(&mut self, size: f64) {
        match size > 0.0 {
            true => *self.bins.entry(bin(size)).or_default() += 1,
            false => self.zeros += 1,
        }
    }

    fn median(&self) -> Option<f64> {
        let total = self.zeros + self.bins.values().sum::<u64>();
        let mut below = self.zeros;
        if total == 0 || 2 * below > total {
            return None;
        }
        let middle = self.bins.iter().find(|(_, count)| {
            below += *count;
            2 * below >= total
        });
        middle.map(|(bin, _)| ((f64::from(*bin) + 0.5) / PER_OCTAVE).exp2())
    }

    fn above(&self, size: f64) -> u64 {
        self.bins
            .range(bin(size) + 1..)
            .map(|(_, count)| count)
            .sum()
    }
}

fn bin(size: f64) -> i32 {
    (PER_OCTAVE * size.log2()).floor() as i32
}

/// Follows a column.
#[derive(Clone, Debug, Default)]
pub struct Spikes {
    last: [f64; 3],
    last_line: u64,
    seen: usize,
    heights: Sizes,
    differences: Sizes,
    greatest: Option<(f64, u64)>,
}

impl Spikes {
    /// Takes the next value.
    pub fn push(&mut self, value: f64, line: u64) {
        let [a, b, c] = self.last;
        if self.seen >= 3 {
            self.differences.push((a - 3.0 * b + 3.0 * c - value).abs());
        }
        if self.seen >= 2 {
            let (before, after) = (c - b, c - value);
            if before * after > 0.0 {
                let height = before.abs().min(after.abs());
                self.heights.push(height);
                if self.greatest.is_none_or(|(most, _)| height > most) {
                    self.greatest = Some((height, self.last_line));
                }
            }
        }
        self.last = [b, c, value];
        self.last_line = line;
        self.seen += 1;
    }

    /// Starts anew after a hole.
    pub fn interrupt(&mut self) {
        self.seen = 0;
    }

    /// Standard deviation of the white part, by the median; `None` where most rows do not change.
    pub fn noise(&self) -> Option<f64> {
        Some(self.differences.median()? / (MEDIAN_SIZE * THIRD_DIFFERENCE))
    }

    /// Rows that stand above both neighbours (or below) by more than `height`, and the greatest with
    /// its line.
    pub fn above(&self, height: f64) -> Option<(u64, f64, u64)> {
        let (most, line) = self.greatest.filter(|(most, _)| *most > height)?;
        Some((self.heights.above(height).max(1), most, line))
    }
}
