//! Verdicts on all candidate effects, accepted effects, open questions and suggested commands.

use crate::html::Section;
use crate::html::diagnosis::effect;
use crate::html::tables::{table, text_table};
use crate::text::diagnosis::open_questions::{self, EquivalentSet, InconclusiveGroup};
use crate::text::diagnosis::{INTERRUPTED_NOTE, conclusion, formulas, reasons, steps, verdicts};
use crate::text::recording_plan;
use analysis::diagnose::recording_plan::RecordingProposal;
use analysis::diagnose::{Diagnosis, DiscoveredFormula, EffectShape, Verdict, VerdictKind};
use analysis::numbers::{number, percent};
use maud::{Markup, html};

pub fn verdict_section(diagnosis: &Diagnosis) -> Section {
    let there = diagnosis.verdicts.iter().filter(|v| verdicts::is_present(v));
    let provisional = there.clone().any(|verdict| verdict.provisional);
    let headline = steps::force_headline(diagnosis);
    let body = html! {
        @if diagnosis.is_interrupted { p { strong { (INTERRUPTED_NOTE) } } }
        @if !headline.is_empty() { p.verdict { (headline) } }
        @for origin in steps::force_origins(diagnosis) { p { (origin) } }
        p.verdict { (conclusion::verdict(diagnosis)) }
        @if diagnosis.at_floor { p { strong { (conclusion::at_floor_note(diagnosis)) } } }
        @if !diagnosis.staircase.is_empty() { p { (diagnosis.noise.sentence()) } }
        (next(diagnosis))
        @if !diagnosis.verdicts.is_empty() {
            (table(
                "All tested effects, by verdict, then by the force error that they leave",
                &[
                    "effect",
                    "verdict",
                    "magnitude, or reason",
                    "excess / N",
                    "gain",
                    "p",
                    "typical / std. error",
                ],
                diagnosis.verdicts.iter().map(row),
            ))
            @if provisional { p.note { (verdicts::PROVISIONAL_NOTE) } }
            @if diagnosis.verdicts.iter().any(|v| v.kind == VerdictKind::Shadow) { p.note { (verdicts::SHADOW_NOTE) } }
            p.note {
                (verdicts::significance_note(diagnosis))
                " Typical / std. error: a typical magnitude of the effect in standard errors of these recordings."
            }
        }
    };
    Section { id: "diagnosis", heading: "Which effect is missing".to_owned(), body }
}

fn row(verdict: &Verdict) -> Vec<Markup> {
    vec![
        html! { (verdict.effect) },
        html! { span class=(verdict.kind.id()) { (verdicts::verdict_label(verdict)) } },
        html! { (reasons::short_reason(verdict)) },
        html! { (number(verdict.excess_n.unwrap_or(f64::NAN))) },
        // Negative gains are shown as zero; NaN stays NaN.
        html! { (percent(if verdict.gain < 0.0 { 0.0 } else { verdict.gain })) },
        html! { (number(verdict.p_adjusted)) },
        html! { (number(verdict.z_typical)) },
    ]
}

fn next(diagnosis: &Diagnosis) -> Markup {
    let heading = conclusion::suggestion_heading(diagnosis.next.kind);
    html! {
        @if !heading.is_empty() { p { (heading) } }
        @for command in &diagnosis.next.commands { pre.command tabindex="0" { (command) } }
    }
}

/// `None` without accepted effects.
pub fn found_section(diagnosis: &Diagnosis) -> Option<Section> {
    let there: Vec<&Verdict> =
        diagnosis.verdicts.iter().filter(|verdict| verdicts::is_present(verdict)).collect();
    let mut drawn: Vec<&EffectShape> = Vec::new();
    let mut parts = Vec::new();
    for verdict in &there {
        let of = |shape: &&EffectShape| shape.effects.contains(&verdict.effect);
        let shape = diagnosis.shapes.iter().find(of);
        // Equivalent effects share the plot of the fitted one.
        let new = shape.filter(|shape| !drawn.iter().any(|other| std::ptr::eq(*other, *shape)));
        drawn.extend(new);
        parts.push(part(diagnosis, verdict, new));
    }
    let formulas = &diagnosis.formulas;
    (!there.is_empty() || !formulas.is_empty()).then(|| Section {
        id: "found",
        heading: "Accepted effects".to_owned(),
        body: html! {
            @for part in parts { (part) }
            @for formula in formulas { (formula_part(diagnosis, formula)) }
        },
    })
}

