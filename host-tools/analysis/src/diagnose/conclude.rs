//! From a selection to verdicts.

use crate::compare::{AT_FLOOR, BELOW_FLOOR};
use crate::diagnose::candidates::{ScreenedEffect, UntestableEffect, insufficient};
use crate::diagnose::diagnosis::{Diagnosis, StaircaseStep};
use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::selection::{AcceptedStep, Selection};
use crate::diagnose::verdict::{Reason, Unexplained, Verdict, VerdictKind, record_of};
use model_export::effects::EffectTerm;
use model_export::fit::effect_size::{EffectSize, effect_sizes};

/// Verdicts on all candidates, and the summary.
pub fn conclude(
    selection: &Selection,
    formulas: &[DiscoveredFormula],
    untestable: &[UntestableEffect],
    recordings: usize,
) -> Diagnosis {
    let Some(last) = selection.stages.last() else {
        return Diagnosis::default();
    };
    let complete = selection.is_complete();
    let mut diagnosis = Diagnosis {
        at_floor: last.floors() >= BELOW_FLOOR && last.is_at_floor(),
        worst_axis: last.worst_axis(),
        accepted: if complete {
            let of_formulas = formulas.iter().flat_map(|formula| &formula.effects);
            let of_formulas = of_formulas.map(|effect| vec![effect.name().to_owned()]);
            selection.steps.iter().map(names).chain(of_formulas).collect()
        } else {
            Vec::new()
        },
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
        staircase: stairs(selection, formulas),
        dropped: selection.dropped.clone(),
        is_complete: complete,
        block_s: selection.block_s,
        blocks: selection.blocks,
        ..Diagnosis::default()
    };
    if last.is_at_floor() {
        diagnosis.unexplained.clear();
    }
    let named = |name: &str, verdicts: &[Verdict]| verdicts.iter().any(|v| v.effect == name);
    let of_steps: Vec<Verdict> =
        selection.steps.iter().flat_map(|step| of_step(step, last, recordings, complete)).collect();
    // An effect may explain less than another in one step and be accepted in the next.
    let (shadows, accepted): (Vec<_>, Vec<_>) =
        of_steps.into_iter().partition(|verdict| verdict.kind == VerdictKind::Shadow);
    for verdict in accepted.into_iter().chain(shadows) {
        if !named(&verdict.effect, &diagnosis.verdicts) {
            diagnosis.verdicts.push(verdict);
        }
    }
    for step in &selection.unconfirmed {
        for effect in std::iter::once(&step.chosen).chain(&step.tied) {
            if !named(effect.name(), &diagnosis.verdicts) {
                diagnosis.verdicts.push(unconfirmed(effect, step, complete));
            }
        }
    }
    for screened in &selection.last {
        if !named(screened.candidate.name(), &diagnosis.verdicts) {
            diagnosis.verdicts.push(of_rest(screened, complete, selection, &diagnosis.unexplained));
        }
    }
    for verdict in &mut diagnosis.verdicts {
        verdict.reproduces = selection.similarity.reproduced_by(&verdict.effect);
    }
    diagnosis.verdicts.extend(untestable.iter().map(UntestableEffect::verdict));
    diagnosis.sort_verdicts();
    diagnosis
}

fn names(step: &AcceptedStep) -> Vec<String> {
    let all = std::iter::once(&step.chosen).chain(&step.tied);
    all.map(|effect| effect.name().to_owned()).collect()
}

