//! Text of an evaluation of the disturbance detector.

use std::fmt::Write;

use analysis::magnetic_disturbance::counts::{DetectionCounts, MEASURES, UNITS};
use analysis::magnetic_disturbance::event::MAX_LATENCY;
use analysis::numbers::decimal;

use crate::text::terminal;

/// False alarms per ten hours for which the threshold of each measure is listed.
const RATES: [f64; 4] = [0.0, 10.0, 100.0, 1000.0];
/// Fewer hours give a wide bound.
const FEW_HOURS: f64 = 3.0;

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
        " (a wide bound from little data; `cargo bench -p host-tools --bench foreign_magnet` evaluates ten hours)"
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
