//! Noise of a recording on its aligned rows, by several estimators: scatter about a smooth, differences of successive rows, and
//! differences of the residual of a smooth in the forces and covariates.
//!
//! Differences of the raw rows hold the motion of the load where rows are sparse (a reference at 10 Hz) or the load is rough. What a
//! polynomial in the forces and covariates explains is therefore removed before differences are taken (difference-based variance
//! estimation after a partial fit, Hall, Kay and Titterington 1990), and the variance of the differences is split into the noise of
//! the field, of the forces through dB/dF, and of the reference's clock through dB/dF dF/dt.

use nalgebra::{DMatrix, DVector, Vector3};

use crate::Recording;
use crate::columns::Axis;
use crate::noise_estimate::{NoiseEstimate, NoiseEstimator, RawNoise, RowOrder};
use crate::smooth_field::{MAX_TERMS, ROWS_PER_TERM, SmoothField};

impl RawNoise {
    fn of(recording: &Recording) -> Self {
        Self {
            field_g: recording.sensors.iter().map(|(key, sensor)| (*key, sensor.noise_g)).collect(),
            forces_n: recording.forces.iter().map(|(key, force)| (*key, force.noise_n)).collect(),
        }
    }

    fn restore(&self, recording: &mut Recording) {
        for (key, noise_g) in &self.field_g {
            recording.sensors.entry(*key).and_modify(|sensor| sensor.noise_g = *noise_g);
        }
        for (key, noise_n) in &self.forces_n {
            recording.forces.entry(*key).and_modify(|force| force.noise_n = *noise_n);
        }
    }
}

/// Ratio of two estimates within which they agree; below, several standard errors of a recording of ten seconds.
const AGREE: f64 = 1.07;
/// Standard errors by which two estimates differ that disagree.
const STANDARD_ERRORS: f64 = 3.0;
/// Ratio of the variance of successive differences to twice the variance (von Neumann 1941) from which a column has no order: 1 for
/// independent values, near zero for smooth ones.
const UNORDERED: f64 = 0.7;
/// Share of the field's variance that a smooth explains, from which the order of the settings is evaluated.
const FOLLOWS_SETTINGS: f64 = 0.3;
/// Squared differences above this multiple of their expectation are cut off: disturbances.
const CUT_OFF: f64 = 16.0;
/// Share of the variance, and standard errors, from which jitter of the clock is significant.
const MIN_JITTER: (f64, f64) = (0.05, 4.0);
/// Ratio of two estimates of the clock's variance up to which they are the same.
const SAME_CLOCK: f64 = 1.5;
/// Number of limits of the clock's variance, each by the variances that the one before left to the others.
const LIMITED: usize = 4;
/// Board rows in an averaging window from which the board's own differences hold no motion of the load.
const DENSE_ROWS: f64 = 5.0;
/// Minimum number of rows of the estimators by differences.
const MIN_ROWS: usize = 40;
/// Gain of the variance of third differences.
const GAIN: f64 = 20.0;
/// Degrees of freedom of the mean square of third differences for each row (see [`crate::noise`]).
const FREEDOM: f64 = 0.433;

/// Third difference over `step` rows at `row`, divided by its gain; `None` across a gap or at the end.
struct Differences<'a> {
    time_s: &'a [f64],
    step: usize,
    longest_s: f64,
}

impl<'a> Differences<'a> {
    fn new(time_s: &'a [f64], step: usize) -> Self {
        let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        let median_s = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        Self { time_s, step, longest_s: 3.0 * step as f64 * median_s * 1.5 }
    }

    fn rows(&self) -> impl Iterator<Item = usize> {
        let last = self.time_s.len().saturating_sub(3 * self.step);
        (0..last)
            .filter(|&row| self.time_s[row + 3 * self.step] - self.time_s[row] <= self.longest_s)
    }

    fn of(&self, values: impl Fn(usize) -> f64, row: usize) -> f64 {
        let at = |k: usize| values(row + k * self.step);
        (at(0) - 3.0 * at(1) + 3.0 * at(2) - at(3)) / GAIN.sqrt()
    }
}

