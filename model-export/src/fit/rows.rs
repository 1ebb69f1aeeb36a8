//! Usable rows of one sensor with its reference forces and their noise.

use nalgebra::Vector3;

use crate::effects::ExcitationSeries;
use crate::effects::excitation::LoadCycleCounter;
use crate::fit::FitError;
use crate::physics::SensorOrientation;
use crate::recordings::columns::{Axis, force_column_name};
use crate::recordings::dependence::{BlockFolds, block_folds};
use crate::recordings::noise_estimate::RowOrder;
use crate::recordings::noise_model::jitter_n;
use crate::recordings::{Campaign, Location, Recording};

/// Minimum standard deviation of a force, in standard deviations of its noise.
const MIN_EXCITATION: f64 = 10.0;
/// Share of a field's variance that a force explains from which it moves, whatever its differences from row to row.
const MIN_FOLLOWED: f64 = 0.01;
/// F statistic of that line from which it is significant whatever the number of rows.
const MIN_F: f64 = 30.0;

/// The usable rows of one sensor: field finite on all axes, every force measured.
#[derive(Clone, Debug)]
pub struct SensorRows {
    /// Number of the sensor.
    pub sensor: u32,
    /// Orientation by which the fields were turned into the gripper's axes.
    pub orientation: SensorOrientation,
    /// Forces in the order of every row's `force_n`.
    pub forces: Vec<(u32, Axis)>,
    /// One part for each recording, in the campaign's order.
    pub parts: Vec<RecordingRows>,
    /// One in this many rows of the campaign is used: more than one where it has more than [`MAX_ROWS`].
    pub stride: usize,
    /// Folds of a campaign whose recordings are not independent.
    pub blocks: Option<BlockFolds>,
}

/// Mean and standard deviation of a force over all rows, and its noise, in newtons.
struct ForceSpread {
    mean_n: f64,
    sigma_n: f64,
    noise_n: f64,
}

/// Maximum number of rows of a campaign that are fitted: six minutes at 100 Hz. The parameters are then determined far better than
/// any model is right.
pub const MAX_ROWS: usize = 36_000;

/// Evenly spaced rows of a sample for each turning point of one axis, at least.
const ROWS_PER_TURN: usize = 3;
/// Maximum spacing in seconds of a sample of evenly spaced rows only.
const MAX_SPACING_S: f64 = 0.075;

/// Rows that the cylinder base needs: several for each of its 14 parameters.
const CYLINDER_ROWS: usize = 100;
/// Rows for each coefficient in the training part of each fold.
const ROWS_PER_COEFFICIENT: usize = 2;
/// Folds within a recording.
const FOLDS: usize = 6;

/// Rows that a base with this many coefficients needs: a fold trains on all but one part of them.
pub(crate) fn least_rows(coefficients: usize) -> usize {
    (ROWS_PER_COEFFICIENT * coefficients * FOLDS).div_ceil(FOLDS - 1).max(FOLDS)
}

/// The rows of one recording.
#[derive(Clone, Debug)]
pub struct RecordingRows {
    /// The reference's clock in seconds.
    pub time_s: Vec<f64>,
    /// Newtons, in the order of [`SensorRows::forces`].
    pub force_n: Vec<Vec<f64>>,
    /// Gauss.
    pub field_g: Vec<Vector3<f64>>,
    /// White noise of one averaged row in gauss, each axis.
    pub field_noise_g: Vector3<f64>,
    /// White noise of one reference row in newtons, each force.
    pub force_noise_n: Vec<f64>,
    /// Error of each force in newtons by the jitter of the reference's clock, one standard deviation, by row; empty without jitter.
    pub jitter_n: Vec<Vec<f64>>,
    /// Variance of the noise without the jitter relative to all of it, by row: the weight of its square; empty without jitter.
    pub precision: Vec<f64>,
    /// Covariates of the same rows.
    pub track: ExcitationSeries,
}

/// Checks that a recording has any forces; `record` without a reference writes their times only.
///
/// # Errors
/// It has none.
pub fn check_forces(recording: &Recording) -> Result<(), FitError> {
    if recording.forces.is_empty() {
        return Err(FitError::NoForces { place: Location::file(&recording.folder) });
    }
    Ok(())
}

