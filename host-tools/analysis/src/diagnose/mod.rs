//! Diagnosis: which physical effect is missing from a model, which effects are equivalent or inconclusive on the data, and
//! what no effect explains.
//!
//! [`Diagnosis`] holds all results; terminal, report and `--json` format them.
//!
//! - [`mod@candidates`]: testable effects, and their screening by a bootstrap score test.
//! - [`candidate_fit`]: a full fit of the significant candidates, of which the best is added.
//! - [`selection`]: state of the selection.
//! - [`mod@forward_selection`]: forward selection, equivalent effects, backward elimination.
//! - [`confusable_effects`]: how similar the effects are on the recordings, and data that cannot separate them.
//! - [`residuals`]: the remaining residual, and what each effect removed of it.
//! - [`remaining_structure`]: what follows no covariate.
//! - [`formulas`]: formulas of the covariates, where the catalogue leaves structure.
//! - [`drifts`]: drifts that explain the same as an effect of time.
//! - [`observer`]: progress, first answer, early end.
//! - [`verdicts`]: a verdict on every candidate.
//! - [`recording_differences`]: zeros and places that differ between recordings, before any effect.
//! - [`recording_plan`]: the shortest recording that decides what is open.
//! - [`recording_check`]: effects on which recordings can decide, before a diagnosis.
//! - [`suggestions`]: the next command.

use crate::compare::cv_plan::ModelRefit;
use crate::compare::force_errors::held_out_forces;
use crate::compare::{EffectOrigin, ForceError};
use crate::data_quality::Finding;
use crate::data_quality::evidence::Evidence;
use crate::diagnose::candidates::candidates;
use crate::diagnose::drifts::equivalent_drifts;
pub use crate::diagnose::formulas::DiscoveredFormula;
use crate::diagnose::formulas::simpler::{SimplerFormula, simpler_formulas};
use crate::diagnose::formulas::{discover, equivalent_formulas};
use crate::diagnose::forward_selection::{
    eliminate_undetermined, forward_selection, reconsider_shadows, tie_delays,
};
use crate::diagnose::observer::Observer;
use crate::diagnose::recording_differences::Differences;
use crate::diagnose::recording_plan::{RecordingProposal, propose};
use crate::diagnose::remaining_structure::RemainingStructure;
pub use crate::diagnose::residuals::EffectShape;
use crate::diagnose::residuals::{residuals_against, shapes};
use crate::diagnose::selection::{DISTINGUISHABLE, FittedModel, Selection, WorstAxis};
pub use crate::diagnose::selection::{DropReason, DroppedStep};
pub use crate::diagnose::suggestions::{Suggestion, SuggestionKind};
use crate::diagnose::verdicts::conclude;
use crate::noise_floor::NoiseSummary;
use anyhow::{Context, Result};
use model_export::effects::{EffectTerm, find};
use model_export::fit::FitOptions;
use model_export::fit::campaign::{FitSetup, SEARCH_ROWS};
use model_export::fit::joint::JointFit;
use model_export::fit::polynomial::{HigherDegree, PolynomialFit};
use model_export::fit::recording_differences::DifferenceCause;
use model_export::inverse::compensation::{DeviceSupport, device_support};
use model_export::model_file::{EffectModel, ModelFile, Provenance};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::mapping::ATTITUDE_COLUMNS;
use serde::Serialize;
use std::borrow::Cow;
use std::path::Path;

pub mod candidate_fit;
pub mod candidates;
pub mod confusable_effects;
pub mod drifts;
pub mod formulas;
pub mod forward_selection;
pub mod observer;
pub mod recording_check;
pub mod recording_differences;
pub mod recording_plan;
pub mod remaining_structure;
pub mod residuals;
pub mod selection;
pub mod suggestions;
pub mod verdicts;

/// Fraction of the work that the comparison of the recordings takes.
const DIFFERENCES: f64 = 0.05;
/// Fraction of the work after the selection that the fits to all rows take.
const ALL_ROWS: f64 = 0.7;
/// Fraction of what then remains that the replays take.
const REPLAYS: f64 = 0.5;

