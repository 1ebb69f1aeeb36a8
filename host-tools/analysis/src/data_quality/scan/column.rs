//! Statistics of one column in constant memory: extent, noise, quantisation steps, constant runs, clipping, outliers.

use crate::data_quality::scan::spectrum::{SpectralLine, Spectrum};
use model_export::recordings::columns::{Axis, FieldUnit, ForceColumn, HallColumn};
use model_export::recordings::noise::WhiteNoise;
use std::collections::{BTreeMap, HashSet};

/// A constant run longer than this many rows is frozen and excluded from the noise estimate; shorter
/// repeats are not.
const HELD_ROWS: u64 = 200;
/// A channel counts as noisy if its noise is at least this share of its smallest step. Rounding alone
/// leaves 0.29 steps.
const NOISY_STEPS: f64 = 0.5;

/// Physical quantity of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Quantity {
    /// Magnetic field.
    Field {
        /// Number of the sensor, from 1.
        sensor: u32,
        /// Field axis.
        axis: Axis,
        /// Unit of the written values.
        unit: FieldUnit,
    },
    /// Temperature of a sensor.
    Temperature,
    /// Reference force.
    Force,
    /// Any other covariate.
    Covariate,
}

impl Quantity {
    /// Quantity of a column of the board's table; `None` for the clock.
    pub fn of_hall(column: &HallColumn) -> Option<Self> {
        match column {
            HallColumn::Time => None,
            HallColumn::Field { sensor, axis, unit } => {
                Some(Self::Field { sensor: *sensor, axis: *axis, unit: *unit })
            }
            HallColumn::Temperature { .. } => Some(Self::Temperature),
            HallColumn::Covariate { .. } => Some(Self::Covariate),
        }
    }

    /// Quantity of a column of the reference's table; `None` for the clock.
    pub fn of_force(column: &ForceColumn) -> Option<Self> {
        match column {
            ForceColumn::Time => None,
            ForceColumn::Force { .. } => Some(Self::Force),
        }
    }

    pub fn is_field(&self) -> bool {
        matches!(self, Self::Field { .. })
    }
}

/// Statistics of one column of one recording.
#[derive(Clone)]
pub struct ColumnScan {
    /// Name in the header.
    pub name: String,
    /// Index in a row.
    pub index: usize,
    /// Physical quantity.
    pub quantity: Quantity,
    /// Gauss or newtons per unit of the values.
    pub scale: f64,
    /// Saturation limits (lower, upper) in the unit of the values.
    pub limits: (f64, f64),
    pub rows: u64,
    /// Minimum and maximum.
    pub extent: (f64, f64),
    /// Rows at or beyond a limit, and the line of the first.
    pub at_limit: (u64, u64),
    /// Lower and upper extreme values.
    pub ends: [Extreme; 2],
    /// Largest change from row to row.
    pub largest_jump: f64,
    last: f64,
    /// Quantisation.
    pub grid: StepGrid,
    /// Runs of equal values.
    pub runs: Runs,
    pub sample: Subsample,
    /// Outlier statistics; fields only.
    pub spikes: Spikes,
    /// Spectral lines; filled by [`Self::close`].
    pub lines: Vec<SpectralLine>,
    /// Upper edge of the load's band in hertz.
    pub load_edge_hz: f64,
    noise: WhiteNoise,
    mean: f64,
    squares: f64,
    spectrum: Option<Spectrum>,
}

impl ColumnScan {
    /// No rows yet.
    pub fn new(name: &str, index: usize, quantity: Quantity) -> Self {
        Self {
            name: name.to_owned(),
            index,
            quantity,
            scale: 1.0,
            limits: (f64::NEG_INFINITY, f64::INFINITY),
            rows: 0,
            extent: (f64::INFINITY, f64::NEG_INFINITY),
            at_limit: (0, 0),
            ends: [Extreme::lower(), Extreme::upper()],
            largest_jump: 0.0,
            last: f64::NAN,
            grid: StepGrid::default(),
            runs: Runs::default(),
            sample: Subsample::default(),
            spikes: Spikes::default(),
            lines: Vec::new(),
            load_edge_hz: 0.0,
            noise: WhiteNoise::default(),
            mean: 0.0,
            squares: 0.0,
            spectrum: None,
        }
    }

