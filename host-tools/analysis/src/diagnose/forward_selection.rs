//! Forward selection of effects by cross-validated error, separation of equivalent effects, and backward
//! elimination.

use crate::compare::BELOW_FLOOR;
use crate::diagnose::candidate_fit::{best_candidate, best_pair};
use crate::diagnose::confusable_effects::{Collinearity, Similarity};
use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel, MIN_GAIN};
use crate::diagnose::observer::Observer;
use crate::diagnose::selection::{DropReason, SMALL, Selection, replaced};
use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::recordings::Campaign;
use rayon::prelude::*;

const MAX_STEPS: usize = 6;
/// If a covariate explains more than this fraction of the residual and the best effect less than [`SMALL`] of that,
/// the effect is not named: it would approximate something else.
const ATTRIBUTED: f64 = 0.3;
/// Fractions of the remaining work that a screening and the fits of a step take.
const SCREENING: f64 = 0.25;
const FITTING: f64 = 0.2;

/// Runs the selection from a model with the effects `present`, on the rows of `prepared`, a sample of those of `all`.
///
/// # Errors
/// The initial model cannot be fitted.
pub fn forward_selection(
    campaign: &Campaign,
    (prepared, all): (&FitSetup, &FitSetup),
    present: &[EffectTerm],
    candidates: &[EffectTerm],
    options: FitOptions,
    observer: &Observer,
) -> Result<Selection> {
    let mut selection = Selection {
        steps: Vec::new(),
        implausible: Vec::new(),
        unconfirmed: Vec::new(),
        dropped: Vec::new(),
        stages: vec![FittedModel::new(
            prepared,
            present.to_vec(),
            prepared.split(present),
            options,
        )?],
        last: Vec::new(),
        attributed: Vec::new(),
        collinearity: Collinearity::of(prepared),
        similarity: Similarity::default(),
        block_s: 0.0,
        blocks: 0,
    };
    loop {
        observer.stage("screening candidates", SCREENING);
        selection.screen_last(campaign, prepared, candidates, options);
        if selection.steps.is_empty() {
            observer.screened(&selection.last);
            selection.similarity = Similarity::of(&selection.last);
        }
        let stage = &selection.stages[selection.stages.len() - 1];
        // A floor above the residual says nothing of it: what a model takes from it may be noise.
        let is_below_floor = stage.floors() < BELOW_FLOOR;
        if selection.steps.len() >= MAX_STEPS || is_below_floor || observer.is_stopped() {
            break;
        }
        observer.stage("fitting candidates", FITTING);
        let mut implausible = std::mem::take(&mut selection.implausible);
        let best = best_candidate(prepared, stage, &selection, options, &mut implausible)?;
        selection.implausible = implausible;
        let excess = 1.0 - stage.floors().powi(-2);
        let attributed = selection.attributed.first().map_or(0.0, |(_, share)| *share);
        let is_named = |gain: f64| attributed <= ATTRIBUTED || gain >= SMALL * attributed * excess;
        match best.filter(|(step, _)| is_named(step.gain)) {
            Some((step, next)) => {
                selection.steps.push(step);
                selection.stages.push(next);
            }
            None if exchange(prepared, &mut selection, options)? => {}
            None if add_pair(prepared, &mut selection, options)? => {}
            None => break,
        }
    }
    if !observer.is_stopped() {
        observer.stage("separating equivalent effects", FITTING);
        resolve_equivalences((prepared, all), &mut selection, options)?;
        observer.stage("eliminating effects", FITTING);
        eliminate_backward(prepared, &mut selection, options)?;
    }
    align_validation(prepared, &mut selection.stages, options)?;
    Ok(selection)
}

/// Cross-validates every model like the last one, so that their errors are comparable.
fn align_validation(
    prepared: &FitSetup,
    stages: &mut [FittedModel],
    options: FitOptions,
) -> Result<()> {
    let Some(split) = stages.last().map(|last| last.fit.split) else {
        return Ok(());
    };
    for stage in stages.iter_mut().filter(|stage| stage.fit.split != split) {
        *stage = FittedModel::new(prepared, stage.effects.clone(), split, options)?;
    }
    Ok(())
}

