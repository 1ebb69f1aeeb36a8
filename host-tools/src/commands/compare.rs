//! `magpie compare`: the model beside the measurement, and where it fails.

pub mod json;
pub mod text;

use std::path::PathBuf;

use anyhow::Result;

use super::beside::Beside;
use crate::compare::compute::compare;
use crate::findings::fix;
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
    #[command(flatten)]
    beside: Beside,
    /// A second model, judged on the same rows.
    #[arg(long, value_name = "OTHER")]
    with: Option<PathBuf>,
    /// Write the recordings anew, with those mistakes of the rig mended that can be without doubt.
    #[arg(long, value_name = "NEW")]
    fix: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let beside = &args.beside;
    beside.check()?;
    let comparison = compare(
        &beside.model,
        &beside.campaign,
        args.with.as_deref(),
        beside.clocks.alignment()?,
        beside.options(),
    )?;
    let text = match beside.json {
        true => format!("{}\n", json::json(&comparison)),
        false => text::text(&comparison),
    };
    show::page(&text)?;
    beside.report(&comparison, &[])?;
    if let Some(to) = &args.fix {
        for done in fix::write(&beside.campaign, &comparison.findings, to)? {
            beside.say(&done)?;
        }
        beside.say(&format!("Mended recordings are in {}.", to.display()))?;
    }
    Ok(())
}
