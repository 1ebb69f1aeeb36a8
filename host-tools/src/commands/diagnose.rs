//! `magpie diagnose`: which physical effect is missing.

pub mod json;
pub mod text;

use std::path::PathBuf;

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::model_file::{Base, ModelFile};

use super::clocks::Clocks;
use super::fit::read_campaign;
use super::formulas::Formulas;
use crate::diagnose::Diagnosis;
use crate::diagnose::assemble::assemble;
use crate::diagnose::candidates::candidates;
use crate::diagnose::select::select;
use crate::findings::files::scan;
use crate::{progress, show};

/// Tell which physical effect a model lacks, with the evidence.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie diagnose model.toml tests/data/friction
  cargo magpie diagnose model.toml my-campaign --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'
  cargo magpie diagnose model.toml tests/data/demo --json | jq '.accepted'")]
pub struct Args {
    /// Model file, as `magpie fit` writes it.
    model: PathBuf,
    /// Folder of recordings (or one recording).
    campaign: PathBuf,
    #[command(flatten)]
    formulas: Formulas,
    #[command(flatten)]
    clocks: Clocks,
    /// Seed of the bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let diagnosis = diagnosis(args)?;
    let text = match args.json {
        true => format!("{}\n", json::json(&diagnosis)),
        false => text::text(&diagnosis),
    };
    show::page(&text)?;
    Ok(())
}

fn diagnosis(args: &Args) -> Result<Diagnosis> {
    let model = ModelFile::read(&args.model)?;
    let options = Options {
        seed: args.seed,
        ..Options::default()
    };
    let findings = scan(&args.campaign, |_| ())?;
    if findings.iter().any(|finding| finding.stops) {
        return Ok(Diagnosis {
            verdict: crate::compare::words::stopped(&findings),
            findings,
            ..Diagnosis::default()
        });
    }
    let campaign = read_campaign(&args.campaign, args.clocks.alignment()?)?;
    let own = args.formulas.read(&campaign)?;
    let prepared = match model.base {
        Base::Cylinder => Prepared::cylinder(&campaign)?,
        Base::Polynomial => Prepared::polynomial(&campaign, model.degree(), options)?,
    };
    let present: Vec<Addition> = model.additions(&args.model)?;
    let (judged, unjudged) = candidates(&campaign, model.base, model.force_axes(), &present, &own);
    let bar = progress::rows("diagnosing");
    let said = |what: &str| bar.set_message(what.to_owned());
    let selection = select(&campaign, &prepared, &present, &judged, options, &said)?;
    bar.finish_and_clear();
    let mut diagnosis = assemble(&selection, &unjudged, campaign.recordings.len());
    diagnosis.findings = findings;
    diagnosis.model = args.model.display().to_string();
    diagnosis.campaign = args.campaign.display().to_string();
    diagnosis.seed = args.seed;
    Ok(diagnosis)
}
