//! `magpie demo`: from recordings to forces computed by the device code, and to the missing effect.

use std::path::{Path, PathBuf};

use analysis::compare::ForceError;
use analysis::comparison::compare;
use analysis::diagnose::observer::Observer;
use analysis::diagnose::{Diagnosis, Scope, diagnose};
use analysis::edit_model::{edited_output, refit};
use analysis::fit::fit_model;
use analysis::model::Model;
use analysis::parameters::ParameterTable;
use analysis::progress;
use analysis::statistics::pooled_rms;
use anyhow::{Context, Result, bail};
use firmware::config::constants;
use model_export::design::SensorDesign;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::inverse::build::{ModelVariant, build};
use model_export::inverse::codegen::tables_source;
use model_export::model_file::{self, BaseKind, EffectModel, ModelFile, TABLES_MARK};
use model_export::output::Output;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprints, recording_folders};
use model_export::recordings::units::round_significant;
use report::text;
use report::text::diagnosis::format_summary;
use report::text::terminal;
use sim::campaign;
use sim::campaign::settings::CampaignSettings;
use sim::effects::Effect;

use crate::commands::args::ForceArg;
use crate::commands::output::print_notes;

/// The complete workflow on one campaign: fit, compare, diagnose, add the missing effects.
///
/// Without a campaign it simulates one of a gripper with two effects that are missing from the model: one of the catalogue,
/// and one that no catalogue contains.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie demo
  cargo magpie demo tests/data/friction -o friction-demo --verbose")]
pub struct Args {
    /// Folder of recordings [default: a simulated campaign, in the output folder].
    campaign: Option<PathBuf>,
    /// Folder for models, tables and report.
    #[arg(short, long, value_name = "FOLDER", default_value = "magpie-demo")]
    output: PathBuf,
    #[command(flatten)]
    force: ForceArg,
    /// Print what each step computes: parameters, tables of errors, evidence.
    #[arg(short, long)]
    verbose: bool,
}

/// The default campaign: folder in the output, effects with magnitudes in their units, random seed, sensors, and seconds of each
/// recording.
const CAMPAIGN: &str = "campaign";
const HIDDEN: [&str; 2] = ["neighbour_magnet=6", "guide_ripple"];
const SEED: u64 = 5;
const SENSORS: u32 = 2;
const SECONDS: f64 = 15.0;

