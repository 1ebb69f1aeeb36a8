//! `clock_offset`: offset and rate of the reference's clock relative to the board's, from the loads alone.
//!
//! The delay of the reference is estimated in windows of each recording ([`reference_delay`]); a straight line through them gives
//! offset and rate with their standard errors. No model is needed: one that was fitted to misaligned recordings has absorbed a part.

use std::path::Path;

use model_export::recordings::Location;
use model_export::recordings::noise::WhiteNoise;
use rayon::prelude::*;

use crate::data_quality::checks::{CheckContext, Found};
use crate::data_quality::evidence::{ClockOffset, Evidence};
use crate::data_quality::fix::{Change, Fix, FixKind, Repair};
use crate::data_quality::scan::RecordingScan;
use crate::reference_delay::{self, FieldSeries, ForceSeries};

/// Search range on each side in seconds.
const SEARCH_S: f64 = 1.0;
/// The same in a window, around the delay of the whole recording: a clock that runs fast.
const SEARCH_IN_WINDOW_S: f64 = 0.3;
/// Rows of the reference in a window at least, and number of windows.
const WINDOW_ROWS: usize = 75;
const MAX_WINDOWS: usize = 8;
/// Rows that are used: for the search of the delay, in a window, and for its final estimate. More would not change them.
const ROWS: [usize; 3] = [400, 150, 2000];
/// Share of the forces' variance above its noise that a misalignment worth a search leaves unexplained.
const WORTH: f64 = 2e-3;
/// Least number of windows that determine a rate.
const MIN_WINDOWS: usize = 3;
/// Largest difference of two clocks: that of a microcontroller's RC oscillator.
const MAX_RATE: f64 = 0.03;
/// Standard errors from which an offset or a rate is significant.
const SIGMAS: f64 = 5.0;
/// Smaller offsets in seconds are left to `magpie diagnose`, which compares them with similar effects.
const LEAST_S: f64 = 1.5e-3;
/// Offsets in seconds beyond any lag of a flexure or filter.
const BEYOND_LAGS_S: f64 = 0.05;
/// Minimum share of the reference's variance that the fields explain once it is aligned.
const EXPLAINED: f64 = 0.5;
/// Minimum share of the error above the noise that the alignment removes: friction and creep are no delays. Of all forces, and of
/// each one.
const FALLS: [f64; 2] = [0.7, 0.5];
/// Share of a force's variance that a misalignment must leave for that force to be evaluated by itself.
const LEAST_LEFT: f64 = 0.02;

/// Fields and forces of one recording.
struct Series {
    fields: Vec<FieldSeries>,
    forces: Vec<ForceSeries>,
    /// Variance of each force's white noise relative to its variance.
    noise: Vec<f64>,
}

impl Series {
    fn read(scan: &RecordingScan, delay_s: f64) -> Option<Self> {
        let (fields, mut forces) = reference_delay::series(&scan.folder).ok()?;
        for force in &mut forces {
            force.time_s.iter_mut().for_each(|time_s| *time_s += delay_s);
        }
        let noise = forces.iter().map(|force| relative_noise(&force.force_n)).collect();
        (!fields.is_empty() && !forces.is_empty()).then_some(Self { fields, forces, noise })
    }

    /// Forces whose times are moved to the board's clock, at most `most` rows of part `part` of `parts`.
    fn moved(
        &self,
        of: (f64, f64),
        (part, parts): (usize, usize),
        most: usize,
    ) -> Vec<ForceSeries> {
        let (offset_s, rate) = of;
        let window = |force: &ForceSeries| {
            let rows = force.time_s.len();
            let rows = part * rows / parts..(part + 1) * rows / parts;
            let stride = rows.len().div_ceil(most).max(1);
            let time_s = force.time_s[rows.clone()].iter().step_by(stride);
            let force_n = force.force_n[rows].iter().step_by(stride);
            ForceSeries {
                time_s: time_s.map(|time_s| time_s + offset_s + rate * time_s).collect(),
                force_n: force_n.copied().collect(),
                ..force.clone()
            }
        };
        self.forces.iter().map(window).collect()
    }

    /// Share of each force's variance above its noise that the fields do not explain with this alignment.
    fn unexplained(&self, of: (f64, f64)) -> Vec<f64> {
        let left = reference_delay::unexplained(&self.fields, &self.moved(of, (0, 1), ROWS[2]));
        left.iter().zip(&self.noise).map(|(left, noise)| (left - noise).max(0.0)).collect()
    }

    /// Delay in seconds of a part of the recording, near another one; with its standard error where the fields explain the forces.
    fn delay(
        &self,
        near_s: f64,
        part: (usize, usize),
        most: usize,
        search_s: f64,
    ) -> Option<(f64, f64)> {
        let forces = self.moved((near_s, 0.0), part, most);
        let found = reference_delay::estimate(&self.fields, &forces, search_s)?;
        let is_clear = found.explained > EXPLAINED && found.standard_error_s > 0.0;
        is_clear.then_some((near_s + found.delay_s, found.standard_error_s))
    }