/// Variances of a sensor: of the field by axis in gauss squared, of each force in newtons squared, of the clock in seconds squared.
#[derive(Clone, Debug)]
struct Variances {
    field: Vector3<f64>,
    forces: Vec<f64>,
    clock: f64,
}

/// Square of the third difference of a residual, and the mean squares of dB/dF over its four rows, in their weights.
struct SquaredDifference {
    /// First row.
    row: usize,
    /// Square by axis in gauss squared.
    square: Vector3<f64>,
    /// Square of dB/dF of each force.
    slopes2: Vec<Vector3<f64>>,
    /// Square of dB/dt.
    rate2: Vector3<f64>,
}

impl SquaredDifference {
    fn variance(&self, of: &Variances) -> Vector3<f64> {
        let forces =
            self.slopes2.iter().zip(&of.forces).map(|(slope2, variance)| slope2 * *variance);
        forces.fold(of.field + self.rate2 * of.clock, |sum, term| sum + term)
    }
}

/// Usable rows of one sensor, and a smooth through its field.
struct SensorNoise {
    sensor: u32,
    smooth: SmoothField,
    /// Rates of the forces in N/s, by force and row.
    rates: Vec<Vec<f64>>,
    /// By raw differences.
    plain: Variances,
    /// Whether the field's own differences hold motion as well.
    is_sparse: bool,
    /// By the differences of the residual.
    adjusted: Variances,
    /// Squares of the differences of the residual, and what they depend on.
    squares: Vec<SquaredDifference>,
    /// Standard error of the clock's variance.
    clock_error: f64,
}

impl SensorNoise {
    fn floor2(&self, of: &Variances) -> f64 {
        let rows = self.squares.iter().map(|one| one.variance(of).sum() / 3.0);
        rows.sum::<f64>() / self.squares.len().max(1) as f64
    }

    /// Change of the field with time at a row, in G/s.
    fn per_second(&self, row: usize) -> Vector3<f64> {
        let slopes = self.smooth.slopes[row].iter().zip(&self.rates);
        slopes.map(|(slope, rates)| slope * rates[row]).sum()
    }

    /// Variance of each row without the jitter of the clock, relative to all of it. What no smooth explains is part of it: where that
    /// is more than the jitter, rows count alike.
    fn precision(&self) -> Vec<f64> {
        let rows = 0..self.smooth.rows.len();
        let jitter: Vec<f64> =
            rows.map(|row| self.per_second(row).norm_squared() * self.adjusted.clock).collect();
        // In the slowest third of the rows, which has no knocks, without the jitter.
        let mut slow: Vec<usize> = (0..jitter.len()).collect();
        slow.sort_by(|a, b| jitter[*a].total_cmp(&jitter[*b]));
        slow.truncate(jitter.len().div_ceil(3));
        let of_row = |row: &usize| self.smooth.residual_g[*row].norm_squared() - jitter[*row];
        let mut left: Vec<f64> = slow.iter().map(of_row).collect();
        left.sort_by(f64::total_cmp);
        let left = left.get(left.len() / 2).copied().unwrap_or(0.0);
        let of_row = |(row, jitter): (usize, &f64)| {
            let slopes = self.smooth.slopes[row].iter().zip(&self.adjusted.forces);
            let forces = slopes.map(|(slope, variance)| slope.norm_squared() * variance);
            let white = left.max(self.adjusted.field.sum() + forces.sum::<f64>());
            white / (white + jitter)
        };
        jitter.iter().enumerate().map(of_row).collect()
    }

    /// Mean square of the residual's differences, without disturbances.
    fn observed2(&self) -> f64 {
        let cut = |one: &SquaredDifference| {
            let expected = one.variance(&self.adjusted).sum() / 3.0;
            (one.square.sum() / 3.0).min(CUT_OFF * expected.max(f64::MIN_POSITIVE))
        };
        self.squares.iter().map(cut).sum::<f64>() / self.squares.len().max(1) as f64
    }

