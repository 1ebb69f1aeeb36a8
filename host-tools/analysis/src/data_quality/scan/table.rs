//! Tolerant reader and statistics of one CSV file.

use crate::data_quality::scan::channel::{ColumnScan, Quantity, Subsample};
use crate::data_quality::scan::clock::{ClockScan, RotorSpeed, TickOutcome};
use crate::data_quality::scan::sensor::Repeats;
use crate::data_quality::scan::spectrum::Spectrum;
use csv::ByteRecord;
use flate2::read::MultiGzDecoder;
use model_export::recordings::columns::{force_column, hall_column};
use realfft::RealFftPlanner;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Number of rows from which the typical clock step is estimated, as in the strict reader.
const FIRST_ROWS: usize = 1000;

/// Statistics of one table of a recording.
#[derive(Clone)]
pub struct TableScan {
    /// Path of the file.
    pub path: PathBuf,
    /// `hall.csv` or `force.csv`.
    pub name: &'static str,
    /// Clock statistics.
    pub clock: ClockScan,
    /// Statistics of the known columns, without the clock.
    pub columns: Vec<ColumnScan>,
    /// Repeated samples, one for each sensor.
    pub repeats: Vec<Repeats>,
    /// Rotor speed.
    pub turning: RotorSpeed,
    /// Subsample of the norm of the acceleration, in its own unit.
    pub acceleration: Subsample,
    time_column: usize,
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
        let TickOutcome::On { regular } = self.clock.tick(line, t_us, record) else {
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

    /// Column by name.
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
    while first.len() < FIRST_ROWS && rows.next_into(&mut row) {
        first.push(row.clone());
    }
    first
}

/// Median step in the clock's unit; `None` without rows.
fn typical_step(rows: &[ScannedRow], time_column: usize) -> Option<f64> {
    let times: Vec<f64> =
        rows.iter().map(|row| row.record.get(time_column).map_or(f64::NAN, number)).collect();
    times.first()?;
    let mut steps: Vec<f64> =
        times.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    Some(steps.get(steps.len() / 2).copied().unwrap_or(0.0))
}

/// Path of the table `name` in `folder`, plain or compressed; `None` where neither or both exist.
pub fn table_path(folder: &Path, name: &str) -> Option<PathBuf> {
    let plain = folder.join(name);
    let packed = folder.join(format!("{name}.gz"));
    match (plain.is_file(), packed.is_file()) {
        (true, false) => Some(plain),
        (false, true) => Some(packed),
        _ => None,
    }
}

/// True for the extension of a compressed file.
pub fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "gz")
}

/// CSV reader of the file, decompressed where necessary; the header is the first record.
pub fn reader(path: &Path) -> std::io::Result<csv::Reader<Box<dyn Read + Send>>> {
    let file = File::open(path)?;
    let input: Box<dyn Read + Send> =
        if is_packed(path) { Box::new(MultiGzDecoder::new(file)) } else { Box::new(file) };
    Ok(csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .buffer_capacity(1 << 16)
        .from_reader(input))
}

/// Column names of a header record, as in the strict reader.
pub fn names(header: &ByteRecord) -> Vec<String> {
    header
        .iter()
        .map(|cell| {
            let name = String::from_utf8_lossy(cell);
            name.trim_start_matches('\u{feff}').trim().to_owned()
        })
        .collect()
}

/// Parses a cell; NaN where it is not a number.
pub fn number(cell: &[u8]) -> f64 {
    std::str::from_utf8(cell.trim_ascii())
        .ok()
        .and_then(|text| text.parse::<f64>().ok())
        .filter(|value| value.is_finite())
        .unwrap_or(f64::NAN)
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
    reader: csv::Reader<Box<dyn Read + Send>>,
    /// Column names.
    pub header: Vec<String>,
}

impl TolerantReader {
    /// Opens the file; `None` without a readable header.
    pub fn open(path: &Path) -> Option<Self> {
        let mut reader = reader(path).ok()?;
        let mut record = ByteRecord::new();
        reader.read_byte_record(&mut record).ok().filter(|found| *found)?;
        Some(Self { header: names(&record), reader })
    }

    /// Reads the next row with as many cells as the header into `row`; false at the end or at an
    /// unreadable place.
    pub fn next_into(&mut self, row: &mut ScannedRow) -> bool {
        loop {
            match self.reader.read_byte_record(&mut row.record) {
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