fn formula_part(diagnosis: &Diagnosis, formula: &DiscoveredFormula) -> Markup {
    let shape = diagnosis.shapes.iter().find(|shape| shape.effects.contains(&formula.name));
    let device = formulas::formula_on_device(diagnosis, formula);
    html! {
        h3 { (formulas::formula_heading(diagnosis, formula)) }
        @for model in &formula.models {
            @if let Some(expression) = &model.expression { pre.command tabindex="0" { (expression) } }
        }
        p { (formulas::formula_evidence(diagnosis, formula)) }
        p.note { (formulas::formula_alternatives(formula)) }
        @if !device.is_empty() { p.note { (device) } }
        @if let Some(shape) = shape { (effect::strongest(shape)) (effect::all(shape)) }
        (text_table("Values at each sensor, with standard errors", &formulas::formula_table(formula)))
    }
}

fn part(diagnosis: &Diagnosis, verdict: &Verdict, shape: Option<&EffectShape>) -> Markup {
    let device = verdicts::runs_on_device(diagnosis, &[&verdict.effect]);
    html! {
        h3 { (verdict.effect) " " span.model { (verdicts::verdict_label(verdict)) } }
        div.pair {
            div {
                @if !verdicts::magnitude(verdict).is_empty() { p { strong { (verdicts::magnitude(verdict)) } } }
                p { (verdicts::physics(verdict)) }
                p.note { (reasons::reason_sentence(verdict)) " " (verdicts::similar_effects(verdict)) }
                @if !device.is_empty() { p.note { (device) } }
            }
            @if let Some(shape) = shape { (effect::strongest(shape)) }
        }
        @if let Some(shape) = shape { (effect::load_loop(shape)) (effect::all(shape)) }
    }
}

/// `None` without open questions.
pub fn open_section(diagnosis: &Diagnosis) -> Option<Section> {
    let (ties, unjudged) = (
        open_questions::equivalent_sets(diagnosis),
        open_questions::inconclusive_groups(diagnosis),
    );
    let is_explained = diagnosis.unexplained.is_empty() && diagnosis.remaining.is_none();
    let none = ties.is_empty() && unjudged.is_empty() && is_explained;
    (!none).then(|| Section {
        id: "open",
        heading: "Open questions".to_owned(),
        body: html! {
            (unexplained(diagnosis))
            @for tie in &ties { (equivalence(tie)) }
            @if !unjudged.is_empty() {
                h3 { "Inconclusive from these recordings" }
                ul { @for group in &unjudged { (inconclusive(group)) } }
            }
            @if let Some(proposal) = &diagnosis.proposal { (planned(proposal)) }
        },
    })
}

/// The proposed recordings: what they decide, and their steps.
pub fn planned(proposal: &RecordingProposal) -> Markup {
    let rows = proposal.decisions.iter().map(recording_plan::decision_cells);
    html! {
        h3 { (recording_plan::heading(proposal)) }
        @if !proposal.decisions.is_empty() {
            (table("Predicted probability of the right decision", &recording_plan::COLUMNS, rows))
        }
        ol { @for step in &proposal.plan.steps {
            li { (format!("{:.0} s: {}.", step.seconds, step.instruction())) }
        } }
        @if let Some(note) = recording_plan::several(&proposal.plan) { p.note { (note) } }
    }
}

fn unexplained(Diagnosis { unexplained, remaining, noise, .. }: &Diagnosis) -> Markup {
    html! {
        @if !unexplained.is_empty() || remaining.is_some() {
            h3 { "Unexplained" }
            ul {
                @for one in unexplained { li { (open_questions::unexplained(one)) } }
                @if let Some(structure) = remaining { li { (open_questions::remaining(structure, noise.unit)) } }
            }
            @if !unexplained.is_empty() { p { (open_questions::EXPR_HINT) } }
        }
    }
}

fn equivalence(tie: &EquivalentSet) -> Markup {
    html! {
        h3 { "Not distinguishable: " (tie.effects.join(", ")) }
        @if !tie.alike.is_empty() { ul { @for why in &tie.alike { li { (why) } } } }
        (recordings("To distinguish them, record", &tie.record))
    }
}

fn inconclusive(group: &InconclusiveGroup) -> Markup {
    html! {
        li {
            strong { (verdicts::listed(&group.effects)) } ": " (group.why) "."
            (recordings("To test it, record", &group.record))
        }
    }
}

fn recordings(head: &str, list: &[(String, String)]) -> Markup {
    html! {
        @for (effects, record) in list {
            p.note {
                (head)
                @if list.len() > 1 { ", for " (effects) }
                ": " (record)
            }
        }
    }
}