#[derive(Clone, Debug, Default)]
pub struct Diagnosis {
    /// The model's file.
    pub model: String,
    /// The campaign's folder.
    pub campaign: String,
    /// Setup errors in the recordings; if one stops the diagnosis, everything else is empty.
    pub findings: Vec<Finding>,
    /// A verdict on each candidate, sorted by kind and gain.
    pub verdicts: Vec<Verdict>,
    /// Steps that were accepted and dropped again, in this order.
    pub dropped: Vec<DroppedStep>,
    /// Accepted steps, each one effect or several equivalent ones; the effects of formulas last.
    pub accepted: Vec<Vec<String>>,
    /// Formulas of the covariates that explain what no effect of the catalogue does.
    pub formulas: Vec<DiscoveredFormula>,
    /// Formulas that explain as much as the accepted effects together.
    pub equivalent_formulas: Vec<DiscoveredFormula>,
    /// Whether the device compensates the accepted effects, those equivalent to them, and the formulas.
    pub device: Vec<DeviceSupport>,
    /// Residual structure that no effect explains, largest share first.
    pub unexplained: Vec<Unexplained>,
    /// What of the residual follows no covariate; none at the noise floor.
    pub remaining: Option<RemainingStructure>,
    /// Degree of the polynomial that describes the forces clearly better than that of the model.
    pub higher_degree: Option<HigherDegree>,
    /// Offsets of sensors that are confounded with an accepted effect.
    pub confounded_offsets: Option<ConfoundedOffsets>,
    /// The axis with the largest error of the last model, in its noise floors.
    pub worst_axis: Option<WorstAxis>,
    /// True if the residual is indistinguishable from noise.
    pub at_floor: bool,
    /// Noise of the recordings, and how it was estimated.
    pub noise: NoiseSummary,
    /// Cross-validated error after every step.
    pub staircase: Vec<StaircaseStep>,
    /// Effects of the last step whose error is not one of the device's model.
    pub origins: Vec<EffectOrigin>,
    /// Residual removed by each step, in order.
    pub shapes: Vec<EffectShape>,
    /// Proposed recording for what is open, where it was asked for.
    pub proposal: Option<RecordingProposal>,
    /// Suggested next command.
    pub next: Suggestion,
    /// True if it was ended early: candidates and formulas that would have been tried later are missing.
    pub is_interrupted: bool,
    /// True if the effects explain the residual except noise; otherwise names are provisional.
    pub is_complete: bool,
    /// Rows of all sensors by which effects were selected, and all rows, to which the models were fitted.
    pub rows: [usize; 2],
    /// Recordings by which effects were selected, and all recordings.
    pub recordings: [usize; 2],
    /// Number of bootstrap blocks.
    pub blocks: usize,
    /// Length of a block in seconds.
    pub block_s: f64,
    /// Seed of the bootstrap.
    pub seed: u64,
}

/// Kind of a verdict, in the order of display.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VerdictKind {
    /// Present; no other effect explains the same.
    Found,
    /// It or one of its equivalents is present.
    Tied,
    /// It explains only what another effect explains better.
    Shadow,
    /// These recordings are not sufficient.
    Inconclusive,
    /// Absent up to an upper bound.
    Absent,
}

impl VerdictKind {
    /// Identifier in JSON.
    pub fn id(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Tied => "tied",
            Self::Shadow => "shadow",
            Self::Inconclusive => "not_judgeable",
            Self::Absent => "absent",
        }
    }
}

/// Reason of a verdict.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// It reduces the cross-validated error.
    ReducesError,
    /// Others explain the same on these recordings.
    Equivalent,
    /// The effects of this step, the accepted one first, explain more of the same.
    ExplainedBetter(Vec<String>),
    /// Other forms of an accepted effect explain nearly as much.
    FormOf(String),
    /// The residual drifts with time more freely than the effect can.
    DriftsWithTime,
    /// It fits part of a residual with another cause.
    OtherCause,
    /// It only fits with a magnitude that is implausible, negligible or not determined.
    Implausible,
    /// Significant by itself, but not in a full fit.
    Unconfirmed,
    /// Much more than noise is unexplained; the covariate that it follows most, if any.
    UnexplainedResidual(Option<Unexplained>),
    /// A typical magnitude hardly changes the field.
    HardlyChangesField,
    /// It is confounded with the model's parameters.
    Confounded,
    /// The residual of other causes masks a typical magnitude.
    Masked,
    /// 95 % upper bound as a multiple of the typical magnitude.
    BelowBound(f64),
    /// It acts on the magnet, which a polynomial does not model.
    NeedsGeometry,
    /// It depends on the present forces alone: a polynomial of them contains it.
    InPolynomial,
    /// It acts through a force, and none was recorded.
    NeedsForce,
    /// Its magnitude is a field, and the signal of the sensors is in this unit.
    NotAField(&'static str),
    /// A column was not recorded in these recordings; none listed: in no recording.
    NotRecorded(String, Vec<String>),
    /// It depends on times that are assumed.
    AssumedTimes(AssumedTimes),
    /// A column does not vary beyond its noise.
    DoesNotVary(String),
    /// The order of the rows carries no time.
    NoTimeOrder,
    /// The base model cannot be fitted, with the error.
    Unfitted(String),
}

