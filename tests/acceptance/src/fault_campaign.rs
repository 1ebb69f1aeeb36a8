//! Faults injected at their sources into simulated grippers in every state, and the bounds of the hazard table.

use std::cmp::Ordering;

use analysis::progress;
use anyhow::{Context, Result};
use sim::closed_loop;
use sim::faults::campaign::{self, FaultSummary, RequirementDraws, RequirementSummary};

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, intervals};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 20, quick: 1 };
/// Full and quick: fault-free hours; random grippers for each motion onto a hand and each stop; grippers for RELEASE in every
/// state under every fault.
const HOURS: [f64; 2] = [10.0, 0.05];
const DRAWS: [u64; 2] = [1000, 10];
const OPENINGS: [u64; 2] = [3, 1];

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
    let hours = args.hours.unwrap_or(HOURS[usize::from(options.quick)]);
    let [grippers, openings] = [DRAWS, OPENINGS].map(|counts| counts[usize::from(options.quick)]);
    let tables = closed_loop::nominal_tables()?;
    let cases = campaign::cases(seeds.start, seeds.end - seeds.start);
    let bar = progress::progress_bar("injecting faults", cases.len());
    let outcomes = campaign::run(&cases, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let draws = RequirementDraws { first: seeds.start, grippers, openings };
    let bar = progress::progress_bar("bounds of the hazard table", draws.runs());
    let mut requirements = campaign::fault_requirements(&outcomes);
    requirements.extend(campaign::evaluate_requirements(&draws, &tables, || bar.inc(1)));
    bar.finish_and_clear();
    let bar = progress::progress_bar("fault-free operation", campaign::fault_free_minutes(hours));
    let alarms = campaign::run_fault_free(seeds.start, hours, &tables, || bar.inc(1)).alarms;
    bar.finish_and_clear();
    let rows = campaign::summarize(&outcomes);
    let sum = |count: fn(&FaultSummary) -> usize| rows.iter().map(count).sum::<usize>();
    let [found, runs] = [sum(|row| row.found), sum(|row| row.runs)];
    let forbidden: u32 = rows.iter().map(|row| row.forbidden).sum();
    let met = rows.iter().filter(|row| row.is_met()).count();
    for row in rows.iter().filter(|row| !row.is_met()) {
        let fault = row.fault.specification().description;
        eprintln!("failed: {fault} while {:?}: {}", row.state, row.ends_words());
    }
    let (share, closest) = closest(&rows).context("a row with a latency")?;
    let [lower, upper] = intervals::proportion(found, runs).map(|share| 100.0 * share);
    let [least, most] = intervals::poisson(alarms);
    let table = [
        ["runs".to_owned(), "-".to_owned(), outcomes.len().to_string()],
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
    let are_kept = requirements.iter().all(RequirementSummary::is_met);
    let bounds = requirements.iter().map(requirement_cells);
    Ok(Section {
        id: "fault-campaign",
        title: "Fault campaign",
        extent: format!("{}, {} runs", seeds_text(&seeds), outcomes.len()),
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
fn requirement_cells(requirement: &RequirementSummary) -> [String; 4] {
    let direction = if requirement.is_minimum { "at least" } else { "at most" };
    [
        requirement.description.clone(),
        format!("{}: {direction} {}", requirement.quantity, requirement.bound),
        format!("{} of {}", requirement.kept, requirement.runs),
        format!("{:.2}", requirement.worst),
    ]
}

/// Maximum ratio of a p99 latency to its limit, and its fault.
fn closest(rows: &[FaultSummary]) -> Option<(f64, &'static str)> {
    let shares = rows.iter().map(|row| {
        let fault = row.fault.specification();
        let [_, p99_ms, _] = row.latency_ms;
        (p99_ms / fault.within_ms, fault.description)
    });
    shares.max_by(|(a, _), (b, _)| a.partial_cmp(b).unwrap_or(Ordering::Equal))
}
