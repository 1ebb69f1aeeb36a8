//! Formulas next to the effects of a selection, in their place, or as equivalents of them; and those that are an effect of the
//! catalogue, which next to another cause did not lower the error of every fold.

use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::score_test::{CandidateScore, ScoreTest};
use model_export::recordings::Campaign;
use rayon::prelude::*;

use crate::diagnose::candidates::{REPLACES, ScreenedEffect, screen};
use crate::diagnose::fitted_model::{FittedModel, MIN_KEPT, NEAR};
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::formulas::search::{Discovery, FormulaSearch, STEP, explains_most};
use crate::diagnose::observer::Observer;
use crate::diagnose::selection::{AcceptedStep, DropReason, DroppedStep, Selection};

/// Residual in noise floors above which effects at the floor may imitate another cause: a gain of each axis took 98 % of the
/// reduction by the true cause at 1.03 to 1.06 floors.
const OPEN: f64 = 1.03;
/// Minimum share of a formula's pattern that an accepted effect reproduces where the formula is another form of the effect.
const REPRODUCED: f64 = 0.9;
/// Fraction of the remaining work that the last screening takes.
const FINAL: f64 = 0.8;

/// What a search from the initial model found; `None` where none was made.
pub type FromFirst = Option<Option<Discovery>>;

/// Searches formulas where the effects of a selection leave more than noise: from the initial model, where the effects may only
/// imitate the cause, and from the last one. The result of the first replaces the effects where it is at the noise floor with
/// fewer terms; else effects that the formulas make needless are removed. The candidates are then screened again. The second value
/// is the first of the two searches, where its result was not taken.
///
/// # Errors
/// A fit fails.
pub fn discover(
    campaign: &Campaign,
    setup: &FitSetup,
    candidates: &[EffectTerm],
    selection: &mut Selection,
    options: FitOptions,
    observer: &Observer,
) -> Result<(Vec<DiscoveredFormula>, FromFirst)> {
    let (Some(first), Some(last)) = (selection.stages.first(), selection.stages.last()) else {
        return Ok((Vec::new(), None));
    };
    if last.is_at_floor() || observer.is_stopped() {
        return Ok((Vec::new(), None));
    }
    observer.stage("preparing the search for formulas", STEP);
    let search = FormulaSearch::new(campaign, (setup, last), selection.block_s, options);
    let alone = search.run(first, observer)?;
    // An interrupted search says nothing.
    let from_first = (!observer.is_stopped()).then(|| alone.clone());
    let is_enough =
        |found: &Discovery| found.is_at_floor() && found.formulas.len() <= selection.steps.len();
    let joined = if selection.steps.is_empty() || alone.as_ref().is_some_and(is_enough) {
        None
    } else {
        search.run(last, observer)?
    };
    let (steps, found) = match (alone, joined) {
        (None, None) => return Ok((Vec::new(), from_first)),
        (None, Some(joined)) => (selection.steps.len(), joined),
        (Some(alone), joined) => {
            let of_effects = joined.as_ref().and_then(|joined| joined.stages.last());
            let is_better = alone.stages.last().is_some_and(|of_formulas| {
                is_better_than_effects(of_formulas, of_effects.unwrap_or(last))
            });
            match joined {
                _ if is_better => (0, alone),
                Some(joined) => (selection.steps.len(), joined),
                None => return Ok((Vec::new(), from_first)),
            }
        }
    };
    let replaced = selection.steps.drain(steps.min(selection.steps.len())..);
    let replaced: Vec<_> = replaced.map(|step| step.dropped(DropReason::Replaced)).collect();
    selection.dropped.extend(replaced);
    selection.stages.truncate(1 + steps);
    selection.stages.extend(found.stages);
    let mut formulas = found.formulas;
    remove_needless(setup, selection, &mut formulas, options)?;
    name_formulas(setup, candidates, selection, &mut formulas, options)?;
    observer.stage("screening candidates", FINAL);
    selection.screen_last(campaign, setup, candidates, options);
    Ok((formulas, from_first))
}

