//! Import, fit, comparison, diagnosis, edit, replay, training, export and simulation, as the commands of the same names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

use analysis::compare::campaign_reader::{Caching, read_campaign};
use analysis::compare::checked_campaign::CheckedCampaign;
use analysis::comparison;
use analysis::diagnose::observer::Observer;
use analysis::diagnose::{Scope, diagnose_checked};
use analysis::edit_model::{edited_effects, edited_output, find_effects, parse_formulas, refit};
use analysis::fit::fit_model;
use analysis::import::import_campaign;
use analysis::model::Model;
use analysis::network_training::dataset::TrainingData;
use analysis::network_training::{
    DEFAULT_PATIENCE, DEFAULT_RATE, TrainingResult, check_settings, default_epochs, default_hidden,
};
use analysis::notes::check_compensated;
use analysis::replay::bags::write_bags;
use analysis::replay::evaluation;
use anyhow::{Context, Result, anyhow, bail};
use device_run::networks::{NetworkSet, tables_source};
use model_export::design::SensorDesign;
use model_export::effects::expression::ParameterRange;
use model_export::effects::{CATALOGUE, EffectTerm};
use model_export::fit::FitOptions;
use model_export::gru::network::Target;
use model_export::gru::tensors::TensorFileKind;
use model_export::gru::train::checkpoint;
use model_export::gru::train::dataset::Topology;
use model_export::gru::train::trainer::{Trainer, TrainingSettings};
use model_export::inverse::build::{ModelVariant, build};
use model_export::model_file::{BaseKind, SIGNATURE, TABLES_MARK};
use model_export::output::{Output, Overwrite, write_same};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::fingerprints;
use model_export::recordings::guess;
use pyo3::prelude::*;
use pyo3::types::PyString;
use report::text;
use serde_json::{Value, json};
use sim::campaign::plan::RecordingPlan;
use sim::campaign::settings::CampaignSettings;
use sim::effects::{MAX_STRENGTH, draw_random_effects};
use sim::mountings::{MountedSensor, Mountings};

use crate::interrupt::{self, Progress};
use crate::{to_text, with_notes};

/// A formula's nonlinear parameter with the ends of its range.
type Range = (String, f64, f64);

fn options(seed: u64) -> FitOptions {
    FitOptions { seed, ..FitOptions::default() }
}

fn alignment(delay_ms: f64) -> Alignment {
    Alignment { delay_us: 1e3 * delay_ms }
}

fn formulas(texts: &[String], ranges: &[Range], campaign: &Campaign) -> Result<Vec<EffectTerm>> {
    let first = campaign.recordings.first().context("the campaign is empty")?;
    let columns: Vec<String> = first.covariates.keys().cloned().collect();
    let range =
        |(name, from, to): &Range| ParameterRange { name: name.clone(), from: *from, to: *to };
    let ranges: Vec<ParameterRange> = ranges.iter().map(range).collect();
    parse_formulas(texts, &ranges, &columns)
}

/// Fits the base to a campaign and writes the model.
#[pyfunction]
fn fit(
    py: Python<'_>,
    campaign: PathBuf,
    output: PathBuf,
    base: &str,
    degree: Option<u8>,
    delay_ms: f64,
    seed: u64,
) -> PyResult<Py<PyString>> {
    let base = match base {
        "cylinder" => Ok(BaseKind::Cylinder),
        "polynomial" => Ok(BaseKind::Polynomial),
        other => Err(format!("base {other:?}: give \"cylinder\" or \"polynomial\"")),
    };
    let result = interrupt::run(py, move |_| {
        let base = base.map_err(anyhow::Error::msg)?;
        if degree.is_some() && base == BaseKind::Cylinder {
            bail!("degree requires base \"polynomial\"; the cylinder base has no degree");
        }
        let output = Output::check(&output, SIGNATURE, fingerprints(&campaign)?, Overwrite::NEVER)?;
        let fit = fit_model(&campaign, base, degree, alignment(delay_ms), options(seed))?;
        fit.model.write_output(&output)?;
        Ok(with_notes(text::fit::to_json(&fit), &fit.notes))
    })?;
    Ok(to_text(py, &result))
}

/// Compares a model, and the one at `other` on the same rows, with a campaign.
#[pyfunction]
fn compare(
    py: Python<'_>,
    model: PathBuf,
    campaign: PathBuf,
    other: Option<PathBuf>,
    report: Option<PathBuf>,
    delay_ms: Option<f64>,
    seed: u64,
) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let check = |path: PathBuf| {
            Output::check(&path, report::html::MARK, fingerprints(&campaign)?, Overwrite::NEVER)
        };
        let report = report.map(check).transpose()?;
        let model = Model::read(&model)?;
        let other = other.as_deref().map(Model::read).transpose()?;
        let (alignment, options) = (model.file.alignment(delay_ms), options(seed));
        let comparison =
            comparison::compare(&model, &campaign, other.as_ref(), alignment, options)?;
        if let Some(page) = &report {
            report::html::write(page, &comparison, &[])?;
        }
        Ok(with_notes(text::comparison::to_json(&comparison), &comparison.notes))
    })?;
    Ok(to_text(py, &result))
}

