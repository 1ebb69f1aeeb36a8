//! `magpie fit`: fits the base physics to a campaign.

use std::path::{Path, PathBuf};

use analysis::compare::campaign_reader::scan_with_progress;
use analysis::data_quality::corrected_copy;
use analysis::fit::fit_model;
use anyhow::Result;
use clap::ValueEnum;
use model_export::model_file::{self, BaseKind};
use model_export::output::Output;
use model_export::recordings::campaign::fingerprints;
use report::text::findings::message;
use report::text::fit::{format_report, to_json};
use report::text::terminal;

use crate::commands::args::{FitArgs, ForceArg};
use crate::commands::output::print_notes;

/// Fit the base physics to a campaign and write a model file.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie fit tests/data/clean -o model.toml
  cargo magpie fit my-campaign --base polynomial --degree 5 -o model.toml
  cargo magpie fit my-campaign --fix corrected -o model.toml
  cargo magpie fit tests/data/clean --json | jq '.axes'")]
pub struct Args {
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    /// Model file to write.
    #[arg(short, long, value_name = "MODEL")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArg,
    /// Base physics.
    #[arg(long, value_enum, default_value = "cylinder")]
    base: BaseChoice,
    /// Degree of the polynomial base [default: chosen by held-out error].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=9))]
    degree: Option<u8>,
    /// Fit a corrected copy of the recordings, written to this new folder: all setup errors with an unambiguous correction that
    /// the files show without a model.
    #[arg(long, value_name = "NEW")]
    fix: Option<PathBuf>,
    #[command(flatten)]
    fit: FitArgs,
}

/// The base physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum BaseChoice {
    /// Exact field of the design's magnet (cylinder or other shape) on two flexures.
    Cylinder,
    /// Polynomial of the forces, for unknown geometry.
    Polynomial,
}

impl BaseChoice {
    fn kind(self) -> BaseKind {
        match self {
            Self::Cylinder => BaseKind::Cylinder,
            Self::Polynomial => BaseKind::Polynomial,
        }
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.degree.is_some() && args.base == BaseChoice::Cylinder {
        anyhow::bail!("--degree requires --base polynomial; the cylinder base has no degree");
    }
    let alignment = args.fit.align.alignment()?;
    if let Some(to) = &args.fix {
        let check = |folder: &Path| scan_with_progress(folder, alignment);
        let findings = check(&args.campaign)?;
        if findings.iter().all(|finding| finding.fix.is_none()) {
            // What a fit refuses shows only in the fit.
            let messages =
                findings.iter().map(|finding| format!("{}: {}", finding.place, message(finding)));
            let refusal = fit_model(
                &args.campaign,
                args.base.kind(),
                args.degree,
                alignment,
                args.fit.options(),
            );
            let messages = messages.chain(refusal.err().map(|error| error.to_string()));
            let messages: Vec<String> = messages.collect();
            anyhow::bail!(
                "nothing here has an unambiguous correction, so that {} is not written{}{}; with a good model of this gripper, \
                 `compare --fix` corrects more",
                to.display(),
                if messages.is_empty() { "" } else { ": " },
                messages.join("; ")
            );
        }
        for correction in corrected_copy::write(&args.campaign, &findings, to, check)? {
            eprintln!("{correction}");
        }
        eprintln!("Corrected and checked: {}", to.display());
    }
    let campaign = args.fix.as_ref().unwrap_or(&args.campaign);
    let check = |path| {
        let inputs = fingerprints(campaign)?;
        Output::check(path, model_file::SIGNATURE, inputs, args.force.overwrite())
    };
    let output = args.output.as_deref().map(check).transpose()?;
    let options = args.fit.options();
    let fit = fit_model(campaign, args.base.kind(), args.degree, alignment, options)?;
    print_notes(&fit.notes);
    terminal::print_result(args.fit.json, || to_json(&fit), || format_report(&fit))?;
    if let Some(output) = &output {
        fit.model.write_output(output)?;
    }
    if !args.fit.json {
        terminal::print_written(args.output.as_deref(), "-o model.toml")?;
    }
    Ok(())
}