/// The demo assumes synchronised clocks.
const ALIGNMENT: Alignment = Alignment { delay_us: 0.0 };

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let simulated = args.output.join(CAMPAIGN);
    let folder = args.campaign.as_deref().unwrap_or(&simulated);
    if args.campaign.is_none() {
        simulate(folder)?;
    }
    if recording_folders(folder)?.len() < 2 {
        bail!("{}: the demo needs two recordings, one to predict from the other", folder.display());
    }
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("{} cannot be made", args.output.display()))?;
    let model_path = args.output.join("model.toml");
    let (inputs, overwrite) = (fingerprints(folder)?, args.force.overwrite());
    let page_path = args.output.join("report.html");
    let page = Output::check(&page_path, report::html::MARK, inputs.clone(), overwrite)?;
    let model_file = Output::check(&model_path, model_file::SIGNATURE, inputs, overwrite)?;
    let options = FitOptions::default();
    let base = fit_model(folder, BaseKind::Cylinder, None, ALIGNMENT, options)?;
    print_notes(&base.notes);
    base.model.write_output(&model_file)?;
    let base_model = Model::read(&model_path)?;
    let (campaign, model) = (&base.campaign, &base.model);
    let count = campaign.recordings.len();
    terminal::print(&terminal::paragraph(&format!(
        "Recorded: {count} recordings of {:.0} s of a gripper on a (simulated) bench, {} Hall sensors at 1 kHz, force reference at \
         100 Hz. What the base model misses is not known to the tool.",
        campaign.duration_s() / count as f64,
        campaign.sensors().len(),
    )))?;
    let force = base.force.as_ref().map_or_else(String::new, text::force_error::headline);
    terminal::print(&terminal::paragraph(&format!(
        "1. Fit. Magnet, gap, flexures and misalignment of each sensor; the inverse in fixed point, as in the {} Hz task. Each \
         recording is predicted by a fit to the others. {force}",
        constants::SENSE_RATE.value,
    )))?;
    if args.verbose {
        let built = build(&model_path, ModelVariant::Fitted)?;
        terminal::print(&format!(
            "\n{}\n{}{}\n{}\n{}\n",
            text::parameters::format_report(&ParameterTable::of(model)),
            text::fit::error_table(campaign, model),
            text::fit::verdict(model, campaign.signal_unit()),
            gap_axis_note(model),
            text::export::format_tables(&built.chosen, &built.header),
        ))?;
    }
    let diagnosis = diagnosed(campaign, &base_model, options)?;
    let models = add_effects(args, campaign, &base_model, &diagnosis, options)?;
    let last = models.last().map_or(&model_path, |(_, path)| path);
    let comparison = match models.last() {
        Some((_, path)) => {
            compare(&Model::read(path)?, folder, Some(&base_model), ALIGNMENT, options)?
        }
        None => compare(&base_model, folder, None, ALIGNMENT, options)?,
    };
    print_notes(&comparison.notes);
    let of_base = comparison.other.as_deref().unwrap_or(&comparison);
    let verdict = text::comparison::conclusion::verdict(of_base);
    terminal::print(&terminal::paragraph(&format!("2. Compare. {verdict}")))?;
    if args.verbose {
        terminal::print(&format!("\n{}", text::comparison::format_report(of_base)))?;
    }
    terminal::print(&found(&diagnosis))?;
    if args.verbose {
        terminal::print(&format!("\n{}", format_summary(&diagnosis)))?;
    }
    let held_out = text::comparison::conclusion::validation(&comparison);
    terminal::print(&error_table(&diagnosis, &model_path, &models, &held_out))?;
    let built = build(last, ModelVariant::Fitted)?;
    let tables_path = args.output.join("tables.rs");
    Output::check(&tables_path, TABLES_MARK, built.model.inputs(), overwrite)?
        .write(tables_source(&built).as_bytes())?;
    report::html::write(&page, &comparison, &report::html::diagnosis::effects_first(&diagnosis))?;
    terminal::print(&closing(&args.output))?;
    Ok(())
}

/// Simulates the default campaign, unless an earlier demo did.
fn simulate(folder: &Path) -> Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    let effects = HIDDEN.iter().map(|effect| effect.parse()).collect::<Result<Vec<Effect>>>()?;
    let settings = CampaignSettings {
        seed: SEED,
        seconds: SECONDS,
        sensors: SENSORS,
        effects,
        hidden: true,
        ..CampaignSettings::of_design(&SensorDesign::magpie())
    };
    let bar = progress::progress_bar("simulating recordings", settings.numbers().count());
    campaign::write(&settings, folder, None, || bar.inc(1))?;
    bar.finish_and_clear();
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
        "\nOpen {0}/report.html: forces over time, what was found, and the error step by step.\n\
         All numbers of each step:   cargo magpie demo --verbose\n\
         Image with the tables:      MAGPIE_TABLES={0}/tables.rs cargo image\n\
         Your own recordings:        cargo magpie fit YOUR-CAMPAIGN -o model.toml\n\
         Missing effects:            cargo magpie diagnose model.toml YOUR-CAMPAIGN -o report.html\n",
        output.display(),
    )
}

/// Diagnoses the base model.
fn diagnosed(campaign: &Campaign, base: &Model, options: FitOptions) -> Result<Diagnosis> {
    let bar = progress::Stages::new();
    let observer = Observer::new(|stage, share| bar.set(stage, share), |_| (), || false);
    let campaign = (campaign, ALIGNMENT);
    let (diagnosis, _) = diagnose(campaign, base, &[], Scope::CATALOGUE, options, &observer)?;
    drop(observer);
    bar.finish();
    Ok(diagnosis)
}

