//! `magpie effects`: the catalogue of physical effects.

use anyhow::Result;
use model_export::effects::{CATALOGUE, find};
use report::text::effects::{catalogue_table, describe, to_json};
use report::text::terminal;
use serde_json::json;

/// List the catalogue of physical effects, or describe one.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie effects
  cargo magpie effects hysteresis")]
pub struct Args {
    /// Effect to describe [default: list all].
    effect: Option<String>,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let text = match (&args.effect, args.json) {
        (Some(name), false) => describe(find(name)?),
        (Some(name), true) => format!("{}\n", to_json(find(name)?)),
        (None, false) => catalogue_table(),
        (None, true) => format!("{}\n", json!({ "effects": CATALOGUE.map(to_json) })),
    };
    terminal::print(&text)?;
    Ok(())
}