/// Backward elimination: removes every step but the last that does not improve the last model. Models after a
/// removed step are fitted again.
///
/// # Errors
/// A fit fails.
fn eliminate_backward(
    prepared: &FitSetup,
    selection: &mut Selection,
    options: FitOptions,
) -> Result<()> {
    let mut place = 0;
    while place + 1 < selection.steps.len() {
        let Some(last) = selection.stages.last() else {
            return Ok(());
        };
        let chosen = &selection.steps[place].chosen;
        let without = |stage: &FittedModel| -> Vec<EffectTerm> {
            let others = stage.effects.iter().filter(|effect| *effect != chosen);
            others.cloned().collect()
        };
        if FittedModel::without_validation(prepared, without(last), options)?.is_clearly_worse(last)
        {
            place += 1;
            continue;
        }
        let split = last.fit.split;
        let simpler = FittedModel::new(prepared, without(last), split, options)?;
        if last.gain(&simpler) > MIN_GAIN && last.improves_all_folds(&simpler) {
            place += 1;
            continue;
        }
        selection.remove(place, simpler, DropReason::Needless, (prepared, options))?;
    }
    Ok(())
}

/// Adds two effects that only lower the error together; returns whether it did.
fn add_pair(prepared: &FitSetup, selection: &mut Selection, options: FitOptions) -> Result<bool> {
    let last = selection.stages.last().filter(|last| last.floors() > MIN_EXCHANGE);
    let Some(stage) = last.filter(|_| selection.steps.len() + 2 <= MAX_STEPS) else {
        return Ok(false);
    };
    let Some(pair) = best_pair(prepared, stage, selection, options)? else {
        return Ok(false);
    };
    for (step, model) in pair {
        selection.steps.push(step);
        selection.stages.push(model);
    }
    Ok(true)
}

/// Residual in noise floors below which no effect is exchanged or added in a pair.
const MIN_EXCHANGE: f64 = 1.03;

/// Replaces the effect of an earlier step by one that explained less in any step, where that now lowers the error: what the later
/// steps explain was in the residual when it was accepted. Returns whether an effect was replaced.
///
/// # Errors
/// A fit fails.
fn exchange(prepared: &FitSetup, selection: &mut Selection, options: FitOptions) -> Result<bool> {
    let Some(last) = selection.stages.last().filter(|last| last.floors() > MIN_EXCHANGE) else {
        return Ok(false);
    };
    // The effect of the last step was compared with everything else fitted.
    let earlier = selection.steps.len().saturating_sub(1);
    let mut others: Vec<EffectTerm> = Vec::new();
    for other in selection.steps.iter().flat_map(|step| &step.shadows) {
        if !last.effects.contains(other) && !others.contains(other) {
            others.push(other.clone());
        }
    }
    let pairs: Vec<(usize, EffectTerm)> = (0..earlier)
        .flat_map(|place| others.iter().map(move |other| (place, other.clone())))
        .collect();
    let fitted = |(place, other): &(usize, EffectTerm)| {
        let effects = replaced(&last.effects, &selection.steps[*place].chosen, other);
        FittedModel::without_validation(prepared, effects, options).ok()
    };
    let fits: Vec<Option<FittedModel>> = pairs.par_iter().map(fitted).collect();
    let best = pairs
        .into_iter()
        .zip(fits)
        .filter_map(|(pair, fit)| Some((pair, fit?)))
        .filter(|(_, fit)| fit.is_better_fit(DISTINGUISHABLE, last))
        .min_by(|a, b| a.1.fitted_mean_square().total_cmp(&b.1.fitted_mean_square()));
    let Some(((place, other), fit)) = best else {
        return Ok(false);
    };
    let split = prepared.split(&[&last.effects[..], &fit.effects].concat());
    let old = last.clone().with_split(prepared, split, options);
    let new = FittedModel::new(prepared, fit.effects, split, options)?;
    let recordings = prepared.recordings();
    if !new.is_distinguishably_better(&old)
        || !new.is_possible(recordings)
        || !new.is_plausible(&other, recordings)
    {
        return Ok(false);
    }
    let chosen = selection.exchange(place, &other, prepared, options)?;
    let step = &mut selection.steps[place];
    step.shadows.retain(|shadow| *shadow != other);
    step.shadows.push(chosen);
    step.shadows.append(&mut step.tied);
    Ok(true)
}

/// Separates provisionally equivalent effects in the last model, where no larger effect hides their difference.
///
/// The last model is fitted with each of them to the sample, and those that are not clearly worse there to all rows: a filter or a
/// delay of some milliseconds differ only there. If one model has a clearly lower error, its effect explains everything that the
/// other does and more; otherwise they remain equivalent. An effect with which the model cannot be fitted is left out.
fn resolve_equivalences(
    setups: (&FitSetup, &FitSetup),
    selection: &mut Selection,
    options: FitOptions,
) -> Result<()> {
    for place in 0..selection.steps.len() {
        if !selection.steps[place].tied.is_empty() {
            resolve_step(setups, selection, place, options)?;
        }
    }
    Ok(())
}