fn stairs(selection: &Selection, formulas: &[DiscoveredFormula]) -> Vec<StaircaseStep> {
    let added = std::iter::once(Vec::new()).chain(selection.steps.iter().map(names));
    let added = added.chain(formulas.iter().map(|formula| vec![formula.name.clone()]));
    let stair = |(stage, added): (&FittedModel, Vec<String>)| StaircaseStep {
        added,
        parameters: stage.parameters(),
        held_out_rms_g: stage.mean_square().sqrt(),
        force: None,
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
    let base = |effect: &EffectTerm, kind: VerdictKind| Verdict {
        provisional: !complete,
        unit: effect.size_unit().into_owned(),
        ..Verdict::new(effect.name(), kind, Reason::ReducesError)
    };
    let mut verdicts = Vec::new();
    let is_tied = !step.tied.is_empty();
    let kind = if is_tied { VerdictKind::Tied } else { VerdictKind::Found };
    for effect in std::iter::once(&step.chosen).chain(&step.tied) {
        let mut verdict = Verdict {
            tied_with: all.iter().filter(|name| *name != effect.name()).cloned().collect(),
            gain: step.gain,
            p_adjusted: step.p_adjusted,
            inclusion: step.inclusion,
            z_typical: step.z_typical,
            ..base(effect, kind)
        };
        if is_tied {
            (verdict.reason, verdict.record) = (Reason::Equivalent, record_of(effect));
        }
        if *effect == step.chosen
            && let Some(size) = size
        {
            (verdict.value, verdict.std_error) = (size.value, size.std_error);
            verdict.differs = size.differs();
            verdict.unit = size.unit.to_string();
            verdict.implausible = (!size.is_plausible()).then_some(size.size.plausible);
        }
        verdicts.push(verdict);
    }
    verdicts.extend(step.shadows.iter().map(|effect| Verdict {
        gain: f64::NAN,
        z_typical: f64::NAN,
        reason: Reason::ExplainedBetter(all.clone()),
        ..base(effect, VerdictKind::Shadow)
    }));
    verdicts
}

/// Verdict on an effect that reduces the error of the sample, but not that of all rows.
fn unconfirmed(effect: &EffectTerm, step: &AcceptedStep, complete: bool) -> Verdict {
    Verdict {
        provisional: !complete,
        gain: step.gain,
        p_adjusted: step.p_adjusted,
        inclusion: step.inclusion,
        z_typical: step.z_typical,
        record: record_of(effect),
        ..Verdict::new(effect.name(), VerdictKind::Inconclusive, Reason::Unconfirmed)
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
    let of = |kind: VerdictKind, reason: Reason| Verdict {
        provisional: !complete,
        p_adjusted: screened.p_adjusted,
        inclusion: screened.inclusion,
        z_typical: evidence.z_typical,
        ..Verdict::new(effect.name(), kind, reason)
    };
    let (kind, reason) = if !complete {
        (VerdictKind::Inconclusive, Reason::UnexplainedResidual(unexplained.first().cloned()))
    } else if screened.lowers_error() {
        remainder(screened, selection)
    } else if let Some(reason) = insufficient(evidence) {
        (VerdictKind::Inconclusive, reason)
    } else {
        // Rounded up: a bound of nothing would be a claim.
        (VerdictKind::Absent, Reason::BelowBound((100.0 * evidence.bound).ceil() / 100.0))
    };
    // What the accepted effects and formulas explain needs no other name.
    let implausible = selection.implausible.iter().filter(|_| screened.lowers_error());
    if let Some(fit) = implausible.into_iter().find(|of| of.effect == *effect) {
        let EffectSize { value, std_error, unit, size, .. } = &fit.size;
        return Verdict {
            gain: fit.gain,
            value: *value,
            std_error: *std_error,
            unit: unit.to_string(),
            implausible: (!fit.size.is_plausible()).then_some(size.plausible),
            ..of(VerdictKind::Inconclusive, Reason::Implausible)
        };
    }
    Verdict {
        gain: evidence.gain(),
        unit: effect.size_unit().into_owned(),
        record: if kind == VerdictKind::Absent { String::new() } else { record_of(effect) },
        ..of(kind, reason)
    }
}

/// Verdict on an effect that explains part of the residual without being accepted.
fn remainder(screened: &ScreenedEffect, selection: &Selection) -> (VerdictKind, Reason) {
    match selection.forms(screened).next() {
        Some(step) => (VerdictKind::Shadow, Reason::FormOf(step.chosen.name().to_owned())),
        None if screened.candidate.is_transient() => {
            (VerdictKind::Inconclusive, Reason::DriftsWithTime)
        }
        None if selection.stages.last().is_some_and(|last| last.floors() <= AT_FLOOR) => {
            (VerdictKind::Inconclusive, Reason::Unconfirmed)
        }
        None => (VerdictKind::Inconclusive, Reason::OtherCause),
    }
}
