//! One recording in memory: aligned to the reference clock, stored by column.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use sha2::{Digest, Sha256};

use crate::columns::{Axis, ForceColumn, SignalUnit, force_column};
use crate::description::RecordingDescription;
use crate::error::{DataError, ErrorKind, Location, Notice};
use crate::input;
use crate::noise_estimate::{NoiseEstimate, RowOrder};

/// One uninterrupted run on the reference clock.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name of the folder.
    pub name: String,
    /// Path of the folder.
    pub folder: PathBuf,
    /// Content of `recording.toml`.
    pub description: RecordingDescription,
    /// Times of the rows in seconds on the reference clock.
    pub time_s: Vec<f64>,
    /// Sensors by index.
    pub sensors: BTreeMap<u32, SensorSeries>,
    /// Reference forces by sensor index and axis.
    pub forces: BTreeMap<(u32, Axis), ForceSeries>,
    /// Covariates of the gripper by column name; angles are unwrapped.
    pub covariates: BTreeMap<String, Vec<f64>>,
    /// Half the averaging window in seconds.
    pub half_width_s: f64,
    /// Ratio of the white noise after averaging to that of a single board row, RMS over the rows.
    pub noise_gain: f64,
    /// Number of rows read: board, reference.
    pub rows_read: (u64, u64),
    /// Gaps, saturation, skipped rows, unknown keys.
    pub notices: Vec<Notice>,
    /// Estimators of the noise.
    pub noise: NoiseEstimate,
    pub(super) sha256: OnceLock<String>,
}

/// Measurements of one sensor, averaged around each reference row.
#[derive(Clone, Debug, Default)]
pub struct SensorSeries {
    /// Field in gauss (x, y, z); NaN where a sample in the window was saturated.
    pub field_g: Vec<[f64; 3]>,
    /// Temperature in degrees Celsius; empty if not recorded.
    pub temperature_c: Vec<f64>,
    /// White noise of one board row in gauss, each axis; NaN with too few rows.
    pub noise_g: [f64; 3],
    /// Unit of the signal, in place of gauss where the sensor is no magnetometer.
    pub unit: SignalUnit,
}

/// Measurements of one axis of one reference sensor.
#[derive(Clone, Debug, Default)]
pub struct ForceSeries {
    /// Force in newtons; NaN where not measured.
    pub newtons: Vec<f64>,
    /// White noise of one row in newtons; NaN with too few rows.
    pub noise_n: f64,
}

impl Recording {
    /// SHA-256 over the files of the recording, computed once.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn sha256(&self) -> Result<&str, DataError> {
        if let Some(sha256) = self.sha256.get() {
            return Ok(sha256);
        }
        let sha256 = fingerprint(&self.folder)?;
        Ok(self.sha256.get_or_init(|| sha256))
    }

    /// The recording with its known SHA-256.
    pub fn with_sha256(self, sha256: &str) -> Self {
        Self { sha256: OnceLock::from(sha256.to_owned()), ..self }
    }

    /// The recording's description and sensors without its rows.
    pub fn without_rows(&self) -> Self {
        Self {
            name: self.name.clone(),
            folder: self.folder.clone(),
            description: self.description.clone(),
            time_s: Vec::new(),
            sensors: self.sensors.keys().map(|number| (*number, Default::default())).collect(),
            forces: BTreeMap::new(),
            covariates: BTreeMap::new(),
            notices: Vec::new(),
            noise: self.noise.clone(),
            sha256: self.sha256.clone(),
            ..*self
        }
    }

    /// Whether the values of a covariate (`temp_c` for a temperature) were set anew for each row: they vary from row to row, as noise does,
    /// but the field follows them, or the order of the rows carries no time.
    pub fn is_set_by_row(&self, covariate: &str) -> bool {
        let has_order = self.noise.order == RowOrder::Time && !self.description.is_clock_assumed();
        let varies = |values: &[f64]| values.windows(2).any(|pair| pair[0] != pair[1]);
        let is_constant = || match self.covariates.get(covariate) {
            Some(values) => !varies(values),
            None => !self.sensors.values().any(|sensor| varies(&sensor.temperature_c)),
        };
        self.noise.follows(covariate) || (!has_order && !is_constant())
    }

    /// A force by its column name.
    pub fn force(&self, column: &str) -> Option<&ForceSeries> {
        match force_column(column) {
            Ok(ForceColumn::Force { sensor, axis }) => self.forces.get(&(sensor, axis)),
            _ => None,
        }
    }

    /// The forces, where they act on several sensors.
    pub fn forces_on_several(&self) -> impl Iterator<Item = (u32, Axis)> {
        let first = self.forces.keys().next().map(|(sensor, _)| *sensor);
        let are_several = self.forces.keys().any(|(sensor, _)| Some(*sensor) != first);
        self.forces.keys().copied().filter(move |_| are_several)
    }

    /// Time from the first to the last row in seconds.
    pub fn span_s(&self) -> f64 {
        let ends = self.time_s.first().zip(self.time_s.last());
        ends.map_or(0.0, |(first, last)| last - first)
    }

    /// The rows of the first `seconds` seconds.
    pub fn first(&self, seconds: f64) -> Self {
        let mut part = self.clone();
        let end = self.time_s.first().map_or(0.0, |first| first + seconds);
        let rows = self.time_s.partition_point(|time| *time < end);
        part.time_s.truncate(rows);
        for sensor in part.sensors.values_mut() {
            sensor.field_g.truncate(rows);
            sensor.temperature_c.truncate(rows);
        }
        for force in part.forces.values_mut() {
            force.newtons.truncate(rows);
        }
        for covariate in part.covariates.values_mut() {
            covariate.truncate(rows);
        }
        part
    }
}

/// Name of a recording: that of its folder.
pub fn recording_name(folder: &Path) -> String {
    let name = folder.file_name();
    name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// SHA-256 over the content of a recording's files in order of their names, hexadecimal.
pub fn fingerprint(folder: &Path) -> Result<String, DataError> {
    let mut hash = Sha256::new();
    let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(folder));
    let files: BTreeSet<PathBuf> = fs::read_dir(folder)
        .map_err(unreadable)?
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_file())
        .collect();
    for path in files {
        let mut file = input::open(&path)?;
        let mut chunk = [0; 1 << 16];
        loop {
            match file.read(&mut chunk).map_err(unreadable)? {
                0 => break,
                n => hash.update(&chunk[..n]),
            }
        }
    }
    Ok(hex(&hash.finalize()))
}

/// Lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