    /// Enables spectral analysis.
    pub fn with_spectrum(&mut self, spectrum: Option<Spectrum>) {
        self.spectrum = spectrum;
    }

    /// Adds the next row's value; `regular` where no row is missing before it.
    pub fn push(&mut self, value: f64, t_us: f64, line: u64, regular: bool) {
        if let Some(spectrum) = &mut self.spectrum {
            spectrum.push(value, regular);
        }
        if value.is_nan() {
            self.noise.push(value);
            self.spikes.interrupt();
            return;
        }
        self.rows += 1;
        // The maximum with a number that is none is the other one.
        self.largest_jump = self.largest_jump.max((value - self.last).abs());
        self.last = value;
        let from_mean = value - self.mean;
        self.mean += from_mean / self.rows as f64;
        self.squares += from_mean * (value - self.mean);
        self.extent = (self.extent.0.min(value), self.extent.1.max(value));
        if value <= self.limits.0 || value >= self.limits.1 {
            let (count, first) = &mut self.at_limit;
            *first = if *count == 0 { line } else { *first };
            *count += 1;
        }
        self.ends.iter_mut().for_each(|end| end.push(value));
        self.grid.push(value);
        self.sample.push(value);
        let held = self.runs.push(value, t_us, line) > HELD_ROWS;
        self.noise.push(if held { f64::NAN } else { value });
        if self.quantity.is_field() {
            self.spikes.push(value, line);
        }
    }

    /// Ends the recording; `tests` is the number of spectral bins tested in the whole campaign.
    pub fn close(&mut self, tests: f64) {
        self.runs.close();
        if let Some(spectrum) = self.spectrum.take() {
            self.lines = spectrum.lines(tests);
            self.load_edge_hz = spectrum.load_edge_hz();
        }
    }

    /// Number of spectral bins.
    pub fn bins(&self) -> usize {
        self.spectrum.as_ref().map_or(0, Spectrum::bins)
    }

    /// Standard deviation of the white noise, in the unit of the values; 0 for a constant.
    pub fn noise(&self) -> f64 {
        self.noise.estimate().unwrap_or(0.0)
    }

    /// Maximum minus minimum.
    pub fn span(&self) -> f64 {
        (self.extent.1 - self.extent.0).max(0.0)
    }

    /// Number of rows, mean, and sum of squared deviations.
    pub fn moments(&self) -> (f64, f64, f64) {
        (self.rows as f64, self.mean, self.squares)
    }

    /// True where noise changes the value from row to row.
    pub fn is_noisy(&self) -> bool {
        self.noise() > NOISY_STEPS * self.grid.step()
    }

    /// Value at which the column is clipped inside its range, and the number of rows with it.
    pub fn cut_off(&self) -> Option<(f64, u64)> {
        if !self.is_noisy() {
            return None;
        }
        let ends = self.ends.iter().filter_map(|end| end.cut_off(self.span()));
        ends.max_by_key(|(_, rows)| *rows)
    }

    /// Longest constant run, if it is far longer than the noise allows.
    pub fn frozen(&self) -> Option<Run> {
        /// Shorter runs may be a late driver.
        const LEAST_ROWS: u64 = 50;
        /// Minimum ratio to the mean length of other runs, to exclude repeated samples.
        const BEYOND_USUAL: f64 = 20.0;
        /// False-positive probability per recording.
        const CHANCE: f64 = 1e-6;
        let run = self.runs.longest();
        let share = self.runs.share(self.rows).max(1.0 / self.rows as f64);
        let too_long = -(run.rows as f64) * share.ln() > (self.rows as f64 / CHANCE).ln();
        let found = self.is_noisy()
            && self.span() > 0.0
            && run.rows >= LEAST_ROWS
            && run.rows as f64 > BEYOND_USUAL * self.runs.usual()
            && too_long;
        found.then_some(run)
    }
}

