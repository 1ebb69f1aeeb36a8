//! Rates with their confidence intervals and specifications.

use super::cases::Group;
use super::evaluate::{FormulaEvaluation, PredictedCounts};
use super::run::Outcome;
use crate::intervals;
use analysis::diagnose::candidates::LEVEL;

/// Minimum magnitude of a detectable effect in standard errors.
pub const MIN_EFFECT_SIZE: f64 = 4.0;
/// Specified rate of campaigns without an effect in which one has a p-value below [`LEVEL`].
const MAX_SMALL_P: f64 = 0.07;
/// Specified mean number of equivalent effects.
const MAX_EQUIVALENT: f64 = 1.5;

/// A rate, or a mean, and its specification.
#[derive(Clone, Debug, PartialEq)]
pub struct Rate {
    name: &'static str,
    value: f64,
    /// Hits and number of cases; none of a mean.
    counts: Option<(usize, usize)>,
    /// At least (true) or at most the specified value.
    at_least: bool,
    /// None of a figure without a requirement.
    specified: Option<f64>,
}

impl Rate {
    fn of(name: &'static str, hits: usize, of: usize, at_least: bool, specified: f64) -> Self {
        let value = hits as f64 / of.max(1) as f64;
        Self { name, value, counts: Some((hits, of)), at_least, specified: Some(specified) }
    }

    /// A figure without a requirement.
    fn figure(name: &'static str, hits: usize, of: usize) -> Self {
        Self { specified: None, ..Self::of(name, hits, of, true, 0.0) }
    }

    /// Whether the specification is met.
    pub fn is_reached(&self) -> bool {
        self.specified.is_none_or(|specified| {
            if self.at_least { self.value >= specified } else { self.value <= specified }
        })
    }

    /// Row of the table.
    pub fn cells(&self, group: Group, seeds: u64) -> [String; 6] {
        let relation = if self.at_least { "at least" } else { "at most" };
        let missed = if self.is_reached() { "" } else { " (not met)" };
        let specified = |text: &dyn Fn(f64) -> String| {
            self.specified
                .map_or_else(|| "-".to_owned(), |value| format!("{relation} {}", text(value)))
        };
        let (rate, limits, specified) = match self.counts {
            Some((hits, of)) => {
                let [lower, upper] = intervals::proportion(hits, of).map(|share| 100.0 * share);
                (
                    format!("{hits} of {of}{missed}"),
                    format!("{lower:.1} to {upper:.1} %"),
                    specified(&|share| format!("{:.0} %", 100.0 * share)),
                )
            }
            None => (
                format!("{:.2}{missed}", self.value),
                "-".to_owned(),
                specified(&|value| value.to_string()),
            ),
        };
        [
            group.description().to_owned(),
            seeds.to_string(),
            self.name.to_owned(),
            rate,
            limits,
            specified,
        ]
    }
}

pub fn rates(group: Group, outcomes: &[Outcome]) -> Vec<Rate> {
    let detectable = outcomes.iter().filter(|o| o.z.is_nan() || o.z >= MIN_EFFECT_SIZE);
    let detectable: Vec<&Outcome> = detectable.collect();
    let all = detectable.len();
    let count =
        |is: &dyn Fn(&Outcome) -> bool| detectable.iter().filter(|outcome| is(outcome)).count();
    let right = count(&|outcome| outcome.evaluation.right);
    let wrong = count(&|outcome| outcome.evaluation.wrong_alone);
    let correct = |specified| {
        Rate::of("correct, alone or among equivalent effects", right, all, true, specified)
    };
    let only_wrong = |specified| Rate::of("only a wrong effect", wrong, all, false, specified);
    let formulas: Vec<FormulaEvaluation> =
        outcomes.iter().filter_map(|outcome| outcome.evaluation.formulas).collect();
    let sum = |count: fn(&PredictedCounts) -> usize| -> usize {
        outcomes.iter().filter_map(|outcome| outcome.evaluation.predicted.as_ref()).map(count).sum()
    };
    let predicted = sum(|of| of.predicted);
    let mut rates = match group {
        Group::Typical => vec![correct(0.98), only_wrong(0.02)],
        Group::Small => vec![correct(0.92), only_wrong(0.03)],
        Group::Nothing => {
            let named = Rate::of("an effect named", all - right, all, false, 0.01);
            let small = |(name, noise): (&'static str, &str)| {
                let own = || outcomes.iter().filter(|outcome| outcome.noise == noise);
                let below = own().filter(|outcome| outcome.least_p < LEVEL).count();
                Rate::of(name, below, own().count(), false, MAX_SMALL_P)
            };
            let noises = [
                ("least adjusted p below 0.05, white noise", "white"),
                ("least adjusted p below 0.05, correlated noise", "ar1"),
                ("least adjusted p below 0.05, random walk", "walk"),
            ];
            std::iter::once(named).chain(noises.map(small)).collect()
        }
        Group::Pairs => vec![Rate::of("both correct", right, all, true, 0.97)],
        Group::Outside => {
            let is_unnamed = |outcome: &Outcome| outcome.evaluation.formulas.is_none();
            let unnamed = count(&is_unnamed);
            let wrong = count(&|o| is_unnamed(o) && o.evaluation.wrong_alone);
            let rate = Rate::of("no wrong effect alone", unnamed - wrong, unnamed, true, 0.92);
            if unnamed > 0 { vec![rate] } else { Vec::new() }
        }
        Group::Always => vec![Rate::of("reported as inconclusive", right, all, true, 1.0)],
        Group::Planned => vec![
            Rate::of(
                "predicted decisions that are right",
                sum(|of| of.right),
                predicted,
                true,
                0.95,
            ),
            Rate::figure("open questions with a predicted decision", predicted, sum(|of| of.open)),
            Rate::of("only a wrong effect", wrong, all, false, 0.02),
        ],
    };
    let located: Vec<bool> = outcomes.iter().filter_map(|o| o.evaluation.located).collect();
    if !located.is_empty() {
        let hits = located.iter().filter(|located| **located).count();
        rates.push(Rate::of("attributed to its covariate", hits, located.len(), true, 0.85));
    }
    if !formulas.is_empty() {
        let rate = |name, is: fn(&FormulaEvaluation) -> bool, at_least, specified| {
            let hits = formulas.iter().filter(|of| is(of)).count();
            Rate::of(name, hits, formulas.len(), at_least, specified)
        };
        let covariates = "formula with the right covariates";
        rates.push(rate(covariates, |of| of.right_covariates, true, 0.9));
        let explains = "held-out error with it at most 1.15 floors";
        rates.push(rate(explains, |of| of.explains, true, 0.8));
        rates.push(rate("an effect of the catalogue named", |of| of.false_name, false, 0.02));
    }
    if group == Group::Typical {
        let sizes: Vec<usize> = detectable.iter().filter_map(|o| o.evaluation.tied).collect();
        rates.push(Rate {
            name: "equivalent effects, mean number",
            value: sizes.iter().sum::<usize>() as f64 / sizes.len().max(1) as f64,
            counts: None,
            at_least: false,
            specified: Some(MAX_EQUIVALENT),
        });
    }
    rates
}
