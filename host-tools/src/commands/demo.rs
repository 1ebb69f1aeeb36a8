//! `magpie demo`: from recordings to forces computed by the device code, and to the missing effect.

use analysis::progress;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use firmware::config::constants;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::inverse::build::{ModelVariant, build};
use model_export::inverse::codegen::{MARK, tables_source};
use model_export::model_file::{BaseKind, ModelFile, Provenance};
use model_export::output::write_output;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;

use crate::commands::print_notes;
use analysis::compare::ForceError;
use analysis::compare::campaign_reader::{
    Caching, CampaignReader, ScannedCampaign, scan_with_progress,
};
use analysis::compare::pipeline::{compare_scanned, setup_errors_of};
use analysis::diagnose::observer::Observer;
use analysis::diagnose::{Diagnosis, diagnose};
use analysis::edit_model::{find_effects, refit};
use analysis::fit::fit_campaign;
use analysis::replay::evaluation::{ReplayEvaluation, evaluate, pooled_error};
use analysis::statistics::pooled_rms;
use report::text;
use report::text::diagnosis::format_summary;
use report::text::terminal;

/// The complete workflow on one campaign: fit, compare, diagnose, add the missing effects.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie demo
  cargo magpie demo tests/data/friction -o friction-demo --verbose")]
pub struct Args {
    /// Folder of recordings [default: a small campaign of the project].
    campaign: Option<PathBuf>,
    /// Folder for models, tables and report.
    #[arg(short, long, value_name = "FOLDER", default_value = "magpie-demo")]
    output: PathBuf,
    /// Print what each step computes: parameters, tables of errors, evidence.
    #[arg(short, long)]
    verbose: bool,
}

/// The default campaign, in the source tree of this build.
const CAMPAIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/ripple");

/// The demo assumes synchronised clocks.
const ALIGNMENT: Alignment = Alignment { delay_us: 0.0 };

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let folder = args.campaign.as_deref().unwrap_or(Path::new(CAMPAIGN));
    let reader = CampaignReader::open(folder, ALIGNMENT, Caching::Always)?;
    let mut campaign = reader.whole()?.into_owned();
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("{} cannot be made", args.output.display()))?;
    let model_path = args.output.join("model.toml");

    if campaign.recordings.len() < 3 {
        bail!(
            "{} has {} recordings: the demo needs three, one of them held out",
            folder.display(),
            campaign.recordings.len()
        );
    }
    let held_out = campaign.recordings.pop().context("no recording")?;
    let fitted_count = campaign.recordings.len();
    terminal::print(&terminal::paragraph(&format!(
        "Recorded: {} recordings of {:.0} s of a gripper on a (simulated) bench, {} Hall sensors at 1 kHz, force \
         reference at 100 Hz. Recording {} is held out: no fit uses it. What the base model misses is not known to the tool.",
        fitted_count + 1,
        campaign.duration_s() / fitted_count as f64,
        campaign.sensors().len(),
        held_out.name,
    )))?;

    let options = FitOptions::default();
    let (fits, _) = fit_campaign(&campaign, BaseKind::Cylinder, None, options)?;
    let provenance = Provenance::of(&campaign, ALIGNMENT.delay_us, options)?;
    let model = ModelFile::of(&campaign, &fits, provenance);
    model.write(&model_path)?;
    let before = evaluate(&model_path, &held_out.folder, None, ALIGNMENT)?;
    print_notes(&before.notes);
    terminal::print(&terminal::paragraph(&format!(
        "1. Fit. Magnet, gap, flexures and misalignment of each sensor; the inverse in fixed point, as in the {} Hz task. {}",
        constants::SENSE_RATE.value,
        text::force_error::headline(&pooled_error(&before.fitted)),
    )))?;
    if args.verbose {
        let built = build(&model_path, ModelVariant::Fitted)?;
        terminal::print(&format!(
            "\n{}\n{}{}\n{}\n{}\n{}\n{}\n",
            text::fit::parameters(&model),
            text::fit::error_table(&campaign, &model),
            text::fit::verdict(&model),
            gap_axis_note(&model),
            text::export::format_tables(&built.chosen, &built.header),
            text::replay::force_table(&before),
            text::replay::model_table(&before),
        ))?;
    }
    let findings = scan_with_progress(folder)?;
    let scanned = ScannedCampaign::of(reader, findings);
    let fitted = Fitted {
        folder,
        campaign: &campaign,
        held_out: &held_out.folder,
        model: &model,
        model_path: &model_path,
        before: &before,
        output: &args.output,
        options,
    };
    improve(&fitted, scanned, args.verbose)?;
    terminal::print(&closing(&args.output))?;
    Ok(())
}