/// Maximum number of distinct values of a coarse column.
pub const FEW: usize = 1000;

/// Distinct values, up to [`FEW`], and the common divisor of integers.
#[derive(Clone, Debug, Default)]
pub struct StepGrid {
    distinct: HashSet<u64>,
    full: bool,
    first: Option<f64>,
    divisor: u64,
    whole: bool,
}

impl StepGrid {
    /// Adds a value.
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
            // Adding zero maps -0 to 0.
            self.distinct.insert((value + 0.0).to_bits());
            self.full = self.distinct.len() > FEW;
        }
    }

    /// Number of distinct values; `None` above [`FEW`].
    pub fn distinct(&self) -> Option<usize> {
        (!self.full).then_some(self.distinct.len())
    }

    /// Smallest difference between two values (of the first [`FEW`] distinct ones); 0 for a single value.
    pub fn step(&self) -> f64 {
        let mut values: Vec<f64> = self.distinct.iter().map(|bits| f64::from_bits(*bits)).collect();
        values.sort_by(f64::total_cmp);
        let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
        steps.reduce(f64::min).unwrap_or(0.0)
    }

    /// Common step of the values, which are written with a few decimals: that of the counts behind them. `None` for a constant, or
    /// where they have none.
    pub fn resolution(&self) -> Option<f64> {
        /// Decimals of a logger.
        const DECIMALS: std::ops::RangeInclusive<i32> = 0..=9;
        let values = || self.distinct.iter().map(|bits| f64::from_bits(*bits));
        let is_whole = |scale: f64| {
            values().all(|value| (value * scale - (value * scale).round()).abs() < 1e-4)
        };
        let scale =
            DECIMALS.map(|decimals| 10_f64.powi(decimals)).find(|scale| is_whole(*scale))?;
        let first = (values().next()? * scale).round();
        let divisor = values()
            .fold(0, |divisor, value| gcd(divisor, ((value * scale).round() - first).abs() as u64));
        (divisor > 0).then(|| divisor as f64 / scale)
    }

    /// Greatest common divisor of all differences; `None` for non-integers or a
    /// constant.
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

/// Number of distinct extreme values stored.
const KEPT: usize = 9;
/// Minimum number of rows at a clipped value.
const LEAST_ROWS: u64 = 20;
/// Minimum ratio to the mean count of the neighbouring values: noise makes values rarer
/// towards an extreme.
const PILE: f64 = 10.0;
/// Maximum distance to the neighbouring values as a share of the span; beyond it the value is
/// separate, such as the zero of an unpowered sensor.
const NEAR: f64 = 0.05;

/// Most extreme values at one end of the range.
#[derive(Clone, Debug)]
pub struct Extreme {
    /// 1 for the upper end, -1 for the lower.
    sign: f64,
    /// Values times `sign`, largest first, with the rows of each.
    values: Vec<(f64, u64)>,
}

impl Extreme {
    /// Upper extreme.
    pub fn upper() -> Self {
        Self { sign: 1.0, values: Vec::with_capacity(KEPT + 1) }
    }

    /// Lower extreme.
    pub fn lower() -> Self {
        Self { sign: -1.0, ..Self::upper() }
    }

    /// Adds a value.
    pub fn push(&mut self, value: f64) {
        let value = self.sign * value;
        if self.values.len() == KEPT && self.values.last().is_some_and(|(v, _)| *v > value) {
            return;
        }
        match self.values.iter().position(|(v, _)| *v <= value) {
            Some(i) if self.values[i].0 == value => self.values[i].1 += 1,
            Some(i) => self.values.insert(i, (value, 1)),
            None => self.values.push((value, 1)),
        }
        self.values.truncate(KEPT);
    }

