//! From a selection to verdicts.

use crate::analysis::compare::format::{AT_FLOOR, field};
use crate::analysis::diagnose::candidate_fit::FittedModel;
use crate::analysis::diagnose::candidates::{ScreenedEffect, UntestableEffect};
use crate::analysis::diagnose::confusable_effects::are_confusable;
use crate::analysis::diagnose::format::{self, SEE_BELOW};
use crate::analysis::diagnose::forward_selection::{AcceptedStep, Selection};
use crate::analysis::diagnose::{Diagnosis, StaircaseStep, Unexplained, Verdict, VerdictKind};
use model_export::effects::EffectTerm;
use model_export::fit::effect_size::{EffectSize, effect_sizes};
use model_export::fit::score_test::CandidateScore;

/// Minimum typical magnitude in standard errors for a conclusive verdict.
const MIN_Z: f64 = 4.0;

/// Maximum length of a reason in a table.
const MAX_SHORT: usize = 22;

/// Verdicts on all candidates, and the summary.
pub fn conclude(
    selection: &Selection,
    unjudged: &[UntestableEffect],
    recordings: usize,
) -> Diagnosis {
    let Some(last) = selection.stages.last() else {
        return Diagnosis::default();
    };
    let complete = selection.is_complete();
    let mut diagnosis = Diagnosis {
        at_floor: last.floors() <= AT_FLOOR,
        accepted: if complete { selection.steps.iter().map(names).collect() } else { Vec::new() },
        unexplained: selection
            .attributed
            .iter()
            .filter(|(covariate, _)| covariate.name != "constant")
            .map(|(covariate, share)| Unexplained {
                covariate: covariate.name.to_string(),
                words: covariate.words.to_string(),
                share: *share,
            })
            .collect(),
        staircase: stairs(selection),
        block_s: selection.block_s,
        blocks: selection.blocks,
        ..Diagnosis::default()
    };
    if last.floors() <= AT_FLOOR {
        diagnosis.unexplained.clear();
    }
    for step in &selection.steps {
        diagnosis.verdicts.extend(of_step(step, last, recordings, complete));
    }
    let named = |name: &str, verdicts: &[Verdict]| verdicts.iter().any(|v| v.effect == name);
    for screened in &selection.last {
        if !named(screened.candidate.name(), &diagnosis.verdicts) {
            diagnosis.verdicts.push(of_rest(screened, complete, selection, &diagnosis.unexplained));
        }
    }
    diagnosis.verdicts.extend(unjudged.iter().map(of_unjudged));
    diagnosis.verdicts.sort_by(|a, b| {
        (a.kind, b.gain).partial_cmp(&(b.kind, a.gain)).unwrap_or(std::cmp::Ordering::Equal)
    });
    diagnosis.verdict = sentence(&diagnosis, selection, last, complete);
    diagnosis
}

fn names(step: &AcceptedStep) -> Vec<String> {
    let all = std::iter::once(&step.chosen).chain(&step.tied);
    all.map(|effect| effect.name().to_owned()).collect()
}

fn stairs(selection: &Selection) -> Vec<StaircaseStep> {
    let added = std::iter::once(Vec::new()).chain(selection.steps.iter().map(names));
    let stair = |(stage, added): (&FittedModel, Vec<String>)| StaircaseStep {
        added,
        held_out_rms_g: stage.mean_square().sqrt(),
        held_out_rmse_n: stage.fit.tally().rmse_n(),
        floor_g: stage.fit.tally().floor_g(),
    };
    selection.stages.iter().zip(added).map(stair).collect()
}

