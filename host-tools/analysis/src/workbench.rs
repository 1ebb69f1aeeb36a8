//! Models of one campaign side by side: the base with any set of effects. Each is fitted, evaluated on held-out rows, and screened
//! for missing effects; the latest are kept.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::{FitSetup, SEARCH_ROWS};
use model_export::fit::cross_validation::CvSplit;
use model_export::fit::score_test::ScoreTest;
use model_export::model_file::{BaseKind, ModelFile, Provenance};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::columns::force_column_name;
use serde::Deserialize;

use crate::compare::campaign_reader::{Caching, CampaignReader, ScannedCampaign};
use crate::compare::checked_campaign::model_findings;
use crate::compare::covariates::{Covariate, all_covariates};
use crate::compare::pipeline::evaluate;
use crate::compare::{Comparison, ForceError};
use crate::data_quality::{Finding, merge};
use crate::diagnose::candidates::{UntestableEffect, candidates, screen};
use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::observer::Observer;
use crate::diagnose::residuals::{block_s, residual_tables, residuals_against};
use crate::diagnose::{Diagnosis, Scope, diagnose};
use crate::edit_model::check_effects;
use crate::model::Model;

/// Models that are kept: each holds its errors over time. A page compares two.
const MAX_MODELS: usize = 32;

/// Name of the model without effects.
const BASE: &str = "base";

/// The models of a campaign.
pub struct Workbench {
    /// Setup errors in the recordings' files.
    findings: Vec<Finding>,
    /// Effects of the catalogue that these recordings cannot test.
    pub untestable: Vec<UntestableEffect>,
    base: BaseKind,
    reader: CampaignReader,
    campaign: Campaign,
    setup: FitSetup,
    /// A part of the rows, for the screening.
    sample: FitSetup,
    /// Effects of the catalogue that these recordings can test.
    testable: Vec<EffectTerm>,
    options: FitOptions,
    /// The one that was used last at the end.
    models: Mutex<VecDeque<Arc<WorkbenchModel>>>,
}

/// One model of a campaign.
pub struct WorkbenchModel {
    /// The model, fitted to all rows, with effects of the catalogue and formulas.
    pub model: Model,
    /// Its errors on held-out rows.
    pub comparison: Comparison,
    /// What every other effect would add, smallest predicted force error first.
    pub candidates: Vec<ScoredEffect>,
    stage: FittedModel,
}

/// Residuals of one channel over a covariate, of the fit to all rows.
pub struct ResidualScatter {
    pub covariate: Covariate,
    /// Covariate and residual in gauss, in order of time.
    pub all: Vec<[f64; 2]>,
    /// The same within a time interval of one recording.
    pub interval: Vec<[f64; 2]>,
}

/// A channel and a time interval of a recording.
#[derive(Clone, Debug, Deserialize)]
pub struct Interval {
    pub recording: String,
    pub sensor: u32,
    /// Index of the field axis.
    pub axis: usize,
    /// Start and end in seconds of the recording.
    pub from: f64,
    /// See [`Interval::from`].
    pub to: f64,
}

/// What an effect would add to a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoredEffect {
    pub effect: String,
    /// Predicted excess of the force error over its noise with the effect, in newtons, by the linearised model; `None` where the
    /// device computes no forces.
    pub excess_n: Option<f64>,
    /// Predicted reduction of the held-out squared error of the field, as a fraction, by the linearised model.
    pub gain: f64,
    /// p-value adjusted for all effects.
    pub p_adjusted: f64,
    /// Whether the p-value is below 5 % and the error falls in every fold.
    pub is_significant: bool,
}

/// Whether two terms are the same, also in their formula: terms are equal if they have one name.
fn is_same(one: &EffectTerm, other: &EffectTerm) -> bool {
    match (one, other) {
        (EffectTerm::Expression(one), EffectTerm::Expression(other)) => {
            one.text == other.text && one.ranges == other.ranges
        }
        _ => one == other,
    }
}

impl WorkbenchModel {
    /// Held-out force error; `None` where the device cannot compute the forces.
    pub fn force(&self) -> Option<ForceError> {
        self.comparison.force()
    }
}