    /// The clock's variance with which the variances of all rows add up to the squares: that of jitter, whose effect in the fastest rows
    /// is as large as the others say. The motion of a load that moves between the rows is bounded, and this then smaller.
    fn clock_by_sum(&self) -> f64 {
        let white = Variances { clock: 0.0, ..self.adjusted.clone() };
        let beyond = self.squares.iter().map(|one| (one.square - one.variance(&white)).sum());
        let rates2: f64 = self.squares.iter().map(|one| one.rate2.sum()).sum();
        (beyond.sum::<f64>() / rates2.max(f64::MIN_POSITIVE)).max(0.0)
    }

    /// Splits the squares into variances; with that of the clock, at most what all rows allow.
    fn split_with_clock(&mut self) {
        self.split(Some(f64::INFINITY));
        for _ in 0..LIMITED {
            let limit = self.clock_by_sum();
            if self.adjusted.clock <= SAME_CLOCK * limit {
                return;
            }
            self.split(Some(limit));
        }
    }

    /// Splits the squares into variances by non-negative least squares: each at most that of the raw differences, the field's own
    /// as it is where the board's rows are dense. `clock`: limit of that of the clock; none without one.
    fn split(&mut self, clock: Option<f64>) {
        let with_clock = clock.is_some();
        let forces = self.plain.forces.len();
        let (first, count) = (3, 3 + forces + usize::from(with_clock));
        let mut limit = vec![f64::INFINITY; first + forces];
        (0..3).for_each(|axis| limit[axis] = self.plain.field[axis]);
        (0..forces).for_each(|force| limit[first + force] = self.plain.forces[force]);
        limit.extend(clock);
        self.adjusted = Variances { clock: 0.0, ..self.plain.clone() };
        for _ in 0..8 {
            let mut normal = DMatrix::<f64>::zeros(count, count);
            let mut right = DVector::<f64>::zeros(count);
            for one in &self.squares {
                let expected = one.variance(&self.adjusted);
                for axis in 0..3 {
                    let variance = expected[axis].max(f64::MIN_POSITIVE.sqrt());
                    let mut columns = DVector::zeros(count);
                    columns[axis] = 1.0;
                    for (force, slope2) in one.slopes2.iter().enumerate() {
                        columns[first + force] = slope2[axis];
                    }
                    if with_clock {
                        columns[count - 1] = one.rate2[axis];
                    }
                    // In units of the expectation, whatever the unit of the field.
                    columns /= variance;
                    normal.ger(1.0, &columns, &columns, 1.0);
                    right.axpy((one.square[axis] / variance).min(CUT_OFF), &columns, 1.0);
                }
            }
            let mut solution: Vec<f64> = (0..3).map(|axis| self.adjusted.field[axis]).collect();
            solution.extend(&self.adjusted.forces);
            solution.extend(with_clock.then_some(self.adjusted.clock));
            let from = if self.is_sparse { 0 } else { first };
            for _ in 0..200 {
                for index in from..count {
                    let own = normal[(index, index)];
                    if own <= 0.0 {
                        continue;
                    }
                    let others: f64 = (0..count).map(|k| normal[(index, k)] * solution[k]).sum();
                    let next = solution[index] + (right[index] - others) / own;
                    solution[index] = next.clamp(0.0, limit[index]);
                }
            }
            self.adjusted = Variances {
                field: Vector3::new(solution[0], solution[1], solution[2]),
                forces: solution[first..first + forces].to_vec(),
                clock: if with_clock { solution[count - 1] } else { 0.0 },
            };
            if with_clock {
                // The square of a normal variable has twice its squared variance; differences are correlated.
                let inverse = normal.clone().try_inverse();
                let own = inverse.map_or(f64::INFINITY, |inverse| inverse[(count - 1, count - 1)]);
                self.clock_error = (2.0 * own / FREEDOM).sqrt();
            }
        }
    }
}

