//! `magpie compare`: the model beside the measurement, and where it fails.

pub mod json;
pub mod text;

use std::path::PathBuf;

use anyhow::Result;
use model_export::fit::Options;
use model_export::output::check_output;

use super::clocks::Clocks;
use crate::compare::compute::compare;
use crate::findings::fix;
use crate::{report, show};

/// Hold a model against recordings: how good it is, and where it fails.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie compare model.toml tests/data/demo -o report.html
  cargo magpie compare model.toml tests/data/demo --with better.toml
  cargo magpie compare model.toml tests/data/demo --fix mended
  cargo magpie compare model.toml tests/data/demo --json | jq '.where[0]'")]
pub struct Args {
    /// Model file, as `magpie fit` writes it.
    model: PathBuf,
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    /// A second model, judged on the same rows.
    #[arg(long, value_name = "OTHER")]
    with: Option<PathBuf>,
    /// Where the report goes: one HTML file; without it none is written.
    #[arg(short, long, value_name = "REPORT")]
    output: Option<PathBuf>,
    /// Write the recordings anew, with those mistakes of the rig mended that can be without doubt.
    #[arg(long, value_name = "NEW")]
    fix: Option<PathBuf>,
    #[command(flatten)]
    clocks: Clocks,
    /// Seed of the bootstrap behind the bands.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let alignment = args.clocks.alignment()?;
    let options = Options {
        seed: args.seed,
        ..Options::default()
    };
    if let Some(path) = &args.output {
        check_output(path, report::MARK)?;
    }
    let with = args.with.as_deref();
    let comparison = compare(&args.model, &args.campaign, with, alignment, options)?;
    let text = match args.json {
        true => format!("{}\n", json::json(&comparison)),
        false => text::text(&comparison),
    };
    show::page(&text)?;
    if let Some(path) = &args.output {
        report::write(path, &comparison, &[])?;
        say(
            args,
            &format!("The report is in {}: open it in a browser.", path.display()),
        )?;
    }
    if let Some(to) = &args.fix {
        for done in fix::write(&args.campaign, &comparison.findings, to)? {
            say(args, &done)?;
        }
        say(args, &format!("Mended recordings are in {}.", to.display()))?;
    }
    Ok(())
}

/// One line for a person, kept away from what a machine reads.
fn say(args: &Args, line: &str) -> Result<()> {
    match args.json {
        true => eprintln!("{line}"),
        false => show::page(&format!("{line}\n"))?,
    }
    Ok(())
}