/// Explains a residual that is mainly along the gap.
fn gap_axis_note(model: &ModelFile) -> String {
    let axes = || model.sensors.iter().flat_map(|sensor| &sensor.held_out);
    let rms =
        |letter: &str| pooled_rms(axes().filter(|axis| axis.axis == letter).map(|axis| axis.rms_g));
    let (across, along) = (rms("x").hypot(rms("z")), rms("y"));
    if along > 2.0 * across {
        return format!(
            "An effect that is not in the model changes the field along the gap ({along:.1} G, {across:.1} G in the plane of\n\
             motion). The forces depend mainly on the plane, so their error is smaller.\n"
        );
    }
    String::new()
}

fn closing(output: &Path) -> String {
    format!(
        "\nOpen {0}/report.html: forces of the held-out recording over time, what was found, and the error\n\
         step by step, there cross-validated over the recordings of the fit.\n\
         All numbers of each step:   cargo magpie demo --verbose\n\
         Image with the tables:      MAGPIE_TABLES={0}/tables.rs cargo image\n\
         Your own recordings:        cargo magpie fit YOUR-CAMPAIGN -o model.toml\n\
         Missing effects:            cargo magpie diagnose model.toml YOUR-CAMPAIGN -o report.html\n",
        output.display(),
    )
}

/// Intermediate results of the demo.
struct Fitted<'a> {
    folder: &'a Path,
    /// Without the held-out recording.
    campaign: &'a Campaign,
    held_out: &'a Path,
    model: &'a ModelFile,
    model_path: &'a Path,
    /// Replay of the held-out recording.
    before: &'a ReplayEvaluation,
    output: &'a Path,
    options: FitOptions,
}

/// Models of the held-out recording, step by step: added effects, force error, file.
type ErrorSteps = Vec<(String, ForceError, PathBuf)>;

/// Diagnoses, adds the missing effects, and compares the last model with the first.
fn improve(fitted: &Fitted, scanned: ScannedCampaign, is_verbose: bool) -> Result<()> {
    let bar = progress::Stages::new();
    let observer = Observer::new(|stage, share| bar.set(stage, share), |_| (), || false);
    let (mut diagnosis, _) = diagnose(
        (fitted.campaign, ALIGNMENT),
        fitted.model,
        fitted.model_path,
        &[],
        false,
        fitted.options,
        &observer,
    )?;
    drop(observer);
    bar.finish();
    diagnosis.campaign = fitted.folder.display().to_string();
    let steps = add_effects(fitted, &diagnosis)?;
    let Some((_, _, last)) = steps.last() else {
        bail!("no model");
    };
    let baseline = (steps.len() > 1).then_some(fitted.model_path);
    let model = ModelFile::read(last)?;
    let findings = setup_errors_of(&scanned, &model, last)?;
    let comparison =
        compare_scanned((last, &model), baseline, (scanned, findings), None, fitted.options)?;
    print_notes(&comparison.notes);
    let base = comparison.other.as_deref().unwrap_or(&comparison);
    let verdict = text::comparison::verdict(base);
    terminal::print(&terminal::paragraph(&format!("2. Compare. {verdict}")))?;
    terminal::print(&found(&diagnosis))?;
    if is_verbose {
        terminal::print(&format!("\n{}", format_summary(&diagnosis)))?;
    }
    terminal::print(&error_table(&steps, &diagnosis))?;
    let built = build(last, ModelVariant::Fitted)?;
    write_output(&fitted.output.join("tables.rs"), tables_source(&built).as_bytes(), MARK)?;
    let page = fitted.output.join("report.html");
    report::html::write(&page, &comparison, &report::html::diagnosis::effects_first(&diagnosis))?;
    Ok(())
}