impl SensorRows {
    /// Rows of `sensor` with the lateral and longitudinal force at its own place. One that no recording has, or that is zero
    /// throughout, is left out: it is assumed to be zero.
    ///
    /// # Errors
    /// None of the two was recorded, or one of them in some of the recordings only.
    pub fn with_own_forces(campaign: &Campaign, sensor: u32) -> Result<Self, FitError> {
        let own = own_forces(sensor);
        let is_recorded = |force: &&(u32, Axis)| {
            campaign.recordings.iter().any(|recording| recording.forces.contains_key(*force))
        };
        let recorded: Vec<(u32, Axis)> = own.iter().filter(is_recorded).copied().collect();
        let forces = if recorded.is_empty() { own.to_vec() } else { recorded };
        for recording in &campaign.recordings {
            check_forces(recording)?;
            if let Some((_, axis)) =
                forces.iter().find(|force| !recording.forces.contains_key(force))
            {
                return Err(FitError::NoForce {
                    place: Location::file(&recording.folder),
                    sensor,
                    axis: axis.letter(),
                });
            }
        }
        let rows = Self::collect(campaign, sensor, forces, CYLINDER_ROWS)?;
        rows.without_unloaded(campaign)
    }

    /// Rows of `sensor` with the recorded forces of its own place or, where there are none, with all forces
    /// (one reference for all sensors), or without any.
    pub fn with_recorded_forces(campaign: &Campaign, sensor: u32) -> Result<Self, FitError> {
        let everywhere = |force: &&(u32, Axis)| {
            campaign.recordings.iter().all(|r| r.forces.contains_key(*force))
        };
        let recorded: Vec<(u32, Axis)> =
            campaign.recordings.first().map_or_else(Vec::new, |first| {
                first.forces.keys().filter(everywhere).copied().collect()
            });
        for recording in &campaign.recordings {
            let own = recording.forces.keys().filter(|(place, _)| *place == sensor);
            if own.clone().any(|force| !recorded.contains(force)) {
                return Err(FitError::ForcesDiffer {
                    place: Location::file(&recording.folder),
                    sensor,
                });
            }
        }
        let own: Vec<_> = recorded.iter().filter(|(place, _)| *place == sensor).copied().collect();
        let forces = if own.is_empty() { recorded } else { own };
        let any = campaign.recordings.iter().any(|r| !r.forces.is_empty());
        if forces.is_empty() && any {
            return Err(FitError::NoForce {
                place: Location::file(&campaign.folder),
                sensor,
                axis: "x and z",
            });
        }
        let needed = least_rows(1 + forces.len());
        Self::collect(campaign, sensor, forces, needed)?.without_unloaded(campaign)
    }

    /// Without the forces that are zero within their noise, where another one moves.
    fn without_unloaded(self, campaign: &Campaign) -> Result<Self, FitError> {
        let is_loaded = |force: usize| {
            let ForceSpread { mean_n, sigma_n, noise_n } = self.spread(force);
            mean_n.abs().max(sigma_n) > MIN_EXCITATION * noise_n
        };
        let forces = (0..self.forces.len()).filter(|force| is_loaded(*force));
        let loaded: Vec<(u32, Axis)> = forces.map(|force| self.forces[force]).collect();
        if loaded.is_empty() || loaded.len() == self.forces.len() {
            return Ok(self);
        }
        let needed = least_rows(1 + loaded.len());
        Self::collect(campaign, self.sensor, loaded, needed)
    }

    fn spread(&self, force: usize) -> ForceSpread {
        let values =
            || self.parts.iter().flat_map(|part| part.force_n.iter().map(move |row| row[force]));
        let count = self.len() as f64;
        let mean_n = values().sum::<f64>() / count;
        let variance = values().map(|value| (value - mean_n).powi(2)).sum::<f64>() / count;
        let noise_n = self.parts.iter().map(|part| part.force_noise_n[force]).fold(0.0, f64::max);
        ForceSpread { mean_n, sigma_n: variance.sqrt(), noise_n }
    }

