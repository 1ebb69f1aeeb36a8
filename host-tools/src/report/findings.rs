//! Mistakes of the rig: on top, since nothing below means much before they are mended.

use maud::{Markup, html};

use crate::compare::Comparison;

/// All findings, or one line that there are none.
pub fn section(comparison: &Comparison) -> Markup {
    let findings = &comparison.findings;
    html! {
        section #findings {
            @if findings.is_empty() {
                p.none { "Mistakes of the rig: none found." }
            } @else {
                h2 { "Found in the recordings: " (findings.len()) }
                ol.findings {
                    @for finding in findings {
                        li.stops[finding.stops] {
                            @if finding.stops { strong { "Stops the comparison. " } }
                            (finding.message)
                            span.place { (finding.place) }
                            @if let Some(fix) = &finding.fix {
                                span.fix { code { "--fix" } ": " (fix) }
                            }
                        }
                    }
                }
            }
        }
    }
}
