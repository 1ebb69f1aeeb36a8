//! From a model and a campaign to a [`Diagnosis`].

use crate::compare::EffectOrigin;
use crate::compare::cv_plan::ModelRefit;
use crate::compare::force_errors::held_out_forces;
use crate::data_quality::evidence::Evidence;
use crate::diagnose::candidates::candidates;
use crate::diagnose::conclude::conclude;
use crate::diagnose::diagnosis::{ConfoundedOffsets, Diagnosis};
use crate::diagnose::drifts::equivalent_drifts;
use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel};
use crate::diagnose::formulas::discover::{discover, equivalent_formulas};
use crate::diagnose::formulas::simpler::simpler_formulas;
use crate::diagnose::forward_selection::{
    eliminate_undetermined, forward_selection, reconsider_shadows, tie_delays,
};
use crate::diagnose::observer::Observer;
use crate::diagnose::recording_differences::{self, Differences};
use crate::diagnose::recording_plan::propose;
use crate::diagnose::remaining_structure::RemainingStructure;
use crate::diagnose::residuals::residuals_against;
use crate::diagnose::shapes::shapes;
use crate::noise_floor::NoiseSummary;
use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::{FitSetup, SEARCH_ROWS};
use model_export::fit::joint::JointFit;
use model_export::fit::polynomial::PolynomialFit;
use model_export::fit::recording_differences::DifferenceCause;
use model_export::inverse::device_support::{DeviceSupport, device_support};
use model_export::model_file::{EffectModel, ModelFile, Provenance};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use std::borrow::Cow;
use std::path::Path;

/// Fraction of the work that the comparison of the recordings takes.
const DIFFERENCES: f64 = 0.05;
/// Fraction of the work after the selection that the fits to all rows take.
const ALL_ROWS: f64 = 0.7;
/// Fraction of what then remains that the replays take.
const REPLAYS: f64 = 0.5;

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