/// Diagnoses which effects a model does not contain. `progress` is called with the stage and the share that is done.
#[pyfunction]
#[pyo3(name = "diagnose")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
fn diagnose_campaign(
    py: Python<'_>,
    model: PathBuf,
    campaign: PathBuf,
    exprs: Vec<String>,
    ranges: Vec<Range>,
    plans: bool,
    catalogue: bool,
    progress: Option<Py<PyAny>>,
    delay_ms: Option<f64>,
    seed: u64,
) -> PyResult<Py<PyString>> {
    let progress = Progress::new(progress);
    let result = interrupt::run(py, |stop| {
        let model = Model::read(&model)?;
        let alignment = model.file.alignment(delay_ms);
        let checked = CheckedCampaign::open(&campaign, &model, alignment, Caching::Always)?;
        let own = match checked.campaign()? {
            Some(rows) => formulas(&exprs, &ranges, &rows)?,
            None => Vec::new(),
        };
        let observer = Observer::new(
            |stage, share| progress.call(stop, stage, share),
            |_| (),
            || stop.load(Ordering::Relaxed),
        );
        let scope = Scope { catalogue, plans, traces: false };
        let (diagnosis, _) =
            diagnose_checked(&checked, &model, &own, scope, options(seed), &observer)?;
        Ok(text::diagnosis::to_json(&diagnosis))
    })?;
    progress.finish()?;
    Ok(to_text(py, &result))
}

/// Refits a model with effects added and removed, and writes it.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
fn edit(
    py: Python<'_>,
    model: PathBuf,
    campaign: PathBuf,
    output: PathBuf,
    added: Vec<String>,
    removed: Vec<String>,
    exprs: Vec<String>,
    ranges: Vec<Range>,
    delay_ms: Option<f64>,
    seed: u64,
) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let model = Model::read(&model)?;
        let alignment = model.file.alignment(delay_ms);
        let rows = read_campaign(&campaign, alignment)?;
        let added = find_effects(&added, &formulas(&exprs, &ranges, &rows)?)?;
        let after = edited_effects(&model, added, &removed)?;
        let output = edited_output(&output, &model, &after, &rows, Overwrite::NEVER)?;
        let edited = refit(rows, &model, after, alignment, options(seed))?;
        edited.model.write_output(&output)?;
        Ok(with_notes(text::edit_model::to_json(&edited), &edited.notes))
    })?;
    Ok(to_text(py, &result))
}

/// Runs every row of a campaign through the device's code.
#[pyfunction]
fn replay(
    py: Python<'_>,
    model: PathBuf,
    campaign: PathBuf,
    network: Option<PathBuf>,
    delay_ms: Option<f64>,
) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let replayed = evaluation::evaluate(&model, &campaign, network.as_deref(), delay_ms)?;
        Ok(with_notes(text::replay::to_json(&replayed), &replayed.notes))
    })?;
    Ok(to_text(py, &result))
}

/// Writes the device's tables as Rust source.
#[pyfunction]
fn export(
    py: Python<'_>,
    model: PathBuf,
    output: PathBuf,
    network: Option<PathBuf>,
) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let built = build(&model, ModelVariant::Fitted)?;
        let output = Output::check(&output, TABLES_MARK, built.model.inputs(), Overwrite::NEVER)?;
        check_compensated(&built, "remove it from the model")?;
        let networks = network.as_deref().map(|path| NetworkSet::read(path, &built)).transpose()?;
        let source = tables_source(&built, networks.as_ref())?;
        output.write(source.as_bytes())?;
        Ok(text::export::to_json(&built.chosen, &built.header))
    })?;
    Ok(to_text(py, &result))
}

