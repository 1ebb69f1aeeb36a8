//! What of a residual follows no covariate: how large it is, how it varies over time, and on which channels it is.

use std::ops::Range;

use rustfft::algorithm::Radix4;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftDirection};
use serde::Serialize;

use crate::compare::pipeline::correlation_s;
use crate::compare::residual_table::ResidualTable;
use model_export::recordings::columns::Axis;

/// Rate in Hz to which the residual is averaged for its spectrum.
const SPECTRUM_HZ: f64 = 25.0;
/// Minimum rows of a recording for a spectrum.
const MIN_ROWS: usize = 32;
/// Minimum ratio of the spectrum's peak to its median for a statement about an oscillation. The periodogram of white noise is
/// exponentially distributed: on a single channel each of some 400 frequencies exceeds 20 medians with probability 2^-20, any of
/// them with 4e-4; sums over channels vary less.
const MIN_PEAK: f64 = 20.0;
/// Channels or recordings that together have this fraction of the excess are listed.
const LISTED: f64 = 0.8;

/// Structure that remains in a residual above its noise floor.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RemainingStructure {
    /// RMS over all channels above the noise floor, in gauss.
    pub excess_g: f64,
    /// Fraction of the squared excess that follows no covariate.
    pub share: f64,
    /// Time in seconds in which the residual stays alike.
    pub correlation_s: f64,
    /// Frequency in Hz of its strongest oscillation; none if no frequency dominates.
    pub peak_hz: Option<f64>,
    /// Channels with the largest parts of the squared excess, largest first.
    pub channels: Vec<ChannelShare>,
    /// Recordings with the largest parts, largest first; empty where it is not in less than half of them.
    pub recordings: Vec<RecordingShare>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordingShare {
    pub recording: String,
    /// Fraction of the squared excess of all recordings.
    pub share: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChannelShare {
    pub sensor: u32,
    /// Axis of the field.
    pub axis: &'static str,
    /// Fraction of the squared excess of all channels.
    pub share: f64,
}

impl RemainingStructure {
    /// Of residuals, of whose squared excess the fraction `located` follows covariates. `names` are those of all recordings.
    pub fn of(columns: &[ResidualTable], names: &[&str], located: f64) -> Self {
        let mut channels = Vec::new();
        for table in columns {
            for (axis, name) in Axis::ALL.map(Axis::letter).into_iter().enumerate() {
                let rows = table.residual.iter().zip(&table.floor2);
                let excess =
                    rows.map(|(left, floor)| left[axis].powi(2) - floor[axis]).sum::<f64>();
                let excess = (excess / table.len().max(1) as f64).max(0.0);
                channels.push(ChannelShare { sensor: table.sensor, axis: name, share: excess });
            }
        }
        let sum: f64 = channels.iter().map(|channel| channel.share).sum();
        let count = channels.len().max(1) as f64;
        channels.sort_by(|a, b| b.share.total_cmp(&a.share));
        let mut listed = 0.0;
        channels.retain_mut(|channel| {
            channel.share /= sum.max(f64::MIN_POSITIVE);
            let is_listed = listed < LISTED && channel.share > 0.0;
            listed += channel.share;
            is_listed
        });
        Self {
            excess_g: (sum / count).sqrt(),
            share: (1.0 - located).clamp(0.0, 1.0),
            correlation_s: correlation_s(columns),
            peak_hz: peak_hz(columns),
            channels,
            recordings: recording_shares(columns, names),
        }
    }
}

/// The few recordings that hold most of the squared excess; empty where it is spread over half of them or more.
fn recording_shares(columns: &[ResidualTable], names: &[&str]) -> Vec<RecordingShare> {
    let mut squares = vec![0.0_f64; names.len()];
    for table in columns {
        for ((recording, left), floor) in
            table.recording.iter().zip(&table.residual).zip(&table.floor2)
        {
            if let Some(sum) = squares.get_mut(*recording as usize) {
                *sum += left.norm_squared() - floor.sum();
            }
        }
    }
    let sum: f64 = squares.iter().map(|square| square.max(0.0)).sum();
    let mut shares: Vec<RecordingShare> = squares
        .iter()
        .zip(names)
        .map(|(square, name)| RecordingShare {
            recording: (*name).to_owned(),
            share: square.max(0.0) / sum.max(f64::MIN_POSITIVE),
        })
        .collect();
    shares.sort_by(|a, b| b.share.total_cmp(&a.share));
    shares.truncate(names.len().saturating_sub(1) / 2);
    let is_most = shares.iter().map(|one| one.share).sum::<f64>() >= LISTED;
    shares.retain(|one| is_most && one.share >= 1.0 / names.len() as f64);
    shares
}

/// Rows of each recording.
fn recordings(table: &ResidualTable) -> Vec<Range<usize>> {
    let mut ends = 0;
    let chunks = table.recording.chunk_by(|a, b| a == b);
    chunks
        .map(|chunk| {
            let range = ends..ends + chunk.len();
            ends = range.end;
            range
        })
        .collect()
}

/// Frequency of the largest value of the periodogram, summed over channels and recordings; none if it does not dominate.
/// Each recording is averaged to [`SPECTRUM_HZ`], and padded to a power of two that holds the longest.
fn peak_hz(columns: &[ResidualTable]) -> Option<f64> {
    let first = columns.first()?;
    let parts: Vec<Range<usize>> =
        recordings(first).into_iter().filter(|rows| rows.len() >= MIN_ROWS).collect();
    let longest = parts.iter().max_by_key(|rows| rows.len())?.clone();
    let times = first.time_s.get(longest.clone())?;
    let rate_hz = (longest.len() - 1) as f64 / (times.last()? - times.first()?);
    let pooled = ((rate_hz / SPECTRUM_HZ).round() as usize).max(1);
    let length = longest.len() / pooled;
    if length < MIN_ROWS || !rate_hz.is_finite() {
        return None;
    }
    let padded = length.next_power_of_two();
    let transform = Radix4::new(padded, FftDirection::Forward);
    let mut power = vec![0.0; padded / 2 + 1];
    for table in columns {
        for (rows, axis) in parts.iter().flat_map(|rows| [0, 1, 2].map(|axis| (rows.clone(), axis)))
        {
            let values = table.residual.get(rows)?;
            let signal: Vec<f64> = values
                .chunks_exact(pooled)
                .take(length)
                .map(|chunk| chunk.iter().map(|left| left[axis]).sum::<f64>() / pooled as f64)
                .collect();
            let mean = signal.iter().sum::<f64>() / signal.len().max(1) as f64;
            let mut spectrum: Vec<Complex<f64>> =
                signal.iter().map(|value| Complex::new(value - mean, 0.0)).collect();
            spectrum.resize(padded, Complex::default());
            transform.process(&mut spectrum);
            power.iter_mut().zip(spectrum).for_each(|(sum, value)| *sum += value.norm_sqr());
        }
    }
    // Less than two periods in the recording are a drift.
    let lowest = (2 * padded).div_ceil(length);
    let (bin, peak) = power.iter().enumerate().skip(lowest).max_by(|a, b| a.1.total_cmp(b.1))?;
    let mut sorted = power.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    let hz = bin as f64 * rate_hz / (pooled * padded) as f64;
    (*peak > MIN_PEAK * median).then_some(hz)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::Vector3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const NAMES: [&str; 2] = ["one", "two"];

    /// Two recordings of 20 s at 100 Hz with white noise of 0.1 G, and a signal of time in seconds on sensor 3 z.
    fn columns(signal: impl Fn(f64) -> f64) -> Vec<ResidualTable> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut noise = || 0.1 * (rng.random::<f64>() - 0.5) * 12.0_f64.sqrt();
        [0, 3]
            .map(|sensor| {
                let mut table = ResidualTable::new(sensor, &[]);
                for (recording, row) in
                    (0..2).flat_map(|number| (0..2000).map(move |row| (number, row)))
                {
                    let time_s = 0.01 * f64::from(row);
                    let left = if sensor == 3 { signal(time_s) } else { 0.0 };
                    table.recording.push(recording);
                    table.time_s.push(time_s);
                    table.residual.push(Vector3::new(noise(), noise(), left + noise()));
                    table.floor2.push(Vector3::repeat(0.01));
                }
                table
            })
            .into()
    }

    #[test]
    fn oscillation_is_described_by_frequency_and_channel() {
        let structure =
            RemainingStructure::of(&columns(|t| 0.6 * (TAU * 1.7 * t).sin()), &NAMES, 0.25);
        assert!(structure.peak_hz.is_some_and(|hz| (hz - 1.7).abs() < 0.05), "{structure:?}");
        let [channel] = structure.channels[..] else { panic!("{structure:?}") };
        assert_eq!((channel.sensor, channel.axis), (3, "z"));
        assert!(channel.share > 0.9, "{structure:?}");
        // An amplitude of 0.6 on one of six channels.
        let expected_g = (0.18_f64 / 6.0).sqrt();
        assert!((structure.excess_g / expected_g - 1.0).abs() < 0.05, "{structure:?}");
        assert_eq!(structure.share, 0.75);
    }

    #[test]
    fn slow_drift_has_a_long_correlation_and_no_frequency() {
        let structure =
            RemainingStructure::of(&columns(|t| if t < 10.0 { 0.5 } else { -0.5 }), &NAMES, 0.0);
        assert!(structure.correlation_s > 1.0, "{structure:?}");
        let white = RemainingStructure::of(&columns(|_| 0.0), &NAMES, 0.0);
        assert_eq!(white.peak_hz, None);
        assert!(white.correlation_s < 0.1 && white.excess_g < 0.02, "{white:?}");
    }

    #[test]
    fn the_recording_with_most_of_the_excess_is_named() {
        let mut tables = columns(|_| 0.0);
        for table in &mut tables {
            let later = table.recording.clone().into_iter().map(|number| number + 2);
            let (times, left, floor) =
                (table.time_s.clone(), table.residual.clone(), table.floor2.clone());
            table.recording.extend(later);
            table.time_s.extend(times);
            table.residual.extend(left);
            table.floor2.extend(floor);
        }
        let names = ["1", "2", "3", "4"];
        assert_eq!(RemainingStructure::of(&tables, &names, 0.0).recordings, []);
        let table = &mut tables[1];
        for (recording, left) in table.recording.iter().zip(&mut table.residual) {
            left.z += if *recording == 2 { 0.5 } else { 0.0 };
        }
        let structure = RemainingStructure::of(&tables, &names, 0.0);
        let [one] = &structure.recordings[..] else { panic!("{structure:?}") };
        assert_eq!(one.recording, "3");
        assert!(one.share > 0.9, "{structure:?}");
    }
}
