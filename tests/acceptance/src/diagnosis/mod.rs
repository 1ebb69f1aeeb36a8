//! Rate of correct diagnoses: a Monte Carlo over simulated campaigns of 3 x 30 s.
//!
//! Each case is simulated, fitted and diagnosed by commands of `magpie`. The physics of `magpie simulate` shares no
//! code with the models. Failures are printed with their seeds.

pub mod cases;
mod counts;
mod evaluate;
mod run;

use std::ops::Range;

use anyhow::Result;
use rayon::prelude::*;

use crate::results::{Section, markdown_table};
use crate::{DefaultSeeds, Options};
use cases::{Case, Group};
use run::Outcome;

/// Campaigns of each group in a quick run.
const QUICK_CASES: usize = 2;

/// Evaluate the rate of correct diagnoses.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cargo acceptance diagnosis typical small --seeds 5")]
pub struct Args {
    /// Groups to run [default: all].
    #[arg(value_enum)]
    groups: Vec<Group>,
    /// Only cases with this effect.
    #[arg(long, value_name = "EFFECT")]
    only: Option<String>,
}

/// Runs the chosen groups.
pub fn evaluate_groups(args: &Args, options: &Options) -> Result<Section> {
    let chosen = |group: &Group| args.groups.is_empty() || args.groups.contains(group);
    let mut is_met = true;
    let mut rows = Vec::new();
    let mut campaigns = 0;
    for group in Group::ALL.into_iter().filter(chosen) {
        let seeds = options.seeds(default_seeds(group));
        let count = seeds.end - seeds.start;
        let cases = chosen_cases(group, seeds, args, options.quick);
        campaigns += cases.len();
        let bar = analysis::progress::progress_bar("campaigns", cases.len());
        let outcomes: Result<Vec<Outcome>> = cases
            .par_iter()
            .map(|case| {
                let outcome = run::run(case)?;
                bar.inc(1);
                bar.suspend(|| eprintln!("  {}", outcome.line(case)));
                Ok(outcome)
            })
            .collect();
        bar.finish_and_clear();
        for rate in counts::rates(group, &outcomes?) {
            is_met &= rate.is_reached();
            rows.push(rate.cells(group, count));
        }
    }
    // Alone, these two have a section of their own: their run must not replace the table of all.
    let (id, title) = match *args.groups {
        [Group::Outside] => ("diagnosis-outside", "Diagnosis of effects outside the catalogue"),
        [Group::Planned] => ("diagnosis-planned", "Diagnosis with the proposed recordings"),
        _ => ("diagnosis", "Diagnosis"),
    };
    Ok(Section {
        id,
        title,
        extent: format!(
            "{campaigns} campaigns, seeds from {}",
            options.seeds(default_seeds(Group::Typical)).start
        ),
        conditions: format!(
            "Simulated campaigns of 3 x 30 s; rates over effects of at least {} standard errors.",
            counts::MIN_EFFECT_SIZE
        ),
        tables: markdown_table(
            ["random effects", "seeds", "figure", "rate", "95 % confidence limits", "specified"],
            rows,
        ),
        is_met: Some(is_met),
    })
}

fn default_seeds(group: Group) -> DefaultSeeds {
    DefaultSeeds { first: 1, full: group.seeds(), quick: 1 }
}

/// Cases of a group; a quick run has a few, evenly spaced.
fn chosen_cases(group: Group, seeds: Range<u64>, args: &Args, quick: bool) -> Vec<Case> {
    let is_chosen = |case: &Case| args.only.as_ref().is_none_or(|only| case.hides(only));
    let cases: Vec<Case> = cases::of(group, seeds).into_iter().filter(is_chosen).collect();
    let stride = if quick { cases.len().div_ceil(QUICK_CASES).max(1) } else { 1 };
    cases.into_iter().step_by(stride).collect()
}
