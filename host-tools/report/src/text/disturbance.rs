//! Text and JSON of an evaluation of the disturbance detector.

use std::fmt::Write;

use analysis::benchmark::Benchmark;
use analysis::benchmark::disturbance::DisturbanceResult;
use analysis::magnetic_disturbance::counts::{DetectionCounts, MEASURES, UNITS};
use analysis::magnetic_disturbance::event::MAX_LATENCY;
use analysis::numbers::decimal;
use serde_json::{Value, json};

use crate::text::terminal;

/// False alarms per ten hours for which the threshold of each measure is listed.
const RATES: [f64; 4] = [0.0, 10.0, 100.0, 1000.0];
/// Fewer hours give a wide bound.
const FEW_HOURS: f64 = 3.0;

/// The evaluated detector and its data: a heading of [`summary`].
pub fn detector(table: &Benchmark, result: &DisturbanceResult) -> String {
    let rows = if result.simulated {
        "on new recordings of the same simulated gripper".to_owned()
    } else {
        format!("on recording {} with added fields of magnets", table.recordings.1)
    };
    format!("The firmware's detector with {}, {rows}:", result.variant.words())
}

/// The counts as a paragraph.
pub fn summary(counts: &DetectionCounts) -> String {
    let relevant = counts.relevant_count();
    let detected = match counts.detected() {
        None => "the detection rate is unknown. ".to_owned(),
        Some(share) => {
            let [lower, upper] = counts.detected_interval().map(|share| 100.0 * share);
            let latency = |share: f64| match counts.latency(share) {
                None => "never".to_owned(),
                Some(ms) => format!("{ms:.0} ms"),
            };
            format!(
                "detected within {MAX_LATENCY} ms of that: {:.2} % (95 % interval {lower:.2} to {upper:.2}); latency p50 {}, p99 {} (negative: before the force error). ",
                100.0 * share,
                latency(0.5),
                latency(0.99),
            )
        }
    };
    let few = if counts.hours() < FEW_HOURS {
        " (a wide bound from little data; `cargo acceptance magnetic-disturbance` evaluates ten hours)"
    } else {
        ""
    };
    let alarm_n = decimal(counts.alarm_error_n, 2);
    format!(
        "{} magnets passed, {relevant} changed a force by more than {alarm_n} N: {detected}{:.2} disturbance-free hours: {} \
         false alarms, 95 % upper bound {:.2} per 10 h{few}.",
        counts.events.len(),
        counts.hours(),
        counts.false_alarms,
        counts.false_upper(),
    )
}

/// The counts as JSON.
pub fn counts_json(counts: &DetectionCounts) -> Value {
    let curves = MEASURES.iter().enumerate().map(|(measure, name)| {
        let points = counts.characteristic(measure).into_iter();
        let points = points.map(|p| json!([p.threshold, p.false_per_10h, p.detected]));
        ((*name).to_owned(), Value::Array(points.collect()))
    });
    json!({
        "detected": counts.detected(),
        "detected_interval_95": counts.detected().map(|_| counts.detected_interval()),
        "p50_ms": counts.latency(0.5), "p99_ms": counts.latency(0.99),
        "false_per_10h": counts.false_per_10h(),
        "false_per_10h_upper_95": counts.false_upper(),
        "false_alarms": counts.false_alarms,
        "hours": counts.hours(),
        "passages": counts.relevant_count(), "passed": counts.events.len(),
        "within_ms": MAX_LATENCY,
        "roc": curves.collect::<serde_json::Map<_, _>>(),
    })
}

/// The counts of a variant as JSON.
pub fn result_json(result: &DisturbanceResult) -> Value {
    let mut object = counts_json(&result.counts);
    object["variant"] = result.variant.id().into();
    object["simulated"] = result.simulated.into();
    object
}

/// Table of thresholds on each measure alone, with their detection rates.
pub fn table(counts: &DetectionCounts) -> String {
    let heads = RATES.map(|rate| format!("\u{2264} {rate:.0} false / 10 h"));
    let mut shown = terminal::table(std::iter::once("measure".to_owned()).chain(heads));
    for (measure, (name, unit)) in MEASURES.iter().zip(UNITS).enumerate() {
        let curve = counts.characteristic(measure);
        if curve.is_empty() {
            continue;
        }
        let cell = |rate: &f64| {
            let below = curve.iter().rev().find(|point| point.false_per_10h <= *rate);
            below.map_or_else(String::new, |point| {
                format!("{:.1}{unit}: {:.1} %", point.threshold, 100.0 * point.detected)
            })
        };
        let row = std::iter::once((*name).to_owned()).chain(RATES.iter().map(cell));
        shown.add_row(row.collect::<Vec<_>>());
    }
    terminal::right_align(&mut shown, 1);
    let mut text = String::from("Each measure alone: threshold and fraction detected in time\n");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{shown}");
    text
}
