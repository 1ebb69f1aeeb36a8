//! Effects on which a recording can decide, by the criteria of the diagnosis: whether a typical magnitude of an effect
//! would be detected, given excitation, noise and the parameters of the base model.

use crate::diagnose::candidates::{UntestableEffect, candidates, insufficient};
use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::residuals::{block_s, residual_tables};
use crate::diagnose::verdict::{Reason, Verdict, VerdictKind, record_of};
use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::{FitSetup, SEARCH_ROWS};
use model_export::fit::score_test::{CandidateScore, ScoreTest};
use model_export::recordings::columns::Axis;
use model_export::recordings::noise::WhiteNoise;
use model_export::recordings::recording::ForceSeries;
use model_export::recordings::{Campaign, Recording};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Times in seconds and forces in newtons, by sensor and axis.
pub type ForceEstimates = BTreeMap<(u32, Axis), Vec<[f64; 2]>>;

/// Effects on which a recording can and cannot decide.
#[derive(Clone, Debug, Default)]
pub struct RecordingCheck {
    /// Decidable effects, with the typical magnitude in standard errors.
    pub decidable: Vec<(String, f64)>,
    /// All others, with the reason and the recommended recording.
    pub inconclusive: Vec<Verdict>,
}

/// Checks a campaign with the base model of its design. Effects that the campaign contains increase the residual and
/// may mask others, as in the diagnosis.
pub fn check_recordings(campaign: &Campaign, options: FitOptions) -> RecordingCheck {
    let (testable, untestable) = candidates(campaign, None, &[], &[]);
    let mut check = RecordingCheck {
        inconclusive: untestable.iter().map(UntestableEffect::verdict).collect(),
        ..RecordingCheck::default()
    };
    let scores = scores(campaign, &testable, options);
    let unfitted = scores.as_ref().err().map(|error| format!("{error:#}"));
    let mut scores = scores.unwrap_or_default().into_iter();
    for effect in &testable {
        let score = scores.next().flatten();
        let reason = match (&score, &unfitted) {
            (_, Some(error)) => Some(Reason::Unfitted(error.clone())),
            (Some(score), None) => insufficient(score),
            (None, None) => Some(Reason::HardlyChangesField),
        };
        let z_typical = score.map_or(0.0, |score| score.z_typical);
        match reason {
            None => check.decidable.push((effect.name().to_owned(), z_typical)),
            Some(reason) => {
                let record = record_of(effect);
                let open = Verdict::new(effect.name(), VerdictKind::Inconclusive, reason);
                check.inconclusive.push(Verdict { z_typical, record, ..open });
            }
        }
    }
    check
}

/// Score tests of the effects on the fitted base model.
fn scores(
    campaign: &Campaign,
    effects: &[EffectTerm],
    options: FitOptions,
) -> Result<Vec<Option<CandidateScore>>> {
    let setup = FitSetup::cylinder(campaign)?.sampled(SEARCH_ROWS);
    let model = FittedModel::without_validation(&setup, Vec::new(), options)?;
    let block_s = block_s(&residual_tables(campaign, &setup, &model));
    let test = ScoreTest::new(&setup, &model.effects, &model.fit, block_s);
    Ok(effects.par_iter().map(|effect| test.score(effect)).collect())
}

/// Adds estimated forces where the recording has no reference; returns the number of added columns.
pub fn add_missing_forces(recording: &mut Recording, estimates: &ForceEstimates) -> usize {
    let mut added = 0;
    for (&key, samples) in estimates {
        if recording.forces.contains_key(&key) || !recording.sensors.contains_key(&key.0) {
            continue;
        }
        let newtons: Vec<f64> =
            recording.time_s.iter().map(|time_s| interpolated(samples, *time_s)).collect();
        let mut noise = WhiteNoise::default();
        newtons.iter().for_each(|newtons| noise.push(*newtons));
        let noise_n = noise.estimate().unwrap_or(f64::NAN);
        recording.forces.insert(key, ForceSeries { newtons, noise_n });
        added += 1;
    }
    added
}

/// Linear interpolation in samples of time and value; NaN outside.
fn interpolated(samples: &[[f64; 2]], time_s: f64) -> f64 {
    let after = samples.partition_point(|[time, _]| *time < time_s);
    match (after.checked_sub(1).and_then(|before| samples.get(before)), samples.get(after)) {
        (_, Some([time, value])) if *time == time_s => *value,
        (Some([from_s, from]), Some([to_s, to])) => {
            from + (to - from) * (time_s - from_s) / (to_s - from_s)
        }
        _ => f64::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_interpolated_and_unknown_outside() {
        let samples = [[1.0, 10.0], [2.0, 20.0]];
        assert_eq!(
            [1.0, 1.25, 2.0].map(|time_s| interpolated(&samples, time_s)),
            [10.0, 12.5, 20.0]
        );
        assert!(interpolated(&samples, 0.9).is_nan() && interpolated(&samples, 2.1).is_nan());
        assert!(interpolated(&[], 0.0).is_nan());
    }
}
