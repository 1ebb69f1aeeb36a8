//! Cross-validation: splits of a campaign, held-out error and noise floor. Folds are whole recordings (at most ten groups), or
//! sixths of each recording where there is only one or an effect is transient.

use crate::fit::rows::{RecordingRows, SensorRows};
use crate::recordings::columns::Axis;
use crate::recordings::dependence::BlockFolds;
use nalgebra::Vector3;
use std::ops::Range;

/// Number of folds within a recording.
const FOLDS: usize = 6;

/// Maximum number of folds of whole recordings.
pub const MAX_RECORDING_FOLDS: usize = 10;

/// Step and minimum of the length of a block of [`CvSplit::Interleaved`] in seconds.
const BLOCK_STEP_S: f64 = 0.25;

/// Gap on both sides of a block of [`CvSplit::Blocks`] in blocks: one correlation time.
const GAP: f64 = 1.0 / 3.0;

/// A range of rows of one recording.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RowRange {
    /// Index of the recording in the campaign.
    pub part: usize,
    /// Row range.
    pub rows: Range<usize>,
}

/// Training and test rows of one fold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fold {
    /// Rows that are fitted.
    pub training: Vec<RowRange>,
    /// Rows that are held out.
    pub test: Vec<RowRange>,
}

/// Cross-validation scheme of a campaign, the same for all sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CvSplit {
    /// Leave one recording out, of this many; where there are more than ten, a tenth of them in their order.
    Recordings(usize),
    /// Leave a contiguous sixth of every recording out.
    KFold,
    /// Leave every sixth block of this many milliseconds out, so that every fold sees a part of a transient.
    Interleaved {
        /// Length of a block: at least three correlation times of the residual, so that the rows of a block are nearly independent
        /// of those that are fitted.
        block_ms: u32,
    },
    /// The same where recordings are not independent: a block is held out of all of them at the same time, and a third of a block on
    /// both sides of it is fitted in none.
    Blocks {
        /// Length of a block.
        block_ms: u32,
        /// Whether the time is that of the campaign's clock, not that since the start of each recording.
        by_clock: bool,
    },
}

impl CvSplit {
    /// By recordings where there are several independent ones.
    pub fn of(sensors: &[SensorRows]) -> Self {
        if let Some(blocks) = sensors.iter().find_map(|rows| rows.blocks) {
            return Self::within(sensors, blocks.correlation_s);
        }
        let recordings = sensors.iter().map(SensorRows::filled_parts).max().unwrap_or(0);
        if recordings < 2 {
            return Self::KFold;
        }
        Self::Recordings(sensors.first().map_or(0, |rows| rows.parts.len()))
    }

    /// Within recordings, for a residual with this correlation time in seconds. Blocks are at most a sixth of the longest recording.
    pub fn within(sensors: &[SensorRows], correlation_s: f64) -> Self {
        let parts = sensors.iter().flat_map(|rows| &rows.parts);
        let spans = parts.filter_map(|part| Some(part.time_s.last()? - part.time_s.first()?));
        let longest_s = spans.fold(0.0, f64::max) / FOLDS as f64;
        // The casts saturate.
        if let Some(BlockFolds { by_clock, .. }) = sensors.iter().find_map(|rows| rows.blocks) {
            let block_s = (3.0 * correlation_s).min(longest_s).max(1e-3);
            return Self::Blocks { block_ms: (1e3 * block_s).ceil() as u32, by_clock };
        }
        let steps = (3.0 * correlation_s / BLOCK_STEP_S).ceil();
        let block_s = BLOCK_STEP_S * steps.min((longest_s / BLOCK_STEP_S).floor()).max(1.0);
        Self::Interleaved { block_ms: (1e3 * block_s).round() as u32 }
    }

    /// Folds that hold out every row once. With [`CvSplit::KFold`], `gap_s` seconds on both sides of the test
    /// rows are excluded from training because of autocorrelation.
    pub fn folds(self, rows: &SensorRows, gap_s: f64) -> Vec<Fold> {
        match self {
            Self::Recordings(count) => (0..count.min(MAX_RECORDING_FOLDS))
                .map(|fold| self.recording_fold(rows, fold))
                .collect(),
            Self::KFold => (0..FOLDS).map(|cut| k_fold(rows, cut, gap_s)).collect(),
            Self::Interleaved { block_ms } => {
                let block_s = 1e-3 * f64::from(block_ms);
                (0..FOLDS).map(|fold| interleaved_fold(rows, fold, block_s)).collect()
            }
            Self::Blocks { block_ms, by_clock } => {
                let block_s = 1e-3 * f64::from(block_ms);
                (0..FOLDS).map(|fold| common_fold(rows, fold, block_s, by_clock)).collect()
            }
        }
    }

