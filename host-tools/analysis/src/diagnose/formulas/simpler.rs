//! Formulas with fewer parameters that explain as much as one accepted effect.
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

use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::selection::Selection;

/// Rows of a recording on which the formulas are compared with each other.
const ROWS: usize = 150;

/// What a covariate `c` may do: target and factor next to the coefficient of each formula.
const CAUSES: [&[(&str, &str)]; 11] = [
    &[("dx_um", "")],
    &[("dy_um", "")],
    &[("dz_um", "")],
    &[("fx_n", "")],
    &[("fz_n", "")],
    // A load cell's zeros, and a support that expands.
    &[("fx_n", ""), ("fz_n", "")],
    &[("dx_um", ""), ("dy_um", ""), ("dz_um", "")],
    &[("dx_um", "fx_n*")],
    &[("dz_um", "fz_n*")],
    &[("dx_um", "fx_n*"), ("dz_um", "fz_n*")],
    &[("fx_n", "fx_n*"), ("fz_n", "fz_n*")],
];

/// A formula that explains as much as an accepted effect, with fewer parameters.
pub struct SimplerFormula {
    pub effect: EffectTerm,
    /// The formula in its place.
    pub formula: DiscoveredFormula,
}

/// For each accepted effect that reads a covariate: the formula of that covariate that explains as much with fewer parameters, if
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
        let parameters = effect.parameters(sample.recordings()).len();
        let name = format!("formula_{}", count + found.len() + 1);
        let mut causes: Vec<Cause> = Vec::new();
        for covariate in effect.needs() {
            for points in CAUSES.iter().filter(|points| points.len() < parameters) {
                causes.push(Cause::new(&name, points, &covariate)?);
            }
        }
        let others: Vec<EffectTerm> =
            last.effects.iter().filter(|own| *own != effect).cloned().collect();
        let with = |cause: &Cause| [&others[..], &cause.effects].concat();
        let mut fits: Vec<(f64, Cause)> = causes
            .into_par_iter()
            .filter_map(|cause| {
                let fit = FittedModel::without_validation(&few, with(&cause), options).ok()?;
                Some((fit.fitted_mean_square(), cause))
            })
            .collect();
        fits.sort_by(|a, b| a.0.total_cmp(&b.0));
        // The best of each number of formulas, fewer first.
        let mut best: BTreeMap<usize, Cause> = BTreeMap::new();
        for (_, cause) in fits {
            best.entry(cause.effects.len()).or_insert(cause);
        }
        for cause in best.into_values() {
            let model = FittedModel::without_validation(sample, with(&cause), options)?;
            if model.is_clearly_worse(last) {
                continue;
            }
            let split = all.split(&[&last.effects[..], &cause.effects].concat());
            let model = model.on(all, split, options)?;
            let with_effect = last.clone().with_split(all, split, options);
            if with_effect.is_distinguishably_better(&model) {
                continue;
            }
            let left = model.mean_square() / with_effect.mean_square();
            let mut formula = DiscoveredFormula {
                name,
                targets: cause.targets,
                covariates: vec![cause.covariate],
                effects: cause.effects,
                models: Vec::new(),
                gain: 1.0 - (1.0 - step.gain) * left,
                // It is compared with the effect, not tested.
                p_value: f64::NAN,
                other_targets: None,
            };
            formula.set_models(&model, all.recordings());
            found.push(SimplerFormula { effect: effect.clone(), formula });
            break;
        }
    }
    Ok(found)
}

/// Formulas of one covariate that act together.
struct Cause {
    covariate: String,
    targets: Vec<&'static str>,
    effects: Vec<EffectTerm>,
}

impl Cause {
    /// Named after their targets where there are several.
    fn new(name: &str, points: &[(&'static str, &str)], covariate: &str) -> Result<Self> {
        let formula = |(target, factor): &(&str, &str)| {
            let name = if points.len() == 1 { name.to_owned() } else { format!("{name}_{target}") };
            let text = format!("{name}: {target} = a*{factor}{covariate}");
            let expression = Expression::parse(&text, &[], &Expression::covariate_names(&text))
                .map_err(|error| anyhow!("{error}"))?;
            Ok(EffectTerm::Expression(Arc::new(expression)))
        };
        Ok(Self {
            covariate: covariate.to_owned(),
            targets: points.iter().map(|(target, _)| *target).collect(),
            effects: points.iter().map(formula).collect::<Result<_>>()?,
        })
    }
}
