//! `magpie design`: flexure, magnet and gap before anything is made.
//!
//! - [`space`]: where designs are looked for, as options.
//! - [`check`], [`pick`], [`sweep`], [`paper`]: one file for each command below.
//! - [`words`]: what several of them print.

pub mod check;
pub mod paper;
pub mod pick;
pub mod space;
pub mod sweep;
pub mod words;

use anyhow::Result;

/// Design a sensor: judge a flexure, magnet and gap, sweep thousands, or have one proposed for a force.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie design pick --range 250 -o design.toml
  cargo magpie design check design.toml
  cargo magpie simulate --design design.toml -o CAMPAIGN")]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Check(check::Args),
    Sweep(sweep::Args),
    Pick(pick::Args),
    Paper(paper::Args),
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    match &args.command {
        Command::Check(args) => check::run(args),
        Command::Sweep(args) => sweep::run(args),
        Command::Pick(args) => pick::run(args),
        Command::Paper(args) => paper::run(args),
    }
}