    /// Fold in which this recording is held out; `None` where folds are parts of recordings.
    pub fn fold_of(self, part: usize) -> Option<usize> {
        match self {
            Self::Recordings(count) => Some(part * count.min(MAX_RECORDING_FOLDS) / count.max(1)),
            Self::KFold | Self::Interleaved { .. } | Self::Blocks { .. } => None,
        }
    }

    fn recording_fold(self, rows: &SensorRows, fold: usize) -> Fold {
        let (test, training) =
            whole(rows).partition(|range| self.fold_of(range.part) == Some(fold));
        Fold { training, test }
    }
}

/// All rows.
pub fn all_rows(rows: &SensorRows) -> Vec<RowRange> {
    whole(rows).collect()
}

fn whole(rows: &SensorRows) -> impl Iterator<Item = RowRange> {
    let range = |(part, rows): (usize, &RecordingRows)| RowRange { part, rows: 0..rows.len() };
    rows.parts.iter().enumerate().map(range)
}

fn k_fold(rows: &SensorRows, cut: usize, gap_s: f64) -> Fold {
    let (mut training, mut test) = (Vec::new(), Vec::new());
    for (i, part) in rows.parts.iter().enumerate() {
        let (Some(first), Some(last)) = (part.time_s.first(), part.time_s.last()) else {
            continue;
        };
        let step = (last - first) / FOLDS as f64;
        let before = |time: f64| part.time_s.partition_point(|t| *t < time);
        let from = first + step * cut as f64;
        let to = if cut + 1 == FOLDS { f64::INFINITY } else { from + step };
        for rows in [0..before(from - gap_s), before(to + gap_s)..part.len()] {
            if !rows.is_empty() {
                training.push(RowRange { part: i, rows });
            }
        }
        test.push(RowRange { part: i, rows: before(from)..before(to) });
    }
    Fold { training, test }
}

fn interleaved_fold(rows: &SensorRows, fold: usize, block_s: f64) -> Fold {
    let slices = rows.parts.iter().enumerate().flat_map(|(part, of)| {
        let ranges = time_slices(&of.time_s, block_s).into_iter().enumerate();
        ranges.map(move |(i, rows)| (i % FOLDS == fold, RowRange { part, rows }))
    });
    let (test, training): (Vec<_>, Vec<_>) = slices.partition(|(test_part, _)| *test_part);
    let plain = |list: Vec<(bool, RowRange)>| list.into_iter().map(|(_, range)| range).collect();
    Fold { training: plain(training), test: plain(test) }
}

/// Blocks at the same times in all recordings.
fn common_fold(rows: &SensorRows, fold: usize, block_s: f64, by_clock: bool) -> Fold {
    let (mut training, mut test) = (Vec::new(), Vec::new());
    for (place, part) in rows.parts.iter().enumerate() {
        let start_s = if by_clock { part.track.start_s } else { 0.0 };
        let first_s = part.time_s.first().copied().unwrap_or(0.0);
        // Whether a row is held out (1), near such rows (2), or fitted (0).
        let kind = |time_s: f64| {
            let block = (time_s - first_s + start_s) / block_s;
            let is_tested = |block: f64| block.floor().rem_euclid(FOLDS as f64) as usize == fold;
            let near = [block - GAP, block + GAP];
            if is_tested(block) { 1 } else { 2 * usize::from(near.into_iter().any(is_tested)) }
        };
        let kinds: Vec<usize> = part.time_s.iter().map(|time_s| kind(*time_s)).collect();
        let mut from = 0;
        for run in kinds.chunk_by(|a, b| a == b) {
            let range = RowRange { part: place, rows: from..from + run.len() };
            from += run.len();
            match run[0] {
                0 => training.push(range),
                1 => test.push(range),
                _ => {}
            }
        }
    }
    Fold { training, test }
}

