//! Table of a fault campaign.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::plot::{Along, HALF, Swatch, axes, figure, key, px, stroke};
use crate::html::tables::table;
use crate::html::{Section, palette};
use crate::text::fault_campaign::{requirement_cells, state_name};
use analysis::numbers::number;
use sim::faults::campaign::{CampaignResult, FaultSummary};
use sim::faults::injection::{COVERED_BY_OTHER_TESTS, HARDWARE_ONLY};

/// Table and plot.
pub fn section(sentence: &str, result: &CampaignResult) -> Section {
    let summaries = &result.summaries;
    let rows = summaries.iter().map(row);
    let requirements = result.requirements.iter().filter(|requirement| requirement.runs > 0);
    let requirements = requirements
        .map(|requirement| requirement_cells(requirement).map(|cell| html! { (cell) }).to_vec());
    let requirement_heads = ["hazard table", "quantity", "bound", "worst", "runs", "within"];
    let heads = [
        "fault",
        "row",
        "state",
        "runs",
        "detected",
        "p50, ms",
        "p99, ms",
        "max, ms",
        "limit, ms",
        "peak, N",
        "max, N",
        "final state",
        "",
    ];
    let listed = |rows: &[(u8, &str)]| {
        html! {
            ul { @for (number, words) in rows { li { (number) ": " (words) } } }
        }
    };
    let body = html! {
        p { (sentence) }
        (key(&[
            (Swatch::Full, palette::FIRST, "p99 of the latency, a dot for each state".to_owned()),
            (Swatch::Line, palette::SECOND, "limit".to_owned()),
        ]))
        (latencies(summaries))
        (table("Result of each fault", &heads, rows))
        (table("Bounds of the hazard table", &requirement_heads, requirements))
        p.note { "Latency counts from the moment at which the fault is observable: for force sensors from the next tick \
            of sensing, at the CAN bus from the controller's leaving it, else from the moment in which it is done. Peak is the \
            maximum true force between or around the fingers after it; its limit is that of the hazard table for a hand \
            (10 N/mm) outside of a grip, and for a grip of 100 N after a fault of one sensor. Elsewhere something rigid is \
            pressed on purpose. Simulated; motor constants are assumed." }
        p { "Not simulated, needs hardware:" }
        (listed(&HARDWARE_ONLY))
        p { "Covered by other tests:" }
        (listed(&COVERED_BY_OTHER_TESTS))
    };
    Section { id: "faults", heading: "Faults".to_owned(), body }
}

/// Latency relative to its limit for each row and state.
fn latencies(summaries: &[FaultSummary]) -> Markup {
    let dots = summaries.iter().map(|summary| {
        let facts = summary.fault.specification();
        let [_, p99, _] = summary.latency_ms;
        (f64::from(facts.number), p99 / facts.within_ms)
    });
    let dots: Vec<(f64, f64)> = dots.filter(|(_, share)| share.is_finite()).collect();
    let rows = dots.iter().map(|dot| dot.0);
    let across = Along::holding("row of the matrix", rows);
    let shares = dots.iter().map(|dot| dot.1).chain([0.0, 1.1]);
    let upwards = Along::holding("latency / limit", shares);
    let says = "Latency relative to the limit for each row of the matrix.";
    let drawn = figure(HALF, says, |paper| {
        let mut chart = axes(paper, &across, &upwards)?;
        let asked = [(across.range.start, 1.0), (across.range.end, 1.0)];
        chart.draw_series([PathElement::new(asked, stroke(palette::SECOND, 1.5))])?;
        let dot = palette::FIRST.light.filled();
        chart.draw_series(dots.iter().map(|at| Circle::new(*at, px(2.5), dot)))?;
        Ok(())
    });
    html! { div.pair { figure { (drawn) } } }
}

fn row(summary: &FaultSummary) -> Vec<Markup> {
    let facts = summary.fault.specification();
    let [median, p99, max] = summary.latency_ms;
    vec![
        html! { (facts.description) },
        html! { (facts.number) },
        html! { (state_name(summary)) },
        html! { (summary.runs) },
        html! { (summary.found) },
        html! { (number(median)) },
        html! { (number(p99)) },
        html! { (number(max)) },
        html! { (number(facts.within_ms)) },
        html! { (number(summary.peak_n)) },
        html! { (summary.max_n.map_or_else(|| "-".to_owned(), number)) },
        html! { (summary.ends_words()) },
        html! { @if !summary.is_met() { "failed" } },
    ]
}