fn of_step(
    step: &AcceptedStep,
    last: &FittedModel,
    recordings: usize,
    complete: bool,
) -> Vec<Verdict> {
    let found = effect_sizes(&last.fit, &last.effects, recordings);
    let size = last.effects.iter().position(|effect| *effect == step.chosen).map(|i| &found[i]);
    let all = names(step);
    let record = |effect: &EffectTerm| {
        effect.effect().map_or_else(String::new, |effect| effect.record.to_owned())
    };
    let base = |effect: &EffectTerm, kind: VerdictKind| Verdict {
        effect: effect.name().to_owned(),
        kind,
        provisional: !complete,
        tied_with: all.iter().filter(|name| *name != effect.name()).cloned().collect(),
        gain: step.gain,
        p_adjusted: step.p_adjusted,
        value: f64::NAN,
        std_error: f64::NAN,
        unit: effect.size().unit.to_owned(),
        z_typical: step.z_typical,
        reason: String::new(),
        short: String::new(),
        record: String::new(),
    };
    let mut verdicts = Vec::new();
    for effect in std::iter::once(&step.chosen).chain(&step.tied) {
        let mut verdict =
            base(effect, if step.tied.is_empty() { VerdictKind::Found } else { VerdictKind::Tied });
        verdict.reason = if step.tied.is_empty() {
            format!("it reduces the cross-validated squared error by {:.1} %", 100.0 * step.gain)
        } else {
            verdict.record = record(effect);
            "each of them explains the same; these recordings cannot distinguish them".to_owned()
        };
        if !step.tied.is_empty() {
            verdict.short = format!("or {}", verdict.tied_with.join(", "));
        }
        if *effect == step.chosen
            && let Some(size) = size
        {
            (verdict.value, verdict.std_error) = (size.value, size.std_error);
            verdict.reason += &unusual(size);
            if step.tied.is_empty() {
                verdict.short = format::value(size.value, size.std_error, &verdict.unit);
            }
        }
        verdicts.push(verdict);
    }
    for effect in &step.shadows {
        let mut verdict = base(effect, VerdictKind::Shadow);
        verdict.tied_with.clear();
        (verdict.gain, verdict.p_adjusted, verdict.z_typical) = (f64::NAN, f64::NAN, f64::NAN);
        verdict.reason = format!("it explains part of what {} explains better", all.join(" or "));
        verdict.short = format!("part of {}", step.chosen.name());
        verdicts.push(verdict);
    }
    verdicts
}

fn unusual(size: &EffectSize) -> String {
    if size.is_plausible() {
        String::new()
    } else {
        format!(
            "; an implausible magnitude: typical are {} to {} {}",
            size.size.plausible.0, size.size.plausible.1, size.size.unit
        )
    }
}

fn of_rest(
    screened: &ScreenedEffect,
    complete: bool,
    selection: &Selection,
    unexplained: &[Unexplained],
) -> Verdict {
    let effect = &screened.candidate;
    let evidence = &screened.evidence;
    let record = effect.effect().map_or_else(String::new, |effect| effect.record.to_owned());
    let (kind, reason, short, record) = if !complete {
        let what = match unexplained.first() {
            Some(first) => {
                format!("{:.0} % of the residual follows the {}", 100.0 * first.share, first.words)
            }
            None => "much more than noise is unexplained".to_owned(),
        };
        (
            VerdictKind::Inconclusive,
            format!("{what} and is explained by no effect, which prevents a verdict"),
            "too much is unexplained".to_owned(),
            record,
        )
    } else if screened.is_significant() {
        let (kind, reason, short) = remainder(effect, selection);
        (kind, reason, short, record)
    } else if evidence.z_typical < MIN_Z {
        let (why, short) = inadequate(evidence);
        (VerdictKind::Inconclusive, why, short.to_owned(), record)
    } else {
        // Rounded up: a bound of nothing would be a claim.
        let bound = (100.0 * evidence.bound).ceil() / 100.0;
        (
            VerdictKind::Absent,
            format!("at most {bound:.2} times its typical magnitude (95 %)"),
            format!("< {bound:.2} of typical"),
            String::new(),
        )
    };
    Verdict {
        effect: effect.name().to_owned(),
        kind,
        provisional: !complete,
        tied_with: Vec::new(),
        gain: evidence.gain(),
        p_adjusted: screened.p_adjusted,
        value: f64::NAN,
        std_error: f64::NAN,
        unit: effect.size().unit.to_owned(),
        z_typical: evidence.z_typical,
        reason,
        short,
        record,
    }
}

