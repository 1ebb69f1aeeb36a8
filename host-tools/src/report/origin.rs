//! Where all figures come from.

use maud::{Markup, html};

use super::both;
use crate::compare::Comparison;

/// Provenance, seeds and assumptions, of both models.
pub fn section(comparison: &Comparison) -> Markup {
    html! {
        section #origin {
            h2 { "Where this comes from" }
            @for (_, letter, model) in both(comparison) {
                @if comparison.other.is_some() { h3 { (letter) ": " (model.model) } }
                dl.origin {
                    @for (name, value) in &model.provenance { dt { (name) } dd { (value) } }
                }
            }
        }
    }
}
