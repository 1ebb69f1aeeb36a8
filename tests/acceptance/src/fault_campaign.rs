//! The fault campaign of `magpie fault-campaign`.

use std::cmp::Ordering;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, intervals, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 48, quick: 1 };
const HOURS: [f64; 2] = [1.0, 0.05];
/// Inject every fault in every state and evaluate detection, latency and false alarms.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance fault-campaign --seeds 4 --hours 0.1")]
pub struct Args {
    /// Fault-free virtual hours for the false-alarm rate [default: 1; quick: 0.05].
    #[arg(long, value_name = "H")]
    hours: Option<f64>,
}

/// Runs the campaign.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let hours = args.hours.unwrap_or(HOURS[usize::from(options.quick)]).to_string();
    let [first, count] = [seeds.start, seeds.end - seeds.start].map(|number| number.to_string());
    let output = magpie::json(
        &[
            "fault-campaign",
            "--seeds",
            &count,
            "--from-seed",
            &first,
            "--false-alarm-hours",
            &hours,
        ],
        None,
    )?;
    let rows = output["rows"].as_array().context("rows")?;
    let sum = |name: &str| rows.iter().filter_map(|row| row[name].as_u64()).sum::<u64>() as usize;
    let met = rows.iter().filter(|row| row["is_met"] == true).count();
    let [found, runs] = [sum("found"), sum("runs")];
    let forbidden = sum("forbidden");
    let alarms = output["false_alarms"].as_u64().context("false alarms")? as usize;
    let (share, closest) = closest(rows).context("a row with a latency")?;
    let [lower, upper] = intervals::proportion(found, runs).map(|share| 100.0 * share);
    let [least, most] = intervals::poisson(alarms);
    let table = [
        ["runs".to_owned(), "-".to_owned(), output["runs"].to_string()],
        [
            "detected".to_owned(),
            "all".to_owned(),
            format!("{found} of {runs} ({lower:.2} to {upper:.2} %)"),
        ],
        [
            "faults and states with final state, p99 latency and peak force (sensor faults) as specified".to_owned(),
            "all".to_owned(),
            format!("{met} of {}, the closest at {share:.2} of its limit ({closest})", rows.len()),
        ],
        ["forbidden transitions".to_owned(), "0".to_owned(), forbidden.to_string()],
        [
            format!("false alarms in {hours} fault-free virtual hours"),
            "-".to_owned(),
            format!("{alarms} ({least:.1} to {most:.1})"),
        ],
    ];
    Ok(Section {
        id: "fault-campaign",
        title: "Fault campaign",
        extent: format!("{}, {} runs", seeds_text(&seeds), output["runs"]),
        conditions: "Every fault of the matrix during approach, force rise, grip, ground contact and at rest, with both \
                     screws and three stiffnesses. In brackets: 95 % confidence limits."
            .to_owned(),
        tables: markdown_table(["figure", "specified", "simulated"], table),
        is_met: Some(met == rows.len() && forbidden == 0),
    })
}

/// Maximum ratio of a p99 latency to its limit, and its fault.
fn closest(rows: &[Value]) -> Option<(f64, &str)> {
    let share = |row: &Value| Some(row["p99_ms"].as_f64()? / row["asked_ms"].as_f64()?);
    let shares = rows.iter().filter_map(|row| Some((share(row)?, row["fault"].as_str()?)));
    shares.max_by(|(a, _), (b, _)| a.partial_cmp(b).unwrap_or(Ordering::Equal))
}