/// A reason in short form for a table.
fn short_of(why: &str) -> String {
    match why.strip_suffix(" was not recorded") {
        Some(column) => format!("no {column}"),
        None if why.len() <= MAX_SHORT => why.to_owned(),
        None => SEE_BELOW.to_owned(),
    }
}

/// Why a typical magnitude is not detectable, and a short form.
fn inadequate(evidence: &CandidateScore) -> (String, &'static str) {
    let z = evidence.z_typical;
    let (why, short) = if evidence.z_unadjusted < MIN_Z {
        ("a typical magnitude hardly changes the field here", "hardly changes the field")
    } else if evidence.z_white_noise < MIN_Z {
        ("it is confounded with the model's parameters", "confounded")
    } else {
        ("the residual of other causes masks a typical magnitude", "masked by other causes")
    };
    (format!("{why} ({z:.1} standard errors)"), short)
}

/// Verdict on an effect that explains part of the residual without being accepted.
fn remainder(effect: &EffectTerm, selection: &Selection) -> (VerdictKind, String, String) {
    let confusable = selection.steps.iter().find(|step| are_confusable(&step.chosen, effect));
    match confusable {
        Some(step) => (
            VerdictKind::Shadow,
            format!(
                "it explains a remainder that is consistent with the form of {}",
                step.chosen.name()
            ),
            format!("part of {}", step.chosen.name()),
        ),
        None if effect.is_transient() => (
            VerdictKind::Inconclusive,
            "the residual drifts with time more freely than this effect can".to_owned(),
            "drifts with time".to_owned(),
        ),
        None => (
            VerdictKind::Inconclusive,
            "it fits part of a residual with another cause".to_owned(),
            "has another cause".to_owned(),
        ),
    }
}

fn of_unjudged(unjudged: &UntestableEffect) -> Verdict {
    Verdict {
        effect: unjudged.effect.clone(),
        kind: VerdictKind::Inconclusive,
        provisional: false,
        tied_with: Vec::new(),
        gain: 0.0,
        p_adjusted: f64::NAN,
        value: f64::NAN,
        std_error: f64::NAN,
        unit: String::new(),
        z_typical: 0.0,
        reason: unjudged.reason.clone(),
        short: short_of(&unjudged.reason),
        record: unjudged.record.clone(),
    }
}

fn sentence(
    diagnosis: &Diagnosis,
    selection: &Selection,
    last: &FittedModel,
    complete: bool,
) -> String {
    let rms = field(last.mean_square().sqrt());
    let floors = last.floors();
    let steps: Vec<String> = selection
        .steps
        .iter()
        .map(|step| {
            if step.tied.is_empty() {
                step.chosen.name().to_owned()
            } else {
                format!("one of {}", names(step).join(", "))
            }
        })
        .collect();
    let missing = match (steps.is_empty(), complete) {
        (true, _) => "No missing effect was found".to_owned(),
        (false, true) => format!("Missing: {}", steps.join("; ")),
        (false, false) => format!("Provisionally missing: {}", steps.join("; ")),
    };
    let unexplained = diagnosis.unexplained.first().map(|first| {
        format!("{:.0} % of the residual follows the {}", 100.0 * first.share, first.words)
    });
    match (complete, unexplained) {
        (true, _) if floors <= AT_FLOOR => {
            format!(
                "{missing}. The residual is then {rms}, {floors:.2} times the floor: at the noise floor."
            )
        }
        (_, Some(unexplained)) => format!(
            "Structure remains: {unexplained}, and no effect explains it ({rms}, {floors:.1} times the floor). {}",
            if steps.is_empty() {
                "Test a formula of your own over it with --expr.".to_owned()
            } else {
                format!("{missing}.")
            }
        ),
        _ => format!(
            "{missing}. Structure remains: {rms}, {floors:.1} times the floor, explained by no covariate."
        ),
    }
}
