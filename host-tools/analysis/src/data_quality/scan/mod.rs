//! One tolerant pass over every file of a campaign, in constant memory.
//!
//! - [`clock`]: order, duplicates and gaps of a clock; rotor speed.
//! - [`mod@column`]: statistics of a column.
//! - [`spectrum`]: averaged periodograms and their narrow lines.

pub mod clock;
pub mod column;
pub mod spectrum;

use crate::data_quality::scan::clock::{ClockScan, RotorSpeed, TickOutcome};
use crate::data_quality::scan::column::{ColumnScan, Quantity, Subsample};
use crate::data_quality::scan::spectrum::Spectrum;
use csv::ByteRecord;
use firmware::sensors::hall::a31301::FIELD_LIMITS;
use model_export::recordings::columns::{FieldUnit, force_column, hall_column};
use model_export::recordings::csv_table::{
    CsvReader, PERIOD_ROWS, column_names, number, table_path,
};
use model_export::recordings::description::RecordingDescription;
use std::path::{Path, PathBuf};

#[derive(Clone)]
pub struct RecordingScan {
    /// Name of the folder.
    pub name: String,
    pub folder: PathBuf,
    /// Whether its rows have no clock: they are settings, not samples of a course of time.
    pub is_table_of_settings: bool,
    /// Readable tables: the board's, the reference's.
    pub tables: Vec<TableScan>,
}

impl RecordingScan {
    /// Scans the recording in `folder`, one of `recordings`. Missing files are skipped: the strict
    /// reader reports them.
    pub fn read(folder: &Path, recordings: usize) -> Self {
        let description = RecordingDescription::read(folder).ok().map(|(found, _)| found);
        let declared = description.as_ref().map_or_else(Vec::new, |found| found.covariates.clone());
        let read = |name: &'static str| {
            let path = table_path(folder, name).ok()?;
            TableScan::read(&path, name, &declared, recordings, |column| {
                prepare(column, description.as_ref());
            })
        };
        Self {
            name: folder
                .file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            folder: folder.to_path_buf(),
            is_table_of_settings: description
                .as_ref()
                .is_some_and(|found| found.is_clock_assumed()),
            tables: ["hall.csv", "force.csv"].into_iter().filter_map(read).collect(),
        }
    }

    /// Table by file name.
    pub fn table(&self, name: &str) -> Option<&TableScan> {
        self.tables.iter().find(|table| table.name == name)
    }
}

/// Sets scale and limits of a field.
fn prepare(column: &mut ColumnScan, description: Option<&RecordingDescription>) {
    let Quantity::Field { unit, .. } = column.quantity else {
        return;
    };
    let raw = unit == FieldUnit::Lsb;
    let most = description.map_or(f64::INFINITY, |found| found.saturated_gauss(raw));
    column.limits = (-most, most);
    if raw {
        column.scale = description.and_then(|found| found.gauss_per_lsb).unwrap_or(1.0);
        let (low, high) = (f64::from(FIELD_LIMITS.0), f64::from(FIELD_LIMITS.1));
        let most = most / column.scale;
        column.limits = (low.max(-most), high.min(most));
    }
}

/// Statistics of one table of a recording.
#[derive(Clone)]
pub struct TableScan {
    pub path: PathBuf,
    /// `hall.csv` or `force.csv`.
    pub name: &'static str,
    /// Clock statistics.
    pub clock: ClockScan,
    /// Statistics of the known columns, without the clock.
    pub columns: Vec<ColumnScan>,
    /// Repeated samples, one for each sensor.
    pub repeats: Vec<Repeats>,
    pub turning: RotorSpeed,
    /// Subsample of the norm of the acceleration, in its own unit.
    pub acceleration: Subsample,
    time_column: usize,
    /// Numbers of the row, reused.
    values: Vec<f64>,
    angle: Option<usize>,
    accelerations: Vec<usize>,
}