    /// Extreme value and its number of rows, if the column is clipped there; `span` is its extent.
    pub fn cut_off(&self, span: f64) -> Option<(f64, u64)> {
        let ((value, rows), neighbours) = self.values.split_first()?;
        let farthest = neighbours.last()?.0;
        let mean =
            neighbours.iter().map(|(_, rows)| *rows as f64).sum::<f64>() / neighbours.len() as f64;
        let piled = *rows >= LEAST_ROWS && *rows as f64 > PILE * mean;
        (piled && value - farthest <= NEAR * span).then_some((self.sign * value, *rows))
    }
}

/// Run of equal values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Run {
    /// Length in rows.
    pub rows: u64,
    /// Times of the first and last row in microseconds.
    pub from_us: f64,
    /// See `from_us`.
    pub to_us: f64,
    /// Line of its first row.
    pub line: u64,
    /// Constant value.
    pub value: f64,
}

/// Run lengths of a column.
#[derive(Clone, Debug, Default)]
pub struct Runs {
    now: Run,
    longest: Run,
    /// Completed runs of at least two rows: number and total rows.
    over: (u64, u64),
}

impl Runs {
    /// Adds a value; returns the length of its run so far.
    pub fn push(&mut self, value: f64, t_us: f64, line: u64) -> u64 {
        if self.now.rows > 0 && value == self.now.value {
            self.now.rows += 1;
            self.now.to_us = t_us;
            return self.now.rows;
        }
        self.close();
        self.now = Run { rows: 1, from_us: t_us, to_us: t_us, line, value };
        1
    }

    /// Ends the current run.
    pub fn close(&mut self) {
        if self.now.rows >= 2 {
            self.over.0 += 1;
            self.over.1 += self.now.rows;
        }
        if self.now.rows > self.longest.rows {
            self.longest = self.now;
        }
        self.now = Run::default();
    }

    /// Longest completed run.
    pub fn longest(&self) -> Run {
        self.longest
    }

    /// Mean length of the other runs of at least two rows; at least 1.
    pub fn usual(&self) -> f64 {
        let longest = if self.longest.rows >= 2 { (1, self.longest.rows) } else { (0, 0) };
        let (count, rows) = (self.over.0 - longest.0, self.over.1 - longest.1);
        (rows as f64 / count.max(1) as f64).max(1.0)
    }

    /// Share of the rows outside the longest run that repeat the previous value; `rows` is the total.
    pub fn share(&self, rows: u64) -> f64 {
        let repeated = self.over.1 - self.over.0;
        let own = self.longest.rows.saturating_sub(1);
        let others = rows.saturating_sub(self.longest.rows).max(1);
        repeated.saturating_sub(own) as f64 / others as f64
    }
}

/// Maximum number of stored values.
const MOST: usize = 512;

/// Every n-th value; n doubles when the store is full.
#[derive(Clone, Debug)]
pub struct Subsample {
    values: Vec<f64>,
    stride: u64,
    seen: u64,
}

impl Default for Subsample {
    fn default() -> Self {
        Self { values: Vec::new(), stride: 1, seen: 0 }
    }
}

impl Subsample {
    /// Adds a value.
    pub fn push(&mut self, value: f64) {
        if self.seen.is_multiple_of(self.stride) {
            if self.values.len() == MOST {
                let mut kept = 0_u64;
                self.values.retain(|_| {
                    kept += 1;
                    kept % 2 == 1
                });
                self.stride *= 2;
            }
            if self.seen.is_multiple_of(self.stride) {
                self.values.push(value);
            }
        }
        self.seen += 1;
    }

    /// Quantile of the absolute values; `None` without values.
    pub fn size(&self, share: f64) -> Option<f64> {
        let mut sizes: Vec<f64> = self.values.iter().map(|value| value.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let last = sizes.len().checked_sub(1)?;
        sizes.get((share * last as f64).round() as usize).copied()
    }

    /// Median; `None` without values.
    pub fn median(&self) -> Option<f64> {
        let mut values = self.values.clone();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
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