impl Reason {
    /// What the recordings lack for a test, as a sentence; `None` for other reasons.
    pub fn missing_data(&self) -> Option<String> {
        Some(match self {
            Self::NotRecorded(column, recordings) => match recordings.as_slice() {
                [] => format!("{column} was not recorded"),
                [one] => format!("{column} was not recorded in recording {one}"),
                many => format!("{column} was not recorded in recordings {}", many.join(", ")),
            },
            Self::DoesNotVary(column) => format!("{column} does not vary"),
            Self::NotAField(unit) => format!("the signal is in {unit} and no magnetic field"),
            Self::AssumedTimes(AssumedTimes::Starts) => {
                "the times between the recordings are assumed (state start_s and start = \"stated\" in each recording.toml, or in the \
                 mapping starts_s = [...] or one_clock = true)"
                    .to_owned()
            }
            Self::AssumedTimes(AssumedTimes::Rows) => {
                "the times of the rows are assumed (import with a clock)".to_owned()
            }
            _ => return None,
        })
    }
}

/// Times that are not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AssumedTimes {
    /// Of the recordings' starts.
    Starts,
    Rows,
}

/// The verdict on one effect.
#[derive(Clone, Debug)]
pub struct Verdict {
    pub effect: String,
    pub kind: VerdictKind,
    /// True if much more than noise remains unexplained: names are then provisional, and other effects
    /// inconclusive.
    pub provisional: bool,
    /// Equivalent effects.
    pub tied_with: Vec<String>,
    /// Other effects, each with the share of its pattern on these recordings that this one reproduces, largest first.
    pub reproduces: Vec<(String, f64)>,
    /// Excess of the held-out force error over its noise with this effect, in newtons: of an accepted effect that of its step, of others
    /// as the linearised model predicts it next to the accepted ones. `None` where the force error was not computed, or the effect is
    /// equivalent to an accepted one.
    pub excess_n: Option<f64>,
    /// Reduction of the cross-validated squared error, as a fraction.
    pub gain: f64,
    /// p-value adjusted for all candidates; NaN if not tested.
    pub p_adjusted: f64,
    /// Share of the resamples of the blocks of time in which it reduces the held-out squared error of the linearised model; NaN
    /// if not tested.
    pub inclusion: f64,
    /// Magnitude in `unit`; NaN if not fitted.
    pub value: f64,
    /// Standard error of the magnitude.
    pub std_error: f64,
    /// Unit of the magnitude.
    pub unit: String,
    /// Typical magnitude in standard errors of these recordings.
    pub z_typical: f64,
    /// Plausible range of the magnitude, where the estimate is outside.
    pub implausible: Option<(f64, f64)>,
    pub reason: Reason,
    /// Recording that would decide; empty if none is needed.
    pub record: String,
}

impl Diagnosis {
    /// Whether the effects were sought on recordings without the other places of their magnets.
    pub fn is_without_places(&self) -> bool {
        self.findings.iter().any(|finding| match &finding.evidence {
            Evidence::RecordingDifference { cause, floors, .. } => {
                *cause == DifferenceCause::MagnetPlace
                    && recording_differences::explains_all(*floors)
            }
            _ => false,
        })
    }

