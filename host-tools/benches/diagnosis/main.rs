//! How often `magpie diagnose` is right: a Monte Carlo over simulated campaigns of 3 x 30 s.
//!
//! Each case is simulated, fitted and diagnosed by the tool's own commands; the truth never enters. Every
//! rate comes with its exact binomial interval (Clopper and Pearson 1934), every failure with the commands
//! that repeat it. The world is `magpie simulate`, whose physics share no code with the models.
//!
//! ```text
//! cargo bench -p host-tools --bench diagnosis                  # all of it
//! cargo bench -p host-tools --bench diagnosis -- nothing --seeds 3
//! ```

mod cases;
mod counts;
mod evaluate;
mod run;

use clap::Parser;
use rayon::prelude::*;

use cases::Group;
use run::Outcome;

/// Counts how often the diagnosis is right.
#[derive(Parser)]
struct Args {
    /// Groups to run: typical, small, nothing, pairs, outside, always.
    groups: Vec<String>,
    /// Campaigns of each kind; by default as many as the published figures rest on.
    #[arg(long)]
    seeds: Option<u64>,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    first: u64,
    /// Only cases that hide this.
    #[arg(long)]
    only: Option<String>,
    /// What cargo passes to every bench.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() {
    let args = Args::parse();
    let chosen = |group: &Group| {
        let named = args.groups.iter().any(|name| name == group.id());
        args.groups.is_empty() || named
    };
    let mut missed = false;
    for group in Group::ALL.into_iter().filter(chosen) {
        let seeds = args.first..args.first + args.seeds.unwrap_or(group.seeds());
        let cases: Vec<_> = cases::of(group, seeds.clone())
            .into_iter()
            .filter(|case| args.only.as_ref().is_none_or(|only| case.hides(only)))
            .collect();
        println!("\n{}: {} campaigns, seeds {seeds:?}", group.id(), cases.len());
        let bar = analysis::progress::progress_bar("campaigns", cases.len());
        let outcomes: Vec<Outcome> = cases
            .par_iter()
            .map(|case| {
                let outcome = run::run(case);
                bar.inc(1);
                bar.suspend(|| println!("  {}", outcome.line(case)));
                outcome
            })
            .collect();
        bar.finish_and_clear();
        missed |= !counts::report(group, &outcomes);
    }
    if missed {
        std::process::exit(1);
    }
}