/// Whether a model of formulas alone replaces one with effects, and with formulas next to them: with fewer parameters it leaves no more;
/// with more it explains what the other leaves, as formulas next to effects must.
fn is_better_than_effects(of_formulas: &FittedModel, of_effects: &FittedModel) -> bool {
    match of_formulas.parameters() < of_effects.parameters() {
        true => of_formulas.mean_square() < (1.0 + NEAR) * of_effects.mean_square(),
        false => explains_most(of_formulas, of_effects),
    }
}

/// Replaces formulas by effects of the catalogue that do the same, and explain more, or as much with no more parameters. Where structure
/// remains, the formulas are approximations, and so would be the effects.
///
/// # Errors
/// A fit fails.
fn name_formulas(
    setup: &FitSetup,
    candidates: &[EffectTerm],
    selection: &mut Selection,
    formulas: &mut Vec<DiscoveredFormula>,
    options: FitOptions,
) -> Result<()> {
    let recordings = setup.recordings();
    for place in (0..formulas.len()).rev() {
        let last = selection.stages.last().filter(|last| last.is_at_floor());
        let Some(last) = last.cloned() else { return Ok(()) };
        let own = &formulas[place].effects;
        let others: Vec<EffectTerm> =
            last.effects.iter().filter(|effect| !own.contains(effect)).cloned().collect();
        let without = FittedModel::without_validation(setup, others.clone(), options)?;
        let test = ScoreTest::new(setup, &others, &without.fit, selection.block_s);
        let patterns: Vec<CandidateScore> =
            own.iter().filter_map(|effect| test.score(effect)).collect();
        let is_open = |effect: &&EffectTerm| {
            effect.effect().is_some() && !effect.is_transient() && !others.contains(effect)
        };
        let open: Vec<EffectTerm> = candidates.iter().filter(is_open).cloned().collect();
        let does_the_same = |screened: &&ScreenedEffect| {
            let mut shares = patterns.iter().map(|one| screened.evidence.reproduced_share(one));
            shares.all(|share| share >= REPLACES)
        };
        let with = |effect: &EffectTerm| [&others[..], std::slice::from_ref(effect)].concat();
        let named = |screened: &ScreenedEffect| {
            let effects = with(&screened.candidate);
            let model = FittedModel::new(setup, effects, last.fit.split, options).ok()?;
            let is_as_simple = model.parameters() <= last.parameters()
                && model.mean_square() <= (1.0 + NEAR) * last.mean_square();
            let is_named = (is_as_simple || model.is_distinguishably_better(&last))
                && model.is_possible(recordings)
                && model.is_plausible(&screened.candidate, recordings);
            is_named.then_some(model)
        };
        let screened = screen(&test, &open, options.seed);
        let alike: Vec<&ScreenedEffect> = screened.iter().filter(does_the_same).collect();
        let fits = alike.into_par_iter().filter_map(|screened| Some((screened, named(screened)?)));
        let mut fits: Vec<(&ScreenedEffect, FittedModel)> = fits.collect();
        fits.sort_by(|a, b| a.1.mean_square().total_cmp(&b.1.mean_square()));
        let Some((screened, model)) = fits.first() else { continue };
        let before = without.with_split(setup, last.fit.split, options);
        let equivalent =
            fits[1..].iter().filter(|other| !model.is_distinguishably_better(&other.1));
        selection.steps.push(AcceptedStep {
            tied: equivalent.map(|(other, _)| other.candidate.clone()).collect(),
            ..AcceptedStep::new(screened, model, &before)
        });
        formulas.remove(place);
        // The steps in their order, then the formulas.
        let steps = selection.steps.len();
        selection.stages.truncate(steps);
        let Some(start) = selection.stages.last() else { return Ok(()) };
        let mut effects = start.effects.clone();
        effects.push(screened.candidate.clone());
        for formula in std::iter::once(None).chain(formulas.iter().map(Some)) {
            effects.extend(formula.iter().flat_map(|formula| formula.effects.iter().cloned()));
            let stage = FittedModel::new(setup, effects.clone(), setup.split(&effects), options)?;
            selection.stages.push(stage);
        }
    }
    Ok(())
}