    /// Accepted effects are equivalent to formulas that explain as much.
    fn set_equivalent_formulas(&mut self, equivalent_formulas: Vec<DiscoveredFormula>) {
        if equivalent_formulas.is_empty() {
            return;
        }
        let is_accepted =
            |verdict: &&mut Verdict| matches!(verdict.kind, VerdictKind::Found | VerdictKind::Tied);
        for verdict in self.verdicts.iter_mut().filter(is_accepted) {
            (verdict.kind, verdict.reason) = (VerdictKind::Tied, Reason::Equivalent);
            verdict
                .tied_with
                .extend(equivalent_formulas.iter().map(|formula| formula.name.clone()));
            if verdict.record.is_empty() {
                let effect = find(&verdict.effect);
                verdict.record = effect.map_or_else(|_| String::new(), |one| one.record.to_owned());
            }
        }
        self.equivalent_formulas = equivalent_formulas;
    }

    /// An accepted effect is equivalent to drifts of these quantities.
    fn set_equivalent_drifts(&mut self, effect: &EffectTerm, targets: &[&str]) {
        let drifts: Vec<String> =
            targets.iter().map(|target| format!("a drift of {target}")).collect();
        self.set_tied(effect, &drifts);
    }

    /// An accepted effect is equivalent to a formula with fewer coefficients.
    fn set_simpler_formula(&mut self, simpler: SimplerFormula) {
        self.set_tied(&simpler.effect, std::slice::from_ref(&simpler.formula.name));
        self.equivalent_formulas.push(simpler.formula);
    }

    /// Whether an effect is present, or equivalent to one that is.
    fn has_accepted(&self, effect: &EffectTerm) -> bool {
        let is_accepted =
            |one: &Verdict| matches!(one.kind, VerdictKind::Found | VerdictKind::Tied);
        self.verdicts.iter().any(|one| one.effect == effect.name() && is_accepted(one))
    }

    /// An accepted effect is equivalent to these causes.
    fn set_tied(&mut self, effect: &EffectTerm, causes: &[String]) {
        if causes.is_empty() {
            return;
        }
        for step in &mut self.staircase {
            if step.added.iter().any(|name| name == effect.name()) {
                step.added.extend(causes.iter().cloned());
            }
        }
        for verdict in self.verdicts.iter_mut().filter(|one| one.effect == effect.name()) {
            (verdict.kind, verdict.reason) = (VerdictKind::Tied, Reason::Equivalent);
            verdict.tied_with.extend(causes.iter().cloned());
            if verdict.record.is_empty() {
                verdict.record = effect.effect().map_or("", |known| known.record).to_owned();
            }
        }
    }

    /// Sets the force error of each step, and from it the excess of each verdict.
    fn set_forces(&mut self, forces: &[Option<ForceError>], selection: &Selection) {
        for (step, force) in self.staircase.iter_mut().zip(forces) {
            step.force = *force;
        }
        let last = self.staircase.last().and_then(|last| last.force);
        for verdict in &mut self.verdicts {
            let of_step =
                self.staircase.iter().find(|step| step.added.first() == Some(&verdict.effect));
            let screened = || {
                selection.last.iter().find(|screened| screened.candidate.name() == verdict.effect)
            };
            verdict.excess_n = match (of_step, verdict.kind) {
                (Some(step), _) => step.force.map(|force| force.excess_n()),
                (None, VerdictKind::Tied | VerdictKind::Shadow) => None,
                (None, _) => last.zip(screened()).map(|(force, screened)| {
                    force.excess_less(screened.evidence.force_reduction_n2())
                }),
            };
        }
        self.sort_verdicts();
    }

    /// Sorts the verdicts by their kind, then by the force error that they leave, then by the error of the field.
    fn sort_verdicts(&mut self) {
        let key = |verdict: &Verdict| {
            let excess_n = verdict.excess_n.unwrap_or(f64::INFINITY);
            let gain = if verdict.gain.is_nan() { f64::NEG_INFINITY } else { verdict.gain };
            (verdict.kind, excess_n, -gain)
        };
        self.verdicts.sort_by(|a, b| {
            let ((kind, excess_n, gain), (other, other_n, other_gain)) = (key(a), key(b));
            let by_error = excess_n.total_cmp(&other_n).then(gain.total_cmp(&other_gain));
            kind.cmp(&other).then(by_error)
        });
    }

    /// Name of each accepted step with its effects: the first of several equivalent ones, and all of a formula.
    ///
    /// # Errors
    /// A step is neither of the catalogue nor a discovered formula.
    pub fn accepted_steps(&self) -> Result<Vec<(String, Vec<EffectTerm>)>> {
        let steps = if self.accepted.is_empty() { &[] } else { self.staircase.as_slice() };
        let terms = |step: &StaircaseStep| {
            let first = step.added.first().context("an empty step")?;
            let terms = match self.formulas.iter().find(|formula| formula.name == *first) {
                Some(formula) => formula.effects.clone(),
                None => vec![EffectTerm::Catalogue(find(first)?)],
            };
            Ok((step.added.join(" or "), terms))
        };
        steps.iter().skip(1).map(terms).collect()
    }
}

