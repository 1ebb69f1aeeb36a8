//! From a model and a campaign to a [`Diagnosis`].
//!
//! What differs between the recordings is removed first. Effects are then selected on a sample of the rows, formulas explain what the
//! effects leave, all models are fitted to all rows and replayed on the device's code, and each effect gets a verdict.

use std::borrow::Cow;

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

use crate::compare::checked_campaign::CheckedCampaign;
use crate::compare::force_errors::held_out_forces;
use crate::compare::pipeline::ModelRefit;
use crate::compare::{EffectOrigin, ForceError};
use crate::data_quality::evidence::Evidence;
use crate::diagnose::candidates::candidates;
use crate::diagnose::conclude::conclude;
use crate::diagnose::diagnosis::{ConfoundedOffsets, Diagnosis};
use crate::diagnose::drifts::equivalent_drifts;
use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel};
use crate::diagnose::formulas::discover::{discover, equivalent_formulas};
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::formulas::simpler::{SimplerFormula, simpler_formulas};
use crate::diagnose::forward_selection::forward_selection;
use crate::diagnose::observer::Observer;
use crate::diagnose::recording_differences::{self, Differences, Found};
use crate::diagnose::recording_plan::propose;
use crate::diagnose::refinement::refine;
use crate::diagnose::remaining_structure::RemainingStructure;
use crate::diagnose::residuals::residuals_against;
use crate::diagnose::selection::Selection;
use crate::diagnose::shapes::shapes;
use crate::diagnose::verdict::VerdictKind;
use crate::model::Model;
use crate::noise_floor::NoiseSummary;

/// Fraction of the work that the comparison of the recordings takes.
const DIFFERENCES: f64 = 0.05;
/// Fraction of what then remains that the replays take.
const REPLAYS: f64 = 0.5;

/// What a diagnosis examines besides the user's own effects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scope {
    /// The effects of the catalogue; without them only formulas are searched.
    pub catalogue: bool,
    /// Recordings for what is open.
    pub plans: bool,
    /// The forces of the model over time, for a report.
    pub traces: bool,
}

impl Scope {
    /// The catalogue, without plans and traces.
    pub const CATALOGUE: Self = Self { catalogue: true, plans: false, traces: false };
}

/// [`diagnose`] of a checked campaign, with its setup errors and the next command. If a setup error prevents any result, the
/// diagnosis has the setup errors only.
///
/// # Errors
/// A recording cannot be read, or a fit fails.
pub fn diagnose_checked(
    checked: &CheckedCampaign,
    model: &Model,
    own: &[EffectTerm],
    scope: Scope,
    options: FitOptions,
    observer: &Observer,
) -> Result<(Diagnosis, Option<ModelRefit>)> {
    let mut findings = checked.findings.clone();
    let Some(reader) = checked.reader() else {
        return Ok((Diagnosis { findings, ..Diagnosis::default() }, None));
    };
    let (campaign, alignment) = (reader.whole()?, reader.alignment);
    let (mut diagnosis, refit) =
        diagnose((&campaign, alignment), model, own, scope, options, observer)?;
    findings.append(&mut diagnosis.findings);
    diagnosis.findings = findings;
    let is_fitted_here = checked.other_recordings(model).is_none();
    diagnosis.set_suggestion(own, &model.file, alignment.delay_us / 1e3, is_fitted_here);
    Ok((diagnosis, refit))
}

