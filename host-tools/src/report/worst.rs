//! The worst stretches, each with a button that shows it in the overlay.

use maud::{Markup, html};

use super::numbers::number;
use super::tables::table;
use crate::compare::Comparison;

/// The table of the worst stretches.
pub fn section(comparison: &Comparison) -> Markup {
    let rows = comparison.worst.iter().map(|worst| {
        let shown = comparison
            .traces
            .iter()
            .any(|trace| trace.recording == worst.recording && trace.sensor == worst.sensor);
        vec![
            html! { (number(worst.rms_g)) " G" },
            html! { (worst.recording) },
            html! { (format!("{:.2} to {:.2}", worst.from_s, worst.to_s)) },
            html! { "s" (worst.sensor) },
            html! { span.doing { (worst.doing) } },
            html! {
                @if shown {
                    button.live hidden type="button" data-recording=(worst.recording) data-sensor=(worst.sensor)
                        data-from=(worst.from_s) data-to=(worst.to_s) {
                        "Show"
                    }
                }
            },
        ]
    });
    html! {
        section #worst {
            h2 { "The worst stretches" }
            @if comparison.worst.is_empty() { p.empty { "None stands out." } }
            @else {
                (table(
                    "RMS over all sensors and axes",
                    &["RMS", "recording", "from, to (s)", "sensor", "what was going on", ""],
                    rows,
                ))
            }
            @if comparison.correlation_s > 0.0 {
                p.note {
                    "What is left stays alike for " (number(comparison.correlation_s))
                    " s (integrated autocorrelation time); bands and shares take that into account."
                }
            }
        }
    }
}