impl NoiseEstimate {
    /// Estimates the noise of a recording, and sets that of its sensors and forces where raw differences of successive rows are none.
    pub fn of(recording: &mut Recording) -> Self {
        let numbers: Vec<u32> = recording.sensors.keys().copied().collect();
        let step = numbers.first().map_or(1, |sensor| sample_rows(recording, *sensor));
        let smooths = numbers.iter().filter_map(|&sensor| {
            let smooth = SmoothField::of(recording, sensor, MAX_TERMS)?;
            (smooth.rows.len() >= MIN_ROWS.max(12 * step)).then_some((sensor, smooth))
        });
        let smooths: Vec<(u32, SmoothField)> = smooths.collect();
        if smooths.is_empty() {
            return Self { sample_rows: step, ..Self::default() };
        }
        Self::by_smooths(recording, smooths, step)
    }

    /// By smooths of the sensors; `step`: rows between independent samples.
    fn by_smooths(
        recording: &mut Recording,
        smooths: Vec<(u32, SmoothField)>,
        step: usize,
    ) -> Self {
        let correlation_s = smooths.iter().map(|(_, smooth)| smooth.correlation_s(recording));
        let correlation_s = correlation_s.fold(0.0, f64::max);
        let left: Vec<f64> =
            smooths.iter().map(|(_, smooth)| smooth.deviation_g().norm_squared() / 3.0).collect();
        let smooth_g = root_mean(&left).unwrap_or(0.0);
        let mut covariates: Vec<String> =
            smooths.iter().flat_map(|(_, smooth)| smooth.covariates.clone()).collect();
        covariates.sort();
        covariates.dedup();
        if smooths.iter().all(|(_, smooth)| is_shuffled(recording, smooth)) {
            return Self {
                correlation_s,
                smooth_g,
                covariates,
                ..Self::by_smooth(recording, &smooths)
            };
        }
        let sensors: Vec<SensorNoise> = smooths
            .into_iter()
            .map(|(sensor, smooth)| differences(recording, sensor, smooth, step))
            .collect();
        Self {
            correlation_s,
            smooth_g,
            covariates,
            ..Self::by_differences(recording, sensors, step)
        }
    }

    fn by_smooth(recording: &mut Recording, smooths: &[(u32, SmoothField)]) -> Self {
        let found: Vec<(u32, Vector3<f64>)> =
            smooths.iter().map(|(sensor, smooth)| (*sensor, smooth.deviation_g())).collect();
        let floors2: Vec<f64> = found.iter().map(|(_, g)| g.norm_squared() / 3.0).collect();
        set_total(recording, &found);
        Self {
            estimator: NoiseEstimator::Smooth,
            floors_g: root_mean(&floors2)
                .map(|g| (NoiseEstimator::Smooth, g))
                .into_iter()
                .collect(),
            order: RowOrder::Shuffled,
            sample_rows: 1,
            ..Self::default()
        }
    }

