//! `magpie dev emulate`: runs the unmodified firmware image in an emulated chip.

mod args;
#[cfg(unix)]
mod session;
#[cfg(unix)]
mod text;

use anyhow::Result;

pub use args::Args;

/// Runs the command.
#[cfg(unix)]
pub fn run(args: &Args) -> Result<()> {
    session::run(args)
}

/// Fails: there are no pseudo-terminals.
#[cfg(not(unix))]
pub fn run(_: &Args) -> Result<()> {
    anyhow::bail!("emulate needs pseudo-terminals, which this system does not have")
}
