//! What the recordings cannot tell apart, whatever they show: a force's history from its rate under one
//! sine, a temperature from time where every recording warms up alike.

use model_export::effects::{Addition, Track};
use model_export::fit::campaign::Prepared;

use super::kin::BY_HISTORY;

/// The amplitude, from value and rate, of what counts as one sine spreads by less than this share.
const STEADY: f64 = 0.2;
/// Rows at rest and rows where the sine begins or ends take no part: an amplitude below this share of the
/// largest.
const LOADED: f64 = 0.3;
/// Share of the rows that must be loaded.
const MOSTLY: f64 = 0.5;

/// Instants of each recording at which temperatures are compared.
const INSTANTS: usize = 20;
/// Temperatures that differ by less than this share of their span are alike.
const ALIKE: f64 = 0.1;

/// What the recordings' programme makes alike.
#[derive(Clone, Copy, Debug, Default)]
pub struct Excitation {
    single_sine: bool,
    same_warm_up: bool,
}

impl Excitation {
    /// Of a campaign.
    pub fn of(prepared: &Prepared) -> Self {
        Self {
            single_sine: is_single_sine(prepared),
            same_warm_up: is_same_warm_up(prepared),
        }
    }

    /// True where one of two effects can hardly be told from the other here but by its form.
    pub fn hides_the_difference(self, one: &Addition, other: &Addition) -> bool {
        let both = |ids: &[&str]| [one, other].iter().all(|e| ids.contains(&e.name()));
        (self.single_sine && both(BY_HISTORY)) || (self.same_warm_up && both(BY_WARMTH))
    }
}

/// Offsets that follow the temperature, or the time.
const BY_WARMTH: &[&str] = &["sensor_temperature", "field_drift"];

/// True where the temperature takes the same course in every recording.
fn is_same_warm_up(prepared: &Prepared) -> bool {
    let courses: Vec<Vec<Vec<f64>>> = prepared
        .rows
        .iter()
        .map(|rows| {
            let tracks = rows.parts.iter().map(|part| &part.track);
            tracks.map(|track| course(&track.temperature_c)).collect()
        })
        .collect();
    let sensor = |courses: &Vec<Vec<f64>>| {
        let all = || courses.iter().flatten();
        let high = all().copied().fold(f64::NEG_INFINITY, f64::max);
        let low = all().copied().fold(f64::INFINITY, f64::min);
        let first = courses.first().map_or(&[][..], Vec::as_slice);
        let alike = |other: &Vec<f64>| {
            let mut pairs = first.iter().zip(other);
            other.len() == INSTANTS && pairs.all(|(a, b)| (a - b).abs() <= ALIKE * (high - low))
        };
        courses.len() > 1 && courses.iter().all(alike)
    };
    !courses.is_empty() && courses.iter().all(sensor)
}

/// Means of even stretches of a column; none where it was not recorded.
fn course(column: &[f64]) -> Vec<f64> {
    let length = column.len() / INSTANTS;
    match length {
        0 => Vec::new(),
        _ => column
            .chunks_exact(length)
            .take(INSTANTS)
            .map(|stretch| stretch.iter().sum::<f64>() / length as f64)
            .collect(),
    }
}

/// True where every force that moves is one sine of one amplitude over the whole campaign: there a delay,
/// a lag and friction all turn the same line into the same ellipse.
fn is_single_sine(prepared: &Prepared) -> bool {
    let axes = prepared.rows.iter().flat_map(|rows| {
        let tracks = || rows.parts.iter().map(|part| &part.track);
        [0, 1].map(|axis| steadiness(tracks(), axis))
    });
    let moving: Vec<bool> = axes.flatten().collect();
    !moving.is_empty() && moving.iter().all(|steady| *steady)
}

/// Whether the amplitude of one axis is steady; `None` where it does not move.
fn steadiness<'a>(tracks: impl Iterator<Item = &'a Track> + Clone, axis: usize) -> Option<bool> {
    let pairs = || {
        tracks.clone().flat_map(move |track| {
            let rows = track.smooth_n.iter().zip(&track.rate_n_per_s);
            rows.map(move |(force, rate)| (force[axis], rate[axis]))
        })
    };
    let count = pairs().count().max(1) as f64;
    let mean = pairs().map(|(force, _)| force).sum::<f64>() / count;
    let (forces, rates) = pairs().fold((0.0, 0.0), |(f, r), (force, rate)| {
        (f + (force - mean).powi(2), r + rate * rate)
    });
    if rates <= 0.0 || (forces / count).sqrt() < 1.0 {
        return None;
    }
    let per_omega_squared = forces / rates;
    let amplitude = |(force, rate): (f64, f64)| {
        ((force - mean).powi(2) + rate * rate * per_omega_squared).sqrt()
    };
    let amplitudes: Vec<f64> = pairs().map(amplitude).collect();
    let most = amplitudes.iter().copied().fold(0.0, f64::max);
    let loaded: Vec<f64> = amplitudes
        .into_iter()
        .filter(|amplitude| *amplitude > LOADED * most)
        .collect();
    let n = loaded.len().max(1) as f64;
    let mean = loaded.iter().sum::<f64>() / n;
    let spread = (loaded.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / n).sqrt();
    Some(n > MOSTLY * count && spread < STEADY * mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steady(force: impl Fn(f64) -> f64) -> Option<bool> {
        let time_s: Vec<f64> = (0..3000).map(|i| 0.01 * f64::from(i)).collect();
        let force_n = time_s.iter().map(|t| [force(*t), 0.0]).collect();
        let track = Track {
            time_s,
            ..Track::default()
        };
        steadiness([&track.under(force_n)].into_iter(), 0)
    }

    #[test]
    fn one_sine_after_a_rest_is_one_and_two_are_not() {
        let sine = |t: f64| match t {
            t if t < 0.5 => 0.0,
            t => 150.0 * (3.0 * (t - 0.5)).sin(),
        };
        assert_eq!(steady(sine), Some(true));
        assert_eq!(
            steady(|t| 100.0 * (3.0 * t).sin() + 80.0 * (7.3 * t).sin()),
            Some(false)
        );
        assert_eq!(steady(|t| 15.0 * t * (3.0 * t).sin()), Some(false));
        assert_eq!(steady(|_| 0.0), None);
    }
}
