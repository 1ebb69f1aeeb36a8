//! Formulas with fewer coefficients that explain as much as one accepted effect.
//!
//! An effect with several coefficients for each sensor may imitate a cause that has one: the offsets and gains of a sensor over the
//! temperature explain flexures that soften when warm. Whether they do is not seen where the error falls to the noise floor, so each
//! such effect is compared with what the same covariate may do to forces and flexures.

use std::collections::BTreeMap;

use anyhow::{Result, anyhow};
use model_export::effects::EffectTerm;
use model_export::effects::expression::Expression;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use rayon::prelude::*;
use std::sync::Arc;

use crate::diagnose::formulas::DiscoveredFormula;
use crate::diagnose::selection::{FittedModel, Selection};

/// Rows of a recording on which the formulas are compared with each other.
const ROWS: usize = 150;

/// What a covariate `c` may do: target and factor next to the coefficient of each formula.
const CAUSES: [&[(&str, &str)]; 9] = [
    &[("dx_um", "")],
    &[("dy_um", "")],
    &[("dz_um", "")],
    &[("fx_n", "")],
    &[("fz_n", "")],
    &[("dx_um", "fx_n*")],
    &[("dz_um", "fz_n*")],
    &[("dx_um", "fx_n*"), ("dz_um", "fz_n*")],
    &[("fx_n", "fx_n*"), ("fz_n", "fz_n*")],
];

/// A formula that explains as much as an accepted effect, with fewer coefficients.
pub struct SimplerFormula {
    /// The effect.
    pub effect: EffectTerm,
    /// The formula in its place.
    pub formula: DiscoveredFormula,
}

/// For each accepted effect that reads a covariate: the formula of that covariate that explains as much with fewer coefficients, if
/// there is one. They are compared on the rows of `sample`, and the best with the effect on all rows. `count` formulas were found
/// already. None for a polynomial, which has no flexures.
///
/// # Errors
/// A fit fails.
pub fn simpler_formulas(
    (sample, all): (&FitSetup, &FitSetup),
    selection: &Selection,
    count: usize,
    options: FitOptions,
) -> Result<Vec<SimplerFormula>> {
    // The targets are those of the sensor's geometry.
    let Some(last) = selection.stages.last().filter(|_| all.polynomials.is_empty()) else {
        return Ok(Vec::new());
    };
    let few = sample.sampled(ROWS);
    let mut found = Vec::new();
    for step in &selection.steps {
        let effect = &step.chosen;
        let coefficients = coefficients(effect, sample.recordings());
        let name = format!("formula_{}", count + found.len() + 1);
        let mut causes: Vec<Vec<EffectTerm>> = Vec::new();
        for covariate in effect.needs() {
            for cause in CAUSES.iter().filter(|cause| cause.len() < coefficients) {
                causes.push(formulas(&name, cause, &covariate)?);
            }
        }
        let others: Vec<EffectTerm> =
            last.effects.iter().filter(|own| *own != effect).cloned().collect();
        let with = |formulas: &[EffectTerm]| [&others, formulas].concat();
        let mut fits: Vec<(f64, Vec<EffectTerm>)> = causes
            .into_par_iter()
            .filter_map(|formulas| {
                let fit = FittedModel::without_validation(&few, with(&formulas), options).ok()?;
                Some((fit.fitted_mean_square(), formulas))
            })
            .collect();
        fits.sort_by(|a, b| a.0.total_cmp(&b.0));
        // The best of each number of formulas, fewer first.
        let mut best: BTreeMap<usize, Vec<EffectTerm>> = BTreeMap::new();
        for (_, formulas) in fits {
            best.entry(formulas.len()).or_insert(formulas);
        }
        for formulas in best.into_values() {
            let model = FittedModel::without_validation(sample, with(&formulas), options)?;
            if model.is_clearly_worse(last) {
                continue;
            }
            let split = all.split(&[&last.effects[..], &formulas].concat());
            let model = model.on(all, split, options)?;
            let with_effect = last.clone().with_split(all, split, options);
            if with_effect.is_distinguishably_better(&model) {
                continue;
            }
            let mut formula = DiscoveredFormula {
                name,
                covariates: effect.needs(),
                targets: targets(&formulas),
                effects: formulas,
                models: Vec::new(),
                gain: step.gain,
                p_value: step.p_adjusted,
                other_targets: None,
            };
            formula.set_models(&model, all.recordings());
            found.push(SimplerFormula { effect: effect.clone(), formula });
            break;
        }
    }
    Ok(found)
}

/// Coefficients of an effect for each sensor.
fn coefficients(effect: &EffectTerm, recordings: usize) -> usize {
    effect.parameters(recordings).iter().filter(|parameter| parameter.is_coefficient()).count()
}

/// The formulas of a cause, named after their targets where there are several.
fn formulas(name: &str, cause: &[(&str, &str)], covariate: &str) -> Result<Vec<EffectTerm>> {
    let formula = |(target, factor): &(&str, &str)| {
        let name = if cause.len() == 1 { name.to_owned() } else { format!("{name}_{target}") };
        let text = format!("{name}: {target} = a*{factor}{covariate}");
        let expression = Expression::parse(&text, &[], &Expression::covariate_names(&text))
            .map_err(|error| anyhow!("{error}"))?;
        Ok(EffectTerm::Expression(Arc::new(expression)))
    };
    cause.iter().map(formula).collect()
}

fn targets(formulas: &[EffectTerm]) -> Vec<&'static str> {
    let names = CAUSES.iter().flat_map(|cause| cause.iter().map(|(target, _)| *target));
    let acts_on = |target: &&'static str| {
        formulas.iter().any(|formula| match formula {
            EffectTerm::Expression(expression) => expression.text.contains(&format!("{target} =")),
            EffectTerm::Catalogue(_) => false,
        })
    };
    let mut targets: Vec<&'static str> = names.filter(acts_on).collect();
    targets.sort_unstable();
    targets.dedup();
    targets
}
