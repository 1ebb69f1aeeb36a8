//! The reason of a verdict in words.

use std::borrow::Cow;

use analysis::diagnose::candidates::{LEVEL, RESAMPLES};
use analysis::diagnose::{Reason, Unexplained, Verdict};
use analysis::numbers::{self, capitalised};

use crate::text::comparison::attribution::dependence;

/// A magnitude with a larger relative standard error is not identifiable.
const MAX_RELATIVE_ERROR: f64 = 10.0;
/// Placeholder in a table for a long reason.
const SEE_BELOW: &str = "see below";

/// The reason of a verdict, for a table and for a sentence.
struct ReasonWords {
    /// The magnitude or the reason in a few words, equal for equal reasons.
    short: Cow<'static, str>,
    clause: Cow<'static, str>,
}

/// Both forms of every reason.
fn words(verdict: &Verdict) -> ReasonWords {
    let z = verdict.z_typical;
    let magnitude = || value(verdict);
    let missing = || verdict.reason.missing_data().unwrap_or_default().into();
    let (short, mut clause): (Cow<'static, str>, Cow<'static, str>) = match &verdict.reason {
        Reason::ReducesError => {
            let included = if verdict.inclusion.is_finite() {
                format!(
                    ", and is included in {:.0} of {RESAMPLES} resamples of the blocks of time",
                    verdict.inclusion * RESAMPLES as f64
                )
            } else {
                String::new()
            };
            let size = if verdict.value.is_finite() { magnitude() } else { String::new() };
            (size.into(), format!("it {}{included}", reduction(verdict.gain)).into())
        }
        Reason::Equivalent => (
            format!("or {}", verdict.tied_with.join(", ")).into(),
            "each of them explains the same; these recordings cannot distinguish them".into(),
        ),
        Reason::ExplainedBetter(effects) => (
            effects.first().map_or_else(String::new, |first| format!("part of {first}")).into(),
            format!("it explains part of what {} explains better", effects.join(" or ")).into(),
        ),
        Reason::FormOf(effect) => (
            format!("form of {effect}").into(),
            format!("it explains a remainder that is consistent with another form of {effect}")
                .into(),
        ),
        Reason::DriftsWithTime => (
            "drifts with time".into(),
            "the residual drifts with time more freely than this effect can".into(),
        ),
        Reason::OtherCause => {
            ("has another cause".into(), "it fits part of a residual with another cause".into())
        }
        Reason::Implausible => {
            let (word, why) = match verdict.implausible {
                Some(_) => ("implausible", "so the cause is another one"),
                None => ("undetermined", "which is negligible or not determined"),
            };
            let (gain, size) = (100.0 * verdict.gain, magnitude());
            (
                format!("{word}: {size}").into(),
                format!("it lowers the error by {gain:.1} %, but only with {size}, {why}").into(),
            )
        }
        Reason::Unconfirmed => (
            "not confirmed by a fit".into(),
            "the score test is significant, but no fit with it lowers the held-out error in every fold, with a plausible magnitude"
                .into(),
        ),
        Reason::UnexplainedResidual(first) => {
            let much = || "much more than noise is unexplained".to_owned();
            let what = first.as_ref().map_or_else(much, residual_follows);
            (
                "much is unexplained".into(),
                format!("{what} and is explained by no effect, which prevents a verdict").into(),
            )
        }
        Reason::HardlyChangesField => (
            "not detectable here".into(),
            format!("a typical magnitude hardly changes the field here ({z:.1} standard errors)")
                .into(),
        ),
        Reason::Confounded => (
            "confounded".into(),
            format!("it is confounded with the model's parameters ({z:.1} standard errors)").into(),
        ),
        Reason::Masked => (
            "masked by other causes".into(),
            format!(
                "the residual of other causes masks a typical magnitude ({z:.1} standard errors)"
            )
            .into(),
        ),
        Reason::BelowBound(bound) => {
            // Why a small p-value is not enough.
            let short = match (verdict.p_adjusted < LEVEL, *bound < 1.0) {
                (true, true) => format!("not in every fold, < {bound:.2} of typical"),
                (true, false) => "not in every fold".to_owned(),
                (false, true) => format!("< {bound:.2} of typical"),
                (false, false) => "not significant".to_owned(),
            };
            let clause = if *bound >= 1.0 {
                format!(
                    "no significant gain on held-out rows, where a typical magnitude would be {z:.0} standard errors"
                )
            } else {
                format!("at most {bound:.2} times its typical magnitude (95 %)")
            };
            (short.into(), clause.into())
        }
        Reason::NeedsGeometry => (
            SEE_BELOW.into(),
            "it acts on the magnet, which a polynomial does not model: give [design] and fit the cylinder base"
                .into(),
        ),
        Reason::InPolynomial => (
            SEE_BELOW.into(),
            "it depends on the forces alone, and the polynomial of the forces contains it".into(),
        ),
        Reason::NeedsForce => {
            (SEE_BELOW.into(), "it acts through a force, and no force was recorded".into())
        }
        Reason::DoesNotVary(column) => {
            (SEE_BELOW.into(), format!("{column} does not vary beyond its noise").into())
        }
        Reason::NoTimeOrder => {
            ("rows without time".into(), "the order of the rows carries no time".into())
        }
        Reason::NotRecorded(column, _) => (format!("no {column}").into(), missing()),
        Reason::AssumedTimes(_) => ("times are assumed".into(), missing()),
        Reason::NotAField(_) => ("no magnetic field".into(), missing()),
        Reason::Unfitted(error) => (
            "base model not fitted".into(),
            format!("the base model cannot be fitted: {error}").into(),
        ),
    };
    if let Some((low, high)) = verdict.implausible {
        clause = format!("{clause}; plausible are {low} to {high} {}", verdict.unit).into();
    }
    ReasonWords { short, clause }
}

