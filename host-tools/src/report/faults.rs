//! The table of a campaign of faults.

use maud::{Markup, html};
use plotters::prelude::*;

use super::Section;
use super::numbers::number;
use super::palette;
use super::plot::{Along, HALF, Swatch, axes, figure, key, px, stroke};
use super::tables::table;
use crate::faults::campaign::Tally;
use crate::faults::row::{BESIDE, ELSEWHERE};

/// All of it.
pub fn section(sentence: &str, tallies: &[Tally]) -> Section {
    let rows = tallies.iter().map(row);
    let heads = [
        "fault",
        "row",
        "state",
        "runs",
        "found",
        "p50, ms",
        "p99, ms",
        "most, ms",
        "asked, ms",
        "peak, N",
        "ends as",
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
            (Swatch::Line, palette::SECOND, "what is asked".to_owned()),
        ]))
        (latencies(tallies))
        (table("What became of each fault", &heads, rows))
        p.note { "Latency counts from the moment in which the fault can be seen: at the sensors of force from the next tick \
            of sensing, at the CAN bus from the controller's leaving it, else from the moment in which it is done. Peak is the \
            greatest true force between the fingers after it. Simulated; motor constants are assumed." }
        p { "Reviewed at register level, never counted:" }
        (listed(&ELSEWHERE))
        p { "Not in these runs:" }
        (listed(&BESIDE))
    };
    Section {
        id: "faults",
        heading: "Faults".to_owned(),
        body,
    }
}

/// The latency of each row and state as a share of what is asked.
fn latencies(tallies: &[Tally]) -> Markup {
    let dots = tallies.iter().map(|tally| {
        let facts = tally.row.facts();
        let [_, most, _] = tally.latency_ms;
        (f64::from(facts.number), most / facts.within_ms)
    });
    let dots: Vec<(f64, f64)> = dots.filter(|(_, share)| share.is_finite()).collect();
    let rows = dots.iter().map(|dot| dot.0);
    let across = Along::holding("row of the matrix", rows);
    let shares = dots.iter().map(|dot| dot.1).chain([0.0, 1.1]);
    let upwards = Along::holding("latency, share of what is asked", shares);
    let says = "For each row of the matrix the latency as a share of what is asked.";
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

fn row(tally: &Tally) -> Vec<Markup> {
    let facts = tally.row.facts();
    let [median, most, greatest] = tally.latency_ms;
    let situation = format!("{:?}", tally.situation).to_lowercase();
    vec![
        html! { (facts.words) },
        html! { (facts.number) },
        html! { (situation) },
        html! { (tally.runs) },
        html! { (tally.found) },
        html! { (number(median)) },
        html! { (number(most)) },
        html! { (number(greatest)) },
        html! { (number(facts.within_ms)) },
        html! { (number(tally.peak_n)) },
        html! { (tally.ends_words()) },
        html! { @if !tally.is_met() { "missed" } },
    ]
}