impl TableScan {
    /// Reads the table; `prepare` sets scale and limits of a column. `None` without a clock or without
    /// rows.
    pub fn read(
        path: &Path,
        name: &'static str,
        declared: &[String],
        recordings: usize,
        prepare: impl Fn(&mut ColumnScan),
    ) -> Option<Self> {
        let mut rows = TolerantReader::open(path)?;
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
            turning: RotorSpeed::default(),
            acceleration: Subsample::default(),
            accelerations,
            time_column,
            values: Vec::new(),
            angle: angle.first().copied(),
        };
        scan.plan_spectra();
        first.iter().for_each(|row| scan.push(row.line, &row.record));
        let mut row = ScannedRow { line: 0, record: ByteRecord::new() };
        while rows.next_into(&mut row) {
            scan.push(row.line, &row.record);
        }
        let bins: usize = scan.columns.iter().map(ColumnScan::bins).sum();
        let tests = (bins * recordings).max(1) as f64;
        scan.columns.iter_mut().for_each(|column| column.close(tests));
        Some(scan)
    }

    fn plan_spectra(&mut self) {
        let spectrum = Spectrum::new(1e6 / self.clock.period_us);
        for column in &mut self.columns {
            if column.quantity.is_field() || column.quantity == Quantity::Force {
                column.with_spectrum(spectrum.clone());
            }
        }
    }

    fn push(&mut self, line: u64, record: &ByteRecord) {
        self.values.clear();
        self.values.extend(record.iter().map(finite));
        let values = &self.values;
        let cell = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        let t_us = cell(self.time_column);
        if t_us.is_nan() {
            return;
        }
        let TickOutcome::On { regular } = self.clock.tick(line, t_us, record) else {
            return;
        };
        for column in &mut self.columns {
            column.push(cell(column.index), t_us, line, regular);
        }
        for repeats in &mut self.repeats {
            repeats.push(cell, line);
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

    pub fn column(&self, name: &str) -> Option<&ColumnScan> {
        self.columns.iter().find(|column| column.name == name)
    }

    /// Seconds since the first row.
    pub fn second(&self, t_us: f64) -> f64 {
        1e-6 * (t_us - self.clock.first_us)
    }
}

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

fn first_rows(rows: &mut TolerantReader) -> Vec<ScannedRow> {
    let mut first = Vec::new();
    let mut row = ScannedRow { line: 0, record: ByteRecord::new() };
    while first.len() < PERIOD_ROWS && rows.next_into(&mut row) {
        first.push(row.clone());
    }
    first
}

/// Median step in the clock's unit; `None` without rows.
fn typical_step(rows: &[ScannedRow], time_column: usize) -> Option<f64> {
    let times: Vec<f64> =
        rows.iter().map(|row| row.record.get(time_column).map_or(f64::NAN, finite)).collect();
    times.first()?;
    let mut steps: Vec<f64> =
        times.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    Some(steps.get(steps.len() / 2).copied().unwrap_or(0.0))
}

/// Number in a cell; NaN where it is not a finite number.
pub fn finite(cell: &[u8]) -> f64 {
    number(cell).filter(|value| value.is_finite()).unwrap_or(f64::NAN)
}

/// Row with as many cells as the header.
#[derive(Clone, Debug)]
pub struct ScannedRow {
    /// Line in the file; the header is line 1.
    pub line: u64,
    /// Cells.
    pub record: ByteRecord,
}

/// Reader of the complete rows of a table.
pub struct TolerantReader {
    reader: CsvReader,
    /// Column names.
    pub header: Vec<String>,
}

impl TolerantReader {
    /// Opens the file; `None` without a readable header.
    pub fn open(path: &Path) -> Option<Self> {
        let mut reader = CsvReader::open(path).ok()?;
        let mut record = ByteRecord::new();
        reader.read(&mut record).ok().filter(|found| *found)?;
        Some(Self { header: column_names(&record), reader })
    }

    /// Reads the next row with as many cells as the header into `row`; false at the end or at an
    /// unreadable place.
    pub fn next_into(&mut self, row: &mut ScannedRow) -> bool {
        loop {
            match self.reader.read(&mut row.record) {
                Ok(true) if row.record.len() == self.header.len() => {
                    row.line = row.record.position().map_or(0, csv::Position::line);
                    return true;
                }
                Ok(true) => {}
                Ok(false) | Err(_) => return false,
            }
        }
    }
}

/// Counts rows in which no axis of a sensor changed.
#[derive(Clone, Debug, Default)]
pub struct Repeats {
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

    /// Adds the fields of a row; `value` is that of a column.
    pub fn push(&mut self, value: impl Fn(usize) -> f64, line: u64) {
        let fields = self.indices.iter().map(|&index| value(index));
        if self.last.len() != self.indices.len() {
            self.last = fields.collect();
            self.single = vec![0; self.last.len()];
            return;
        }
        self.rows += 1;
        if self.last.iter().copied().eq(fields.clone()) {
            if self.repeated == 0 {
                self.line = line;
            }
            self.repeated += 1;
            return;
        }
        for ((count, last), now) in self.single.iter_mut().zip(&mut self.last).zip(fields) {
            *count += u64::from(*last == now);
            *last = now;
        }
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
