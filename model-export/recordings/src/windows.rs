//! Reading of a recording: validated, averaged over windows of two widths, of which the better one is taken.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use crate::align::Alignment;
use crate::columns::{ChannelLayout, ForceColumn, HallColumn, SignalUnit};
use crate::description::RecordingDescription;
use crate::error::{DataError, Location, Notice};
use crate::input::check_recording_values;
use crate::noise_estimate::NoiseEstimate;
use crate::recording::{Recording, recording_name};
use crate::repeated_settings;
use crate::stream::{AlignedRow, AlignedStream, StreamSummary};

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
/// [`WindowMotion`]: crate::align::WindowMotion
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
