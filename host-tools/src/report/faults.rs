//! The table of a campaign of faults.

use maud::{Markup, html};

use super::Section;
use super::numbers::number;
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
