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
use analysis::compare::pipeline::compare_scanned;
use analysis::diagnose::observer::Observer;
use analysis::diagnose::{Diagnosis, diagnose};
use analysis::edit_model::{find_effects, refit};
use analysis::fit::fit_campaign;
use analysis::replay::evaluation::{ReplayEvaluation, evaluate, pooled_error};
use analysis::statistics::pooled_rms;
use report::text;
use report::text::diagnosis::format_summary;
use report::text::terminal;

/// The complete workflow on one campaign: fit, invert, evaluate, diagnose, add the missing effects.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie demo
  cargo magpie demo tests/data/friction -o friction-demo")]
pub struct Args {
    /// Folder of recordings [default: a small campaign of the project].
    campaign: Option<PathBuf>,
    /// Folder for models, tables and report.
    #[arg(short, long, value_name = "FOLDER", default_value = "magpie-demo")]
    output: PathBuf,
}

/// The default campaign, in the source tree of this build.
pub(super) const CAMPAIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/demo");

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
    let tables_path = args.output.join("tables.rs");

    if campaign.recordings.len() < 3 {
        bail!(
            "{} has {} recordings: the demo needs three, one of them held out",
            folder.display(),
            campaign.recordings.len()
        );
    }
    let held_out = campaign.recordings.pop().context("no recording")?;
    terminal::print(&format!(
        "1. The recordings. {} recordings of a gripper on a (simulated) bench, {:.0} s each: {} Hall sensors at\n\
         1 kHz and a force reference at 100 Hz. Recording {} is held out.\n\n",
        campaign.recordings.len() + 1,
        campaign.duration_s() / campaign.recordings.len() as f64,
        campaign.sensors().len(),
        held_out.name,
    ))?;

    let options = FitOptions::default();
    let (fits, _) = fit_campaign(&campaign, BaseKind::Cylinder, None, options)?;
    let provenance = Provenance::of(&campaign, ALIGNMENT.delay_us, options)?;
    let model = ModelFile::of(&campaign, &fits, provenance);
    model.write(&model_path)?;
    terminal::print(&format!(
        "2. The fit. Magnet, gap, flexures and misalignment of each sensor.\n\n{}\n{}{}\n{}\n",
        text::fit::parameters(&model),
        text::fit::error_table(&campaign, &model),
        text::fit::verdict(&model),
        gap_axis_note(&model),
    ))?;

    let building = progress::progress_bar("building tables", 1);
    let built = build(&model_path, ModelVariant::Fitted)?;
    building.finish_and_clear();
    write_output(&tables_path, tables_source(&built).as_bytes(), MARK)?;
    terminal::print(&format!(
        "3. The inverse. From three field axes to two forces in fixed point, as in the {} Hz task.\n\n{}\n",
        constants::SENSE_RATE.value,
        text::export::format_tables(&built.chosen, &built.header),
    ))?;

    let outcome = evaluate(&model_path, &held_out.folder, None, ALIGNMENT)?;
    print_notes(&outcome.notes);
    terminal::print(&format!(
        "4. The evaluation. The held-out recording {}, row by row through the device code.\n\n{}\n{}\n",
        held_out.name,
        text::replay::force_table(&outcome),
        text::replay::model_table(&outcome),
    ))?;
    let findings = scan_with_progress(folder)?;
    let scanned = ScannedCampaign::of(reader, findings);
    let fitted = Fitted {
        folder,
        campaign: &campaign,
        held_out: &held_out.folder,
        model: &model,
        model_path: &model_path,
        before: &outcome,
        output: &args.output,
        options,
    };
    improve(&fitted, scanned)?;
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
             motion). The forces depend mainly on the plane, so their error is smaller: see step 4.\n"
        );
    }
    String::new()
}

fn closing(output: &Path) -> String {
    let tables = output.join("tables.rs");
    format!(
        "Output in {}: models, tables.rs for the firmware, report.html for a browser.\n\
         Image with the tables:      MAGPIE_TABLES={} cargo image\n\
         Your own recordings:        cargo magpie fit YOUR-CAMPAIGN -o model.toml\n\
         Missing effects:            cargo magpie diagnose model.toml YOUR-CAMPAIGN -o report.html\n",
        output.display(),
        tables.display(),
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

/// Added effects and force error of the held-out recording, step by step.
type ErrorSteps = Vec<(String, ForceError)>;

/// Compares, diagnoses and adds the missing effects.
fn improve(fitted: &Fitted, scanned: ScannedCampaign) -> Result<()> {
    let comparison =
        compare_scanned(fitted.model_path, fitted.model, None, scanned, None, fitted.options)?;
    print_notes(&comparison.notes);
    terminal::print(&format!(
        "5. The residual. Model and measurement over all recordings.\n\n{}\n",
        terminal::paragraph(&text::comparison::verdict(&comparison))
    ))?;
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
    terminal::print(&format!(
        "{}\n{}",
        terminal::paragraph(
            "6. The missing effects. Each effect of the catalogue is tested on the fitted recordings by \
             cross-validation."
        ),
        format_summary(&diagnosis)
    ))?;
    let steps = add_effects(fitted, &diagnosis)?;
    terminal::print(&format!("7. The error by effect.\n\n{}\n", error_table(fitted, &steps)))?;
    let path = fitted.output.join("report.html");
    report::html::write(&path, &comparison, &report::html::diagnosis::sections(&diagnosis))?;
    terminal::print(&format!("8. Plots: {}\n\n", path.display()))?;
    Ok(())
}

/// Adds the accepted effects one by one and replays the held-out recording with each model.
fn add_effects(fitted: &Fitted, diagnosis: &Diagnosis) -> Result<ErrorSteps> {
    let mut steps = vec![("base model".to_owned(), pooled_error(&fitted.before.fitted))];
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
        steps.push((format!("+ {}", step.join(" or ")), pooled_error(&after.fitted)));
    }
    Ok(steps)
}

fn error_table(fitted: &Fitted, steps: &ErrorSteps) -> String {
    if steps.len() < 2 {
        return terminal::paragraph(
            "No effect of the catalogue is missing. (User-defined formulas are tested with `magpie diagnose --expr`.)",
        );
    }
    let mut table = terminal::table(["with", "excess / N", "force / N", "noise / N"]);
    for (with, error) in steps {
        let newtons = [error.excess_n(), error.rms_n, error.noise_n].map(|n| format!("{n:.3}"));
        table.add_row(std::iter::once(with.clone()).chain(newtons));
    }
    terminal::right_align(&mut table, 1);
    let tie = if steps.iter().any(|(with, _)| with.contains(" or ")) {
        "Effects joined by \"or\" are equivalent on these data; the first was added.\n"
    } else {
        ""
    };
    let heading = terminal::paragraph(
        "Force error of the held-out recording (device's code, RMS over all forces), its noise, and the excess over the noise:",
    );
    format!(
        "{heading}\n{table}\n{tie}Models: better-1.toml and so on, in {}.\n",
        fitted.output.display()
    )
}
