//! Formulas that are an effect of the catalogue: next to another cause the effect did not lower the error of every fold.

use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::score_test::{CandidateScore, ScoreTest};
use rayon::prelude::*;

use crate::diagnose::candidates::{REPLACES, ScreenedEffect, screen};
use crate::diagnose::fitted_model::{FittedModel, NEAR};
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::selection::{AcceptedStep, Selection};

/// Replaces formulas by effects of the catalogue that do the same, and explain more, or as much with no more parameters. Where structure
/// remains, the formulas are approximations, and so would be the effects.
///
/// # Errors
/// A fit fails.
pub fn name_formulas(
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
