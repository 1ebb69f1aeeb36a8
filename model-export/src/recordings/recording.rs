//! One folder, checked, aligned to the reference's clock and held in memory column by column.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::align::Alignment;
use super::columns::{Axis, ForceColumn, HallColumn};
use super::description::Description;
use super::layout::Layout;
use super::problem::{Notice, Problem};
use super::stream::{AlignedRow, RecordingStream, Summary};

/// One uninterrupted run, on the reference's clock.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name of its folder.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Its `recording.toml`.
    pub description: Description,
    /// Times of the rows in seconds, on the reference's clock.
    pub time_s: Vec<f64>,
    /// The sensors, by number.
    pub sensors: BTreeMap<u32, SensorTrack>,
    /// The reference's forces, by place and axis.
    pub forces: BTreeMap<(u32, Axis), ForceTrack>,
    /// Covariates of the whole gripper, by column name; angles are continuous, not wrapped.
    pub covariates: BTreeMap<String, Vec<f64>>,
    /// Half the averaging window in seconds.
    pub half_width_s: f64,
    /// Factor by which the averaging multiplies the sensors' white noise, root mean square.
    pub noise_gain: f64,
    /// Rows read: of the board, of the reference.
    pub rows_read: (u64, u64),
    /// What a person should know.
    pub notices: Vec<Notice>,
}

/// What one sensor measured, averaged around each reference row.
#[derive(Clone, Debug, Default)]
pub struct SensorTrack {
    /// Field in gauss, axes x, y, z; NaN where a sample in the window was saturated.
    pub field_g: Vec<[f64; 3]>,
    /// The sensor's temperature in degrees Celsius, empty if it was not recorded.
    pub temperature_c: Vec<f64>,
    /// White noise of one raw row in gauss, each axis; NaN where it cannot be known.
    pub noise_g: [f64; 3],
}

/// What one axis of one reference sensor measured.
#[derive(Clone, Debug, Default)]
pub struct ForceTrack {
    /// Newtons; NaN where not measured.
    pub newtons: Vec<f64>,
    /// White noise of one row in newtons; NaN where it cannot be known.
    pub noise_n: f64,
}

impl Recording {
    /// Reads the recording in `folder`.
    pub fn read(folder: &Path, alignment: Alignment) -> Result<Self, Problem> {
        let (description, notices) = Description::read(folder)?;
        let mut stream = RecordingStream::open(folder, &description, alignment)?;
        let mut recording = Self {
            name: folder
                .file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
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
        };
        let layout = stream.layout().clone();
        let mut squares = 0.0;
        while let Some(row) = stream.next_row()? {
            squares += row.noise_gain * row.noise_gain;
            recording.push(&layout, &row);
        }
        recording.noise_gain = (squares / recording.time_s.len() as f64).sqrt();
        recording.close(&layout, stream.summary());
        Ok(recording)
    }

    /// Seconds between its first and its last row.
    pub fn span_s(&self) -> f64 {
        let ends = self.time_s.first().zip(self.time_s.last());
        ends.map_or(0.0, |(first, last)| last - first)
    }

    /// Its rows before `seconds` after its first alone.
    pub fn first(&self, seconds: f64) -> Self {
        let mut part = self.clone();
        let end = self.time_s.first().map_or(0.0, |first| first + seconds);
        let rows = self.time_s.partition_point(|time| *time < end);
        part.time_s.truncate(rows);
        for sensor in part.sensors.values_mut() {
            sensor.field_g.truncate(rows);
            sensor.temperature_c.truncate(rows);
        }
        for track in part.forces.values_mut() {
            track.newtons.truncate(rows);
        }
        for covariate in part.covariates.values_mut() {
            covariate.truncate(rows);
        }
        part
    }

    fn push(&mut self, layout: &Layout, row: &AlignedRow) {
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
                    self.sensors
                        .entry(*sensor)
                        .or_default()
                        .temperature_c
                        .push(value);
                }
                HallColumn::Covariate { name } => match self.covariates.get_mut(name) {
                    Some(values) => values.push(value),
                    None => drop(self.covariates.insert(name.clone(), vec![value])),
                },
                HallColumn::Time | HallColumn::Field { .. } => {}
            }
        }
        for (column, &value) in layout.forces.iter().zip(&row.forces) {
            if let ForceColumn::Force { place, axis } = column {
                self.forces
                    .entry((*place, *axis))
                    .or_default()
                    .newtons
                    .push(value);
            }
        }
    }

    fn close(&mut self, layout: &Layout, summary: Summary) {
        for (&id, sensor) in &mut self.sensors {
            if let Some(channels) = layout.field_channels(id) {
                sensor.noise_g = channels.map(|c| summary.hall_noise[c].unwrap_or(f64::NAN));
            }
        }
        // A temperature without a field says nothing about a force.
        self.sensors.retain(|_, sensor| !sensor.field_g.is_empty());
        for (column, noise) in layout.forces.iter().zip(&summary.force_noise) {
            if let ForceColumn::Force { place, axis } = column
                && let Some(track) = self.forces.get_mut(&(*place, *axis))
            {
                track.noise_n = noise.unwrap_or(f64::NAN);
            }
        }
        // A column that was left empty throughout was not measured.
        self.forces
            .retain(|_, track| track.newtons.iter().any(|n| n.is_finite()));
        self.rows_read = (summary.hall_rows, summary.force_rows);
        self.notices.extend(summary.notices);
    }
}
