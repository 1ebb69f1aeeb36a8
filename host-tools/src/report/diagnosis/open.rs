//! What stays open: ties, what cannot be judged, what is unexplained; each with what would help.

use maud::{Markup, html};

use crate::diagnose::words::{self, Tie, Unjudged};
use crate::diagnose::{Diagnosis, Unexplained};
use crate::report::Section;

/// `None` where nothing stays open.
pub fn section(diagnosis: &Diagnosis) -> Option<Section> {
    let (ties, unjudged) = (words::ties(diagnosis), words::unjudged(diagnosis));
    let none = ties.is_empty() && unjudged.is_empty() && diagnosis.unexplained.is_empty();
    (!none).then(|| Section {
        id: "open",
        heading: "What stays open".to_owned(),
        body: html! {
            (unexplained(&diagnosis.unexplained))
            @for tie in &ties { (told(tie)) }
            @if !unjudged.is_empty() {
                h3 { "Not judgeable from these recordings" }
                ul { @for group in &unjudged { (judged(group)) } }
            }
        },
    })
}

fn unexplained(list: &[Unexplained]) -> Markup {
    html! {
        @if !list.is_empty() {
            h3 { "Unexplained" }
            ul { @for one in list { li { (words::unexplained(one)) } } }
            p { (words::EXPR) }
        }
    }
}

fn told(tie: &Tie) -> Markup {
    html! {
        h3 { "Not told apart: " (tie.effects.join(", ")) }
        @if !tie.alike.is_empty() { ul { @for why in &tie.alike { li { (why) } } } }
        (recordings("To tell, record", &tie.record))
    }
}

fn judged(group: &Unjudged) -> Markup {
    html! {
        li {
            strong { (group.effects.join(", ")) } ": " (group.why) "."
            (recordings("To judge, record", &group.record))
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