/// Row ranges of about `length_s` seconds each.
pub(crate) fn time_slices(time_s: &[f64], length_s: f64) -> Vec<Range<usize>> {
    let (Some(first), Some(last)) = (time_s.first(), time_s.last()) else {
        return Vec::new();
    };
    let count = ((last - first) / length_s).round().max(1.0);
    let step = (last - first) / count;
    let edges: Vec<usize> = (0..count as usize)
        .map(|i| time_s.partition_point(|t| *t < first + step * i as f64))
        .chain([time_s.len()])
        .collect();
    edges.windows(2).map(|pair| pair[0]..pair[1]).filter(|range| !range.is_empty()).collect()
}

/// Held-out error and noise floor of one field axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisScore {
    /// Number of the sensor.
    pub sensor: u32,
    /// Axis of its field.
    pub axis: Axis,
    /// Root mean square of measured minus modelled field, in gauss.
    pub held_out_rms_g: f64,
    /// The same on the rows that were fitted.
    pub fitted_rms_g: f64,
    /// Expected error of a perfect model: white noise of the averaged sensor and the reference's noise through
    /// dB/dF, added in squares.
    pub floor_g: f64,
    /// Peak-to-peak field in the campaign, in gauss.
    pub span_g: f64,
}

/// Sums of squared errors and noise variances over rows, each with the weight of its noise ([`RecordingRows::weight`]).
#[derive(Clone, Copy, Debug)]
pub struct ErrorSums {
    rows: usize,
    /// Sum of the weights of the rows.
    weight: f64,
    error: Vector3<f64>,
    floor: Vector3<f64>,
    /// Sum of squared off-plane residuals, and their number.
    off_plane: (f64, usize),
}

impl Default for ErrorSums {
    fn default() -> Self {
        Self {
            rows: 0,
            weight: 0.0,
            error: Vector3::zeros(),
            floor: Vector3::zeros(),
            off_plane: (0.0, 0),
        }
    }
}

impl ErrorSums {
    /// Adds one row: its residual in gauss, and dB/dF for each force in G/N.
    pub fn add(
        &mut self,
        (part, row): (&RecordingRows, usize),
        residual: Vector3<f64>,
        per_newton: impl IntoIterator<Item = Vector3<f64>>,
    ) {
        let per_newton: Vec<Vector3<f64>> = per_newton.into_iter().collect();
        let floor = noise_variance(part, Some(row), per_newton.iter().copied());
        let weight = part.weight(row);
        self.rows += 1;
        self.weight += weight;
        self.error += residual.component_mul(&residual) * weight;
        self.floor += floor * weight;
        if let Some((_, off_plane)) = off_plane_residual(&per_newton, residual) {
            self.off_plane.0 += off_plane * off_plane;
            self.off_plane.1 += 1;
        }
    }

