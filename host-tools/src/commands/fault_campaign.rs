//! `magpie fault-campaign`: fault injection into a simulated gripper.

use analysis::progress;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};

use report::text::fault_campaign::{format_report, summary, to_json};
use report::text::terminal;
use sim::closed_loop;
use sim::faults::campaign::{self, CampaignResult, RequirementDraws};

/// Inject faults at their sources into a simulated gripper in every state, check the bounds of the hazard table, and report
/// detection, reaction, forces and travel.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie fault-campaign --seeds 1
  cargo magpie fault-campaign --seeds 20 --draws 100 --false-alarm-hours 1 -o faults.html")]
pub struct Args {
    /// Grippers with perturbed parameters per fault, state, screw and stiffness.
    #[arg(long, value_name = "N", default_value_t = 2)]
    seeds: u64,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    from_seed: u64,
    /// Random grippers for each motion onto a hand and each stop of a grip.
    #[arg(long, value_name = "N", default_value_t = 10)]
    draws: u64,
    /// Grippers for RELEASE in each state, under each fault and with each screw.
    #[arg(long, value_name = "N", default_value_t = 1)]
    openings: u64,
    /// Fault-free virtual hours for the false-alarm rate.
    #[arg(long, alias = "quiet-hours", value_name = "HOURS", default_value_t = 0.0)]
    false_alarm_hours: f64,
    /// HTML report to write.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Maximum number of seeds and of fault-free hours.
const MAX_SEEDS: u64 = 10_000;
const MAX_HOURS: f64 = 1000.0;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if !(1..=MAX_SEEDS).contains(&args.seeds) {
        bail!("--seeds {} is not possible here; give 1 to {MAX_SEEDS}", args.seeds);
    }
    for (name, count) in [("--draws", args.draws), ("--openings", args.openings)] {
        if count > MAX_SEEDS {
            bail!("{name} {count} is not possible here; give at most {MAX_SEEDS}");
        }
    }
    if !(0.0..=MAX_HOURS).contains(&args.false_alarm_hours) {
        bail!(
            "--false-alarm-hours {:?} is not possible here; give 0 to {MAX_HOURS}",
            args.false_alarm_hours
        );
    }
    let tables = closed_loop::nominal_tables()?;
    let cases = campaign::cases(args.from_seed, args.seeds);
    let start = Instant::now();
    let bar = progress::progress_bar("injecting faults", cases.len());
    let outcomes = campaign::run(&cases, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let draws =
        RequirementDraws { first: args.from_seed, grippers: args.draws, openings: args.openings };
    let bar = progress::progress_bar("bounds of the hazard table", draws.runs());
    let mut requirements = campaign::fault_requirements(&outcomes);
    requirements.extend(campaign::evaluate_requirements(&draws, &tables, || bar.inc(1)));
    bar.finish_and_clear();
    let bar = progress::progress_bar(
        "fault-free operation",
        campaign::fault_free_minutes(args.false_alarm_hours),
    );
    let fault_free =
        campaign::run_fault_free(args.from_seed, args.false_alarm_hours, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let result = CampaignResult {
        seeds: (args.from_seed, args.seeds),
        summaries: campaign::summarize(&outcomes),
        runs: outcomes.len(),
        requirements,
        unreached: outcomes.iter().filter(|(_, o)| !o.was_reached).count(),
        fault_free,
        seconds: start.elapsed().as_secs_f64(),
    };
    if let Some(path) = &args.output {
        let title = "magpie: fault campaign on a simulated gripper";
        let section = report::html::faults::section(&summary(&result), &result);
        report::html::write_sections(path, title, &[section])?;
    }
    let report = args.output.as_deref();
    terminal::print_result(
        args.json,
        || to_json(&result, report),
        || format_report(&result, report),
    )
}