/// What is missing, with the formulas in full.
fn found(diagnosis: &Diagnosis) -> String {
    let verdict = text::diagnosis::conclusion::verdict(diagnosis);
    let models = diagnosis.formulas.iter().flat_map(|formula| &formula.models);
    let formulas: Vec<String> = models
        .filter_map(|model| Some((model.expression.as_ref()?, nonlinear_values(model))))
        .map(|(text, values)| format!("   {text}{values}\n"))
        .collect();
    if formulas.is_empty() {
        return terminal::paragraph(&format!("3. Diagnose. {verdict}"));
    }
    let heading = format!(
        "3. Diagnose. {verdict} No effect of the catalogue explains as much as the formula with as few coefficients; it is not a cause:"
    );
    let covariates = diagnosis.formulas.iter().flat_map(|formula| &formula.covariates);
    let causes = terminal::paragraph(&text::causes::causes_sentence(covariates));
    terminal::paragraph(&heading) + &formulas.concat() + &causes
}

/// The nonlinear parameters of a formula, from the least to the largest of the sensors: ", p = 2.609 mm".
fn nonlinear_values(formula: &EffectModel) -> String {
    let of_name = |name: &String| {
        let values = formula.sensors.iter().filter_map(|sensor| sensor.parameters.get(name));
        let mut shown: Vec<f64> =
            values.clone().map(|fitted| round_significant(fitted.value, 4)).collect();
        shown.sort_by(f64::total_cmp);
        shown.dedup();
        let unit = values.map(|fitted| fitted.unit.as_str()).next().unwrap_or_default();
        let span = match shown.as_slice() {
            [] => return String::new(),
            [one] => one.to_string(),
            [least, .., largest] => format!("{least} to {largest}"),
        };
        format!(", {name} = {span} {unit}").trim_end().to_owned()
    };
    formula.ranges.iter().map(|range| of_name(&range.name)).collect()
}

/// Adds the accepted effects one by one; returns what was added and the file of each model.
fn add_effects(
    args: &Args,
    campaign: &Campaign,
    base: &Model,
    diagnosis: &Diagnosis,
    options: FitOptions,
) -> Result<Vec<(String, PathBuf)>> {
    let mut models = Vec::new();
    let mut added: Vec<EffectTerm> = Vec::new();
    for (i, (name, terms)) in diagnosis.accepted_steps()?.into_iter().enumerate() {
        added.extend(terms);
        let path = args.output.join(format!("better-{}.toml", i + 1));
        let output = edited_output(&path, base, &added, campaign, args.force.overwrite())?;
        let edit = refit(campaign.clone(), base, added.clone(), ALIGNMENT, options)?;
        print_notes(&edit.notes);
        edit.model.write_output(&output)?;
        models.push((name, path));
    }
    Ok(models)
}

/// The force error after each step of the diagnosis, with the file of its model.
fn error_table(
    diagnosis: &Diagnosis,
    base: &Path,
    models: &[(String, PathBuf)],
    held_out: &str,
) -> String {
    if models.is_empty() {
        return terminal::paragraph(
            "4. Add. No effect of the catalogue is missing. (User-defined formulas are tested with `cargo magpie diagnose --expr`.)",
        );
    }
    let mut table = terminal::table(["with", "excess / N", "force / N", "noise / N", "model"]);
    let names = models.iter().map(|(added, path)| (format!("+ {added}"), path.as_path()));
    let steps = std::iter::once(("base model".to_owned(), base)).chain(names);
    for (step, (with, path)) in diagnosis.staircase.iter().zip(steps) {
        let newtons = |of: fn(&ForceError) -> f64| {
            step.force.as_ref().map_or_else(|| "-".to_owned(), |force| format!("{:.3}", of(force)))
        };
        let numbers = [newtons(ForceError::excess_n), newtons(|f| f.rms_n), newtons(|f| f.noise_n)];
        let row = std::iter::once(with).chain(numbers).chain([path.display().to_string()]);
        table.add_row(row);
    }
    terminal::right_align(&mut table, 1);
    let mut notes = Vec::new();
    if models.iter().any(|(with, _)| with.contains(" or ")) {
        notes.push(
            "Effects joined by \"or\" are equivalent on these data; the first was added."
                .to_owned(),
        );
    }
    notes.extend(text::diagnosis::steps::rising_force(&diagnosis.staircase));
    let note = if notes.is_empty() { String::new() } else { terminal::paragraph(&notes.join(" ")) };
    let heading = terminal::paragraph(&format!(
        "4. Add. {} {} Held-out rows: {held_out}.",
        text::diagnosis::steps::force_headline(diagnosis),
        text::force_error::TERMS
    ));
    format!("{heading}{table}\n{note}")
}
