//! `magpie diagnose`: which physical effect is missing from a model.

use analysis::progress;
use anyhow::Result;
use model_export::model_file::ModelFile;

use crate::commands::args::{CompareArgs, ExprArgs};
use analysis::compare::campaign_reader::read_campaign;
use analysis::compare::pipeline::compare;
use analysis::data_quality::scan_files;
use analysis::diagnose::Diagnosis;
use analysis::diagnose::suggestions::{Invocation, suggest};
use report::text::diagnosis::{format_report, to_json};
use report::text::terminal;

/// Identify the physical effects that are missing from a model, with the evidence.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie diagnose model.toml tests/data/friction -o report.html
  cargo magpie diagnose model.toml my-campaign --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'
  cargo magpie diagnose model.toml tests/data/demo --json | jq '.accepted'")]
pub struct Args {
    #[command(flatten)]
    common: CompareArgs,
    #[command(flatten)]
    exprs: ExprArgs,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let common = &args.common;
    common.check_output()?;
    let diagnosis = run_diagnosis(args)?;
    terminal::print_result(
        common.input.json,
        || to_json(&diagnosis),
        || format_report(&diagnosis),
    )?;
    if common.output.is_some() {
        let input = &common.input;
        let alignment = input.align.alignment()?;
        let comparison = compare(&input.model, &input.campaign, None, alignment, input.options())?;
        common.write_report(&comparison, &report::html::diagnosis::sections(&diagnosis))?;
    }
    Ok(())
}

fn run_diagnosis(args: &Args) -> Result<Diagnosis> {
    let input = &args.common.input;
    let model = ModelFile::read(&input.model)?;
    let options = input.options();
    let findings = scan_files(&input.campaign, |_| ())?;
    if findings.iter().any(|finding| finding.stops) {
        return Ok(Diagnosis { findings, ..Diagnosis::default() });
    }
    let alignment = input.align.alignment()?;
    let campaign = read_campaign(&input.campaign, alignment)?;
    let formulas = args.exprs.parse(&campaign)?;
    let bar = progress::row_spinner("diagnosing");
    let report_step = |step: &str| bar.set_message(step.to_owned());
    let mut diagnosis = analysis::diagnose::diagnose(
        &campaign,
        &model,
        &input.model,
        &formulas,
        options,
        &report_step,
    )?;
    bar.finish_and_clear();
    diagnosis.findings = findings;
    diagnosis.campaign = input.campaign.display().to_string();
    diagnosis.next = suggest(
        &diagnosis,
        &Invocation {
            model: &diagnosis.model,
            campaign: &diagnosis.campaign,
            delay_ms: 1e-3 * alignment.delay_us,
            base: model.base,
            own: &formulas,
        },
    );
    Ok(diagnosis)
}
