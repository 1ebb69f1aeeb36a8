//! `magpie diagnose`: which physical effect is missing from a model.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use analysis::model::Model;
use analysis::progress;
use anyhow::Result;
use model_export::output::{Output, Overwrite};
use model_export::recordings::campaign::fingerprints;

use crate::commands::args::{CompareArgs, ExprArgs};
use crate::commands::interrupt::{INTERRUPTED, first_interrupt};
use crate::commands::output::print_notes;
use analysis::compare::campaign_reader::Caching;
use analysis::compare::checked_campaign::CheckedCampaign;
use analysis::compare::pipeline::compare_checked;
use analysis::diagnose::observer::{FirstCandidate, Observer};
use analysis::diagnose::recording_plan::RecordingProposal;
use analysis::diagnose::{Scope, diagnose_checked};
use report::text::diagnosis::{format_report, to_json};
use report::text::terminal;
use sim::campaign::plan::RecordingPlan;

/// Identify the physical effects that are missing from a model, with the evidence.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie diagnose model.toml tests/data/friction -o report.html
  cargo magpie diagnose model.toml my-campaign --range p=2..5 \\
    --expr 'ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)'
  # the recording that decides what is open
  cargo magpie diagnose model.toml tests/data/demo --plan plan.toml
  cargo magpie diagnose model.toml tests/data/demo --json | jq '.accepted'")]
pub struct Args {
    #[command(flatten)]
    common: CompareArgs,
    #[command(flatten)]
    exprs: ExprArgs,
    /// Write a plan of the shortest recording that decides what is open (for record --plan and simulate --plan).
    #[arg(long, value_name = "PLAN")]
    plan: Option<PathBuf>,
}

/// What the screening says, before anything was fitted.
fn first_answer(first: &[FirstCandidate]) -> String {
    const SHOWN: usize = 3;
    if first.is_empty() {
        return "First answer: no effect of the catalogue is significant by itself. Refining."
            .to_owned();
    }
    let shown = first.iter().take(SHOWN);
    let names: Vec<String> =
        shown.map(|one| format!("{} ({:.0} %)", one.effect, 100.0 * one.gain)).collect();
    format!(
        "First answer, provisional: the linearised model improves most with {} of its squared error. Refining.",
        names.join(", ")
    )
}

/// First line of a plan.
const PLAN_MARK: &str = "# Plan of a recording, by magpie diagnose.";

/// Writes the proposed plan, if it has steps, and names the commands that carry it out.
fn write_plan(args: &Args, output: &Output, proposal: &RecordingProposal) -> Result<()> {
    if proposal.plan.steps.is_empty() {
        let path = output.path().display();
        return args.common.print_line(&format!("{path} was not written: no plan."));
    }
    args.common.print_line(&write_plan_file(output, &proposal.plan, &args.common.input.campaign)?)
}

/// The file of a plan that recordings of `campaign` lead to.
///
/// # Errors
/// The path holds another file.
pub fn plan_output(path: &Path, campaign: &Path, overwrite: Overwrite) -> Result<Output> {
    Ok(Output::check(path, PLAN_MARK, fingerprints(campaign)?, overwrite)?)
}

/// Writes a plan; returns the commands that record it into `campaign`.
///
/// # Errors
/// The file cannot be written.
pub fn write_plan_file(output: &Output, plan: &RecordingPlan, campaign: &Path) -> Result<String> {
    let text = format!("{PLAN_MARK}\n{}", plan.to_toml()?);
    output.write(text.as_bytes())?;
    let (path, campaign) = (output.path().display(), campaign.display());
    let mut text =
        format!("Plan: {path}. Record it into the same campaign, then fit and diagnose again:");
    for number in 1..=plan.recordings {
        let which = if number == 1 { String::new() } else { format!(" --plan-recording {number}") };
        text += &format!(
            "\n  cargo magpie record --port PATH --plan {path}{which} -o {campaign}/planned-{number}"
        );
    }
    Ok(text)
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let common = &args.common;
    let page = common.page()?;
    let overwrite = common.force.overwrite();
    let plan = |path| plan_output(path, &common.input.campaign, overwrite);
    let plan = args.plan.as_deref().map(plan).transpose()?;
    let input = &common.input;
    let model = Model::read(&input.model)?;
    let (alignment, options) = (input.fit.align.of_model(&model.file)?, input.fit.options());
    let mut checked = CheckedCampaign::open(&input.campaign, &model, alignment, Caching::Always)?;
    let own = match checked.campaign()? {
        Some(campaign) => args.exprs.parse(&campaign)?,
        None => Vec::new(),
    };
    print_notes(&checked.notes(&model)?);
    let bar = progress::Stages::new();
    let stop = first_interrupt()?;
    let observer = Observer::new(
        |stage, share| bar.set(stage, share),
        |first| bar.line(&first_answer(first)),
        || stop.load(Ordering::Relaxed),
    );
    let scope =
        Scope { catalogue: true, plans: args.plan.is_some(), traces: common.output.is_some() };
    let (diagnosis, refit) = diagnose_checked(&checked, &model, &own, scope, options, &observer)?;
    drop(observer);
    bar.finish();
    terminal::print_result(input.fit.json, || to_json(&diagnosis), || format_report(&diagnosis))?;
    if let Some((plan, proposal)) = plan.zip(diagnosis.proposal.as_ref()) {
        write_plan(args, &plan, proposal)?;
    }
    if page.is_some() {
        checked.findings.clone_from(&diagnosis.findings);
        let comparison = compare_checked(&model, None, &checked, refit, options)?;
        print_notes(&comparison.notes);
        common.write_report(
            page.as_ref(),
            &comparison,
            &report::html::diagnosis::sections(&diagnosis),
        )?;
    }
    if diagnosis.is_interrupted {
        std::process::exit(INTERRUPTED);
    }
    Ok(())
}