    fn by_differences(
        recording: &mut Recording,
        mut sensors: Vec<SensorNoise>,
        step: usize,
    ) -> Self {
        // One clock has one jitter: the mean over the sensors, weighted by their precision.
        sensors.iter_mut().for_each(SensorNoise::split_with_clock);
        let weight = |sensor: &SensorNoise| 1.0 / sensor.clock_error.powi(2).max(1e-30);
        let weights: f64 = sensors.iter().map(weight).sum();
        let clock = sensors.iter().map(|s| s.adjusted.clock * weight(s)).sum::<f64>() / weights;
        let of_clock = |sensor: &SensorNoise| {
            let jitter = Variances {
                field: Vector3::zeros(),
                forces: vec![0.0; sensor.plain.forces.len()],
                clock,
            };
            sensor.floor2(&jitter)
        };
        let jitter2: f64 = sensors.iter().map(of_clock).sum();
        let all2: f64 = sensors.iter().map(|sensor| sensor.floor2(&sensor.adjusted)).sum();
        let errors = clock * weights.sqrt();
        // Rows without a clock are settings, between which the load does not move.
        let has_clock = !recording.description.is_clock_assumed();
        let is_jitter = has_clock && jitter2 > MIN_JITTER.0 * all2 && errors > MIN_JITTER.1;
        if !is_jitter {
            sensors.iter_mut().for_each(|sensor| sensor.split(None));
        }
        let floors = |of: fn(&SensorNoise) -> f64| {
            let floors2: Vec<f64> = sensors.iter().map(of).collect();
            root_mean(&floors2).unwrap_or(0.0)
        };
        let plain_g = floors(|sensor| sensor.floor2(&sensor.plain));
        let adjusted_g = floors(SensorNoise::observed2);
        let rows = sensors.iter().map(|sensor| sensor.squares.len()).max().unwrap_or(0);
        let error = 1.0 / (2.0 * FREEDOM * rows.max(1) as f64).sqrt();
        let agree = AGREE.max(1.0 + STANDARD_ERRORS * error);
        let mut estimate = Self {
            estimator: NoiseEstimator::Differences,
            floors_g: vec![
                (NoiseEstimator::ResidualDifferences, adjusted_g),
                (NoiseEstimator::Differences, plain_g),
            ],
            differences_hold_motion: plain_g > agree * adjusted_g,
            sample_rows: step,
            ..Self::default()
        };
        estimate.quiet_g = quiet_floors(recording, &sensors, step);
        if estimate.differences_hold_motion || is_jitter || step > 1 {
            estimate.estimator = NoiseEstimator::ResidualDifferences;
            if is_jitter {
                let jitter_s = clock.sqrt();
                estimate.jitter_s = (jitter_s, 0.5 * jitter_s / errors);
                for one in &mut sensors {
                    one.adjusted.clock = clock;
                    let mut precision = vec![1.0; recording.time_s.len()];
                    let rows = one.smooth.rows.iter().zip(one.precision());
                    rows.for_each(|(&row, of)| precision[row] = of);
                    estimate.precision.insert(one.sensor, precision);
                }
            }
            estimate.raw = Some(RawNoise::of(recording));
            apply(recording, &sensors);
        }
        estimate
    }

    /// Estimates the noise of recordings of few rows again, by a smooth through all recordings of a campaign: one of few terms does not
    /// follow the field, and what it leaves grows with the rate of the load, as by jitter.
    pub(crate) fn estimate_together(recordings: &mut [Recording]) {
        let is_short = |one: &Recording| {
            let is_by_differences = !one.noise.floors_g.is_empty()
                && matches!(
                    one.noise.estimator,
                    NoiseEstimator::Differences | NoiseEstimator::ResidualDifferences
                );
            is_by_differences && one.time_s.len() < MAX_TERMS * ROWS_PER_TERM
        };
        if recordings.len() < 2 || !recordings.iter().any(is_short) {
            return;
        }
        let numbers: Vec<u32> = recordings[0].sensors.keys().copied().collect();
        let through = |sensor: &u32| SmoothField::through(recordings, *sensor, MAX_TERMS);
        let smooths: Option<Vec<Vec<SmoothField>>> = numbers.iter().map(through).collect();
        let Some(smooths) = smooths else { return };
        let mut of_sensors: Vec<_> = smooths.into_iter().map(Vec::into_iter).collect();
        for recording in recordings {
            let of_recording = of_sensors.iter_mut().filter_map(Iterator::next);
            let smooths: Vec<(u32, SmoothField)> =
                numbers.iter().copied().zip(of_recording).collect();
            let least = MIN_ROWS.max(12 * recording.noise.sample_rows);
            if is_short(recording) && smooths.iter().all(|(_, smooth)| smooth.rows.len() >= least) {
                Self::estimate_again(recording, smooths);
            }
        }
    }

    /// By these smooths, where the floor is lower by them.
    fn estimate_again(recording: &mut Recording, smooths: Vec<(u32, SmoothField)>) {
        let mut again = recording.clone();
        if let Some(raw) = &recording.noise.raw {
            raw.restore(&mut again);
        }
        let old = &recording.noise;
        let estimate = Self::by_smooths(&mut again, smooths, old.sample_rows);
        let floor_g = |of: &Self| of.floor_g().unwrap_or(f64::INFINITY);
        if estimate.order == old.order && floor_g(&estimate) < floor_g(old) {
            let (unit, covariates) = (old.unit, old.covariates.clone());
            again.noise = Self { unit, covariates, ..estimate };
            *recording = again;
        } else {
            recording.noise.smooth_g = estimate.smooth_g;
        }
    }
}

