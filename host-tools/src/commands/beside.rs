//! What `compare` and `diagnose` share: a model beside a campaign, and a report of it.

use std::path::PathBuf;

use anyhow::Result;
use model_export::fit::Options;
use model_export::output::check_output;

use super::clocks::Clocks;
use crate::compare::Comparison;
use crate::report::{self, Section};
use crate::show;

/// Arguments that both commands take.
#[derive(Debug, clap::Args)]
pub struct Beside {
    /// Model file, as `magpie fit` writes it.
    pub model: PathBuf,
    /// Folder of recordings (or one recording).
    pub campaign: PathBuf,
    /// Where the report goes: one HTML file; without it none is written.
    #[arg(short, long, value_name = "REPORT")]
    pub output: Option<PathBuf>,
    /// How the two clocks belong together.
    #[command(flatten)]
    pub clocks: Clocks,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    pub json: bool,
}

impl Beside {
    /// Options of every fit.
    pub fn options(&self) -> Options {
        Options {
            seed: self.seed,
            ..Options::default()
        }
    }

    /// Refuses before any work what would be refused after it.
    pub fn check(&self) -> Result<()> {
        if let Some(path) = &self.output {
            check_output(path, report::MARK)?;
        }
        Ok(())
    }

    /// Writes the report where one is wanted, with a diagnosis's sections.
    pub fn report(&self, comparison: &Comparison, sections: &[Section]) -> Result<()> {
        let Some(path) = &self.output else {
            return Ok(());
        };
        report::write(path, comparison, sections)?;
        self.say(&format!(
            "The report is in {}: open it in a browser.",
            path.display()
        ))
    }

    /// One line for a person, kept away from what a machine reads.
    pub fn say(&self, line: &str) -> Result<()> {
        match self.json {
            true => eprintln!("{line}"),
            false => show::page(&format!("{line}\n"))?,
        }
        Ok(())
    }
}