/// Trains networks that estimate each force with its standard deviation, and writes them. With a `checkpoint`, each epoch is saved
/// there, and a training that was ended goes on.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
fn train(
    py: Python<'_>,
    model: PathBuf,
    campaign: PathBuf,
    output: PathBuf,
    quick: bool,
    hidden: Option<usize>,
    axes: &str,
    with_ideal: bool,
    of_residual: bool,
    shared: bool,
    hold_out: Option<usize>,
    epochs: Option<u32>,
    patience: Option<u32>,
    rate: Option<f64>,
    zero_weight: f64,
    checkpoint: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
    delay_ms: Option<f64>,
    seed: u64,
) -> PyResult<Py<PyString>> {
    let axes: BTreeSet<Option<usize>> = axes.chars().map(|axis| "xyz".find(axis)).collect();
    let axes: Option<Vec<usize>> = axes.into_iter().collect();
    let progress = Progress::new(progress);
    let result = interrupt::run(py, |stop| {
        let topology = Topology {
            axes: axes.filter(|axes| !axes.is_empty()).context("axes: give letters of \"xyz\"")?,
            ideal: with_ideal,
            target: if of_residual { Target::Residual } else { Target::Force },
            shared,
            hidden: hidden.unwrap_or_else(|| default_hidden(shared, quick)),
        };
        let settings = TrainingSettings {
            seed,
            epochs: epochs.unwrap_or_else(|| default_epochs(quick)),
            patience: patience.unwrap_or(DEFAULT_PATIENCE),
            rate: rate.unwrap_or(DEFAULT_RATE),
            near_zero: zero_weight,
            force_range_n: 0.0,
        };
        check_settings(&settings, topology.hidden).map_err(anyhow::Error::msg)?;
        if checkpoint.as_ref() == Some(&output) {
            bail!("network and checkpoint need different files");
        }
        let mark = TensorFileKind::Network.mark();
        let output = Output::check(&output, mark, fingerprints(&campaign)?, Overwrite::NEVER)?;
        let start = Instant::now();
        let data = TrainingData::read(&model, &campaign, hold_out, delay_ms)?;
        // A training resumes from no file but its own.
        let saved = |path| data.checkpoint(path, Overwrite::Forced);
        let saved = checkpoint.as_deref().map(saved).transpose()?;
        let force_range_n = data.built.model.force_range_n();
        let settings = TrainingSettings { force_range_n, ..settings };
        let epochs = settings.epochs;
        let mut trainer = Trainer::new(settings, topology, &data.training, &data.held_out)?;
        if let Some(path) = checkpoint.as_deref().filter(|path| path.exists()) {
            checkpoint::resume(path, &mut trainer, &data.key())?;
        }
        while !trainer.finished() && !stop.load(Ordering::Relaxed) {
            let losses = trainer.epoch()?;
            if let Some(output) = &saved {
                checkpoint::write(output, &trainer, &data.key())?;
            }
            let stage = format!("training, held-out loss {:.3}", losses.held_out_loss);
            progress.call(stop, &stage, f64::from(trainer.epoch) / f64::from(epochs));
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(Value::Null);
        }
        let trained = TrainingResult::of(&trainer, &data, start.elapsed())?;
        trained.network_file(&trainer, &data).write(&output)?;
        Ok(with_notes(text::training::to_json(&trained, &data.notes), &data.notes))
    })?;
    progress.finish()?;
    Ok(to_text(py, &result))
}

/// Writes a mapping proposed from the names and values of source files.
#[pyfunction]
fn guess_mapping(py: Python<'_>, sources: Vec<PathBuf>, output: PathBuf) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let proposal = guess::propose(&sources)?;
        write_same(&output, proposal.text.as_bytes(), Overwrite::NEVER)?;
        Ok(text::import::proposal_json(&proposal, &output))
    })?;
    Ok(to_text(py, &result))
}

/// Converts source files to a campaign with a mapping file.
#[pyfunction]
fn import_recordings(
    py: Python<'_>,
    mapping: PathBuf,
    sources: Vec<PathBuf>,
    output: PathBuf,
) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let imported = import_campaign(&mapping, &sources, &output)?;
        Ok(with_notes(text::import::to_json(&imported), &imported.notes))
    })?;
    Ok(to_text(py, &result))
}

/// Writes the recordings of a campaign with the device's estimates as MCAP files.
#[pyfunction]
fn export_mcap(
    py: Python<'_>,
    model: PathBuf,
    campaign: PathBuf,
    output: PathBuf,
    network: Option<PathBuf>,
    delay_ms: Option<f64>,
) -> PyResult<Vec<PathBuf>> {
    interrupt::run(py, move |_| {
        Ok(write_bags(&model, network.as_deref(), &campaign, &output, delay_ms)?.0)
    })
}