/// Root of the mean of squares.
pub(super) fn root_mean(squares: &[f64]) -> Option<f64> {
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Sets noise that holds all that differs between rows of equal settings: that of the forces is part of it.
pub(super) fn set_total(recording: &mut Recording, found: &[(u32, Vector3<f64>)]) {
    let gain = recording.noise_gain;
    for (number, noise_g) in found {
        if let Some(sensor) = recording.sensors.get_mut(number) {
            sensor.noise_g = (noise_g / gain).into();
        }
    }
    recording.forces.values_mut().for_each(|force| force.noise_n = 0.0);
}

/// Sets the noise that the differences of the residual give; of a force of several sensors the mean.
fn apply(recording: &mut Recording, sensors: &[SensorNoise]) {
    let gain = recording.noise_gain;
    for one in sensors {
        if let Some(sensor) = recording.sensors.get_mut(&one.sensor) {
            sensor.noise_g = one.adjusted.field.map(|variance| variance.sqrt() / gain).into();
        }
    }
    for (key, force) in &mut recording.forces {
        let of_sensor = |one: &SensorNoise| {
            let place = one.smooth.forces.iter().position(|own| own == key)?;
            Some(one.adjusted.forces[place])
        };
        let found: Vec<f64> = sensors.iter().filter_map(of_sensor).collect();
        if let Some(noise_n) = root_mean(&found) {
            force.noise_n = noise_n;
        }
    }
}

/// Whether neither the settings nor the residual have an order, though the field follows the settings.
fn is_shuffled(recording: &Recording, smooth: &SmoothField) -> bool {
    let at = |column: &[f64]| -> Vec<f64> { smooth.rows.iter().map(|&row| column[row]).collect() };
    let forces = smooth.forces.iter().filter_map(|key| recording.forces.get(key));
    let columns = forces.map(|force| at(&force.newtons));
    let covariates = recording.covariates.values().map(|column| at(column));
    let ratios: Vec<f64> = columns.chain(covariates).filter_map(|c| von_neumann(&c)).collect();
    let of_residual = [0, 1, 2].map(|axis| {
        von_neumann(&smooth.residual_g.iter().map(|r| r[axis]).collect::<Vec<f64>>()).unwrap_or(1.0)
    });
    let bound = 1.0 - 4.0 / (smooth.rows.len() as f64).sqrt();
    !ratios.is_empty()
        && ratios.iter().all(|ratio| *ratio > UNORDERED)
        && smooth.explained > FOLLOWS_SETTINGS
        && of_residual.iter().all(|ratio| *ratio > bound)
}

/// Mean square of successive differences over twice the variance; `None` for a constant.
pub(crate) fn von_neumann(values: &[f64]) -> Option<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let steps: f64 = values.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    (squares > 1e-18 * mean * mean * values.len() as f64).then(|| 0.5 * steps / squares)
}

/// Rows between the samples of a column that was held or interpolated linearly, at most of the fields and forces: its second
/// differences are zero but at the samples.
fn sample_rows(recording: &Recording, sensor: u32) -> usize {
    let fields = recording.sensors.get(&sensor).into_iter().flat_map(|sensor| {
        [0, 1, 2].map(|axis| sensor.field_g.iter().map(|b| b[axis]).collect::<Vec<f64>>())
    });
    let forces = recording.forces.values().map(|force| force.newtons.clone());
    fields.chain(forces).filter_map(|column| knot_spacing(&column)).max().unwrap_or(1)
}

/// Share of rows between the knots, at least, and largest second difference there relative to those at knots.
const BETWEEN_KNOTS: (f64, f64) = (0.6, 0.02);

