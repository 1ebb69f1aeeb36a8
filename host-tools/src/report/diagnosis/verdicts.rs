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
        @if diagnosis.at_floor { p { strong { (words::stop(diagnosis)) } } }
        (next(diagnosis))
        @if !diagnosis.verdicts.is_empty() {
            (table(
                "Every effect that was judged, the surest first",
                &["effect", "verdict", "how much, or why not", "gain", "p", "typical / error bar"],
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
        html! { (verdict.short) },
        // Worse than nothing is nothing; a number that is none stays one.
        html! { (percent(if verdict.gain < 0.0 { 0.0 } else { verdict.gain })) },
        html! { (number(verdict.p_adjusted)) },
        html! { (number(verdict.z_typical)) },
    ]
}

fn next(diagnosis: &Diagnosis) -> Markup {
    html! {
        @if !diagnosis.next.words.is_empty() { p { (diagnosis.next.words) } }
        @for command in &diagnosis.next.commands { pre.command tabindex="0" { (command) } }
    }
}
