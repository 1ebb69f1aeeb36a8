//! The fault campaign of `magpie fault-campaign`.

use std::cmp::Ordering;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, intervals, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 20, quick: 1 };
/// Full and quick: fault-free hours; random grippers for each motion onto a hand and each stop; grippers for RELEASE in every
/// state under every fault.
const HOURS: [f64; 2] = [10.0, 0.05];
const DRAWS: [&str; 2] = ["1000", "10"];
const OPENINGS: [&str; 2] = ["3", "1"];

/// Inject every fault in every state; evaluate detection, latency, the bounds of the hazard table and false alarms.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance fault-campaign --seeds 4 --hours 0.1")]
pub struct Args {
    /// Fault-free virtual hours for the false-alarm rate [default: 10; quick: 0.05].
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
            "--draws",
            DRAWS[usize::from(options.quick)],
            "--openings",
            OPENINGS[usize::from(options.quick)],
            "--false-alarm-hours",
            &hours,
        ],
        None,
    )?;
    let rows = output["rows"].as_array().context("rows")?;
    let sum = |name: &str| rows.iter().filter_map(|row| row[name].as_u64()).sum::<u64>() as usize;
    let met = rows.iter().filter(|row| row["is_met"] == true).count();
    let [found, runs] = [sum("detected"), sum("runs")];
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
            "faults and states with final state, p99 latency and peak force as specified"
                .to_owned(),
            "all".to_owned(),
            format!("{met} of {}, the closest at {share:.2} of its limit ({closest})", rows.len()),
        ],
        ["forbidden transitions".to_owned(), "0".to_owned(), forbidden.to_string()],
        [
            format!("false alarms in {hours} fault-free virtual hours of mixed motion"),
            "-".to_owned(),
            format!("{alarms} ({least:.1} to {most:.1})"),
        ],
    ];
    let requirements = output["requirements"].as_array().context("requirements")?;
    let are_kept = requirements.iter().all(|requirement| requirement["is_met"] == true);
    let bounds = requirements.iter().map(requirement_cells).collect::<Option<Vec<_>>>();
    let bounds = bounds.context("a requirement with runs, bound and worst value")?;
    Ok(Section {
        id: "fault-campaign",
        title: "Fault campaign",
        extent: format!("{}, {} runs", seeds_text(&seeds), output["runs"]),
        conditions: "Every fault of the matrix while approaching, pressing, gripping, releasing, moving, homing, opening \
                     inside of something, calibrating, standing on the ground and resting, with both screws, three \
                     stiffnesses and objects off centre. Expected reactions and bounds are those of \
                     `firmware/hazards.toml`; a hand has 10 N/mm, forces have errors of up to 8 N by a wrong tare. In \
                     brackets: 95 % confidence limits."
            .to_owned(),
        tables: markdown_table(["figure", "specified", "simulated"], table)
            + "\n"
            + &markdown_table(["hazard table", "bound", "runs within", "worst"], bounds),
        is_met: Some(met == rows.len() && forbidden == 0 && are_kept && alarms == 0),
    })
}

/// Description, bound, runs within it, worst value.
fn requirement_cells(requirement: &Value) -> Option<[String; 4]> {
    let direction = if requirement["is_minimum"] == true { "at least" } else { "at most" };
    let bound = requirement["bound"].as_f64()?;
    Some([
        requirement["description"].as_str()?.to_owned(),
        format!("{}: {direction} {bound}", requirement["quantity"].as_str()?),
        format!("{} of {}", requirement["kept"], requirement["runs"]),
        format!("{:.2}", requirement["worst"].as_f64()?),
    ])
}

/// Maximum ratio of a p99 latency to its limit, and its fault.
fn closest(rows: &[Value]) -> Option<(f64, &str)> {
    let share = |row: &Value| Some(row["p99_ms"].as_f64()? / row["limit_ms"].as_f64()?);
    let shares = rows.iter().filter_map(|row| Some((share(row)?, row["fault"].as_str()?)));
    shares.max_by(|(a, _), (b, _)| a.partial_cmp(b).unwrap_or(Ordering::Equal))
}
