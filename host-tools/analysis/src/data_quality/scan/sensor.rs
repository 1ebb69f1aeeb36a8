//! Repeated samples of a sensor, and outliers of a channel.

use std::collections::BTreeMap;

/// Counts rows in which no axis of a sensor changed.
#[derive(Clone, Debug, Default)]
pub struct Repeats {
    /// Number of the sensor.
    pub sensor: u32,
    /// Column indices of its axes.
    pub indices: Vec<usize>,
    last: Vec<f64>,
    /// Rows after the first.
    pub rows: u64,
    /// Rows in which no axis changed.
    pub repeated: u64,
    /// Line of the first of them.
    pub line: u64,
    /// Number of unchanged rows of each axis, among the others.
    single: Vec<u64>,
}

impl Repeats {
    /// Counter of a sensor, with the column index of its first axis.
    pub fn of(sensor: u32, index: usize) -> Self {
        Self { sensor, indices: vec![index], ..Self::default() }
    }

    /// Adds the fields of a row.
    pub fn push(&mut self, fields: &[f64], line: u64) {
        if self.last.len() != fields.len() {
            self.last = fields.to_vec();
            self.single = vec![0; fields.len()];
            return;
        }
        self.rows += 1;
        if self.last == fields {
            if self.repeated == 0 {
                self.line = line;
            }
            self.repeated += 1;
            return;
        }
        for ((count, last), now) in self.single.iter_mut().zip(&self.last).zip(fields) {
            *count += u64::from(last == now);
        }
        self.last.copy_from_slice(fields);
    }

    /// Share of rows in which no axis changed.
    pub fn share(&self) -> f64 {
        self.repeated as f64 / self.rows.max(1) as f64
    }

    /// Expected share for independent noise of the axes.
    pub fn by_chance(&self) -> f64 {
        let others = (self.rows - self.repeated).max(1) as f64;
        self.single.iter().map(|count| *count as f64 / others).product()
    }
}

/// Bins per octave: resolution of quantiles 9 %.
const PER_OCTAVE: f64 = 8.0;
/// Median absolute value of the standard normal distribution.
const MEDIAN_SIZE: f64 = 0.6745;
/// Norm of the weights 1, -3, 3, -1.
const THIRD_DIFFERENCE: f64 = 4.472_135_955;

/// Histogram with logarithmic bins.
#[derive(Clone, Debug, Default)]
struct Sizes {
    zeros: u64,
    bins: BTreeMap<i32, u64>,
}

impl Sizes {
    fn push(&mut self, size: f64) {
        if size > 0.0 { *self.bins.entry(bin(size)).or_default() += 1 } else { self.zeros += 1 }
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
        self.bins.range(bin(size) + 1..).map(|(_, count)| count).sum()
    }
}

fn bin(size: f64) -> i32 {
    (PER_OCTAVE * size.log2()).floor() as i32
}

/// Outlier statistics of a channel, by third differences.
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
    /// Adds a value.
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

    /// Restarts after a gap.
    pub fn interrupt(&mut self) {
        self.seen = 0;
    }

    /// Standard deviation of the white noise from the median; `None` where most rows do not change.
    pub fn noise(&self) -> Option<f64> {
        Some(self.differences.median()? / (MEDIAN_SIZE * THIRD_DIFFERENCE))
    }

    /// Number of rows that deviate from both neighbours in the same direction by more than `height`, and the largest
    /// deviation with its line.
    pub fn above(&self, height: f64) -> Option<(u64, f64, u64)> {
        let (most, line) = self.greatest.filter(|(most, _)| *most > height)?;
        Some((self.heights.above(height).max(1), most, line))
    }
}