/// Writes a campaign of a simulated gripper; its true parameters are in `truth`.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
fn simulate(
    py: Python<'_>,
    output: PathBuf,
    truth: Option<PathBuf>,
    design: Option<PathBuf>,
    plan: Option<PathBuf>,
    effects: Vec<String>,
    orientations: Vec<String>,
    programme: Option<String>,
    recordings: Option<u32>,
    seconds: Option<f64>,
    sensors: Option<u32>,
    scatter: Option<f64>,
    random_effects: Option<usize>,
    strength: Option<f64>,
    load: Option<f64>,
    warmer: Option<f64>,
    noise: Option<String>,
    field_noise: Option<f64>,
    reference_noise: Option<f64>,
    seed: u64,
) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| {
        let design = SensorDesign::read_or_magpie(design.as_deref())?;
        let default = CampaignSettings::of_design(&design);
        let sensors = sensors.unwrap_or(default.sensors);
        let mounted =
            orientations.iter().map(|text| text.parse().map_err(|error: String| anyhow!(error)));
        let mounted: Vec<MountedSensor> = mounted.collect::<Result<_>>()?;
        let settings = CampaignSettings {
            mountings: Mountings::new(&mounted, sensors)?,
            effects: match random_effects {
                Some(_) if !effects.is_empty() => bail!("give effects or random_effects, not both"),
                Some(count) => draw_random_effects(seed, count, checked_strength(strength)?)?,
                None if strength.is_some() => bail!("strength requires random_effects"),
                None => effects.iter().map(|text| text.parse()).collect::<Result<_>>()?,
            },
            hidden: random_effects.is_some(),
            programme: match programme {
                Some(name) => serde_json::from_value(json!(name)).context("programme")?,
                None => default.programme,
            },
            noise: match noise {
                Some(name) => serde_json::from_value(json!(name)).context("noise")?,
                None => default.noise,
            },
            plan: plan.as_deref().map(RecordingPlan::read).transpose()?,
            recordings: recordings.unwrap_or(default.recordings),
            seconds: seconds.unwrap_or(default.seconds),
            scatter: scatter.unwrap_or(default.scatter),
            sensors,
            harder: load.unwrap_or(default.harder),
            warmer_k: warmer.unwrap_or(default.warmer_k),
            field_noise_g: field_noise.unwrap_or(default.field_noise_g),
            reference_noise_n: reference_noise.unwrap_or(default.reference_noise_n),
            seed,
            ..default
        };
        let (truth, path) = sim::campaign::write(&settings, &output, truth.as_deref(), || ())?;
        Ok(text::simulate::to_json(&settings, &truth, &output, &path))
    })?;
    Ok(to_text(py, &result))
}

/// The factor on random effects, within the range of the command.
fn checked_strength(strength: Option<f64>) -> Result<f64> {
    let strength = strength.unwrap_or(1.0);
    if !(0.0..=MAX_STRENGTH).contains(&strength) {
        bail!("strength = {strength:?} is not possible here; give 0 to {MAX_STRENGTH}");
    }
    Ok(strength)
}

/// The catalogue of effects.
#[pyfunction]
fn effects(py: Python<'_>) -> Py<PyString> {
    to_text(py, &Value::from_iter(CATALOGUE.map(text::effects::to_json)))
}

/// Summary of a campaign's recordings.
#[pyfunction]
fn campaign(py: Python<'_>, folder: PathBuf, delay_ms: f64) -> PyResult<Py<PyString>> {
    let result = interrupt::run(py, move |_| describe(&folder, delay_ms))?;
    Ok(to_text(py, &result))
}

fn describe(folder: &Path, delay_ms: f64) -> Result<Value> {
    let campaign = read_campaign(folder, alignment(delay_ms))?;
    let recordings = campaign.recordings.iter().map(|recording| {
        let ends = recording.time_s.first().zip(recording.time_s.last());
        json!({
            "folder": recording.folder,
            "rows": recording.time_s.len(),
            "seconds": ends.map_or(0.0, |(first, last)| last - first),
            "covariates": recording.covariates.keys().collect::<Vec<_>>(),
        })
    });
    let notices = campaign.notices().map(ToString::to_string);
    Ok(json!({
        "recordings": recordings.collect::<Vec<_>>(),
        "sensors": campaign.sensors(),
        "notes": notices.collect::<Vec<_>>(),
    }))
}

/// Adds the functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(fit, module)?)?;
    module.add_function(wrap_pyfunction!(compare, module)?)?;
    module.add_function(wrap_pyfunction!(diagnose_campaign, module)?)?;
    module.add_function(wrap_pyfunction!(edit, module)?)?;
    module.add_function(wrap_pyfunction!(replay, module)?)?;
    module.add_function(wrap_pyfunction!(export, module)?)?;
    module.add_function(wrap_pyfunction!(train, module)?)?;
    module.add_function(wrap_pyfunction!(guess_mapping, module)?)?;
    module.add_function(wrap_pyfunction!(import_recordings, module)?)?;
    module.add_function(wrap_pyfunction!(export_mcap, module)?)?;
    module.add_function(wrap_pyfunction!(simulate, module)?)?;
    module.add_function(wrap_pyfunction!(effects, module)?)?;
    module.add_function(wrap_pyfunction!(campaign, module)?)
}