impl Workbench {
    /// Reads a campaign and fits the base: the design's, or polynomials where there is no design. If setup errors prevent any
    /// result, they are returned instead.
    ///
    /// # Errors
    /// A recording cannot be read, or the fit fails.
    pub fn open(
        folder: &Path,
        alignment: Alignment,
        options: FitOptions,
    ) -> Result<Result<Self, Vec<Finding>>> {
        let scanned = ScannedCampaign::open(folder, alignment, Caching::Always)?;
        let Some(reader) = scanned.reader else {
            return Ok(Err(scanned.findings));
        };
        reader.check_distinct()?;
        let campaign = reader.whole()?.into_owned();
        let (setup, base) = match campaign.design() {
            Some(_) => (FitSetup::cylinder(&campaign)?, BaseKind::Cylinder),
            None => (FitSetup::polynomial(&campaign, None, options)?, BaseKind::Polynomial),
        };
        let fit = setup.fit(&[], setup.split(&[]), options, |_| ())?;
        let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
        let file = ModelFile::with_effects(&campaign, &setup, &fit, &[], provenance);
        let (testable, untestable) = candidates(&campaign, Some(&file), &[], &[]);
        let model = Model::of(Path::new(BASE), file)?;
        let findings = merge(scanned.findings.clone(), model_findings(&reader, &model)?);
        if findings.iter().any(|finding| finding.stops) {
            return Ok(Err(findings));
        }
        Ok(Ok(Self {
            findings: scanned.findings,
            untestable,
            base,
            sample: setup.sampled_by_fold(SEARCH_ROWS),
            reader,
            campaign,
            setup,
            testable,
            options,
            models: Mutex::default(),
        }))
    }

    /// Columns of the recordings for formulas.
    pub fn covariates(&self) -> Vec<String> {
        let first = self.campaign.recordings.first();
        first.map_or_else(Vec::new, |recording| {
            let forces = recording.forces_on_several().map(force_column_name);
            recording.covariates.keys().cloned().chain(forces).collect()
        })
    }

    /// The model with these effects, if it was fitted for a comparison with a model with the effects `compared`.
    pub fn fitted(
        &self,
        effects: &[EffectTerm],
        compared: &[EffectTerm],
    ) -> Option<Arc<WorkbenchModel>> {
        let split = self.split(effects, compared);
        let mut models = self.models.lock().unwrap_or_else(PoisonError::into_inner);
        let place = models.iter().position(|known| {
            known.stage.fit.split == split
                && known.model.effects.len() == effects.len()
                && known.model.effects.iter().zip(effects).all(|(a, b)| is_same(a, b))
        });
        let model = models.remove(place?)?;
        models.push_back(model.clone());
        Some(model)
    }

    /// The folds that models with both sets of effects need.
    fn split(&self, effects: &[EffectTerm], compared: &[EffectTerm]) -> CvSplit {
        self.setup.split(&[effects, compared].concat())
    }

    /// Fits the model with these effects, unless it was fitted before; its folds are those that a model with the effects `compared`
    /// needs too. Of many models the one that was not used for the longest time is dropped.
    ///
    /// # Errors
    /// The recordings cannot identify an effect, a fit fails, or a recording was removed meanwhile.
    pub fn fit_model(
        &self,
        effects: &[EffectTerm],
        compared: &[EffectTerm],
    ) -> Result<Arc<WorkbenchModel>> {
        if let Some(known) = self.fitted(effects, compared) {
            return Ok(known);
        }
        // The replay reads the recordings again.
        recording_folders(&self.reader.folder)?;
        let model = Arc::new(self.fit(effects, compared)?);
        let mut models = self.models.lock().unwrap_or_else(PoisonError::into_inner);
        models.push_back(model.clone());
        let surplus = models.len().saturating_sub(MAX_MODELS);
        models.drain(..surplus);
        Ok(model)
    }

    fn fit(&self, effects: &[EffectTerm], compared: &[EffectTerm]) -> Result<WorkbenchModel> {
        let mut notes = check_effects(effects, self.base, &self.campaign, &self.setup)?;
        let split = self.split(effects, compared);
        let fit = self.setup.fit(effects, split, self.options, |_| ())?;
        let provenance =
            Provenance::of(&self.campaign, self.reader.alignment.delay_us, self.options)?;
        let file = ModelFile::with_effects(&self.campaign, &self.setup, &fit, effects, provenance);
        let name = effects.iter().map(EffectTerm::name).collect::<Vec<_>>().join(" + ");
        let path = PathBuf::from(if name.is_empty() { BASE } else { &name });
        let model = Model { path, file, effects: effects.to_vec() };
        let findings = merge(self.findings.clone(), model_findings(&self.reader, &model)?);
        let stage = FittedModel { effects: effects.to_vec(), fit };
        let comparison = evaluate(
            &model,
            &self.reader,
            Some((&self.setup, &stage.fit)),
            None,
            compared,
            (&findings, self.options),
            &mut notes,
        )?;
        let comparison = Comparison { findings, notes, ..comparison };
        let candidates = self.screen(&stage, comparison.force());
        Ok(WorkbenchModel { model, comparison, candidates, stage })
    }

