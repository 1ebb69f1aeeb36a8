//! Cross-validation: which fitted parameters predict which rows, so that no row is predicted by a model that was
//! fitted to it.

use crate::compare::Validation;
use crate::compare::campaign_reader::{CampaignReader, RecordingId};
use crate::model::Model;
use crate::progress;
use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::JointFit;
use model_export::fit::{FitError, FitOptions};
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::Campaign;
use std::path::Path;

/// If the file's own parameters have an error larger by this factor than a new fit to the same recordings, the
/// file is not a fit of these recordings (edited, or by an older version) and is evaluated unchanged.
const NOT_A_FIT: f64 = 1.02;

#[derive(Clone, Debug)]
pub struct RecordingFolds {
    /// Name, folder and hash.
    pub named: RecordingId,
    /// End of each segment in seconds of the recording, and the index of its model, in order.
    pub folds: Vec<(f64, usize)>,
}

/// Cross-validation of a campaign.
pub struct CvPlan {
    /// Models: first the file itself, then one per fold.
    pub models: Vec<Model>,
    /// Recordings in chronological order.
    pub recordings: Vec<RecordingFolds>,
    /// How the errors are separated from the fit.
    pub validation: Validation,
    /// Whether each row is predicted by a fold of the fit that was known before.
    pub is_of_known_fit: bool,
}

impl CvPlan {
    /// Plans the cross-validation of `source`, with new fits if the model was fitted to any of it. `refit` is the fit to all
    /// recordings, if known. The folds are those that a model with the effects `compared` needs too, so that the errors of both are
    /// of the same rows.
    ///
    /// # Errors
    /// A recording cannot be read.
    pub fn new(
        model: &Model,
        source: &CampaignReader,
        refit: Option<(&FitSetup, &JointFit)>,
        compared: &[EffectTerm],
        options: FitOptions,
    ) -> Result<Self> {
        let unseen = |named: &RecordingId| RecordingFolds {
            named: named.clone(),
            folds: vec![(f64::INFINITY, 0)],
        };
        let recordings: Vec<RecordingFolds> = source.names.iter().map(unseen).collect();
        let fitted = model.file.provenance.recordings.len();
        let is_seen = |i: &usize| model.place_of(&recordings[*i].named.sha256) < fitted;
        let seen: Vec<usize> = (0..recordings.len()).filter(is_seen).collect();
        let mut plan = Self {
            models: vec![model.clone()],
            recordings,
            validation: Validation::UnseenRecordings,
            is_of_known_fit: false,
        };
        if !seen.is_empty() {
            plan.refit(source, &seen, refit, compared, options)?;
        }
        Ok(plan)
    }

    /// Plan of a fit with these effects to a whole campaign.
    pub fn of_fit(
        campaign: &Campaign,
        setup: &FitSetup,
        fit: &JointFit,
        effects: &[EffectTerm],
        provenance: &Provenance,
    ) -> Self {
        let read = campaign.recordings.iter().zip(&provenance.recordings).enumerate();
        let recordings = read.map(|(part, (recording, source))| {
            let named = RecordingId {
                folder: recording.folder.clone(),
                name: recording.name.clone(),
                sha256: source.sha256.clone(),
            };
            RecordingFolds { named, folds: segments(setup, fit, part, 0) }
        });
        let recordings: Vec<RecordingFolds> = recordings.collect();
        let all = recordings.len();
        Self {
            models: fold_models(Path::new(FITTED), campaign, setup, fit, effects, provenance),
            recordings,
            validation: Validation::CrossValidated {
                split: fit.split,
                seen: all,
                refitted: all,
                all,
            },
            is_of_known_fit: true,
        }
    }

