//! The counts for people and machines.

use std::fmt::Write;

use serde_json::{Value, json};

use super::passage::IN_TIME;
use super::tally::{MEASURES, Tally, UNITS};
use crate::show;

/// False alarms in ten hours up to which a threshold of one measure alone is told.
const RATES: [f64; 4] = [0.0, 10.0, 100.0, 1000.0];
/// Fewer hours than this leave a bound that says little.
const FEW_HOURS: f64 = 3.0;

/// The counts as sentences.
pub fn sentences(tally: &Tally) -> String {
    let judged = tally.judged();
    let noticed = match tally.detected() {
        None => "no share can be told. ".to_owned(),
        Some(share) => {
            let [least, most] = tally.detected_interval().map(|share| 100.0 * share);
            let latency = |share: f64| match tally.latency(share) {
                None => "never".to_owned(),
                Some(ms) => format!("{ms:.0} ms"),
            };
            format!(
                "noticed within {IN_TIME} ms of that {:.2} % ({least:.2} to {most:.2}, 95 %); half of them by {}, 99 % by {} (below zero: before a force was off so far). ",
                100.0 * share,
                latency(0.5),
                latency(0.99),
            )
        }
    };
    let few = match tally.hours() < FEW_HOURS {
        true => {
            ": a wide bound, of a short time. `cargo bench -p host-tools --bench foreign_magnet` takes ten hours"
        }
        false => "",
    };
    let worth = show::plain(tally.worth_n, 2);
    format!(
        "{} magnets passed, {judged} moved a force by more than {worth} N: {noticed}{:.2} h without a magnet: {} false alarms, \
         with 95 % fewer than {:.2} in 10 h{few}.",
        tally.passages.len(),
        tally.hours(),
        tally.false_alarms,
        tally.false_upper(),
    )
}

/// Each measure alone: thresholds, and the shares that they notice.
pub fn table(tally: &Tally) -> String {
    let heads = RATES.map(|rate| format!("\u{2264} {rate:.0} false / 10 h"));
    let mut shown = show::table(std::iter::once("by".to_owned()).chain(heads));
    for (measure, (name, unit)) in MEASURES.iter().zip(UNITS).enumerate() {
        let curve = tally.characteristic(measure);
        if curve.is_empty() {
            continue;
        }
        let cell = |rate: &f64| {
            let below = curve
                .iter()
                .rev()
                .find(|point| point.false_per_10h <= *rate);
            below.map_or_else(String::new, |point| {
                format!(
                    "{:.1}{unit}: {:.1} %",
                    point.threshold,
                    100.0 * point.noticed
                )
            })
        };
        let row = std::iter::once((*name).to_owned()).chain(RATES.iter().map(cell));
        shown.add_row(row.collect::<Vec<_>>());
    }
    show::right_align(&mut shown, 1);
    let mut text = String::from("Each measure alone: threshold, and share noticed in time\n");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{shown}");
    text
}

/// For `--json`.
pub fn json(tally: &Tally) -> Value {
    let curves = MEASURES.iter().enumerate().map(|(measure, name)| {
        let points = tally.characteristic(measure).into_iter();
        let points = points.map(|p| json!([p.threshold, p.false_per_10h, p.noticed]));
        ((*name).to_owned(), Value::Array(points.collect()))
    });
    json!({
        "detected": tally.detected(),
        "detected_interval_95": tally.detected().map(|_| tally.detected_interval()),
        "p50_ms": tally.latency(0.5), "p99_ms": tally.latency(0.99),
        "false_per_10h": tally.false_per_10h(),
        "false_per_10h_upper_95": tally.false_upper(),
        "false_alarms": tally.false_alarms,
        "hours": tally.hours(),
        "passages": tally.judged(), "passed": tally.passages.len(),
        "within_ms": IN_TIME,
        "roc": curves.collect::<serde_json::Map<_, _>>(),
    })
}