    /// Sums of both.
    pub fn with(self, other: &Self) -> Self {
        Self {
            rows: self.rows + other.rows,
            weight: self.weight + other.weight,
            error: self.error + other.error,
            floor: self.floor + other.floor,
            off_plane: (self.off_plane.0 + other.off_plane.0, self.off_plane.1 + other.off_plane.1),
        }
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    fn all(&self) -> f64 {
        if self.weight > 0.0 { self.weight } else { 1.0 }
    }

    /// Noise floor, root mean square over rows and axes, in gauss.
    pub fn floor_g(&self) -> f64 {
        (self.floor.sum() / (3.0 * self.all())).sqrt()
    }

    /// Root mean square in gauss of the residual normal to the plane of both forces' fields, which no force
    /// explains; `None` where two forces were not recorded.
    pub fn parity_residual_g(&self) -> Option<f64> {
        let (squares, count) = self.off_plane;
        (count > 0).then(|| (squares / count as f64).sqrt())
    }

    /// Mean squared error over all axes, in gauss squared.
    pub fn mean_square(&self) -> f64 {
        self.error.sum() / (3.0 * self.all())
    }

    /// One score for each axis; `training` are the sums over the training rows.
    pub fn scores(&self, training: &Self, sensor: u32, span_g: Vector3<f64>) -> Vec<AxisScore> {
        let rows = self.all();
        let axes = Axis::ALL.into_iter().enumerate();
        axes.map(|(i, axis)| AxisScore {
            sensor,
            axis,
            fitted_rms_g: (training.error[i] / training.all()).sqrt(),
            held_out_rms_g: (self.error[i] / rows).sqrt(),
            floor_g: (self.floor[i] / rows).sqrt(),
            span_g: span_g[i],
        })
        .collect()
    }
}

/// Noise variance of one row (`None`: of a row at rest), each axis, in gauss squared. Unknown noise (a recording of a few rows)
/// counts as zero: the floor is then too low, never too high.
pub fn noise_variance(
    part: &RecordingRows,
    row: Option<usize>,
    per_newton: impl IntoIterator<Item = Vector3<f64>>,
) -> Vector3<f64> {
    let known = |noise: f64| if noise.is_finite() { noise } else { 0.0 };
    let sensor = part.field_noise_g.map(|noise| known(noise).powi(2));
    let through = |(slope, noise): (Vector3<f64>, &f64)| (slope * known(*noise)).map(|x| x * x);
    let slopes: Vec<Vector3<f64>> = per_newton.into_iter().collect();
    let forces = slopes.iter().copied().zip(&part.force_noise_n).map(through);
    let white = forces.fold(sensor, |sum, term| sum + term);
    // The forces of a row have one time stamp.
    let jitter_n = row.and_then(|row| part.jitter_n.get(row)).map_or(&[][..], Vec::as_slice);
    let jitter_g: Vector3<f64> = slopes.iter().zip(jitter_n).map(|(slope, n)| slope * *n).sum();
    white + jitter_g.component_mul(&jitter_g)
}

/// Axis with the largest component of the normal of the plane of both forces' fields, and the distance of a
/// residual from that plane along it. `None` where the forces move the field along one line.
pub(crate) fn off_plane_residual(
    per_newton: &[Vector3<f64>],
    residual: Vector3<f64>,
) -> Option<(usize, f64)> {
    let [gx, gz] = per_newton else {
        return None;
    };
    let across = gx.cross(gz);
    let axis = across.iamax();
    (across[axis] != 0.0).then(|| (axis, across.dot(&residual) / across[axis]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::ExcitationSeries;

    /// A sensor with recordings of these durations in seconds, at 100 Hz.
    fn rows(durations_s: &[usize]) -> SensorRows {
        let part = |seconds: &usize| {
            let time_s: Vec<f64> = (0..=100 * seconds).map(|row| 0.01 * row as f64).collect();
            RecordingRows {
                force_n: vec![Vec::new(); time_s.len()],
                field_g: vec![Vector3::zeros(); time_s.len()],
                field_noise_g: Vector3::zeros(),
                force_noise_n: Vec::new(),
                jitter_n: Vec::new(),
                precision: Vec::new(),
                track: ExcitationSeries { time_s: time_s.clone(), ..ExcitationSeries::default() },
                time_s,
            }
        };
        let parts = durations_s.iter().map(part).collect();
        SensorRows {
            sensor: 0,
            orientation: Default::default(),
            forces: Vec::new(),
            parts,
            stride: 1,
            blocks: None,
        }
    }

    #[test]
    fn blocks_are_three_correlation_times_and_at_most_a_sixth_of_a_recording() {
        let rows = [rows(&[30, 12])];
        for (correlation_s, block_ms) in
            [(0.0, 250), (0.01, 250), (0.1, 500), (1.0, 3000), (9.0, 5000)]
        {
            let split = CvSplit::within(&rows, correlation_s);
            assert_eq!(split, CvSplit::Interleaved { block_ms }, "{correlation_s}");
            let folds = split.folds(&rows[0], 0.0);
            let tested: usize =
                folds.iter().flat_map(|fold| &fold.test).map(|r| r.rows.len()).sum();
            assert_eq!((folds.len(), tested), (6, rows[0].len()));
        }
    }

    #[test]
    fn recordings_are_held_out_once_in_at_most_ten_folds_of_nearly_equal_size() {
        for count in [1, 3, 10, 11, 25, 100] {
            let folds: Vec<usize> =
                (0..count).filter_map(|part| CvSplit::Recordings(count).fold_of(part)).collect();
            assert_eq!(folds.len(), count);
            assert!(folds.is_sorted() && folds[0] == 0);
            assert_eq!(folds[count - 1] + 1, count.min(10));
            let sizes: Vec<usize> = folds.chunk_by(|a, b| a == b).map(<[usize]>::len).collect();
            assert_eq!(sizes.len(), count.min(10), "{count}");
            assert!(sizes.iter().all(|size| [count / 10, count.div_ceil(10)].contains(size)));
        }
    }
}
