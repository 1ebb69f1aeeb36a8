//! `magpie diagnose`: which physical effect is missing from a model.

use analysis::progress;
use anyhow::Result;
use model_export::model_file::ModelFile;

use crate::commands::args::{CompareArgs, ExprArgs};
use crate::commands::print_notes;
use analysis::compare::campaign_reader::{Caching, ScannedCampaign};
use analysis::compare::pipeline::compare_scanned;
use analysis::diagnose::suggestions::{Invocation, suggest};
use analysis::diagnose::{Diagnosis, diagnose};
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
    let input = &common.input;
    let model = ModelFile::read(&input.model)?;
    let options = input.options();
    let alignment = input.align.alignment()?;
    let scanned = ScannedCampaign::open(&input.campaign, alignment, Caching::Always)?;
    let (diagnosis, refit) = match &scanned.reader {
        Some(reader) => {
            let campaign = reader.whole()?;
            let own = args.exprs.parse(&campaign)?;
            let bar = progress::row_spinner("diagnosing");
            let on_stage = |stage: &str| bar.set_message(stage.to_owned());
            let (mut diagnosis, refit) =
                diagnose(&campaign, &model, &input.model, &own, options, &on_stage)?;
            bar.finish_and_clear();
            diagnosis.findings.clone_from(&scanned.findings);
            let discovered = diagnosis.formulas.iter().flat_map(|formula| &formula.effects);
            let own: Vec<_> = own.iter().chain(discovered).cloned().collect();
            diagnosis.next = suggest(
                &diagnosis,
                &Invocation {
                    model: &diagnosis.model,
                    campaign: &diagnosis.campaign,
                    delay_ms: 1e-3 * alignment.delay_us,
                    base: model.base,
                    own: &own,
                },
            );
            (diagnosis, refit)
        }
        None => (Diagnosis { findings: scanned.findings.clone(), ..Diagnosis::default() }, None),
    };
    terminal::print_result(input.json, || to_json(&diagnosis), || format_report(&diagnosis))?;
    if common.output.is_some() {
        let comparison =
            compare_scanned(&input.model, &model, None, scanned, refit.as_ref(), options)?;
        print_notes(&comparison.notes);
        common.write_report(&comparison, &report::html::diagnosis::sections(&diagnosis))?;
    }
    Ok(())
}