/// Diagnoses which effects `model` does not contain on `campaign`: those of the catalogue and the user's `own`. The campaign was read
/// with `alignment`. `observer` receives the progress and can end it early. What differs between recordings without a covariate is a
/// finding, and effects are sought on the recordings without it. The second value is the fit of `model` to the campaign, where its
/// cross-validation is that of a comparison.
///
/// # Errors
/// A fit fails.
pub fn diagnose(
    (campaign, alignment): (&Campaign, Alignment),
    model: &Model,
    own: &[EffectTerm],
    scope: Scope,
    options: FitOptions,
    observer: &Observer,
) -> Result<(Diagnosis, Option<ModelRefit>)> {
    observer.begin();
    let mut search = Search::new(campaign, model, scope, options, observer)?;
    let (testable, untestable) = match scope.catalogue {
        true => candidates(&search.rows.campaign, Some(&model.file), &model.effects, own),
        false => (own.to_vec(), Vec::new()),
    };
    let mut selection = search.select(&testable)?;
    let mut tied_difference = search.decide_contested(&mut selection, &testable)?;
    let Search { rows: Rows { campaign, sample, all }, differences, .. } = search;
    let campaign = &*campaign;
    let (first, last) = (selection.stages.first().cloned(), selection.stages.last().cloned());
    let (mut formulas, from_first) =
        discover(campaign, &sample, &testable, &mut selection, options, observer)?;
    refine((&sample, &all), &mut selection, &mut formulas, options, observer)?;
    let mut forces = Vec::new();
    if !observer.is_stopped() {
        observer.stage("replaying each step on the device's code", REPLAYS);
        let fits: Vec<(&JointFit, &[EffectTerm])> =
            selection.stages.iter().map(|stage| (&stage.fit, stage.effects.as_slice())).collect();
        let offsets = differences.as_ref().map_or(&[][..], |found| &found.offsets);
        let recordings = (campaign, offsets);
        forces = held_out_forces(recordings, &all, &fits, alignment, scope.traces, options)?;
    }
    let mut errors = forces.iter().map(|forces| forces.error).collect();
    selection.drop_irrelevant(&mut formulas, &mut errors);
    let equivalent_formulas = match first.zip(last) {
        Some((first, last)) => equivalent_formulas(
            campaign,
            (&sample, &all),
            &[first, last],
            &selection,
            from_first,
            options,
            observer,
        )?,
        None => Vec::new(),
    };
    if let Some(last) = selection.stages.last_mut() {
        all.search_profiles(&mut last.fit, &last.effects);
        let recordings = campaign.recordings.len();
        formulas.iter_mut().for_each(|formula| formula.set_models(last, recordings));
    }
    let mut diagnosis = conclude(&selection, &formulas, &untestable, campaign.recordings.len());
    let simpler = if equivalent_formulas.is_empty() && !observer.is_stopped() {
        observer.stage("comparing effects with simpler causes", REPLAYS);
        simpler_formulas((&sample, &all), &selection, formulas.len(), options)?
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
    if let Some((found, rivals)) = &mut tied_difference {
        rivals.retain(|rival| diagnosis.has_accepted(rival));
        rivals.iter().for_each(|rival| diagnosis.set_tied(rival, &found.causes()));
    }
    if !errors.is_empty() {
        diagnosis.set_forces(&errors, &selection);
        diagnosis.origins = selection.stages.last().map_or_else(Vec::new, |last| {
            let recordings = campaign.recordings.len();
            EffectOrigin::of(&EffectModel::all_of(&last.fit, &last.effects, recordings))
        });
    }
    diagnosis.model = model.path.display().to_string();
    diagnosis.campaign = campaign.folder.display().to_string();
    diagnosis.seed = options.seed;
    diagnosis.noise = NoiseSummary::of(campaign.recordings.iter().map(|one| &one.noise));
    diagnosis.at_floor &= diagnosis.noise.disagreement.is_none();
    let degrees = all.polynomials.iter().filter_map(PolynomialFit::higher_degree);
    diagnosis.higher_degree = degrees.max_by_key(|higher| higher.degree);
    diagnosis.rows = [sample.row_count(), all.row_count()];
    diagnosis.recordings = [sample.recording_count(), all.recording_count()];
    if let Some(last) = selection.stages.last() {
        let provenance = Provenance::of(campaign, alignment.delay_us, options)?;
        let found = ModelFile::with_effects(campaign, &all, &last.fit, &last.effects, provenance);
        let effects = selection.steps.iter().flat_map(|step| &step.tied);
        let of_formulas = diagnosis.equivalent_formulas.iter().flat_map(|of| &of.effects);
        diagnosis.device = device_support(&found, &last.effects);
        diagnosis.device.extend(effects.chain(of_formulas).map(DeviceSupport::of));
        diagnosis.confounded_offsets = ConfoundedOffsets::of(campaign, &last.fit);
    }
    if let Some(last) = selection.stages.last().filter(|_| !diagnosis.at_floor) {
        let located = selection.attributed.iter().map(|(_, share)| share).sum();
        let columns = residuals_against(&sample, last, &[]);
        let names: Vec<&str> = campaign.recordings.iter().map(|one| one.name.as_str()).collect();
        diagnosis.remaining = Some(RemainingStructure::of(&columns, &names, located));
    }
    if scope.plans && !observer.is_stopped() {
        let (setups, verdicts) = ((&sample, &all), &diagnosis.verdicts);
        let proposal = propose(setups, &selection, verdicts, &untestable, options, observer);
        diagnosis.proposal = Some(proposal);
    }
    diagnosis.shapes = shapes(campaign, &sample, &selection, &formulas, options.seed);
    diagnosis.formulas = formulas;
    // The fit is that of a comparison where it is of the recordings as they are.
    let is_as_recorded = differences.is_none();
    let tied_difference = tied_difference.filter(|(_, rivals)| !rivals.is_empty());
    let found = differences.or(tied_difference.map(|(found, _)| found));
    diagnosis.findings = found.map_or_else(Vec::new, |found| found.findings);
    retain_likely(&mut diagnosis, selection.stages.last());
    diagnosis.is_interrupted = observer.was_stopped();
    let own_split = all.split(&model.effects);
    let first = selection.stages.into_iter().next().map(|stage| stage.fit);
    let forces = forces.into_iter().next().filter(|_| scope.traces);
    let refit = first
        .filter(|fit| is_as_recorded && fit.split == own_split)
        .map(|fit| ModelRefit { setup: all, fit, forces });
    Ok((diagnosis, refit))
}

impl Diagnosis {
    /// Accepted effects are equivalent to formulas that explain as much.
    fn set_equivalent_formulas(&mut self, equivalent_formulas: Vec<DiscoveredFormula>) {
        if equivalent_formulas.is_empty() {
            return;
        }
        let causes: Vec<String> = equivalent_formulas.iter().map(|one| one.name.clone()).collect();
        self.verdicts.iter_mut().filter(|one| one.is_accepted()).for_each(|one| one.tie(&causes));
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
        self.verdicts.iter().any(|one| one.effect == effect.name() && one.is_accepted())
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
        let own = self.verdicts.iter_mut().filter(|one| one.effect == effect.name());
        own.for_each(|one| one.tie(causes));
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
}

/// The recordings, and the rows by which effects are selected and to which the models are fitted.
struct Rows<'a> {
    campaign: Cow<'a, Campaign>,
    all: FitSetup,
    /// A part of them.
    sample: FitSetup,
}

impl<'a> Rows<'a> {
    fn of(campaign: Cow<'a, Campaign>, model: &Model, options: FitOptions) -> Result<Self> {
        let all = model.file.fit_setup(&campaign, options)?;
        Ok(Self { campaign, sample: all.sampled_by_fold(SEARCH_ROWS), all })
    }
}

/// Search for the effects that a model does not contain, and for what differs between the recordings.
struct Search<'a> {
    model: &'a Model,
    scope: Scope,
    options: FitOptions,
    observer: &'a Observer<'a>,
    /// Without `differences`.
    rows: Rows<'a>,
    differences: Option<Differences>,
    /// Differences that effects explain as well, to first order.
    contested: Option<Found>,
}

