//! What is said of every candidate, and what to type next.

use maud::{Markup, html};

use crate::diagnose::{Diagnosis, Verdict, words};
use crate::report::Section;
use crate::report::numbers::{number, percent};
use crate::report::tables::table;

/// The table of the verdicts.
pub fn section(diagnosis: &Diagnosis) -> Section {
    let there = diagnosis.verdicts.iter().filter(|v| words::is_there(v));
    let provisional = there.clone().any(|verdict| verdict.provisional);
    let body = html! {
        p.verdict { (diagnosis.verdict) }
        @if diagnosis.at_floor { p { strong { (words::STOP) } } }
        (next(diagnosis))
        @if !diagnosis.verdicts.is_empty() {
            (table(
                "Every effect that was judged, the surest first",
                &["effect", "verdict", "gain", "p", "typical / error bar", "how much, or why not"],
                diagnosis.verdicts.iter().map(row),
            ))
            @if provisional { p.note { (words::PROVISIONAL) } }
            p.note {
                (words::chance(diagnosis))
                " Typical / error bar: how many error bars a typical size is from nothing in these recordings."
            }
        }
    };
    Section {
        id: "diagnosis",
        heading: "Which effect is missing".to_owned(),
        body,
    }
}

fn row(verdict: &Verdict) -> Vec<Markup> {
    vec![
        html! { (verdict.effect) },
        html! { span class=(verdict.kind.id()) { (words::word(verdict)) } },
        html! { (percent(verdict.gain.max(0.0) + 0.0 * verdict.gain)) },
        html! { (number(verdict.p_adjusted)) },
        html! { (number(verdict.z_typical)) },
        html! { span.why { (why(verdict)) } },
    ]
}

/// What was found stands with its size, everything else with its reason.
fn why(verdict: &Verdict) -> &str {
    match words::is_there(verdict) || verdict.reason.is_empty() {
        true => &verdict.short,
        false => &verdict.reason,
    }
}

fn next(diagnosis: &Diagnosis) -> Markup {
    html! {
        @if !diagnosis.next.words.is_empty() { p { (diagnosis.next.words) } }
        @for command in &diagnosis.next.commands { pre.command tabindex="0" { (command) } }
    }
}
