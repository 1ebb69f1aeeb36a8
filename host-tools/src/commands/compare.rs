//! `magpie compare`: residuals of a model on a campaign, and what explains them.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::commands::args::CompareArgs;
use crate::commands::output::print_notes;
use analysis::comparison::{compare, setup_errors};
use analysis::data_quality::corrected_copy;
use analysis::model::Model;
use report::text::comparison::{format_report, to_json};
use report::text::terminal;

/// Evaluate a model: residuals, noise floor, and what the residuals depend on.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie compare model.toml tests/data/demo -o report.html
  cargo magpie compare better.toml tests/data/demo --baseline model.toml
  cargo magpie compare model.toml tests/data/demo --fix corrected
  cargo magpie compare model.toml tests/data/demo --json | jq '.where[0]'")]
pub struct Args {
    #[command(flatten)]
    common: CompareArgs,
    /// A second model, evaluated on the same rows.
    #[arg(long, value_name = "OTHER")]
    baseline: Option<PathBuf>,
    /// Write corrected copies of the recordings: all setup errors with an unambiguous correction.
    #[arg(long, value_name = "NEW")]
    fix: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let common = &args.common;
    let input = &common.input;
    let page = common.page()?;
    let model = Model::read(&input.model)?;
    let baseline = args.baseline.as_deref().map(Model::read).transpose()?;
    let (alignment, options) = (input.fit.align.of_model(&model.file)?, input.fit.options());
    let comparison = compare(&model, &input.campaign, baseline.as_ref(), alignment, options)?;
    print_notes(&comparison.notes);
    terminal::print_result(input.fit.json, || to_json(&comparison), || format_report(&comparison))?;
    common.write_report(page.as_ref(), &comparison, &[])?;
    if let Some(to) = &args.fix {
        let check = |folder: &Path| setup_errors(&model, folder, alignment, options);
        for correction in corrected_copy::write(&input.campaign, &comparison.findings, to, check)? {
            common.print_line(&correction)?;
        }
        common.print_line(&format!("Corrected and checked: {}", to.display()))?;
    }
    Ok(())
}