impl<'a> Search<'a> {
    /// On the recordings without what differs between them next to the model.
    fn new(
        campaign: &'a Campaign,
        model: &'a Model,
        scope: Scope,
        options: FitOptions,
        observer: &'a Observer<'a>,
    ) -> Result<Self> {
        let rows = Rows::of(Cow::Borrowed(campaign), model, options)?;
        let ratio = rows.all.row_count() as f64 / rows.sample.row_count().max(1) as f64;
        observer.select_on_sample(ratio);
        let effects = model.effects.clone();
        let first = FittedModel::without_validation(&rows.sample, effects, options)?;
        let (differences, contested) = (None, None);
        let mut search = Self { model, scope, options, observer, rows, differences, contested };
        search.remove_differences(&first)?;
        Ok(search)
    }

    /// Removes what differs between the recordings next to `fitted`; returns whether anything does.
    fn remove_differences(&mut self, fitted: &FittedModel) -> Result<bool> {
        if !self.scope.catalogue || self.differences.is_some() {
            return Ok(false);
        }
        self.observer.stage("comparing recordings", DIFFERENCES);
        // All recordings, of many with a sample of the rows of each.
        let (campaign, fitted) = (&self.rows.campaign, (&self.rows.all, fitted));
        let found = recording_differences::find(campaign, &self.model.file, fitted, self.options);
        let Some(found) = found else { return Ok(false) };
        if !found.rivals.is_empty() {
            self.contested.get_or_insert(found);
            return Ok(false);
        }
        self.differences = Some(found.differences);
        self.rows = Rows::of(Cow::Owned(found.corrected), self.model, self.options)?;
        Ok(true)
    }

