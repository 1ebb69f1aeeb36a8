//! `magpie design paper`: what the paper says of magnets, sensitivity and materials, computed.

use std::path::PathBuf;

use anyhow::Result;
use model_export::design::interference::{DRAWS, Surroundings};
use model_export::design::paper::claims::Verdict;
use model_export::design::paper::{MATERIALS, Paper};
use model_export::design::sweep::COUNT;
use serde_json::json;

use crate::report;
use crate::report::design as pages;
use crate::{progress, show};

/// Compute the paper's figures of fields, sensitivity and materials, and judge each of its statements.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design paper -o paper.html
  cargo magpie design paper --json")]
pub struct Args {
    /// Designs of each material.
    #[arg(long, value_name = "N", default_value_t = COUNT, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    count: u32,
    /// Seed of the draws of misalignment.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where the report goes.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let around = Surroundings::assumed(args.seed, DRAWS);
    let bar = progress::bar("judging designs", args.count as usize * MATERIALS.len());
    let paper = Paper::of(args.count, &around, || bar.inc(1));
    bar.finish_and_clear();
    if let Some(path) = &args.output {
        let sections = pages::of_paper(&paper);
        report::write_sections(path, "magpie: the paper's figures of a design", &sections)?;
    }
    let page = match args.json {
        true => {
            let claims = paper.claims.iter().map(|claim| {
                json!({
                    "says": claim.says,
                    "place": claim.place,
                    "found": claim.found,
                    "verdict": claim.verdict.name(),
                })
            });
            let claims: Vec<_> = claims.collect();
            format!("{}\n", json!({ "claims": claims, "report": args.output }))
        }
        false => text(args, &paper),
    };
    show::page(&page)?;
    Ok(())
}

fn text(args: &Args, paper: &Paper) -> String {
    let mut table = show::table(["the paper says", "where", "found", ""]);
    for claim in &paper.claims {
        table.add_row([
            claim.says,
            claim.place,
            claim.found.as_str(),
            claim.verdict.name(),
        ]);
    }
    let of = |verdict| {
        let claims = paper.claims.iter();
        claims.filter(|claim| claim.verdict == verdict).count()
    };
    let mut page = format!("{table}\n");
    page += &show::paragraph(&format!(
        "{} reproduced, {} not, {} impossible as stated.",
        of(Verdict::Reproduced),
        of(Verdict::NotReproduced),
        of(Verdict::Impossible)
    ));
    if let Some(path) = &args.output {
        page += &format!("Report: {}\n", path.display());
    }
    page
}