fn knot_spacing(values: &[f64]) -> Option<usize> {
    let bends: Vec<f64> = values.windows(3).map(|v| (v[0] - 2.0 * v[1] + v[2]).abs()).collect();
    let mut sorted: Vec<f64> = bends.iter().copied().filter(|bend| bend.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get((share * sorted.len() as f64) as usize).copied();
    let (share, small) = BETWEEN_KNOTS;
    let limit = small * at(0.95)?;
    if sorted.len() < MIN_ROWS || limit <= 0.0 || at(share)? > limit {
        return None;
    }
    // A knot bends up to two successive rows.
    let mut knots: Vec<usize> = Vec::new();
    for (row, _) in bends.iter().enumerate().filter(|(_, bend)| **bend > limit) {
        if knots.last().is_none_or(|last| row > last + 2) {
            knots.push(row);
        }
    }
    let mut gaps: Vec<usize> = knots.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_unstable();
    gaps.get(gaps.len() / 2).copied().filter(|gap| *gap > 1)
}

/// Differences of one sensor's residual and raw rows.
fn differences(
    recording: &Recording,
    sensor: u32,
    smooth: SmoothField,
    step: usize,
) -> SensorNoise {
    let time_s: Vec<f64> = smooth.rows.iter().map(|&row| recording.time_s[row]).collect();
    let over = Differences::new(&time_s, step);
    // Residuals of a fit of these terms are smaller than the noise.
    let freedom = smooth.rows.len() as f64 / smooth.freedom();
    let columns: Vec<Vec<f64>> = smooth.force_columns(recording);
    let rates = columns.iter().map(|column| rates(&time_s, column)).collect();
    let known = |noise: f64| if noise.is_finite() { noise * noise } else { 0.0 };
    let mean_square = |value: &dyn Fn(usize) -> f64| {
        let squares = over.rows().map(|row| over.of(value, row).powi(2));
        squares.sum::<f64>() / over.rows().count().max(1) as f64
    };
    let own = recording.sensors.get(&sensor);
    let field_g: Vec<[f64; 3]> =
        smooth.rows.iter().filter_map(|&row| own.map(|own| own.field_g[row])).collect();
    // Differences over the samples of a held column hold more motion than those of the tables' rows.
    let plain = if step > 1 {
        Variances {
            field: Vector3::new(
                mean_square(&|row| field_g[row][0]),
                mean_square(&|row| field_g[row][1]),
                mean_square(&|row| field_g[row][2]),
            ),
            forces: columns.iter().map(|column| mean_square(&|row| column[row])).collect(),
            clock: 0.0,
        }
    } else {
        let noise_g = own.map_or([0.0; 3], |own| own.noise_g);
        let noise_n = smooth.forces.iter().filter_map(|key| recording.forces.get(key));
        Variances {
            field: Vector3::from(noise_g).map(|noise| known(noise * recording.noise_gain)),
            forces: noise_n.map(|force| known(force.noise_n)).collect(),
            clock: 0.0,
        }
    };
    // White noise falls with the root of the number of averaged rows.
    let averaged = recording.noise_gain.powi(-2);
    let mut one = SensorNoise {
        sensor,
        rates,
        adjusted: plain.clone(),
        plain,
        is_sparse: step > 1 || averaged < DENSE_ROWS,
        squares: Vec::new(),
        smooth,
        clock_error: f64::INFINITY,
    };
    // A row that makes the difference counts with the square of its weight.
    let weights = [1.0, 9.0, 9.0, 1.0].map(|square| square / GAIN);
    let mean = |row: usize, of: &dyn Fn(usize) -> Vector3<f64>| -> Vector3<f64> {
        let rows = weights.iter().enumerate();
        rows.map(|(k, weight)| of(row + k * step).map(|x| x * x) * *weight).sum()
    };
    let square = |row: usize| {
        let of_axis =
            |axis: usize| over.of(|at| one.smooth.residual_g[at][axis], row).powi(2) * freedom;
        let slope2 = |force: usize| mean(row, &|at| one.smooth.slopes[at][force]);
        SquaredDifference {
            row,
            square: Vector3::new(of_axis(0), of_axis(1), of_axis(2)),
            slopes2: (0..one.smooth.forces.len()).map(slope2).collect(),
            rate2: mean(row, &|at| one.per_second(at)),
        }
    };
    let squares = over.rows().map(square).collect();
    one.squares = squares;
    one
}

/// Share of the rows in which the load moves least.
const QUIET_SHARE: f64 = 0.2;
/// Minimum number of quiet rows.
const MIN_QUIET: usize = 100;
/// Motion over a third difference in multiples of the noise, up to which a row is quiet.
const QUIET_NOISES: f64 = 6.0;

/// Floor by raw differences of field and forces in the rows in which the load moves least, and that of the split variances in the same
/// rows; `None` without forces, or where it moves in those rows as well.
fn quiet_floors(recording: &Recording, sensors: &[SensorNoise], step: usize) -> Option<[f64; 2]> {
    let (mut measured2, mut modelled2) = (Vec::new(), Vec::new());
    for one in sensors.iter().filter(|one| !one.smooth.forces.is_empty()) {
        let own = recording.sensors.get(&one.sensor)?;
        let time_s: Vec<f64> = one.smooth.rows.iter().map(|&row| recording.time_s[row]).collect();
        let over = Differences::new(&time_s, step);
        let columns = one.smooth.force_columns(recording);
        let mut quiet: Vec<&SquaredDifference> = one.squares.iter().collect();
        quiet.sort_by(|a, b| a.rate2.sum().total_cmp(&b.rate2.sum()));
        quiet.truncate((QUIET_SHARE * quiet.len() as f64) as usize);
        let moves_g = quiet.last()?.rate2.sum().sqrt() * over.longest_s;
        if quiet.len() < MIN_QUIET || moves_g > QUIET_NOISES * one.observed2().sqrt() {
            return None;
        }
        let square = |of: &&SquaredDifference| {
            let field = |axis| over.of(|at| own.field_g[one.smooth.rows[at]][axis], of.row).powi(2);
            let forces = columns
                .iter()
                .zip(&of.slopes2)
                .map(|(column, slope2)| slope2.sum() * over.of(|at| column[at], of.row).powi(2));
            ([0, 1, 2].map(field).iter().sum::<f64>() + forces.sum::<f64>()) / 3.0
        };
        let rows = quiet.len() as f64;
        measured2.push(quiet.iter().map(square).sum::<f64>() / rows);
        modelled2.push(
            quiet.iter().map(|of| of.variance(&one.adjusted).sum() / 3.0).sum::<f64>() / rows,
        );
    }
    Some([root_mean(&measured2)?, root_mean(&modelled2)?])
}

/// Rate of a force times the jitter of the clock, in newtons, for each row; empty without jitter.
pub fn jitter_n(recording: &Recording, forces: &[(u32, Axis)], rows: &[usize]) -> Vec<Vec<f64>> {
    let jitter_s = recording.noise.jitter_s.0;
    if jitter_s <= 0.0 {
        return Vec::new();
    }
    let time_s: Vec<f64> = rows.iter().map(|&row| recording.time_s[row]).collect();
    let rate = |key: &(u32, Axis)| {
        let force = recording.forces.get(key)?;
        let column: Vec<f64> = rows.iter().map(|&row| force.newtons[row]).collect();
        Some(rates(&time_s, &column))
    };
    let rates: Vec<Vec<f64>> = forces.iter().filter_map(rate).collect();
    (0..rows.len()).map(|row| rates.iter().map(|rate| jitter_s * rate[row]).collect()).collect()
}

/// Rates of change over the neighbouring rows: a smooth would spread a step of the load over rows that do not move.
fn rates(time_s: &[f64], values: &[f64]) -> Vec<f64> {
    let rate = |row: usize| {
        let (from, to) = (row.saturating_sub(1), (row + 1).min(values.len() - 1));
        let step_s = time_s[to] - time_s[from];
        if step_s > 0.0 { (values[to] - values[from]) / step_s } else { 0.0 }
    };
    (0..values.len()).map(rate).collect()
}
