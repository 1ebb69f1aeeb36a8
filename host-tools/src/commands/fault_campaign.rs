//! `magpie fault-campaign`: fault injection into a simulated gripper.

use analysis::numbers;
use analysis::progress;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use serde_json::{Value, json};

use report::text::terminal;
use sim::closed_loop;
use sim::faults::campaign::{self, FalseAlarms, FaultSummary};
use sim::faults::injection::{COVERED_BY_OTHER_TESTS, HARDWARE_ONLY};

/// Inject faults at their sources into a simulated gripper in every state, and report detection and reaction.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie fault-campaign --seeds 1
  cargo magpie fault-campaign --seeds 20 --false-alarm-hours 1 -o faults.html")]
pub struct Args {
    /// Grippers with perturbed parameters per fault, state, screw and stiffness.
    #[arg(long, value_name = "N", default_value_t = 2)]
    seeds: u64,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 1)]
    from_seed: u64,
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
    if !(0.0..=MAX_HOURS).contains(&args.false_alarm_hours) {
        bail!(
            "--false-alarm-hours {} is not possible here; give 0 to {MAX_HOURS}",
            args.false_alarm_hours
        );
    }
    let tables = closed_loop::nominal_tables()?;
    let cases = campaign::cases(args.from_seed, args.seeds);
    let start = Instant::now();
    let bar = progress::progress_bar("injecting faults", cases.len());
    let outcomes = campaign::run(&cases, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let bar = progress::progress_bar(
        "fault-free operation",
        campaign::fault_free_minutes(args.false_alarm_hours),
    );
    let quiet =
        campaign::run_fault_free(args.from_seed, args.false_alarm_hours, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let result = CampaignResult {
        tallies: campaign::summarize(&outcomes),
        runs: outcomes.len(),
        unreached: outcomes.iter().filter(|(_, o)| !o.was_reached).count(),
        quiet,
        seconds: start.elapsed().as_secs_f64(),
    };
    if let Some(path) = &args.output {
        let title = "magpie: fault campaign on a simulated gripper";
        let section = report::html::faults::section(&summary(args, &result), &result.tallies);
        report::html::write_sections(path, title, &[section])?;
    }
    terminal::print_result(args.json, || to_json(args, &result), || format_report(args, &result))
}

struct CampaignResult {
    tallies: Vec<FaultSummary>,
    runs: usize,
    unreached: usize,
    quiet: FalseAlarms,
    seconds: f64,
}

fn summary(args: &Args, result: &CampaignResult) -> String {
    let last = args.from_seed + args.seeds - 1;
    let seeds = match args.seeds {
        1 => format!("seed {last}"),
        _ => format!("seeds {} to {last}", args.from_seed),
    };
    let violations: u32 = result.tallies.iter().map(|tally| tally.forbidden).sum();
    let passed = result.tallies.iter().filter(|tally| tally.is_met()).count();
    let mut text = format!(
        "{} runs, {seeds}, both screws, contacts of {} N/mm, uncertain parameters perturbed by up to 20 %. {passed} of \
         {} faults and states meet the specification; {violations} forbidden transitions.",
        result.runs,
        campaign::CONTACTS.map(|stiffness| stiffness.to_string()).join(", "),
        result.tallies.len(),
    );
    if result.unreached > 0 {
        text += &format!(" {} runs did not reach their state.", result.unreached);
    }
    if result.quiet.hours > 0.0 {
        text += &format!(
            " {} false alarms in {} fault-free virtual hours.",
            result.quiet.alarms,
            numbers::decimal(result.quiet.hours, 2)
        );
    }
    text
}

fn format_report(args: &Args, result: &CampaignResult) -> String {
    let mut table = terminal::table([
        "row",
        "fault",
        "state",
        "runs",
        "detected",
        "p50, ms",
        "p99",
        "max",
        "limit",
        "peak, N",
        "final state",
    ]);
    for tally in &result.tallies {
        let facts = tally.fault.specification();
        let [median, p99, max] = tally.latency_ms.map(|ms| numbers::decimal(ms, 2));
        let failed = if tally.is_met() { "" } else { " (failed)" };
        table.add_row([
            facts.number.to_string(),
            facts.description.to_owned(),
            format!("{:?}", tally.state).to_lowercase(),
            tally.runs.to_string(),
            tally.found.to_string(),
            median,
            p99,
            max,
            numbers::decimal(facts.within_ms, 1),
            numbers::decimal(tally.peak_n, 0),
            format!("{}{failed}", tally.ends_words()),
        ]);
    }
    let named = |rows: &[(u8, &str)]| {
        let named = rows.iter().map(|(number, words)| format!("{number} {words}"));
        named.collect::<Vec<_>>().join("; ")
    };
    let mut page = terminal::paragraph(&summary(args, result));
    page += &format!("{table}\n");
    page += &terminal::paragraph(&format!(
        "Reviewed at register level, not simulated: {}.",
        named(&HARDWARE_ONLY)
    ));
    page += &terminal::paragraph(&format!("Not covered: {}.", named(&COVERED_BY_OTHER_TESTS)));
    page += &terminal::paragraph(&format!(
        "Simulated; motor constants assumed. {} s.",
        numbers::decimal(result.seconds, 0)
    ));
    page += &terminal::report_line(args.output.as_deref());
    page
}

fn to_json(args: &Args, result: &CampaignResult) -> Value {
    let rows = result.tallies.iter().map(|tally| {
        let facts = tally.fault.specification();
        let [median, p99, max] = tally.latency_ms;
        json!({
            "row": facts.number,
            "fault": facts.description,
            "code": facts.fault as u16,
            "situation": format!("{:?}", tally.state).to_lowercase(),
            "runs": tally.runs,
            "found": tally.found,
            "p50_ms": median,
            "p99_ms": p99,
            "most_ms": max,
            "asked_ms": facts.within_ms,
            "peak_n": tally.peak_n,
            "specified": tally.specified,
            "forbidden": tally.forbidden,
            "ends": tally.ends_words(),
            "is_met": tally.is_met(),
        })
    });
    json!({
        "simulated": true,
        "from_seed": args.from_seed,
        "seeds": args.seeds,
        "runs": result.runs,
        "unreached": result.unreached,
        "seconds": result.seconds,
        "quiet_hours": result.quiet.hours,
        "false_alarms": result.quiet.alarms,
        "report": args.output,
        "rows": rows.collect::<Vec<_>>(),
    })
}
