//! A selection on a sample of the rows, refined: shadows compared again, all models fitted to all rows, and the steps that these do not
//! confirm removed.

use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use rayon::prelude::*;

use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel, MIN_KEPT, NEAR};
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::observer::Observer;
use crate::diagnose::selection::{DropReason, Selection, replaced};

/// Fraction of the work after the selection that the fits to all rows take.
const ALL_ROWS: f64 = 0.7;

/// Fits all models to all rows, and removes the steps that these do not confirm.
///
/// # Errors
/// A fit fails.
pub fn refine(
    (sample, all): (&FitSetup, &FitSetup),
    selection: &mut Selection,
    formulas: &mut Vec<DiscoveredFormula>,
    options: FitOptions,
    observer: &Observer,
) -> Result<()> {
    if !observer.is_stopped() {
        reconsider_shadows(sample, selection, options)?;
    }
    observer.begin_rest();
    if sample.row_count() < all.row_count() {
        observer.stage("fitting all rows", ALL_ROWS);
        selection.refit(all, options)?;
    }
    eliminate_undetermined(all, selection, formulas.len(), options)?;
    if !observer.is_stopped() {
        tie_delays(all, selection, options);
    }
    selection.confirm(formulas);
    Ok(())
}

/// Compares the effect of each step with those that explained a part of the same when it was accepted, in the last model: later
/// steps and formulas explain what was still in the residual then. An effect that now explains as much is equivalent, with fewer
/// parameters within [`NEAR`]: one number for all flexures that explains what several explain is the likelier cause, although it is
/// not exact where a load jumps. It takes the place of the accepted one where that is not distinguishably better.
///
/// # Errors
/// A fit fails.
fn reconsider_shadows(
    prepared: &FitSetup,
    selection: &mut Selection,
    options: FitOptions,
) -> Result<()> {
    let recordings = prepared.recordings();
    let parameters = |effect: &EffectTerm| effect.parameters(recordings).len();
    for place in 0..selection.steps.len() {
        let (Some(last), step) = (selection.stages.last(), &selection.steps[place]) else {
            return Ok(());
        };
        let is_simpler = |other: &EffectTerm| parameters(other) < parameters(&step.chosen);
        let limit = |other: &EffectTerm| if is_simpler(other) { NEAR } else { DISTINGUISHABLE };
        let instead = |other: &EffectTerm| {
            let effects = replaced(&last.effects, &step.chosen, other);
            let model = FittedModel::without_validation(prepared, effects, options).ok()?;
            let is_close =
                model.is_possible(recordings) && !last.is_better_fit(limit(other), &model);
            is_close.then(|| (other.clone(), model))
        };
        let shadows: Vec<&EffectTerm> =
            step.shadows.iter().filter(|other| !last.effects.contains(other)).collect();
        let close: Vec<_> = shadows.into_par_iter().filter_map(instead).collect();
        let mut equivalent: Vec<EffectTerm> = Vec::new();
        let mut simplest: Option<EffectTerm> = None;
        for (other, model) in close {
            let split = prepared.split(&[&last.effects[..], std::slice::from_ref(&other)].concat());
            let model = FittedModel::new(prepared, model.effects, split, options)?;
            let own = last.clone().with_split(prepared, split, options);
            let is_worse = model.mean_square() > (1.0 + limit(&other)) * own.mean_square();
            if is_worse || !model.is_plausible(&other, recordings) {
                continue;
            }
            let is_fewer = |than: &EffectTerm| parameters(&other) < parameters(than);
            if !own.is_distinguishably_better(&model)
                && is_fewer(simplest.as_ref().unwrap_or(&step.chosen))
            {
                simplest = Some(other.clone());
            }
            equivalent.push(other);
        }
        let step = &mut selection.steps[place];
        step.shadows.retain(|shadow| !equivalent.contains(shadow));
        step.tied.extend(equivalent);
        let Some(other) = simplest else { continue };
        step.tied.retain(|tied| *tied != other);
        let chosen = selection.exchange(place, &other, prepared, options)?;
        selection.steps[place].tied.push(chosen);
    }
    Ok(())
}

/// Effects that delay the field or the reference by some milliseconds: they differ in the second order of a load's changes.
const DELAYS: [&str; 3] = ["clock_skew", "viscous_lag", "reference_filter"];

fn is_delay(effect: &EffectTerm) -> bool {
    DELAYS.contains(&effect.name())
}

/// Error of a delay's other form relative to that of the accepted one, up to which they are equivalent: a shift, a low pass and its
/// inverse treat the noise of the reference differently. (In simulated campaigns with steps of the load, a reference at 100 Hz and
/// lags of 3 to 4 ms, the true form had 0.92 to 1.03 of the squared error of the shift.)
const NOISE_OF_DELAY: f64 = 0.1;

/// Ties each accepted delay of the last model, fitted to all rows, with its other forms that explain as much but for the noise of
/// the reference.
fn tie_delays(all: &FitSetup, selection: &mut Selection, options: FitOptions) {
    let delays: Vec<EffectTerm> = selection
        .steps
        .iter()
        .flat_map(|step| step.shadows.iter().cloned())
        .chain(selection.last.iter().map(|screened| screened.candidate.clone()))
        .filter(is_delay)
        .collect();
    for place in 0..selection.steps.len() {
        let (Some(last), step) = (selection.stages.last(), &selection.steps[place]) else {
            return;
        };
        if !is_delay(&step.chosen) {
            continue;
        }
        let mut forms: Vec<EffectTerm> = Vec::new();
        for form in &delays {
            let is_known = last.effects.contains(form) || step.tied.contains(form);
            if is_known || forms.contains(form) {
                continue;
            }
            let effects = replaced(&last.effects, &step.chosen, form);
            // A form of the other sign may not be fitted at all.
            let Ok(model) = FittedModel::new(all, effects, last.fit.split, options) else {
                continue;
            };
            let is_equal = model.mean_square() <= (1.0 + NOISE_OF_DELAY) * last.mean_square();
            if is_equal && model.is_possible(all.recordings()) {
                forms.push(form.clone());
            }
        }
        let step = &mut selection.steps[place];
        step.shadows.retain(|shadow| !forms.contains(shadow));
        step.tied.extend(forms);
    }
}

/// Removes each step whose magnitude is not determined in the last model, fitted to all rows, unless it lowers the error there in
/// every fold: what a later step explains may have been in the residual when it was accepted. Models after a removed step are fitted
/// again.
///
/// # Errors
/// A fit fails.
fn eliminate_undetermined(
    all: &FitSetup,
    selection: &mut Selection,
    formulas: usize,
    options: FitOptions,
) -> Result<()> {
    let mut place = 0;
    while place < selection.steps.len() && selection.steps.len() + formulas > 1 {
        let (Some(last), chosen) = (selection.stages.last(), &selection.steps[place].chosen) else {
            return Ok(());
        };
        let size = last.size_of(chosen, all.recordings());
        if chosen.is_event() || size.is_none_or(|size| size.is_determined()) {
            place += 1;
            continue;
        }
        let others = last.effects.iter().filter(|effect| *effect != chosen).cloned();
        let without = FittedModel::new(all, others.collect(), last.fit.split, options)?;
        if last.gain(&without) > MIN_KEPT && last.improves_all_folds(&without) {
            place += 1;
            continue;
        }
        selection.remove(place, without, DropReason::Undetermined, (all, options))?;
        if let Some(next) = selection.steps.get_mut(place) {
            next.is_of_pair = false;
        }
    }
    Ok(())
}