/// The last model with one of several equivalent effects.
struct Alternative {
    effect: EffectTerm,
    model: FittedModel,
    /// Whether its magnitude is plausible: another one is at most equivalent.
    is_plausible: bool,
}

impl Alternative {
    fn new(effect: EffectTerm, model: FittedModel, recordings: usize) -> Self {
        let is_plausible = model.is_plausible(&effect, recordings);
        Self { effect, model, is_plausible }
    }
}

/// The plausible alternative with the smallest `error`, and the others: equivalent ones and worse ones.
struct Separated {
    best: Alternative,
    tied: Vec<Alternative>,
    worse: Vec<Alternative>,
}

impl Separated {
    /// `None` without alternatives.
    fn of(
        mut set: Vec<Alternative>,
        error: impl Fn(&FittedModel) -> f64,
        is_worse: impl Fn(&Alternative, &Alternative) -> bool,
    ) -> Option<Self> {
        set.sort_by(|a, b| {
            let by_error = error(&a.model).total_cmp(&error(&b.model));
            b.is_plausible.cmp(&a.is_plausible).then(by_error)
        });
        let others = set.split_off(1.min(set.len()));
        let best = set.pop()?;
        let (worse, tied) = others.into_iter().partition(|other| is_worse(other, &best));
        Some(Self { best, tied, worse })
    }
}

fn resolve_step(
    (prepared, all): (&FitSetup, &FitSetup),
    selection: &mut Selection,
    place: usize,
    options: FitOptions,
) -> Result<()> {
    let recordings = prepared.recordings();
    let collinearity = selection.collinearity;
    let (Some(last), step) = (selection.stages.last(), &mut selection.steps[place]) else {
        return Ok(());
    };
    // An effect accepted in a later step is not equivalent.
    step.tied.retain(|tied| !last.effects.contains(tied));
    let instead = |other: &EffectTerm| {
        let effects = replaced(&last.effects, &step.chosen, other);
        let model = FittedModel::without_validation(prepared, effects, options).ok()?;
        model.is_possible(recordings).then(|| Alternative::new(other.clone(), model, recordings))
    };
    let mut set: Vec<Alternative> = step.tied.par_iter().filter_map(instead).collect();
    set.push(Alternative::new(step.chosen.clone(), last.clone(), recordings));
    let is_hidden = |one: &Alternative, other: &Alternative| {
        collinearity.hides_the_difference(&one.effect, &other.effect)
    };
    let on_sample = Separated::of(set, FittedModel::fitted_mean_square, |other, best| {
        !is_hidden(best, other) && other.model.is_clearly_worse(&best.model)
    });
    let Some(Separated { best, tied, worse }) = on_sample else {
        return Ok(());
    };
    let effects_of = |list: Vec<Alternative>| list.into_iter().map(|one| one.effect);
    step.shadows.extend(effects_of(worse));
    let best = if tied.is_empty() {
        step.tied.clear();
        best
    } else {
        let close: Vec<Alternative> = std::iter::once(best).chain(tied).collect();
        // Transient effects require cross-validation within recordings for the whole set.
        let split = prepared.split(&[&last.effects[..], &step.tied].concat());
        let fitted = close.into_par_iter().filter_map(|Alternative { effect, model, .. }| {
            let model = model.on(all, split, options).ok()?;
            let is_kept = effect == step.chosen || model.is_possible(recordings);
            is_kept.then(|| Alternative::new(effect, model, recordings))
        });
        let on_all = Separated::of(fitted.collect(), FittedModel::mean_square, |other, best| {
            !is_hidden(best, other) && best.model.is_distinguishably_better(&other.model)
        });
        let Some(Separated { best, tied, worse }) = on_all else {
            return Ok(());
        };
        step.tied = effects_of(tied).collect();
        step.shadows.extend(effects_of(worse));
        best
    };
    if best.effect != step.chosen {
        step.chosen = best.effect;
        let effects = best.model.effects.clone();
        let own = prepared.split(&effects);
        selection.stages.pop();
        selection.stages.push(FittedModel::new(prepared, effects, own, options)?);
    }
    Ok(())
}
