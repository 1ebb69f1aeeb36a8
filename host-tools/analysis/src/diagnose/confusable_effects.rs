//! Effects that are hard to distinguish on the recordings at hand.
//!
//! No effect of the catalogue has exactly the form of a real one: friction is not three sliders, creep not two
//! time constants. The remainder of an accepted effect resembles effects of a similar pattern ([`Similarity`]), or is explained
//! by other forms of that effect ([`model_export::fit::score_test::ScoreTest::form_gain`]), and is much smaller; such a
//! remainder is not named.

use crate::diagnose::candidates::ScreenedEffect;
use crate::statistics::mean_and_std;
use model_export::effects::{EffectStage, EffectTerm, ExcitationSeries, Signature, find};
use model_export::fit::campaign::FitSetup;
use rayon::prelude::*;

/// Signatures of an effect; none for a user-defined one.
fn signatures(effect: &EffectTerm) -> &'static [Signature] {
    find(effect.name()).map_or(&[], |effect| effect.signatures)
}

/// Minimum share of an effect's pattern that a similar one reproduces. (Of 3 x 30 s in which everything varies: lags, friction
/// and creep 0.43 to 0.99 of each other; effects with different covariates below 0.3.)
const SIMILAR: f64 = 0.4;

/// How similar the patterns of effects are on the recordings: what each one does to the fields, without what the parameters of
/// the model absorb.
#[derive(Clone, Debug, Default)]
pub struct Similarity {
    /// Effect, another one, and the share of the squared pattern of the second that the first reproduces.
    shares: Vec<(String, String, f64)>,
}

impl Similarity {
    /// Of all pairs of these candidates.
    pub fn of(screened: &[ScreenedEffect]) -> Self {
        let name = |screened: &ScreenedEffect| screened.candidate.name().to_owned();
        let of_one = |one: &ScreenedEffect| -> Vec<(String, String, f64)> {
            let others = screened.iter().filter(|other| other.candidate != one.candidate);
            let share = |other: &ScreenedEffect| one.evidence.reproduced_share(&other.evidence);
            others.map(|other| (name(one), name(other), share(other))).collect()
        };
        Self { shares: screened.par_iter().flat_map(of_one).collect() }
    }

    /// Other effects, each with the share of its pattern that `effect` reproduces, largest first.
    pub fn reproduced_by(&self, effect: &str) -> Vec<(String, f64)> {
        let own = self.shares.iter().filter(|(one, ..)| one == effect);
        let mut list: Vec<(String, f64)> =
            own.map(|(_, other, share)| (other.clone(), *share)).collect();
        list.sort_by(|a, b| b.1.total_cmp(&a.1));
        list
    }

    /// Whether one of them reproduces much of the pattern of the other.
    pub fn are_similar(&self, one: &EffectTerm, other: &EffectTerm) -> bool {
        self.shares.iter().any(|(a, b, share)| {
            let is_pair = |x: &str, y: &str| a == x && b == y;
            *share >= SIMILAR
                && (is_pair(one.name(), other.name()) || is_pair(other.name(), one.name()))
        })
    }
}

/// Maximum relative standard deviation of the amplitude of a single sine.
const MAX_VARIATION: f64 = 0.2;
/// Minimum amplitude of a loaded row, relative to the maximum; excludes rest and transitions.
const LOADED: f64 = 0.3;
/// Minimum fraction of loaded rows.
const MIN_LOADED: f64 = 0.5;

/// Number of intervals per recording in which temperatures are compared.
const INTERVALS: usize = 20;
/// Maximum difference of equal temperatures, relative to their range.
const TOLERANCE: f64 = 0.1;

/// Covariates that the excitation of the recordings makes collinear.
#[derive(Clone, Copy, Debug, Default)]
pub struct Collinearity {
    single_sine: bool,
    same_warm_up: bool,
}

impl Collinearity {
    /// Collinearity in a campaign.
    pub fn of(prepared: &FitSetup) -> Self {
        Self { single_sine: is_single_sine(prepared), same_warm_up: is_same_warm_up(prepared) }
    }

    /// True if these recordings hardly distinguish two effects.
    pub fn hides_the_difference(self, one: &EffectTerm, other: &EffectTerm) -> bool {
        let both = |condition: fn(&EffectTerm) -> bool| condition(one) && condition(other);
        (self.single_sine && both(depends_on_load_history))
            || (self.same_warm_up && both(is_sensor_drift))
    }
}

fn depends_on_load_history(effect: &EffectTerm) -> bool {
    signatures(effect).contains(&Signature::LoadHistory)
}

/// True for errors of the Hall sensor that depend on temperature or time.
fn is_sensor_drift(effect: &EffectTerm) -> bool {
    let is_of_sensor = find(effect.name()).is_ok_and(|e| e.stage == EffectStage::Sensor);
    let drifts = |signature| matches!(signature, &Signature::Temperature | &Signature::Time);
    is_of_sensor && signatures(effect).iter().any(drifts)
}