    fn estimate(&self) -> Option<ClockOffset> {
        let before = self.unexplained((0.0, 0.0));
        if before.iter().sum::<f64>() < WORTH * before.len() as f64 {
            return None;
        }
        let rows = self.forces.iter().map(|force| force.time_s.len()).max()?;
        let windows = (rows / WINDOW_ROWS).clamp(1, MAX_WINDOWS);
        let (near_s, _) = self.delay(0.0, (0, 1), ROWS[0], SEARCH_S)?;
        let at = |part: usize| {
            let times = &self.forces.first()?.time_s;
            let middle = ((2 * part + 1) * times.len() / (2 * windows)).min(times.len() - 1);
            let (delay_s, error_s) =
                self.delay(near_s, (part, windows), ROWS[1], SEARCH_IN_WINDOW_S)?;
            Some((times[middle], delay_s, error_s))
        };
        let points: Vec<(f64, f64, f64)> = (0..windows).filter_map(at).collect();
        let line = (points.len() >= MIN_WINDOWS).then(|| Line::through(&points)).flatten();
        let has_rate = |line: &Line| {
            let reach_s = 0.5 * line.slope.abs() * (points[points.len() - 1].0 - points[0].0);
            line.slope.abs() > SIGMAS * line.slope_error
                && reach_s > LEAST_S
                && line.slope.abs() < MAX_RATE
        };
        if let Some(line) = line.filter(has_rate) {
            return Some(ClockOffset {
                recording: String::new(),
                offset_ms: 1e3 * line.at_zero,
                offset_error_ms: 1e3 * line.at_zero_error,
                rate_ppm: 1e6 * line.slope,
                rate_error_ppm: 1e6 * line.slope_error,
            });
        }
        let (delay_s, error_s) = self.delay(near_s, (0, 1), ROWS[2], LEAST_S)?;
        Some(ClockOffset {
            recording: String::new(),
            offset_ms: 1e3 * delay_s,
            offset_error_ms: 1e3 * error_s,
            rate_ppm: 0.0,
            rate_error_ppm: f64::NAN,
        })
    }

    /// Share of the error above the noise that this alignment removes; `None` where it does not remove it from every force.
    fn fall(&self, offset: &ClockOffset) -> Option<f64> {
        let before = self.unexplained((0.0, 0.0));
        let after = self.unexplained((1e-3 * offset.offset_ms, 1e-6 * offset.rate_ppm));
        let pairs = || before.iter().zip(&after);
        let falls = |(before, after): (&f64, &f64)| 1.0 - after / before.max(f64::MIN_POSITIVE);
        let each =
            pairs().filter(|(before, _)| **before > LEAST_LEFT).all(|pair| falls(pair) >= FALLS[1]);
        let total = falls((&before.iter().sum(), &after.iter().sum()));
        (each && total >= FALLS[0]).then_some(total)
    }
}

/// Variance of the white noise relative to the variance; zero where unknown.
fn relative_noise(values: &[f64]) -> f64 {
    let mut noise = WhiteNoise::default();
    values.iter().for_each(|value| noise.push(*value));
    let finite = || values.iter().filter(|value| value.is_finite());
    let count = finite().count() as f64;
    let mean = finite().sum::<f64>() / count;
    let variance = finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let share = noise.estimate().map_or(0.0, |sigma| sigma * sigma / variance);
    if share.is_finite() { share } else { 0.0 }
}

/// A weighted straight line with standard errors, enlarged where the points scatter more than theirs.
struct Line {
    at_zero: f64,
    at_zero_error: f64,
    slope: f64,
    slope_error: f64,
}

impl Line {
    /// Through points with place, value and standard error.
    fn through(points: &[(f64, f64, f64)]) -> Option<Self> {
        let weight = |error: f64| 1.0 / (error * error);
        let total: f64 = points.iter().map(|point| weight(point.2)).sum();
        let mean = |of: &dyn Fn(&(f64, f64, f64)) -> f64| {
            points.iter().map(|point| weight(point.2) * of(point)).sum::<f64>() / total
        };
        let (centre, value) = (mean(&|point| point.0), mean(&|point| point.1));
        let spread = total * mean(&|point| (point.0 - centre).powi(2));
        let slope = total * mean(&|point| (point.0 - centre) * (point.1 - value)) / spread;
        let residual = |point: &(f64, f64, f64)| point.1 - value - slope * (point.0 - centre);
        let chi = total * mean(&|point| residual(point).powi(2)) / (points.len() as f64 - 2.0);
        let scatter = chi.max(1.0);
        let slope_error = (scatter / spread).sqrt();
        let at_zero_error = (scatter / total + (centre * slope_error).powi(2)).sqrt();
        let line = Self { at_zero: value - slope * centre, at_zero_error, slope, slope_error };
        (slope.is_finite() && slope_error.is_finite()).then_some(line)
    }
}