/// Residual structure that depends on a covariate and that no effect explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unexplained {
    pub covariate: String,
    /// Label in text.
    #[serde(skip)]
    pub words: String,
    /// Fraction of the squared residual above the floor.
    pub share: f64,
}

/// Error after a step of the selection.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StaircaseStep {
    /// Added effects; empty for the first step.
    pub added: Vec<String>,
    /// Free parameters of the model at one sensor.
    pub parameters: usize,
    /// Cross-validated error over all channels, in gauss.
    pub held_out_rms_g: f64,
    /// Held-out force error; `None` where the device cannot compute the forces, or the diagnosis was ended early.
    pub force: Option<ForceError>,
    /// Noise floor in gauss.
    pub floor_g: f64,
}

/// Offsets of sensors that are confounded with the ambient field of an effect in these recordings.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConfoundedOffsets {
    pub sensors: Vec<u32>,
    /// Range of roll, pitch and yaw in degrees.
    pub range_deg: [f64; 3],
}

impl ConfoundedOffsets {
    /// Of a fit to a campaign; `None` where the offsets are determined.
    pub fn of(campaign: &Campaign, fit: &JointFit) -> Option<Self> {
        let confounded = fit.sensors.iter().filter(|fit| fit.offset_confounded);
        let sensors: Vec<u32> = confounded.map(|fit| fit.sensor).collect();
        if sensors.is_empty() {
            return None;
        }
        let range_deg = ATTITUDE_COLUMNS.map(|name| {
            let values = || campaign.recordings.iter().filter_map(|r| r.covariates.get(name));
            let low = values().flatten().copied().fold(f64::INFINITY, f64::min);
            let high = values().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
            (high - low).to_degrees()
        });
        Some(Self { sensors, range_deg })
    }
}

/// What a diagnosis examines besides the user's own effects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scope {
    /// The effects of the catalogue; without them only formulas are searched.
    pub catalogue: bool,
    /// Recordings for what is open.
    pub plans: bool,
}

impl Scope {
    /// The catalogue, without plans.
    pub const CATALOGUE: Self = Self { catalogue: true, plans: false };
}

