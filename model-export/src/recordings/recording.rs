//! One recording in memory: validated, aligned to the reference clock, stored by column.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use sha2::{Digest, Sha256};

use crate::input::{self, check_recording_values};
use crate::recordings::align::Alignment;
use crate::recordings::columns::{
    Axis, ChannelLayout, ForceColumn, HallColumn, SignalUnit, force_column,
};
use crate::recordings::description::RecordingDescription;
use crate::recordings::error::{DataError, ErrorKind, Location, Notice};
use crate::recordings::noise_model::{NoiseEstimate, RowOrder};
use crate::recordings::repeated_settings;
use crate::recordings::stream::{AlignedRow, AlignedStream, StreamSummary};

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
    sha256: OnceLock<String>,
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

/// Half an averaging window in seconds from which the load may move within it.
const SLOW_S: f64 = 0.0125;
/// Width of the narrow window relative to the period of the reference.
const NARROW: f64 = 1.0 / 3.0;
/// Board rows in the wide window, at least, so that the narrow one averages as well.
const DENSE_ROWS: f64 = 20.0;
/// Noise with the narrow window relative to that with the wide one, up to which it is better.
const CLEARLY_LESS: f64 = 0.95;

/// Bend of a window in standard errors from which its mean is not the value at its centre.
const SIGNIFICANT_BEND: f64 = 5.0;
/// Share of the rows with a bend, up to which they are left out. Of more, the load moves so everywhere.
const MAX_BENT: f64 = 0.2;

/// Bend of the field within the window of a row ([`WindowMotion`]), each axis.
///
/// [`WindowMotion`]: crate::recordings::align::WindowMotion
#[derive(Clone, Copy, Debug)]
struct Bend {
    /// In multiples of the standard deviation of white noise of 1 G.
    of_unit_noise: [f64; 3],
    /// Scatter of the samples in gauss.
    scatter_g: [f64; 3],
}

impl Bend {
    fn of(layout: &ChannelLayout, sensor: u32, row: &AlignedRow) -> Option<Self> {
        let (motion, channels) = (row.motion.as_ref()?, layout.field_channels(sensor)?);
        Some(Self {
            of_unit_noise: channels.map(|channel| motion.bends[channel] / motion.bend_gain),
            scatter_g: channels.map(|channel| motion.scatters[channel]),
        })
    }

    /// Rows with a significant bend: relative to the usual scatter, which knocks do not raise.
    fn significant(rows: &[Option<Self>]) -> Vec<usize> {
        let noise_g = [0, 1, 2].map(|axis| {
            let scatters = rows.iter().flatten().map(|bend| bend.scatter_g[axis]);
            let mut scatters: Vec<f64> = scatters.filter(|scatter| scatter.is_finite()).collect();
            scatters.sort_by(f64::total_cmp);
            scatters.get(scatters.len() / 2).copied().unwrap_or(0.0)
        });
        let is_bent = |bend: &Self| {
            let mut axes = bend.of_unit_noise.iter().zip(noise_g);
            axes.any(|(bend, noise_g)| noise_g > 0.0 && bend.abs() > SIGNIFICANT_BEND * noise_g)
        };
        let rows = rows.iter().enumerate();
        rows.filter_map(|(row, bend)| bend.as_ref().filter(|bend| is_bent(bend)).map(|_| row))
            .collect()
    }
}

/// A recording averaged over windows of two widths: the rows of a slow reference may be means over its period or samples of a moment.
pub struct RecordingWindows {
    /// Over the period of the reference.
    pub wide: Recording,
    /// Over a part of it; `None` for a fast reference.
    pub narrow: Option<Recording>,
}

impl RecordingWindows {
    /// Reads the recording in `folder`.
    ///
    /// # Errors
    /// It is no recording, or damaged.
    pub fn read(folder: &Path, alignment: Alignment) -> Result<Self, DataError> {
        let wide = Recording::read_averaged(folder, alignment, 1.0)?;
        let is_slow = wide.half_width_s >= SLOW_S && wide.noise_gain.powi(-2) >= DENSE_ROWS;
        let narrow = is_slow.then(|| Recording::read_averaged(folder, alignment, NARROW));
        Ok(Self { wide, narrow: narrow.transpose()? })
    }

    /// With its known SHA-256.
    pub fn with_sha256(self, sha256: &str) -> Self {
        Self {
            wide: self.wide.with_sha256(sha256),
            narrow: self.narrow.map(|narrow| narrow.with_sha256(sha256)),
        }
    }

    /// The recording with that window which leaves less of the field, without the others of its campaign.
    pub fn alone(self) -> Recording {
        Self::better(vec![self]).remove(0)
    }

    /// The recordings of a campaign with that window which leaves less of the field: one reference has one kind of rows. Their noise is
    /// estimated together.
    pub(super) fn better(all: Vec<Self>) -> Vec<Recording> {
        let count = all.len();
        let (mut wide, narrow): (Vec<Recording>, Vec<Option<Recording>>) =
            all.into_iter().map(|one| (one.wide, one.narrow)).unzip();
        let mut narrow: Vec<Recording> = narrow.into_iter().flatten().collect();
        NoiseEstimate::estimate_together(&mut wide);
        NoiseEstimate::estimate_together(&mut narrow);
        let left_g2 =
            |all: &[Recording]| all.iter().map(|one| one.noise.smooth_g.powi(2)).sum::<f64>();
        let is_better =
            narrow.len() == count && left_g2(&narrow) < CLEARLY_LESS.powi(2) * left_g2(&wide);
        if is_better { narrow } else { wide }
    }
}

