//! Everything that is kept of a column.

use model_export::recordings::columns::{Axis, FieldUnit, ForceColumn, HallColumn};
use model_export::recordings::noise::WhiteNoise;

use super::ends::End;
use super::grid::Grid;
use super::runs::{Run, Runs};
use super::sample::Sample;
use super::spectrum::{Line, Spectrum};
use super::spikes::Spikes;

/// A value that stays for longer than this many rows is frozen: it says nothing of the noise. A sample
/// that is held for shorter does.
const HELD_ROWS: u64 = 200;
/// Values that differ by noise: it is at least this share of their smallest step. Rounding alone
/// leaves 0.29 steps.
const NOISY_STEPS: f64 = 0.5;

/// What a column holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Quantity {
    /// A field of a sensor.
    Field {
        /// Number of the sensor.
        sensor: u32,
        /// Its axis.
        axis: Axis,
        /// How it is written.
        unit: FieldUnit,
    },
    /// A sensor's temperature.
    Temperature,
    /// A force.
    Force,
    /// Anything else.
    Covariate,
}

impl Quantity {
    /// Of a column of the board's table; `None` for the clock.
    pub fn of_hall(column: &HallColumn) -> Option<Self> {
        match column {
            HallColumn::Time => None,
            HallColumn::Field { sensor, axis, unit } => Some(Self::Field {
                sensor: *sensor,
                axis: *axis,
                unit: *unit,
            }),
            HallColumn::Temperature { .. } => Some(Self::Temperature),
            HallColumn::Covariate { .. } => Some(Self::Covariate),
        }
    }

    /// Of a column of the reference's table; `None` for the clock.
    pub fn of_force(column: &ForceColumn) -> Option<Self> {
        match column {
            ForceColumn::Time => None,
            ForceColumn::Force { .. } => Some(Self::Force),
        }
    }

    /// True for a field.
    pub fn is_field(&self) -> bool {
        matches!(self, Self::Field { .. })
    }
}

/// A column over one recording.
#[derive(Clone)]
pub struct ColumnScan {
    /// Its name.
    pub name: String,
    /// Where it stands in a row.
    pub index: usize,
    /// What it holds.
    pub quantity: Quantity,
    /// Gauss or newtons in one unit of its values, for messages.
    pub scale: f64,
    /// Size from which on it is saturated, in its own unit: least, greatest.
    pub limits: (f64, f64),
    /// Rows with a number.
    pub rows: u64,
    /// Least and greatest value.
    pub extent: (f64, f64),
    /// Rows at or beyond a limit, and the line of the first.
    pub at_limit: (u64, u64),
    /// The ends.
    pub ends: [End; 2],
    /// Its steps.
    pub grid: Grid,
    /// Stretches of one value.
    pub runs: Runs,
    /// A few of its values.
    pub sample: Sample,
    /// Rows that stand out; fields only.
    pub spikes: Spikes,
    /// Narrow lines, once the recording is over.
    pub lines: Vec<Line>,
    /// Upper edge of what it follows slowly, in hertz.
    pub load_edge_hz: f64,
    noise: WhiteNoise,
    mean: f64,
    squares: f64,
    spectrum: Option<Spectrum>,
}

impl ColumnScan {
    /// A column of which nothing was read yet.
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
            ends: [End::lower(), End::upper()],
            grid: Grid::default(),
            runs: Runs::default(),
            sample: Sample::default(),
            spikes: Spikes::default(),
            lines: Vec::new(),
            load_edge_hz: 0.0,
            noise: WhiteNoise::default(),
            mean: 0.0,
            squares: 0.0,
            spectrum: None,
        }
    }

    /// Looks for lines too.
    pub fn with_spectrum(&mut self, spectrum: Option<Spectrum>) {
        self.spectrum = spectrum;
    }

    /// Takes the next row's value; `regular` where no row is missing before it.
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

    /// Ends the recording; `tests` bins are looked at in the whole campaign.
    pub fn close(&mut self, tests: f64) {
        self.runs.close();
        if let Some(spectrum) = self.spectrum.take() {
            self.lines = spectrum.lines(tests);
            self.load_edge_hz = spectrum.load_edge_hz();
        }
    }

    /// Bins of its spectrum.
    pub fn bins(&self) -> usize {
        self.spectrum.as_ref().map_or(0, Spectrum::bins)
    }

    /// Standard deviation of the white part, in the column's unit; 0 where nothing changes.
    pub fn noise(&self) -> f64 {
        self.noise.estimate().unwrap_or(0.0)
    }

    /// Greatest minus least value.
    pub fn span(&self) -> f64 {
        (self.extent.1 - self.extent.0).max(0.0)
    }

    /// Rows, mean and sum of squared deviations.
    pub fn moments(&self) -> (f64, f64, f64) {
        (self.rows as f64, self.mean, self.squares)
    }

    /// True where noise makes the value differ from row to row.
    pub fn is_noisy(&self) -> bool {
        self.noise() > NOISY_STEPS * self.grid.step()
    }

    /// The value at which it is cut off and the rows that have it, though that is no end of its range.
    pub fn cut_off(&self) -> Option<(f64, u64)> {
        if !self.is_noisy() {
            return None;
        }
        let ends = self.ends.iter().filter_map(|end| end.cut_off(self.span()));
        ends.max_by_key(|(_, rows)| *rows)
    }

    /// A stretch of equal values that is far longer than its noise allows.
    pub fn frozen(&self) -> Option<Run> {
        /// Shorter stretches than this may be a driver that was late.
        const LEAST_ROWS: u64 = 50;
        /// A stretch this many times as long as others is no sample that is held.
        const BEYOND_USUAL: f64 = 20.0;
        /// Chance of such a stretch in a recording.
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
