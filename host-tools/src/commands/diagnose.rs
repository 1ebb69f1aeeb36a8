//! `magpie diagnose`: which physical effect is missing.

pub mod json;
pub mod text;

use anyhow::Result;
use model_export::model_file::ModelFile;

use super::beside::Beside;
use super::fit::read_campaign;
use super::formulas::Formulas;
use crate::compare::compute::compare;
use crate::diagnose::Diagnosis;
use crate::diagnose::compute::compute;
use crate::diagnose::next::{Typed, next};
use crate::findings::files::scan;
use crate::{progress, report, show};

/// Tell which physical effect a model lacks, with the evidence.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie diagnose model.toml tests/data/friction -o report.html
  cargo magpie diagnose model.toml my-campaign --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'
  cargo magpie diagnose model.toml tests/data/demo --json | jq '.accepted'")]
pub struct Args {
    #[command(flatten)]
    beside: Beside,
    #[command(flatten)]
    formulas: Formulas,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let beside = &args.beside;
    beside.check()?;
    let diagnosis = diagnosis(args)?;
    let text = match beside.json {
        true => format!("{}\n", json::json(&diagnosis)),
        false => text::text(&diagnosis),
    };
    show::page(&text)?;
    if beside.output.is_some() {
        let alignment = beside.clocks.alignment()?;
        let (model, campaign) = (&beside.model, &beside.campaign);
        let comparison = compare(model, campaign, None, alignment, beside.options())?;
        beside.report(&comparison, &report::diagnosis::sections(&diagnosis))?;
    }
    Ok(())
}

fn diagnosis(args: &Args) -> Result<Diagnosis> {
    let beside = &args.beside;
    let model = ModelFile::read(&beside.model)?;
    let options = beside.options();
    let findings = scan(&beside.campaign, |_| ())?;
    if findings.iter().any(|finding| finding.stops) {
        return Ok(Diagnosis {
            verdict: crate::compare::words::stopped(&findings),
            findings,
            ..Diagnosis::default()
        });
    }
    let alignment = beside.clocks.alignment()?;
    let campaign = read_campaign(&beside.campaign, alignment)?;
    let own = args.formulas.read(&campaign)?;
    let bar = progress::rows("diagnosing");
    let said = |what: &str| bar.set_message(what.to_owned());
    let mut diagnosis = compute(&campaign, &model, &beside.model, &own, options, &said)?;
    bar.finish_and_clear();
    diagnosis.findings = findings;
    diagnosis.campaign = beside.campaign.display().to_string();
    diagnosis.next = next(
        &diagnosis,
        &Typed {
            model: &diagnosis.model,
            campaign: &diagnosis.campaign,
            delay_ms: 1e-3 * alignment.delay_us,
            base: model.base,
            own: &own,
        },
    );
    Ok(diagnosis)
}
