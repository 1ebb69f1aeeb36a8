//! `magpie compare`: the model beside the measurement, and where it fails.

pub mod json;
pub mod text;

use std::path::PathBuf;

use anyhow::Result;
use model_export::fit::Options;

use super::clocks::Clocks;
use crate::compare::compute::compare;
use crate::show;

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
    let mut comparison = compare(&args.model, &args.campaign, alignment, options)?;
    if let Some(with) = &args.with {
        comparison.other = Some(Box::new(compare(with, &args.campaign, alignment, options)?));
    }
    let text = match args.json {
        true => format!("{}\n", json::json(&comparison)),
        false => text::text(&comparison),
    };
    show::page(&text)?;
    Ok(())
}