    /// Selects effects, again where the recordings differ next to them.
    fn select(&mut self, testable: &[EffectTerm]) -> Result<Selection> {
        let selection = self.selected(testable)?;
        let is_corrected = match selection.stages.last() {
            Some(last) => self.remove_differences(last)?,
            None => false,
        };
        if is_corrected { self.selected(testable) } else { Ok(selection) }
    }

    fn selected(&self, testable: &[EffectTerm]) -> Result<Selection> {
        let Rows { campaign, sample, all } = &self.rows;
        let present = &self.model.effects;
        forward_selection(campaign, (sample, all), present, testable, self.options, self.observer)
    }

    /// Decides by fits where effects explain as much as a difference to first order. Returns a difference that explains as much as
    /// the selection, with the effects that do the same.
    fn decide_contested(
        &mut self,
        selection: &mut Selection,
        testable: &[EffectTerm],
    ) -> Result<Option<(Differences, Vec<EffectTerm>)>> {
        let contested = self.contested.take().filter(|_| self.differences.is_none());
        let (Some(found), Some(last)) = (contested, selection.stages.last()) else {
            return Ok(None);
        };
        let Found { mut differences, corrected, rivals } = found;
        let rows = Rows::of(Cow::Owned(corrected), self.model, self.options)?;
        let effects = self.model.effects.clone();
        let without = FittedModel::without_validation(&rows.sample, effects, self.options)?;
        if without.is_better_fit(recording_differences::CLEAR, last) {
            differences.set_uncontested();
            self.differences = Some(differences);
            self.rows = rows;
            *selection = self.selected(testable)?;
            return Ok(None);
        }
        let is_tied = !last.is_better_fit(DISTINGUISHABLE, &without);
        Ok(is_tied.then_some((differences, rivals)))
    }
}

/// Removes findings of a magnet's place that leave more than the effects do. Such a place does not explain all, so the effects were
/// sought on recordings that still contain it.
fn retain_likely(diagnosis: &mut Diagnosis, last: Option<&FittedModel>) {
    diagnosis.findings.retain(|finding| match &finding.evidence {
        Evidence::RecordingDifference { cause: DifferenceCause::MagnetPlace, floors, .. }
            if !recording_differences::explains_all(*floors) =>
        {
            last.is_none_or(|last| last.floors() >= floors[1])
        }
        _ => true,
    });
}