    /// Fits the model again without the rows of each fold.
    fn refit(
        &mut self,
        source: &CampaignReader,
        seen: &[usize],
        known: Option<(&FitSetup, &JointFit)>,
        compared: &[EffectTerm],
        options: FitOptions,
    ) -> Result<()> {
        // Ten minutes determine the parameters sufficiently; of more, a uniform subset is used.
        let count = source.at_once.max(3).min(seen.len());
        let some: Vec<usize> = (0..count).map(|i| seen[i * seen.len() / count]).collect();
        let campaign = source.campaign(&some)?;
        let model = self.models[0].clone();
        let computed;
        let all_effects = [&model.effects[..], compared].concat();
        let is_usable = |(setup, fit): &(&FitSetup, &JointFit)| {
            some.len() == self.recordings.len() && fit.split == setup.split(&all_effects)
        };
        let known = known.filter(is_usable);
        let (prepared, fit) = match known {
            Some(known) => known,
            None => match fit_model(&campaign, &model, &all_effects, options) {
                Ok(fitted) => {
                    computed = fitted;
                    (&computed.0, &computed.1)
                }
                Err(FitError::Recording(problem)) => return Err(problem.into()),
                Err(why) => {
                    self.validation = Validation::NotHeldOut(why.to_string());
                    return Ok(());
                }
            },
        };
        if let Some(worse) = excess_error(&model, prepared, fit) {
            self.validation = Validation::Edited(worse);
            return Ok(());
        }
        let provenance = Provenance::of(&campaign, source.alignment.delay_us, options)?;
        let first = self.models.len();
        self.models.extend(fold_models(
            &model.path,
            &campaign,
            prepared,
            fit,
            &model.effects,
            &provenance,
        ));
        let all = self.models.len() - 1;
        let names: Vec<String> = campaign.recordings.iter().map(|r| r.name.clone()).collect();
        for &i in seen {
            let recording = &mut self.recordings[i];
            recording.folds = match names.iter().position(|name| *name == recording.named.name) {
                None => vec![(f64::INFINITY, all)],
                Some(part) => segments(prepared, fit, part, first),
            };
        }
        self.is_of_known_fit = known.is_some() && seen.len() == self.recordings.len();
        self.validation = Validation::CrossValidated {
            split: fit.split,
            seen: seen.len(),
            refitted: names.len(),
            all: self.recordings.len(),
        };
        Ok(())
    }
}

/// Name in messages of a model without a file.
const FITTED: &str = "the fitted model";

/// Models fitted without the rows of each fold, then that of all rows; `path` names them in messages.
fn fold_models(
    path: &Path,
    campaign: &Campaign,
    setup: &FitSetup,
    fit: &JointFit,
    effects: &[EffectTerm],
    provenance: &Provenance,
) -> Vec<Model> {
    let of = |fit: &JointFit| Model {
        path: path.to_path_buf(),
        file: ModelFile::with_effects(campaign, setup, fit, effects, provenance.clone()),
        effects: effects.to_vec(),
    };
    let folds = fit.sensors.first().map_or(0, |sensor| sensor.folds.len());
    (0..folds).map(|fold| of(&fit.without(fold))).chain([of(fit)]).collect()
}

/// Fits the base and effects of a model to a campaign, cross-validated as models with `all_effects` need it.
fn fit_model(
    campaign: &Campaign,
    model: &Model,
    all_effects: &[EffectTerm],
    options: FitOptions,
) -> Result<(FitSetup, JointFit), FitError> {
    let bar = progress::progress_bar("cross-validating", campaign.sensors().len());
    let setup = model.file.fit_setup(campaign, options)?;
    let fit = setup.fit(&model.effects, setup.split(all_effects), options, |_| bar.inc(1))?;
    bar.finish_and_clear();
    Ok((setup, fit))
}

/// Error of the file's parameters relative to a fit to the same rows; `None` if the file is that fit.
fn excess_error(model: &Model, prepared: &FitSetup, fit: &JointFit) -> Option<f64> {
    let (mut own, mut rows) = (0.0, 0.0);
    for sensor in &prepared.rows {
        let Some(predictor) = model.file.predictor(sensor.sensor, &model.effects) else {
            continue;
        };
        for part in &sensor.parts {
            let predicted = predictor.over(part, &sensor.forces);
            let errors = part.field_g.iter().zip(&predicted.field_g);
            own += errors.map(|(b, m)| (b - m).norm_squared()).sum::<f64>();
            rows += 3.0 * part.len() as f64;
        }
    }
    let scores = || fit.sensors.iter().flat_map(|sensor| &sensor.scores);
    let squares: f64 = scores().map(|score| score.fitted_rms_g.powi(2)).sum();
    let ratio = (own / rows / (squares / scores().count().max(1) as f64)).sqrt();
    (ratio > NOT_A_FIT).then_some(ratio)
}

/// Segments of a recording with the models of their folds.
fn segments(prepared: &FitSetup, fit: &JointFit, part: usize, first: usize) -> Vec<(f64, usize)> {
    if let Some(fold) = fit.split.fold_of(part) {
        return vec![(f64::INFINITY, first + fold)];
    }
    let Some((rows, of)) = prepared.rows.first().zip(fit.sensors.first()) else {
        return Vec::new();
    };
    let time_s = &rows.parts[part].track.time_s;
    let folds = fit.split.folds(rows, of.block_s);
    let mut list: Vec<(f64, usize)> = folds
        .iter()
        .enumerate()
        .flat_map(|(fold, of)| of.test.iter().map(move |block| (fold, block)))
        .filter(|(_, block)| block.part == part)
        .map(|(fold, block)| {
            let until = time_s.get(block.rows.end).copied();
            (until.unwrap_or(f64::INFINITY), first + fold)
        })
        .collect();
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list
}