/// Diagnoses which effects `model` (read from `path`) does not contain on `campaign`: those of the catalogue and the user's
/// `own`. The campaign was read with `alignment`. `observer` receives the progress and can end it early. What differs between
/// recordings without a covariate is a finding, and effects are sought on the recordings without it. The second value is the fit of
/// `model` to the campaign, where its cross-validation is that of a comparison.
///
/// # Errors
/// A fit fails.
pub fn diagnose(
    (campaign, alignment): (&Campaign, Alignment),
    model: &ModelFile,
    path: &Path,
    own: &[EffectTerm],
    scope: Scope,
    options: FitOptions,
    observer: &Observer,
) -> Result<(Diagnosis, Option<ModelRefit>)> {
    observer.begin();
    let mut campaign = Cow::Borrowed(campaign);
    let mut differences: Option<Differences> = None;
    let mut contested: Option<recording_differences::Found> = None;
    let present: Vec<EffectTerm> = model.effect_terms(path)?;
    // Next to the model, and next to what was found to be missing from it.
    let mut is_corrected =
        |campaign: &mut Cow<Campaign>, setup: &FitSetup, fitted: &FittedModel| {
            if !scope.catalogue || differences.is_some() {
                return false;
            }
            observer.stage("comparing recordings", DIFFERENCES);
            // All recordings, of many with a sample of the rows of each.
            let found = recording_differences::find(campaign, model, (setup, fitted), options);
            let Some(found) = found else { return false };
            if !found.rivals.is_empty() {
                contested.get_or_insert(found);
                return false;
            }
            differences = Some(found.differences);
            *campaign = Cow::Owned(found.corrected);
            true
        };
    let mut prepared = model.fit_setup(&campaign, options)?;
    let mut sample = prepared.sampled_by_fold(SEARCH_ROWS);
    observer.select_on_sample(prepared.row_count() as f64 / sample.row_count().max(1) as f64);
    let first = FittedModel::without_validation(&sample, present.clone(), options)?;
    if is_corrected(&mut campaign, &prepared, &first) {
        prepared = model.fit_setup(&campaign, options)?;
        sample = prepared.sampled_by_fold(SEARCH_ROWS);
    }
    let (testable, untestable) = match scope.catalogue {
        true => candidates(&campaign, Some(model), &present, own),
        false => (own.to_vec(), Vec::new()),
    };
    let select = |campaign: &Campaign, sample: &FitSetup, prepared: &FitSetup| {
        forward_selection(campaign, (sample, prepared), &present, &testable, options, observer)
    };
    let mut selection = select(&campaign, &sample, &prepared)?;
    if let Some(last) = selection.stages.last()
        && is_corrected(&mut campaign, &prepared, last)
    {
        prepared = model.fit_setup(&campaign, options)?;
        sample = prepared.sampled_by_fold(SEARCH_ROWS);
        selection = select(&campaign, &sample, &prepared)?;
    }
    // Effects explain as much to first order: the fits decide.
    let mut tied_difference = None;
    if let Some(mut found) = contested
        && differences.is_none()
        && let Some(last) = selection.stages.last()
    {
        let corrected = model.fit_setup(&found.corrected, options)?;
        let sampled = corrected.sampled_by_fold(SEARCH_ROWS);
        let without = FittedModel::without_validation(&sampled, present.clone(), options)?;
        if without.is_better_fit(recording_differences::CLEAR, last) {
            found.differences.set_uncontested();
            differences = Some(found.differences);
            campaign = Cow::Owned(found.corrected);
            (prepared, sample) = (corrected, sampled);
            selection = select(&campaign, &sample, &prepared)?;
        } else if !last.is_better_fit(DISTINGUISHABLE, &without) {
            tied_difference = Some(found);
        }
    }
    let campaign = &*campaign;
    let (first, last) = (selection.stages.first().cloned(), selection.stages.last().cloned());
    let (mut formulas, from_first) =
        discover(campaign, &sample, &testable, &mut selection, options, observer)?;
    if !observer.is_stopped() {
        reconsider_shadows(&sample, &mut selection, options)?;
    }
    observer.begin_rest();
    if sample.row_count() < prepared.row_count() {
        observer.stage("fitting all rows", ALL_ROWS);
        selection.refit(&prepared, options)?;
    }
    eliminate_undetermined(&prepared, &mut selection, formulas.len(), options)?;
    if !observer.is_stopped() {
        tie_delays(&prepared, &mut selection, options);
    }
    selection.confirm(&mut formulas);
    let mut forces = Vec::new();
    if !observer.is_stopped() {
        observer.stage("replaying each step on the device's code", REPLAYS);
        let fits: Vec<(&JointFit, &[EffectTerm])> =
            selection.stages.iter().map(|stage| (&stage.fit, stage.effects.as_slice())).collect();
        let offsets = differences.as_ref().map_or(&[][..], |found| &found.offsets);
        let replayed = held_out_forces((campaign, offsets), &prepared, &fits, alignment, options)?;
        forces = replayed.iter().map(|forces| forces.error).collect();
        selection.drop_irrelevant(&mut formulas, &mut forces);
    }
    let equivalent_formulas = match first.zip(last) {
        Some((first, last)) => equivalent_formulas(
            campaign,
            (&sample, &prepared),
            &[first, last],
            &selection,
            from_first,
            options,
            observer,
        )?,
        None => Vec::new(),
    };
    if let Some(last) = selection.stages.last_mut() {
        prepared.search_profiles(&mut last.fit, &last.effects);
        let recordings = campaign.recordings.len();
        formulas.iter_mut().for_each(|formula| formula.set_models(last, recordings));
    }
    let mut diagnosis = conclude(&selection, &formulas, &untestable, campaign.recordings.len());
    let simpler = if equivalent_formulas.is_empty() && !observer.is_stopped() {
        observer.stage("comparing effects with simpler causes", REPLAYS);
        simpler_formulas((&sample, &prepared), &selection, formulas.len(), options)?
    } else {
        Vec::new()
    };
    diagnosis.set_equivalent_formulas(equivalent_formulas);
    simpler.into_iter().for_each(|one| diagnosis.set_simpler_formula(one));
    if let Some(last) = selection.stages.last() {
        for effect in selection.steps.iter().map(|step| &step.chosen) {
            let drifts = equivalent_drifts(&sample, last, effect, selection.block_s);
            diagnosis.set_equivalent_drifts(effect, &drifts);
        }
    }
    if let Some(found) = &mut tied_difference {
        found.rivals.retain(|rival| diagnosis.has_accepted(rival));
        for rival in &found.rivals {
            diagnosis.set_tied(rival, &found.differences.causes());
        }
    }
    diagnosis.noise = NoiseSummary::of(campaign.recordings.iter().map(|one| &one.noise));
    diagnosis.at_floor &= diagnosis.noise.disagreement.is_none();
    let last = selection.stages.last();
    diagnosis.confounded_offsets = last.and_then(|last| ConfoundedOffsets::of(campaign, &last.fit));
    let degrees = prepared.polynomials.iter().filter_map(PolynomialFit::higher_degree);
    diagnosis.higher_degree = degrees.max_by_key(|higher| higher.degree);
    diagnosis.rows = [sample.row_count(), prepared.row_count()];
    diagnosis.recordings = [sample.recording_count(), prepared.recording_count()];
    if !forces.is_empty() {
        diagnosis.set_forces(&forces, &selection);
        diagnosis.origins = selection.stages.last().map_or_else(Vec::new, |last| {
            let recordings = campaign.recordings.len();
            EffectOrigin::of(&EffectModel::all_of(&last.fit, &last.effects, recordings))
        });
    }
    if let Some(last) = selection.stages.last() {
        let provenance = Provenance::of(campaign, alignment.delay_us, options)?;
        let found =
            ModelFile::with_effects(campaign, &prepared, &last.fit, &last.effects, provenance);
        diagnosis.device = device_support(&found, &last.effects);
        let tied = selection.steps.iter().flat_map(|step| &step.tied);
        let of_formulas = diagnosis.equivalent_formulas.iter().flat_map(|of| &of.effects);
        diagnosis.device.extend(tied.chain(of_formulas).map(DeviceSupport::of));
    }
    if let Some(last) = selection.stages.last().filter(|_| !diagnosis.at_floor) {
        let located = selection.attributed.iter().map(|(_, share)| share).sum();
        let columns = residuals_against(&sample, last, &[]);
        let names: Vec<&str> = campaign.recordings.iter().map(|one| one.name.as_str()).collect();
        diagnosis.remaining = Some(RemainingStructure::of(&columns, &names, located));
    }
    if scope.plans && !observer.is_stopped() {
        let verdicts = &diagnosis.verdicts;
        diagnosis.proposal = Some(propose(
            (&sample, &prepared),
            &selection,
            verdicts,
            &untestable,
            options,
            observer,
        ));
    }
    diagnosis.shapes = shapes(campaign, &sample, &selection, &formulas, options.seed);
    diagnosis.formulas = formulas;
    // The fit is that of a comparison where it is of the recordings as they are.
    let is_as_recorded = differences.is_none();
    let tied_difference = tied_difference.filter(|found| !found.rivals.is_empty());
    let tied_difference = tied_difference.map(|found| found.differences);
    diagnosis.findings =
        differences.or(tied_difference).map_or_else(Vec::new, |found| found.findings);
    // The effects were sought on the recordings with the differences of a place that does not explain all: those that explain more
    // are the likelier cause.
    let last = selection.stages.last();
    diagnosis.findings.retain(|finding| match &finding.evidence {
        Evidence::RecordingDifference { cause: DifferenceCause::MagnetPlace, floors, .. }
            if !recording_differences::explains_all(*floors) =>
        {
            last.is_none_or(|last| last.floors() >= floors[1])
        }
        _ => true,
    });
    diagnosis.model = path.display().to_string();
    diagnosis.campaign = campaign.folder.display().to_string();
    diagnosis.seed = options.seed;
    diagnosis.is_interrupted = observer.was_stopped();
    let own_split = prepared.split(&present);
    let first = selection.stages.into_iter().next().map(|stage| stage.fit);
    let refit = first
        .filter(|fit| is_as_recorded && fit.split == own_split)
        .map(|fit| ModelRefit { setup: prepared, fit });
    Ok((diagnosis, refit))
}