/// Formulas that explain as much as the effects of a selection at the noise floor, with as many terms at most, where the effects
/// leave more than noise: a free parameter of an effect may imitate another cause. Formulas that an accepted effect can reproduce
/// are only another form of it. They are searched on the rows of `sample`, on which the selection began with `first` and ended with
/// `last`; `from_first` is such a search, where it was made. Those found are fitted to the rows of `all`.
///
/// # Errors
/// A fit fails.
pub fn equivalent_formulas(
    campaign: &Campaign,
    (sample, all): (&FitSetup, &FitSetup),
    [first, last]: &[FittedModel; 2],
    selection: &Selection,
    from_first: FromFirst,
    options: FitOptions,
    observer: &Observer,
) -> Result<Vec<DiscoveredFormula>> {
    let Some(of_effects) = selection.stages.last() else {
        return Ok(Vec::new());
    };
    let floors = of_effects.floors();
    let is_open = floors > OPEN && of_effects.is_at_floor() && !selection.steps.is_empty();
    if !is_open || observer.is_stopped() {
        return Ok(Vec::new());
    }
    let found = match from_first {
        Some(found) => found,
        None => {
            observer.stage("preparing the search for formulas", STEP);
            FormulaSearch::new(campaign, (sample, last), selection.block_s, options)
                .run(first, observer)?
        }
    };
    let Some(mut found) = found.filter(|found| found.formulas.len() <= selection.steps.len())
    else {
        return Ok(Vec::new());
    };
    let Some(model) = found.stages.pop() else {
        return Ok(Vec::new());
    };
    let model = model.on(all, model.fit.split, options)?;
    if model.mean_square() > (1.0 + NEAR) * of_effects.mean_square() {
        return Ok(Vec::new());
    }
    let test = ScoreTest::new(sample, &first.effects, &first.fit, selection.block_s);
    let accepted: Vec<CandidateScore> =
        selection.steps.iter().filter_map(|step| test.score(&step.chosen)).collect();
    let is_reproduced = |effect: &EffectTerm| {
        test.score(effect).is_some_and(|formula| {
            accepted.iter().any(|own| own.reproduced_share(&formula) >= REPRODUCED)
        })
    };
    if found.formulas.iter().flat_map(|formula| &formula.effects).all(is_reproduced) {
        return Ok(Vec::new());
    }
    let recordings = campaign.recordings.len();
    found.formulas.iter_mut().for_each(|formula| formula.set_models(&model, recordings));
    Ok(found.formulas)
}

/// Removes the effects and formulas that the last model does not need: next to all others they remove nothing relevant.
fn remove_needless(
    setup: &FitSetup,
    selection: &mut Selection,
    formulas: &mut Vec<DiscoveredFormula>,
    options: FitOptions,
) -> Result<()> {
    let mut place = 0;
    while selection.steps.len() + formulas.len() > 1
        && place < selection.steps.len() + formulas.len()
    {
        let Some(last) = selection.stages.last() else {
            return Ok(());
        };
        let removed = match place.checked_sub(selection.steps.len()) {
            None => vec![selection.steps[place].chosen.clone()],
            Some(formula) => formulas[formula].effects.clone(),
        };
        let others = last.effects.iter().filter(|effect| !removed.contains(effect)).cloned();
        let without = FittedModel::new(setup, others.collect(), last.fit.split, options)?;
        let is_needed = last.gain(&without) > MIN_KEPT && last.is_relevant(&without);
        if is_needed {
            place += 1;
            continue;
        }
        let reason = DropReason::Needless;
        let Some(formula) = place.checked_sub(selection.steps.len()) else {
            selection.remove(place, without, reason, (setup, options))?;
            continue;
        };
        selection.stages = selection.stages_without((place, &removed), without, setup, options)?;
        let formula = formulas.remove(formula);
        selection.dropped.push(DroppedStep::of_formula(&formula, reason));
    }
    Ok(())
}
