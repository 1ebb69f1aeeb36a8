//! One file, read once.

use std::path::{Path, PathBuf};

use csv::ByteRecord;
use model_export::recordings::columns::{force_column, hall_column};
use realfft::RealFftPlanner;

use super::clock::{ClockScan, Turn};
use super::column::{ColumnScan, Quantity};
use super::repeats::Repeats;
use super::rows::{Row, Rows, number};
use super::sample::Sample;
use super::spectrum::Spectrum;
use super::turning::Turning;

/// Rows from which the typical step of the clock is taken; the strict reader takes as many.
const FIRST_ROWS: usize = 1000;

/// One table of a recording.
#[derive(Clone)]
pub struct TableScan {
    /// Its file.
    pub path: PathBuf,
    /// `hall.csv` or `force.csv`.
    pub name: &'static str,
    /// Its clock.
    pub clock: ClockScan,
    /// Its columns but the clock, as far as their names are known.
    pub columns: Vec<ColumnScan>,
    /// Rows in which no axis of a sensor changed, sensor by sensor.
    pub repeats: Vec<Repeats>,
    /// The rotor.
    pub turning: Turning,
    /// Length of the acceleration in its own unit, a few rows of it.
    pub acceleration: Sample,
    time_column: usize,
    angle: Option<usize>,
    accelerations: Vec<usize>,
}

impl TableScan {
    /// Reads the table; `prepare` sets scale and limits of a column. `None` where it has no clock or no
    /// row.
    pub fn read(
        path: &Path,
        name: &'static str,
        declared: &[String],
        recordings: usize,
        prepare: impl Fn(&mut ColumnScan),
    ) -> Option<Self> {
        let mut rows = Rows::open(path)?;
        let time_column = rows.header.iter().position(|column| column == "t_us")?;
        let quantity = |column: &String| match name {
            "hall.csv" => Quantity::of_hall(&hall_column(column, declared).ok()?),
            _ => Quantity::of_force(&force_column(column).ok()?),
        };
        let named = rows.header.iter().enumerate();
        let mut columns: Vec<ColumnScan> = named
            .filter_map(|(i, column)| Some(ColumnScan::new(column, i, quantity(column)?)))
            .collect();
        columns.iter_mut().for_each(prepare);
        let indices = |wanted: &dyn Fn(&ColumnScan) -> bool| -> Vec<usize> {
            let wanted = columns.iter().filter(|column| wanted(column));
            wanted.map(|column| column.index).collect()
        };
        let repeats = repeats(&columns);
        let angle = indices(&|column| column.name == "motor_angle_rad");
        let accelerations = indices(&|column| column.name.starts_with("accel_"));
        let first = first_rows(&mut rows);
        let mut scan = Self {
            path: path.to_path_buf(),
            name,
            clock: ClockScan::new(typical_step(&first, time_column)?),
            columns,
            repeats,
            turning: Turning::default(),
            acceleration: Sample::default(),
            accelerations,
            time_column,
            angle: angle.first().copied(),
        };
        scan.plan_spectra();
        first
            .iter()
            .for_each(|row| scan.push(row.line, &row.record));
        let mut row = Row {
            line: 0,
            record: ByteRecord::new(),
        };
        while rows.next_into(&mut row) {
            scan.push(row.line, &row.record);
        }
        let bins: usize = scan.columns.iter().map(ColumnScan::bins).sum();
        let tests = (bins * recordings).max(1) as f64;
        scan.columns
            .iter_mut()
            .for_each(|column| column.close(tests));
        Some(scan)
    }

    fn plan_spectra(&mut self) {
        let mut planner = RealFftPlanner::new();
        let rate_hz = 1e6 / self.clock.period_us;
        for column in &mut self.columns {
            if column.quantity.is_field() || column.quantity == Quantity::Force {
                column.with_spectrum(Spectrum::new(rate_hz, &mut planner));
            }
        }
    }

    fn push(&mut self, line: u64, record: &ByteRecord) {
        let cell = |index: usize| record.get(index).map_or(f64::NAN, number);
        let t_us = cell(self.time_column);
        if t_us.is_nan() {
            return;
        }
        let Turn::On { regular } = self.clock.tick(line, t_us, record) else {
            return;
        };
        for column in &mut self.columns {
            column.push(cell(column.index), t_us, line, regular);
        }
        for repeats in &mut self.repeats {
            let fields: Vec<f64> = repeats.indices.iter().map(|&index| cell(index)).collect();
            repeats.push(&fields, line);
        }
        if self.accelerations.len() == 3 {
            let squares = self.accelerations.iter().map(|&index| cell(index).powi(2));
            let length = squares.sum::<f64>().sqrt();
            if length.is_finite() {
                self.acceleration.push(length);
            }
        }
        if let Some(angle) = self.angle.map(cell).filter(|angle| angle.is_finite()) {
            self.turning.push(angle, t_us);
        }
    }

    /// A column by its name.
    pub fn column(&self, name: &str) -> Option<&ColumnScan> {
        self.columns.iter().find(|column| column.name == name)
    }

    /// Seconds since the first row.
    pub fn second(&self, t_us: f64) -> f64 {
        1e-6 * (t_us - self.clock.first_us)
    }
}

/// One for each sensor.
fn repeats(columns: &[ColumnScan]) -> Vec<Repeats> {
    let mut all: Vec<Repeats> = Vec::new();
    for column in columns {
        let Quantity::Field { sensor, .. } = column.quantity else {
            continue;
        };
        match all.iter_mut().find(|repeats| repeats.sensor == sensor) {
            Some(repeats) => repeats.indices.push(column.index),
            None => all.push(Repeats::of(sensor, column.index)),
        }
    }
    all
}

fn first_rows(rows: &mut Rows) -> Vec<Row> {
    let mut first = Vec::new();
    let mut row = Row {
        line: 0,
        record: ByteRecord::new(),
    };
    while first.len() < FIRST_ROWS && rows.next_into(&mut row) {
        first.push(row.clone());
    }
    first
}

/// Median step in the clock's unit; `None` without a row.
fn typical_step(rows: &[Row], time_column: usize) -> Option<f64> {
    let times: Vec<f64> = rows
        .iter()
        .map(|row| row.record.get(time_column).map_or(f64::NAN, number))
        .collect();
    times.first()?;
    let mut steps: Vec<f64> = times
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|step| *step > 0.0)
        .collect();
    steps.sort_by(f64::total_cmp);
    Some(steps.get(steps.len() / 2).copied().unwrap_or(0.0))
}
