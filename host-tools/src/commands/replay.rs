//! `magpie replay`: runs a campaign through the device code.

use std::path::PathBuf;

use analysis::replay::evaluation::evaluate;
use anyhow::Result;
use report::text::replay::{format_report, to_json};
use report::text::terminal;

use crate::commands::args::AlignArgs;
use crate::commands::output::print_notes;

/// Run a campaign through the device code and compare the forces with the reference.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie replay model.toml tests/data/clean
  cargo magpie replay model.toml my-campaign --network network.safetensors
  cargo magpie replay model.toml tests/data/clean --json | jq '.sensors'")]
pub struct Args {
    /// Model file written by `magpie fit`.
    model: PathBuf,
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    /// Recurrent networks to run after the model, written by `magpie train`.
    #[arg(long, value_name = "NETWORK")]
    network: Option<PathBuf>,
    #[command(flatten)]
    align: AlignArgs,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let delay_ms = args.align.given_ms()?;
    let evaluation = evaluate(&args.model, &args.campaign, args.network.as_deref(), delay_ms)?;
    print_notes(&evaluation.notes);
    terminal::print_result(args.json, || to_json(&evaluation), || format_report(&evaluation))
}