    fn collect(
        campaign: &Campaign,
        sensor: u32,
        forces: Vec<(u32, Axis)>,
        needed: usize,
    ) -> Result<Self, FitError> {
        let mut before_s = 0.0;
        let mut parts = Vec::new();
        let mut cycles = LoadCycleCounter::default();
        let stride = campaign.row_count().div_ceil(MAX_ROWS).max(1);
        for (i, recording) in campaign.recordings.iter().enumerate() {
            let mut part = RecordingRows::new(recording, (i, before_s), sensor, &forces);
            cycles.update(&mut part.track);
            parts.push(if stride > 1 { part.sampled(stride) } else { part });
            before_s += recording.span_s();
        }
        let rows: usize = parts.iter().map(RecordingRows::len).sum();
        let saturated = saturated_share(campaign, sensor);
        if rows < needed && saturated > 0.5 {
            return Err(FitError::Saturated {
                place: Location::file(&campaign.folder),
                sensor,
                share: 100.0 * saturated,
            });
        }
        if rows < needed {
            return Err(FitError::TooFewRows {
                place: Location::file(&campaign.folder),
                sensor,
                rows,
                needed,
            });
        }
        Ok(Self {
            sensor,
            orientation: SensorOrientation::default(),
            forces,
            parts,
            stride,
            blocks: block_folds(campaign),
        })
    }

    /// The rows of a sensor, which are in its own axes, in those of the gripper.
    pub fn turned(mut self, orientation: SensorOrientation) -> Self {
        self.orientation = orientation;
        self.parts = self.parts.into_iter().map(|part| part.turned(orientation)).collect();
        self
    }

    /// Axes that are copies of an earlier one: a sensor of one or two axes has its first in the place of each missing one.
    pub(crate) fn copied_axes(&self) -> [bool; 3] {
        let is_copy = |axis: usize, of: usize| {
            let mut fields = self.parts.iter().flat_map(|part| &part.field_g);
            fields.all(|field| field[axis] == field[of])
        };
        [false, is_copy(1, 0), is_copy(2, 0) || is_copy(2, 1)]
    }

    /// Rejects a constant field channel, and a force that varies little more than its noise.
    pub fn check_excitation(&self, campaign: &Campaign) -> Result<(), FitError> {
        let folder = Location::file(&campaign.folder);
        for (axis, span) in Axis::ALL.into_iter().zip(self.field_span().iter()) {
            if *span == 0.0 {
                let place = folder.clone().column(format!("s{}_{}", self.sensor, axis.letter()));
                return Err(FitError::Stuck { place, sensor: self.sensor });
            }
        }
        let has_noise = |recording: &Recording| {
            let noise = &recording.noise;
            noise.order == RowOrder::Time && !noise.differences_hold_motion
        };
        let is_ordered = campaign.recordings.iter().all(has_noise);
        for (i, force) in self.forces.iter().enumerate() {
            let ForceSpread { sigma_n, noise_n, .. } = self.spread(i);
            // Rows in random order, and rows as far apart as a load's motion, have no noise in their differences: there the field shows
            // whether the load moved. Of other rows it would also follow the noise of forces that were estimated from it.
            if sigma_n <= MIN_EXCITATION * noise_n && (is_ordered || !self.is_followed(i)) {
                let place = folder.clone().column(force_column_name(*force));
                return Err(FitError::ConstantForce { place });
            }
        }
        Ok(())
    }

    /// Whether a straight line in this force explains a significant share of the variance of a field axis.
    fn is_followed(&self, force: usize) -> bool {
        let rows = || {
            let parts = self.parts.iter();
            parts.flat_map(|part| part.force_n.iter().map(|row| row[force]).zip(&part.field_g))
        };
        let count = self.len() as f64;
        let mean_n = rows().map(|(newtons, _)| newtons).sum::<f64>() / count;
        let mean_g = rows().map(|(_, field)| field).sum::<Vector3<f64>>() / count;
        let (mut newtons_2, mut field_2, mut product) = (0.0, Vector3::zeros(), Vector3::zeros());
        for (newtons, field) in rows() {
            let (x, y) = (newtons - mean_n, field - mean_g);
            newtons_2 += x * x;
            field_2 += y.component_mul(&y);
            product += x * y;
        }
        let share = |axis: usize| product[axis] * product[axis] / (newtons_2 * field_2[axis]);
        (0..3)
            .map(share)
            .any(|share| share > MIN_FOLLOWED && share * (count - 2.0) > MIN_F * (1.0 - share))
    }