/// What is missing, with the formulas in full.
fn found(diagnosis: &Diagnosis) -> String {
    let verdict = text::diagnosis::verdict(diagnosis);
    let models = diagnosis.formulas.iter().flat_map(|formula| &formula.models);
    let formulas: Vec<String> = models
        .filter_map(|model| model.expression.as_ref())
        .map(|text| format!("   {text}\n"))
        .collect();
    if formulas.is_empty() {
        return terminal::paragraph(&format!("3. Diagnose. {verdict}"));
    }
    let heading = format!(
        "3. Diagnose. {verdict} No effect of the catalogue has this form; it is a formula, not a cause:"
    );
    terminal::paragraph(&heading) + &formulas.concat()
}

/// Adds the accepted effects one by one and replays the held-out recording with each model.
fn add_effects(fitted: &Fitted, diagnosis: &Diagnosis) -> Result<ErrorSteps> {
    let first = pooled_error(&fitted.before.fitted);
    let mut steps = vec![("base model".to_owned(), first, fitted.model_path.to_path_buf())];
    let mut added: Vec<EffectTerm> = Vec::new();
    for (i, step) in diagnosis.accepted.iter().enumerate() {
        // The first of several equivalent effects; a user would choose, or record data that separate them.
        let first = step.first().context("an empty step")?;
        let formulas = diagnosis.formulas.iter().flat_map(|formula| &formula.effects);
        match formulas.into_iter().find(|formula| formula.name() == first) {
            Some(formula) => added.push(formula.clone()),
            None => added.extend(find_effects(std::slice::from_ref(first), &[])?),
        }
        let edit = refit(
            fitted.campaign.clone(),
            fitted.model,
            Vec::new(),
            added.clone(),
            ALIGNMENT,
            fitted.options,
        )?;
        print_notes(&edit.notes);
        let path = fitted.output.join(format!("better-{}.toml", i + 1));
        edit.model.write(&path)?;
        let after = evaluate(&path, fitted.held_out, None, ALIGNMENT)?;
        print_notes(&after.notes);
        steps.push((format!("+ {}", step.join(" or ")), pooled_error(&after.fitted), path));
    }
    Ok(steps)
}

fn error_table(steps: &ErrorSteps, diagnosis: &Diagnosis) -> String {
    if steps.len() < 2 {
        return terminal::paragraph(
            "4. Add. No effect of the catalogue is missing. (User-defined formulas are tested with `cargo magpie diagnose --expr`.)",
        );
    }
    let mut table = terminal::table(["with", "excess / N", "force / N", "noise / N", "model"]);
    for (with, error, path) in steps {
        let newtons = [error.excess_n(), error.rms_n, error.noise_n].map(|n| format!("{n:.3}"));
        let file = path.display().to_string();
        table.add_row(std::iter::once(with.clone()).chain(newtons).chain([file]));
    }
    terminal::right_align(&mut table, 1);
    let mut notes = Vec::new();
    if steps.iter().any(|(with, ..)| with.contains(" or ")) {
        notes.push(
            "Effects joined by \"or\" are equivalent on these data; the first was added."
                .to_owned(),
        );
    }
    notes.extend(text::diagnosis::rising_force(&diagnosis.staircase));
    let note = if notes.is_empty() { String::new() } else { terminal::paragraph(&notes.join(" ")) };
    let heading = terminal::paragraph(
        "4. Add. Force error of the held-out recording (device's code, RMS over all forces), its noise, and the excess over it, which a better model could remove:",
    );
    format!("{heading}{table}\n{note}")
}
