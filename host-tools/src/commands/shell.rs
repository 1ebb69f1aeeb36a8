//! `magpie dev completions` and `magpie dev man`: completion of the command line in a shell, and manual pages.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap_complete::Shell;
use report::text::terminal;

/// Print the completion script of a shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie dev completions bash > ~/.local/share/bash-completion/completions/magpie
  cargo magpie dev completions fish > ~/.config/fish/completions/magpie.fish")]
pub struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Prints the script for `parser`.
pub fn run_completions(args: &CompletionsArgs, mut parser: clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut parser, "magpie", &mut script);
    Ok(terminal::print(&String::from_utf8(script)?)?)
}

/// Write a manual page for each command.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie dev man ~/.local/share/man/man1
  cargo magpie dev man pages && man pages/magpie-fit.1")]
pub struct ManArgs {
    /// Folder for the pages; existing ones are replaced.
    folder: PathBuf,
}

/// Writes the pages of the commands of `parser`.
pub fn run_man(args: &ManArgs, parser: clap::Command) -> Result<()> {
    let place = args.folder.display();
    std::fs::create_dir_all(&args.folder).with_context(|| format!("{place} cannot be made"))?;
    // No page is generated for hidden commands.
    let all = parser.mut_subcommands(|command| command.hide(false));
    clap_mangen::generate_to(all, &args.folder)
        .with_context(|| format!("{place} cannot be written"))?;
    Ok(terminal::print(&format!("Manual pages of magpie and its commands in {place}.\n"))?)
}