    /// The derivatives to the measured forces, in the order of [`SensorRows::forces`].
    pub fn slopes(&self, per_newton: &[Vector3<f64>; 2]) -> impl Iterator<Item = Vector3<f64>> {
        let slope = |axis| per_newton[usize::from(axis == Axis::Z)];
        self.forces.iter().map(move |(_, axis)| slope(*axis)).collect::<Vec<_>>().into_iter()
    }

    /// At most `count(place)` rows of each recording, evenly spaced, or all; `place` is the recording's index.
    pub fn at_most(&self, count: impl Fn(usize) -> usize) -> Self {
        let parts = self.parts.iter().enumerate();
        let parts = parts.map(|(place, part)| part.at_most(count(place)));
        Self { parts: parts.collect(), forces: self.forces.clone(), ..*self }
    }

    /// Number of recordings with rows.
    pub(crate) fn filled_parts(&self) -> usize {
        self.parts.iter().filter(|part| !part.is_empty()).count()
    }

    /// Rows in all parts.
    pub fn len(&self) -> usize {
        self.parts.iter().map(RecordingRows::len).sum()
    }

    /// True where no row is usable.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Minimum and maximum of each force.
    pub(crate) fn force_spans(&self) -> Vec<(f64, f64)> {
        let span = |force: usize| {
            self.parts
                .iter()
                .flat_map(|part| part.force_n.iter().map(move |row| row[force]))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                    (low.min(value), high.max(value))
                })
        };
        (0..self.forces.len()).map(span).collect()
    }

    /// Maximum reach of a slider that slips before the middle of the largest loop, in newtons: a quarter of the
    /// largest span.
    pub(crate) fn max_reach_n(&self) -> f64 {
        let spans = self.force_spans().into_iter().map(|(low, high)| high - low);
        0.25 * spans.fold(0.0, f64::max)
    }

    /// Peak-to-peak field of each axis in gauss.
    pub(crate) fn field_span(&self) -> Vector3<f64> {
        let fields = || self.parts.iter().flat_map(|part| &part.field_g);
        let high = fields().fold(Vector3::repeat(f64::NEG_INFINITY), |high, field| high.sup(field));
        let low = fields().fold(Vector3::repeat(f64::INFINITY), |low, field| low.inf(field));
        high - low
    }
}

/// Forces at a sensor's own place: lateral, longitudinal.
pub fn own_forces(sensor: u32) -> [(u32, Axis); 2] {
    [(sensor, Axis::X), (sensor, Axis::Z)]
}

/// Lateral and longitudinal force of a sensor by the place of its column; `None` for one that was not measured.
pub type ForcePair = [Option<(u32, Axis)>; 2];

/// The first lateral and the first longitudinal one of these forces.
pub fn pair(forces: &[(u32, Axis)]) -> ForcePair {
    [Axis::X, Axis::Z].map(|axis| forces.iter().copied().find(|(_, of)| *of == axis))
}

/// Fraction of rows in which an axis was saturated.
fn saturated_share(campaign: &Campaign, sensor: u32) -> f64 {
    let fields = || {
        campaign
            .recordings
            .iter()
            .filter_map(|r| r.sensors.get(&sensor))
            .flat_map(|track| &track.field_g)
    };
    let saturated = fields().filter(|field| field.iter().any(|axis| axis.is_nan())).count();
    saturated as f64 / fields().count().max(1) as f64
}

impl RecordingRows {
    /// Usable rows of `sensor` in one recording; `place` is the recording's index in the campaign and the time
    /// in seconds before it. Load cycles are zero. `None` where the sensor or a force is missing.
    pub fn of(
        recording: &Recording,
        place: (usize, f64),
        sensor: u32,
        forces: &[(u32, Axis)],
    ) -> Option<Self> {
        let has = forces.iter().all(|force| recording.forces.contains_key(force));
        let there = recording.sensors.contains_key(&sensor) && has;
        there.then(|| Self::new(recording, place, sensor, forces))
    }

