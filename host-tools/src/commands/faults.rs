//! `magpie faults`: faults thrown at a simulated gripper.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use serde_json::{Value, json};

use crate::drive::tables;
use crate::faults::campaign::{self, Tally};
use crate::faults::quiet::{self, Quiet};
use crate::faults::row::{BESIDE, ELSEWHERE};
use crate::report;
use crate::{progress, show};

/// Throw faults at a simulated gripper where they arise, in every state, and tell what became of it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie faults --seeds 1
  cargo magpie faults --seeds 20 --quiet-hours 1 -o faults.html")]
pub struct Args {
    /// Grippers for each fault, state, screw and stiffness; each is off the card in its own way.
    #[arg(long, value_name = "N", default_value_t = 2)]
    seeds: u64,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 1)]
    from_seed: u64,
    /// Virtual hours without a fault, in which every fault that is told is a false alarm.
    #[arg(long, value_name = "HOURS", default_value_t = 0.0)]
    quiet_hours: f64,
    /// Where the report goes.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// A campaign has no more seeds and hours than these.
const MOST: (u64, f64) = (10_000, 1000.0);

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let (seeds, hours) = MOST;
    if !(1..=seeds).contains(&args.seeds) {
        bail!(
            "--seeds {} is not possible here; give 1 to {seeds}",
            args.seeds
        );
    }
    if !(0.0..=hours).contains(&args.quiet_hours) {
        bail!(
            "--quiet-hours {} is not possible here; give 0 to {hours}",
            args.quiet_hours
        );
    }
    let tables = tables::as_drawn()?;
    let cases = campaign::cases(args.from_seed, args.seeds);
    let began = Instant::now();
    let bar = progress::bar("throwing faults", cases.len());
    let outcomes = campaign::run(&cases, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let bar = progress::bar("waiting without a fault", quiet::minutes(args.quiet_hours));
    let quiet = quiet::run(args.from_seed, args.quiet_hours, &tables, || bar.inc(1));
    bar.finish_and_clear();
    let told = Told {
        tallies: campaign::tallies(&outcomes),
        runs: outcomes.len(),
        unreached: outcomes.iter().filter(|(_, o)| !o.was_reached).count(),
        quiet,
        seconds: began.elapsed().as_secs_f64(),
    };
    if let Some(path) = &args.output {
        let title = "magpie: faults thrown at a simulated gripper";
        let section = report::faults::section(&sentence(args, &told), &told.tallies);
        report::write_sections(path, title, &[section])?;
    }
    let page = match args.json {
        true => format!("{}\n", json_of(args, &told)),
        false => text(args, &told),
    };
    show::page(&page)?;
    Ok(())
}

struct Told {
    tallies: Vec<Tally>,
    runs: usize,
    unreached: usize,
    quiet: Quiet,
    seconds: f64,
}

fn sentence(args: &Args, told: &Told) -> String {
    let last = args.from_seed + args.seeds - 1;
    let seeds = match args.seeds {
        1 => format!("seed {last}"),
        _ => format!("seeds {} to {last}", args.from_seed),
    };
    let forbidden: u32 = told.tallies.iter().map(|tally| tally.forbidden).sum();
    let met = told.tallies.iter().filter(|tally| tally.is_met()).count();
    let mut words = format!(
        "{} runs, {seeds}, both screws, contacts of {} N/mm, all that is uncertain off by up to 20 %. {met} of \
         {} rows and situations are as specified; {forbidden} forbidden steps.",
        told.runs,
        campaign::CONTACTS
            .map(|stiffness| stiffness.to_string())
            .join(", "),
        told.tallies.len(),
    );
    if told.unreached > 0 {
        words += &format!(" {} runs did not come to their situation.", told.unreached);
    }
    if told.quiet.hours > 0.0 {
        words += &format!(
            " Without a fault: {} false alarms in {} virtual hours.",
            told.quiet.alarms,
            show::plain(told.quiet.hours, 2)
        );
    }
    words
}

fn text(args: &Args, told: &Told) -> String {
    let mut table = show::table([
        "row", "fault", "state", "runs", "found", "p50, ms", "p99", "most", "asked", "peak, N",
        "ends as",
    ]);
    for tally in &told.tallies {
        let facts = tally.row.facts();
        let [median, most, greatest] = tally.latency_ms.map(|ms| show::plain(ms, 2));
        let missed = if tally.is_met() { "" } else { " (missed)" };
        table.add_row([
            facts.number.to_string(),
            facts.words.to_owned(),
            format!("{:?}", tally.situation).to_lowercase(),
            tally.runs.to_string(),
            tally.found.to_string(),
            median,
            most,
            greatest,
            show::plain(facts.within_ms, 1),
            show::plain(tally.peak_n, 0),
            format!("{}{missed}", tally.ends_words()),
        ]);
    }
    let named = |rows: &[(u8, &str)]| {
        let named = rows
            .iter()
            .map(|(number, words)| format!("{number} {words}"));
        named.collect::<Vec<_>>().join("; ")
    };
    let mut page = show::paragraph(&sentence(args, told));
    page += &format!("{table}\n");
    page += &show::paragraph(&format!(
        "Reviewed at register level, never counted: {}.",
        named(&ELSEWHERE)
    ));
    page += &show::paragraph(&format!("Not in these runs: {}.", named(&BESIDE)));
    page += &show::paragraph(&format!(
        "Simulated; motor constants assumed. {} s.",
        show::plain(told.seconds, 0)
    ));
    if let Some(path) = &args.output {
        page += &format!("Report: {}\n", path.display());
    }
    page
}

fn json_of(args: &Args, told: &Told) -> Value {
    let rows = told.tallies.iter().map(|tally| {
        let facts = tally.row.facts();
        let [median, most, greatest] = tally.latency_ms;
        json!({
            "row": facts.number,
            "fault": facts.words,
            "code": facts.fault as u16,
            "situation": format!("{:?}", tally.situation).to_lowercase(),
            "runs": tally.runs,
            "found": tally.found,
            "p50_ms": median,
            "p99_ms": most,
            "most_ms": greatest,
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
        "runs": told.runs,
        "unreached": told.unreached,
        "seconds": told.seconds,
        "quiet_hours": told.quiet.hours,
        "false_alarms": told.quiet.alarms,
        "report": args.output,
        "rows": rows.collect::<Vec<_>>(),
    })
}
