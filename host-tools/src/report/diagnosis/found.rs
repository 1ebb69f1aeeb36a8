//! What was found: each effect with its physics, its size beside the typical one, and its plot.

use maud::{Markup, html};

use super::effect;
use crate::diagnose::{Diagnosis, Shape, Verdict, words};
use crate::report::Section;

/// `None` where nothing was found.
pub fn section(diagnosis: &Diagnosis) -> Option<Section> {
    let there: Vec<&Verdict> = diagnosis
        .verdicts
        .iter()
        .filter(|verdict| words::is_there(verdict))
        .collect();
    let mut drawn: Vec<&Shape> = Vec::new();
    let mut parts = Vec::new();
    for verdict in &there {
        let of = |shape: &&Shape| shape.effects.contains(&verdict.effect);
        let shape = diagnosis.shapes.iter().find(of);
        // Effects that are tied have one plot: that of the one which was fitted.
        let new = shape.filter(|shape| !drawn.iter().any(|other| std::ptr::eq(*other, *shape)));
        drawn.extend(new);
        parts.push(part(verdict, new));
    }
    (!there.is_empty()).then(|| Section {
        id: "found",
        heading: "What was found".to_owned(),
        body: html! { @for part in parts { (part) } },
    })
}

fn part(verdict: &Verdict, shape: Option<&Shape>) -> Markup {
    html! {
        h3 { (verdict.effect) " " span.model { (words::word(verdict)) } }
        div.pair {
            div {
                @if !words::size(verdict).is_empty() { p { strong { (words::size(verdict)) } } }
                p { (words::physics(verdict)) }
                p.note { (words::sentence(verdict)) }
            }
            @if let Some(shape) = shape { (effect::strongest(shape)) }
        }
        @if let Some(shape) = shape { (effect::all(shape)) }
    }
}