/// Offset and rate of the reference's clock in the recordings where they are significant; `delay_s` is already applied to it.
pub fn offsets<'a>(context: &CheckContext<'a>, delay_s: f64) -> Vec<Found<'a>> {
    let found: Vec<Option<(ClockOffset, f64)>> = context
        .recordings
        .par_iter()
        .map(|scan| {
            let is_ordered = |table: &&_| context.has("clock_backwards", table);
            if scan.tables.iter().any(|table| is_ordered(&table)) {
                return None;
            }
            let series = Series::read(scan, delay_s)?;
            let offset = ClockOffset { recording: scan.name.clone(), ..series.estimate()? };
            let is_far = offset.offset_ms.abs() > 1e3 * LEAST_S
                && offset.offset_ms.abs() > SIGMAS * offset.offset_error_ms;
            let fall = (is_far || offset.rate_ppm != 0.0).then(|| series.fall(&offset))??;
            Some((offset, fall))
        })
        .collect();
    let hit: Vec<(&RecordingScan, ClockOffset, f64)> = context
        .recordings
        .iter()
        .zip(found)
        .filter_map(|(scan, found)| found.map(|(offset, fall)| (scan, offset, fall)))
        .collect();
    let Some((first, ..)) = hit.first() else { return Vec::new() };
    let place = |scan: &RecordingScan| {
        scan.table("force.csv").map_or_else(|| scan.folder.clone(), |table| table.path.clone())
    };
    let offsets: Vec<ClockOffset> = hit.iter().map(|(_, offset, _)| offset.clone()).collect();
    let common_ms = common(&offsets).filter(|_| hit.len() == context.recordings.len());
    let is_lag = common_ms.is_some_and(|ms| (0.0..1e3 * BEYOND_LAGS_S).contains(&ms));
    let repair = |(scan, offset, _): &(&RecordingScan, ClockOffset, f64)| Repair {
        file: place(scan),
        change: Change::Convert {
            column: "t_us".to_owned(),
            factor: 1.0 + 1e-6 * offset.rate_ppm,
            // The rate counts from time zero of the shifted clock.
            offset: (1e3 * offset.offset_ms + delay_s * offset.rate_ppm).round(),
        },
    };
    let repairs: Vec<Repair> = hit.iter().map(repair).collect();
    let evidence = Evidence::ClockOffsets {
        share: hit.iter().map(|(.., fall)| *fall).fold(1.0, f64::min),
        delay_ms: common_ms.map(|ms| ms + 1e3 * delay_s),
        offsets,
    };
    let found = Found::new(Location::file(Path::new(&place(first))).column("t_us"), evidence);
    if is_lag {
        return vec![found];
    }
    let fix = Fix { kind: FixKind::AlignClock, repairs };
    // No effect explains such an offset, and every one of memory or rate follows it.
    let is_beyond_lags =
        hit.iter().any(|(_, offset, _)| offset.offset_ms.abs() > 1e3 * BEYOND_LAGS_S);
    vec![if is_beyond_lags { found.stopping(Some(fix)) } else { found.with_fix(fix) }]
}

/// The mean offset in milliseconds of clocks with the same offset and rate; `None` where they differ or run at different rates.
fn common(offsets: &[ClockOffset]) -> Option<f64> {
    let weight = |offset: &ClockOffset| offset.offset_error_ms.powi(-2);
    let total: f64 = offsets.iter().map(weight).sum();
    let mean = offsets.iter().map(|offset| weight(offset) * offset.offset_ms).sum::<f64>() / total;
    let is_same = |offset: &ClockOffset| {
        let reach_ms = (SIGMAS * offset.offset_error_ms).max(1e3 * LEAST_S);
        offset.rate_ppm == 0.0 && (offset.offset_ms - mean).abs() < reach_ms
    };
    offsets.iter().all(is_same).then_some(mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_through_exact_points_has_its_slope_and_the_stated_errors() {
        let points = [(0.0, 0.1, 0.01), (10.0, 0.12, 0.01), (20.0, 0.14, 0.01)];
        let line = Line::through(&points).unwrap();
        assert!((line.slope - 0.002).abs() < 1e-12 && (line.at_zero - 0.1).abs() < 1e-12);
        // 0.01 / sqrt(200), and sqrt(1 / 3 + 100 / 200) of 0.01.
        assert!((line.slope_error - 7.071e-4).abs() < 1e-6, "{}", line.slope_error);
        assert!((line.at_zero_error - 9.129e-3).abs() < 1e-5, "{}", line.at_zero_error);
    }

    #[test]
    fn offsets_are_common_within_their_errors_only() {
        let offset = |offset_ms: f64, rate_ppm: f64| ClockOffset {
            recording: String::new(),
            offset_ms,
            offset_error_ms: 0.2,
            rate_ppm,
            rate_error_ppm: 1.0,
        };
        assert_eq!(common(&[offset(370.0, 0.0), offset(371.0, 0.0)]), Some(370.5));
        assert_eq!(common(&[offset(200.0, 0.0), offset(-300.0, 0.0)]), None);
        assert_eq!(common(&[offset(370.0, 50.0), offset(370.0, 50.0)]), None);
    }
}