    /// Diagnoses what is missing from a model, and with `plans` which recording decides what is open.
    ///
    /// # Errors
    /// A fit fails.
    pub fn diagnose(&self, model: &WorkbenchModel, plans: bool) -> Result<Diagnosis> {
        let campaign = (&self.campaign, self.reader.alignment);
        let model = Model { path: PathBuf::from("model.toml"), ..model.model.clone() };
        let scope = Scope { plans, ..Scope::CATALOGUE };
        let observer = Observer::default();
        Ok(diagnose(campaign, &model, &[], scope, self.options, &observer)?.0)
    }

    /// Covariates over which residuals can be shown: those with values in the recordings.
    pub fn residual_covariates(&self) -> Vec<Covariate> {
        let all = self.campaign.recordings.first().map_or_else(Vec::new, all_covariates);
        let first = self.setup.rows.first().and_then(|rows| rows.parts.first());
        let has_values = |covariate: &Covariate| {
            let values = first.and_then(|part| covariate.values(&part.track, 1));
            values.is_some_and(|values| values.iter().any(|value| value.is_finite()))
        };
        all.into_iter().filter(has_values).collect()
    }

    /// The base as options of `fit`.
    pub fn base(&self) -> BaseKind {
        self.base
    }

    /// Residuals of a model over the covariate of this name.
    ///
    /// # Errors
    /// There is no such covariate, sensor or recording.
    pub fn scatter(
        &self,
        model: &WorkbenchModel,
        covariate: &str,
        interval: &Interval,
    ) -> Result<ResidualScatter> {
        let covariates = self.residual_covariates();
        let covariate = covariates.into_iter().find(|known| known.name == covariate);
        let covariate = covariate.context("there is no such covariate")?;
        let tables = residuals_against(&self.setup, &model.stage, std::slice::from_ref(&covariate));
        let table = tables.iter().find(|table| table.sensor == interval.sensor);
        let table = table.with_context(|| format!("there is no sensor {}", interval.sensor))?;
        let place = self.campaign.recordings.iter().position(|one| one.name == interval.recording);
        let place =
            place.with_context(|| format!("there is no recording {}", interval.recording))?;
        let values = table.covariates.first().map_or(&[][..], |column| &column.values);
        let mut scatter = ResidualScatter { covariate, all: Vec::new(), interval: Vec::new() };
        for (row, (value, residual)) in values.iter().zip(&table.residual).enumerate() {
            let point =
                [f64::from(*value), *residual.get(interval.axis).context("there is no such axis")?];
            if !point.iter().all(|number| number.is_finite()) {
                continue;
            }
            scatter.all.push(point);
            let is_inside = (interval.from..=interval.to).contains(&table.time_s[row]);
            if table.recording[row] as usize == place && is_inside {
                scatter.interval.push(point);
            }
        }
        Ok(scatter)
    }

    /// Scores the effects that may be missing from a model.
    fn screen(&self, stage: &FittedModel, force: Option<ForceError>) -> Vec<ScoredEffect> {
        let block_s = block_s(&residual_tables(&self.campaign, &self.sample, stage));
        let around = ScoreTest::new(&self.sample, &stage.effects, &stage.fit, block_s);
        let others: Vec<EffectTerm> = self
            .testable
            .iter()
            .filter(|effect| !stage.effects.contains(effect))
            .cloned()
            .collect();
        let screened = screen(&around, &others, self.options.seed);
        let scored = screened.iter().map(|one| ScoredEffect {
            effect: one.candidate.name().to_owned(),
            excess_n: force.map(|force| force.excess_less(one.evidence.force_reduction_n2())),
            gain: one.evidence.gain(),
            p_adjusted: one.p_adjusted,
            is_significant: one.is_significant(),
        });
        let mut scored: Vec<ScoredEffect> = scored.collect();
        // Where there are no forces, the order of the screening is kept.
        scored.sort_by(|a, b| a.excess_n.unwrap_or(0.0).total_cmp(&b.excess_n.unwrap_or(0.0)));
        scored
    }
}