/// True if the temperature has the same profile in every recording.
fn is_same_warm_up(prepared: &FitSetup) -> bool {
    let profiles: Vec<Vec<Vec<f64>>> = prepared
        .rows
        .iter()
        .map(|rows| {
            let tracks = rows.parts.iter().map(|part| &part.track);
            tracks.map(|track| profile(&track.temperature_c)).collect()
        })
        .collect();
    let sensor = |profiles: &Vec<Vec<f64>>| {
        let all = || profiles.iter().flatten();
        let high = all().copied().fold(f64::NEG_INFINITY, f64::max);
        let low = all().copied().fold(f64::INFINITY, f64::min);
        let first = profiles.first().map_or(&[][..], Vec::as_slice);
        let alike = |other: &Vec<f64>| {
            let mut pairs = first.iter().zip(other);
            other.len() == INTERVALS
                && pairs.all(|(a, b)| (a - b).abs() <= TOLERANCE * (high - low))
        };
        profiles.len() > 1 && profiles.iter().all(alike)
    };
    !profiles.is_empty() && profiles.iter().all(sensor)
}

/// Means over equal intervals of a column; empty where it was not recorded.
fn profile(column: &[f64]) -> Vec<f64> {
    let length = column.len() / INTERVALS;
    match length {
        0 => Vec::new(),
        _ => column
            .chunks_exact(length)
            .take(INTERVALS)
            .map(|stretch| stretch.iter().sum::<f64>() / length as f64)
            .collect(),
    }
}

/// True if every force is a sine of constant amplitude in every recording: delay, lag and friction then have the same elliptic
/// response.
fn is_single_sine(prepared: &FitSetup) -> bool {
    let parts = prepared.rows.iter().flat_map(|rows| &rows.parts);
    let axes = parts.flat_map(|part| [0, 1].map(|axis| is_steady(&part.track, axis)));
    let moving: Vec<bool> = axes.flatten().collect();
    !moving.is_empty() && moving.iter().all(|steady| *steady)
}

/// Whether the amplitude of one axis is constant; `None` without load.
fn is_steady(track: &ExcitationSeries, axis: usize) -> Option<bool> {
    let pairs = || {
        let rows = track.smooth_n.iter().zip(&track.rate_n_per_s);
        rows.map(move |(force, rate)| (force[axis], rate[axis]))
    };
    let count = pairs().count().max(1) as f64;
    let mean = pairs().map(|(force, _)| force).sum::<f64>() / count;
    let (forces, rates) = pairs()
        .fold((0.0, 0.0), |(f, r), (force, rate)| (f + (force - mean).powi(2), r + rate * rate));
    if rates <= 0.0 || (forces / count).sqrt() < 1.0 {
        return None;
    }
    let per_omega_squared = forces / rates;
    let amplitude = |(force, rate): (f64, f64)| {
        ((force - mean).powi(2) + rate * rate * per_omega_squared).sqrt()
    };
    let amplitudes: Vec<f64> = pairs().map(amplitude).collect();
    let max = amplitudes.iter().copied().fold(0.0, f64::max);
    let loaded: Vec<f64> =
        amplitudes.into_iter().filter(|amplitude| *amplitude > LOADED * max).collect();
    let (mean, sigma) = mean_and_std(&loaded);
    Some(loaded.len() as f64 > MIN_LOADED * count && sigma < MAX_VARIATION * mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::effects::find;

    #[test]
    fn effects_are_similar_where_one_reproduces_the_other() {
        let effect = |id| EffectTerm::Catalogue(find(id).unwrap());
        let share = |one: &str, other: &str, share| (one.to_owned(), other.to_owned(), share);
        let similarity = Similarity {
            shares: vec![
                share("viscous_lag", "clock_skew", 0.92),
                share("clock_skew", "viscous_lag", 0.3),
                share("creep", "field_drift", 0.2),
            ],
        };
        assert!(similarity.are_similar(&effect("clock_skew"), &effect("viscous_lag")));
        assert!(!similarity.are_similar(&effect("creep"), &effect("field_drift")));
        assert!(!similarity.are_similar(&effect("creep"), &effect("viscous_lag")));
        assert_eq!(similarity.reproduced_by("clock_skew"), [("viscous_lag".to_owned(), 0.3)]);
    }

    fn steady(force: impl Fn(f64) -> f64) -> Option<bool> {
        let time_s: Vec<f64> = (0..3000).map(|i| 0.01 * f64::from(i)).collect();
        let force_n = time_s.iter().map(|t| [force(*t), 0.0]).collect();
        let track = ExcitationSeries { time_s, ..ExcitationSeries::default() };
        is_steady(&track.with_forces(force_n), 0)
    }

    #[test]
    fn single_sine_is_detected_after_a_rest() {
        let sine = |t: f64| match t {
            t if t < 0.5 => 0.0,
            t => 150.0 * (3.0 * (t - 0.5)).sin(),
        };
        assert_eq!(steady(sine), Some(true));
        assert_eq!(steady(|t| 100.0 * (3.0 * t).sin() + 80.0 * (7.3 * t).sin()), Some(false));
        assert_eq!(steady(|t| 15.0 * t * (3.0 * t).sin()), Some(false));
        assert_eq!(steady(|_| 0.0), None);
    }
}