    fn new(
        recording: &Recording,
        place: (usize, f64),
        sensor: u32,
        forces: &[(u32, Axis)],
    ) -> Self {
        let track = recording.sensors.get(&sensor).cloned().unwrap_or_default();
        let loads: Vec<_> = forces.iter().filter_map(|force| recording.forces.get(force)).collect();
        let load = |i: usize| loads.iter().map(move |load| load.newtons[i]);
        let usable: Vec<usize> = (0..track.field_g.len())
            .filter(|&i| {
                let mut values = track.field_g[i].into_iter().chain(load(i));
                values.all(f64::is_finite) && loads.len() == forces.len()
            })
            .collect();
        Self {
            time_s: usable.iter().map(|&i| recording.time_s[i]).collect(),
            force_n: usable.iter().map(|&i| load(i).collect()).collect(),
            field_g: usable.iter().map(|&i| Vector3::from(track.field_g[i])).collect(),
            field_noise_g: Vector3::from(track.noise_g) * recording.noise_gain,
            force_noise_n: loads.iter().map(|load| load.noise_n).collect(),
            jitter_n: jitter_n(recording, forces, &usable),
            precision: recording.noise.precision.get(&sensor).map_or_else(Vec::new, |of| {
                usable.iter().filter_map(|&row| of.get(row).copied()).collect()
            }),
            track: ExcitationSeries::new(recording, place, sensor, pair(forces), &usable),
        }
    }

    /// The rows of a sensor, which are in its own axes, in those of the gripper.
    pub fn turned(mut self, orientation: SensorOrientation) -> Self {
        if !orientation.is_nominal() {
            self.field_g.iter_mut().for_each(|field| *field = orientation.to_gripper(*field));
            let axes = orientation.sensor_axes().map(|(axis, _)| axis);
            self.field_noise_g = axes.map(|axis| self.field_noise_g[axis]).into();
        }
        self
    }

    /// At most `count` evenly spaced rows or all, and, where they are more than 75 ms apart, the turning points of the load.
    pub fn at_most(&self, count: usize) -> Self {
        if count == 0 { self.at(&[]) } else { self.sampled(self.len().div_ceil(count)) }
    }

    /// Every `stride`-th row and, where these are further apart than 75 ms, those at which the load turns: friction depends on its
    /// peaks.
    fn sampled(&self, stride: usize) -> Self {
        let duration_s = self.time_s.last().zip(self.time_s.first()).map_or(0.0, |(b, a)| b - a);
        if duration_s * stride as f64 <= MAX_SPACING_S * self.len() as f64 {
            return self.thinned(stride);
        }
        let mut rows: Vec<usize> = (0..self.len()).step_by(stride.max(1)).collect();
        let most = rows.len() / ROWS_PER_TURN;
        (0..2).for_each(|axis| rows.extend(self.track.turning_points(axis, most)));
        rows.sort_unstable();
        rows.dedup();
        self.at(&rows)
    }

    /// Every `stride`-th row.
    pub fn thinned(&self, stride: usize) -> Self {
        self.at(&(0..self.len()).step_by(stride.max(1)).collect::<Vec<_>>())
    }

    fn at(&self, rows: &[usize]) -> Self {
        Self {
            time_s: rows.iter().map(|&row| self.time_s[row]).collect(),
            force_n: rows.iter().map(|&row| self.force_n[row].clone()).collect(),
            field_g: rows.iter().map(|&row| self.field_g[row]).collect(),
            field_noise_g: self.field_noise_g,
            force_noise_n: self.force_noise_n.clone(),
            jitter_n: rows.iter().filter_map(|&row| self.jitter_n.get(row).cloned()).collect(),
            precision: rows.iter().filter_map(|&row| self.precision.get(row).copied()).collect(),
            track: self.track.at(rows),
        }
    }

    /// Weight of the squares of a row.
    pub fn weight(&self, row: usize) -> f64 {
        self.precision.get(row).copied().unwrap_or(1.0)
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }
}
