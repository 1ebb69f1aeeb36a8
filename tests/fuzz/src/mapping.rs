//! Mapping files and tables of other test benches, imported as a campaign.

use std::fs;
use std::path::Path;

use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::import::import;
use model_export::recordings::recording::Recording;

use super::bytes::{Bytes, change};

/// Units of magnetic fields with their factor to gauss, and one that is none.
const FIELDS: [(&str, f64); 8] = [
    ("G", 1.0),
    ("mT", 10.0),
    ("uT", 0.01),
    ("T", 1e4),
    ("nT", 1e-5),
    ("gauss", 1.0),
    ("mG", 1e-3),
    ("kg", f64::NAN),
];
/// Units of times with their factor to seconds.
const TIMES: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];
/// Units of forces with their factor to newtons.
const FORCES: [(&str, f64); 4] = [("N", 1.0), ("mN", 1e-3), ("kg", 9.806_65), ("g", 9.806_65e-3)];
/// Other columns with their units.
const COVARIATES: [(&str, &str); 5] = [
    ("opening_mm", "mm"),
    ("stage_mm", "um"),
    ("motor_iq_a", "mA"),
    ("s0_temp_c", "degC"),
    ("pitch_rad", "deg"),
];
/// Scales of a column.
const SCALES: [&str; 6] = ["1", "-1", "0.5", "2e3", "0", "1e13"];

/// Results of an import.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub imported: u32,
    pub refused: u32,
    /// Imported values that were compared with those of the source.
    pub compared: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<3> {
        [("imported", self.imported), ("refused", self.refused), ("compared", self.compared)]
    }
}

/// A mapping with its table, and what the values are.
struct Source {
    mapping: String,
    table: String,
    /// Times in seconds.
    times: Vec<f64>,
    /// Fields in gauss.
    fields: Vec<[f64; 3]>,
    /// Forces in newtons.
    forces: Vec<f64>,
}

/// One import: all of a valid source with its values, or nothing.
pub fn convert(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let kind = bytes.byte();
    let mut source = source(kind, &mut bytes);
    let is_changed = kind & 3 == 0;
    if is_changed {
        for _ in 0..=bytes.byte() % 3 {
            change(&mut source.mapping, &mut bytes);
        }
    }
    let mut table = source.table.clone().into_bytes();
    if kind & 15 == 1 {
        for _ in 0..=bytes.byte() % 3 {
            let at = usize::from(bytes.word()) % table.len();
            table[at] = bytes.byte();
        }
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [mapping, file, campaign] =
        ["mapping.toml", "table.csv", "campaign"].map(|name| folder.path().join(name));
    fs::write(&mapping, &source.mapping).expect("a temporary file");
    fs::write(&file, &table).expect("a temporary file");
    let mut tally = Tally::default();
    match import(&mapping, std::slice::from_ref(&file), &campaign, |_| ()) {
        Ok((imported, _)) => {
            assert_eq!(imported.len(), 1);
            tally.imported = 1;
            if !is_changed && table == source.table.as_bytes() {
                let rows = source.times.len() as u64;
                assert_eq!((imported[0].rows.0, imported[0].rows.1), (rows, rows));
                tally.compared = compare(&campaign.join("1"), &source);
            }
        }
        Err(error) => {
            assert!(!error.to_string().trim().is_empty());
            tally.refused = 1;
            let left = fs::read_dir(folder.path()).expect("the folder").count();
            assert_eq!(left, 2, "a failed import leaves files: {error}");
        }
    }
    tally
}

/// A source that is valid in most cases.
fn source(kind: u8, bytes: &mut Bytes) -> Source {
    let units = bytes.byte();
    let (field, to_gauss) = FIELDS[usize::from(units & 7)];
    let (time, to_seconds) = TIMES[usize::from(units >> 3 & 3)];
    let (force, to_newtons) = FORCES[usize::from(units >> 5 & 3)];
    // Two of 16 scales are refused.
    let choice = usize::from(bytes.byte() & 15);
    let scale = SCALES[if choice < SCALES.len() { choice } else { choice % 4 }];
    let scale_value: f64 = scale.parse().expect("a number");
    let covariates: Vec<_> =
        COVARIATES.into_iter().enumerate().filter(|(at, _)| kind >> 4 >> at & 1 != 0).collect();

    let mut mapping = format!(
        "description = \"fuzzed\"\none_clock = {}\n[hall]\nclock = {{ from = \"t\", unit = \"{time}\" }}\ncolumns = [\n",
        kind & 4 != 0
    );
    for axis in ["x", "y", "z"] {
        mapping += &format!(
            "  {{ from = \"b{axis}\", unit = \"{field}\", to = \"s0_{axis}_gauss\", scale = {scale} }},\n"
        );
    }
    for (number, (to, unit)) in &covariates {
        mapping += &format!("  {{ from = \"c{number}\", unit = \"{unit}\", to = \"{to}\" }},\n");
    }
    mapping += &format!(
        "]\n[force]\nclock = {{ from = \"t\", unit = \"{time}\" }}\ncolumns = [{{ from = \"f\", unit = \"{force}\", to = \"f0_z_n\" }}]\n"
    );

    let mut table = "t,bx,by,bz,f".to_owned();
    for (number, _) in &covariates {
        table += &format!(",c{number}");
    }
    let (mut times, mut fields, mut forces) = (Vec::new(), Vec::new(), Vec::new());
    // In hundredths of a millisecond.
    let mut now = i64::from(bytes.word());
    let step = 100 + i64::from(bytes.byte());
    for _ in 0..4 + bytes.byte() % 24 {
        now += step + i64::from(bytes.byte() & 3);
        let number = |bytes: &mut Bytes| f64::from(bytes.word() as i16) / 64.0;
        let row = [(); 3].map(|()| number(bytes));
        let newtons = number(bytes);
        let t = now as f64 * 1e-5 / to_seconds;
        table += &format!("\n{t},{},{},{},{newtons}", row[0], row[1], row[2]);
        for _ in &covariates {
            table += &format!(",{}", number(bytes));
        }
        times.push(t * to_seconds);
        fields.push(row.map(|axis| axis * to_gauss * scale_value));
        forces.push(newtons * to_newtons);
    }
    table.push('\n');
    Source { mapping, table, times, fields, forces }
}

/// Compares a recording with its source; returns the number of values.
fn compare(folder: &Path, source: &Source) -> u32 {
    let recording = Recording::read(folder, Alignment { delay_us: 0.0 }).expect("it was imported");
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-7 * (a.abs() + b.abs()) + 1e-300;
    let mut compared = 0;
    let sensor = &recording.sensors[&0];
    let forces = &recording.forces[&(0, Axis::Z)].newtons;
    for (row, time_s) in recording.time_s.iter().enumerate() {
        // Time stamps are integers of a microsecond from the first row on.
        let at = source.times.iter().position(|t| (t - source.times[0] - time_s).abs() < 1.5e-6);
        let at = at.unwrap_or_else(|| panic!("no row at {time_s} s"));
        assert!(near(forces[row], source.forces[at]), "{} {}", forces[row], source.forces[at]);
        // Fields of the board are averaged over the window of a reference row: at least within its neighbours.
        let around = &source.fields[at.saturating_sub(1)..source.fields.len().min(at + 2)];
        for axis in 0..3 {
            let values = around.iter().map(|field| field[axis]);
            let (min, max) =
                (values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max));
            let slack = 1e-7 * (min.abs() + max.abs());
            let value = sensor.field_g[row][axis];
            assert!((min - slack..=max + slack).contains(&value), "{value} outside {min} to {max}");
            compared += 1;
        }
        compared += 1;
    }
    compared
}