/// "7.98±0.01 N", of sensors that differ "0.00 to 1.94 ms by sensor", or that the magnitude is not identifiable.
pub(super) fn value(verdict: &Verdict) -> String {
    let Verdict { value, std_error, differs, unit, .. } = verdict;
    if let Some(differs) = *differs {
        return format!("{} {unit} by sensor", numbers::between(differs));
    }
    let (value, std_error) = (*value, *std_error);
    if std_error > MAX_RELATIVE_ERROR * value.abs() {
        return "not identifiable".to_owned();
    }
    let value = numbers::with_error(value, std_error, value.abs());
    format!("{value} {unit}").trim_end().to_owned()
}

/// What a step gains; an earlier step may raise the error that a later one lowers.
pub(super) fn reduction(gain: f64) -> String {
    if gain > 0.0 {
        format!("reduces the held-out squared error by {:.1} %", 100.0 * gain)
    } else {
        "reduces the held-out squared error together with the later steps".to_owned()
    }
}

/// The reason of a verdict, as a clause.
pub fn reason(verdict: &Verdict) -> String {
    words(verdict).clause.into_owned()
}

pub fn reason_sentence(verdict: &Verdict) -> String {
    format!("{}.", capitalised(&words(verdict).clause))
}

/// The magnitude or the reason in a few words, for a table.
pub fn short_reason(verdict: &Verdict) -> String {
    words(verdict).short.into_owned()
}

/// Reason by which an effect is grouped.
pub(super) fn group_reason(verdict: &Verdict) -> String {
    let ReasonWords { short, clause } = words(verdict);
    if short.is_empty() || short == SEE_BELOW { clause.into_owned() } else { short.into_owned() }
}

/// "84 % of the residual follows the rotor angle".
pub(super) fn residual_follows(unexplained: &Unexplained) -> String {
    let dependence = dependence(&unexplained.covariate, &unexplained.words);
    format!("{:.0} % of the residual {dependence}", 100.0 * unexplained.share)
}