impl Recording {
    /// Reads the recording in `folder`, with the better one of its windows.
    ///
    /// # Errors
    /// It is no recording, or damaged.
    pub fn read(folder: &Path, alignment: Alignment) -> Result<Self, DataError> {
        Ok(RecordingWindows::read(folder, alignment)?.alone())
    }

    /// Reads it with the window of the aligned field scaled by `width`.
    fn read_averaged(folder: &Path, alignment: Alignment, width: f64) -> Result<Self, DataError> {
        let (description, notices) = RecordingDescription::read(folder)?;
        let mut stream = AlignedStream::open(folder, &description, alignment, width)?;
        let mut recording = Self {
            name: recording_name(folder),
            folder: folder.to_path_buf(),
            description,
            time_s: Vec::new(),
            sensors: BTreeMap::new(),
            forces: BTreeMap::new(),
            covariates: BTreeMap::new(),
            half_width_s: stream.half_width_s(),
            noise_gain: 0.0,
            rows_read: (0, 0),
            notices,
            noise: NoiseEstimate::default(),
            sha256: OnceLock::new(),
        };
        let layout = stream.layout().clone();
        let mut squares = 0.0;
        let mut bends: BTreeMap<u32, Vec<Option<Bend>>> = BTreeMap::new();
        while let Some(row) = stream.next_row()? {
            let values = 1 + row.hall.len() + row.forces.len();
            check_recording_values(recording.time_s.len(), values)
                .map_err(|kind| kind.at(Location::file(folder)))?;
            squares += row.noise_gain * row.noise_gain;
            recording.push(&layout, &row);
            for sensor in layout.sensors() {
                bends.entry(sensor).or_default().push(Bend::of(&layout, sensor, &row));
            }
        }
        recording.noise_gain = (squares / recording.time_s.len() as f64).sqrt();
        recording.finish(&layout, stream.summary());
        recording.leave_out_bent(&bends);
        let repeats = repeated_settings::within(&mut recording);
        recording.noise = repeats.unwrap_or_else(|| NoiseEstimate::of(&mut recording));
        recording.noise.unit =
            recording.sensors.values().next().map_or(SignalUnit::Gauss, |sensor| sensor.unit);
        Ok(recording)
    }

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

    fn push(&mut self, layout: &ChannelLayout, row: &AlignedRow) {
        self.time_s.push(row.time_s);
        for sensor in layout.sensors() {
            if let Some(channels) = layout.field_channels(sensor) {
                let field = channels.map(|channel| row.hall[channel]);
                self.sensors.entry(sensor).or_default().field_g.push(field);
            }
        }
        for (column, &value) in layout.hall.iter().zip(&row.hall) {
            match column {
                HallColumn::Temperature { sensor } => {
                    self.sensors.entry(*sensor).or_default().temperature_c.push(value);
                }
                HallColumn::Covariate { name } => {
                    self.covariates.entry(name.clone()).or_default().push(value);
                }
                HallColumn::Time | HallColumn::Field { .. } => {}
            }
        }
        for (column, &value) in layout.forces.iter().zip(&row.forces) {
            if let ForceColumn::Force { sensor, axis } = column {
                self.forces.entry((*sensor, *axis)).or_default().newtons.push(value);
            }
        }
    }

    /// Leaves out the rows in whose window the field moves in a curve.
    fn leave_out_bent(&mut self, bends: &BTreeMap<u32, Vec<Option<Bend>>>) {
        let mut most = 0;
        for (number, sensor) in &mut self.sensors {
            let rows = bends.get(number).map_or(&[][..], Vec::as_slice);
            let bent = Bend::significant(rows);
            if bent.len() as f64 > MAX_BENT * rows.len() as f64 {
                continue;
            }
            most = most.max(bent.len());
            for row in bent {
                sensor.field_g[row] = [f64::NAN; 3];
            }
        }
        if most > 0 {
            self.notices.push(Notice {
                location: Location::file(&self.folder),
                message: format!(
                    "up to {most} of {} rows of a sensor are left out: in the {:.0} ms around them its signal jumps or turns, so that its mean is not the value at the reference's instant",
                    self.time_s.len(),
                    2e3 * self.half_width_s
                ),
            });
        }
    }

    fn finish(&mut self, layout: &ChannelLayout, summary: StreamSummary) {
        for (&id, sensor) in &mut self.sensors {
            if let Some(channels) = layout.field_channels(id) {
                sensor.noise_g = channels.map(|c| summary.hall_noise[c].unwrap_or(f64::NAN));
                sensor.unit = layout.hall[channels[0]].signal_unit();
            }
        }
        // A sensor with a temperature and no field is not usable.
        self.sensors.retain(|_, sensor| !sensor.field_g.is_empty());
        for (column, noise) in layout.forces.iter().zip(&summary.force_noise) {
            if let ForceColumn::Force { sensor, axis } = column
                && let Some(force) = self.forces.get_mut(&(*sensor, *axis))
            {
                force.noise_n = noise.unwrap_or(f64::NAN);
            }
        }
        // An empty column was not measured.
        self.forces.retain(|_, force| force.newtons.iter().any(|n| n.is_finite()));
        self.rows_read = (summary.hall_rows, summary.force_rows);
        self.notices.extend(summary.notices);
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
