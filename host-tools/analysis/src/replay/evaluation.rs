//! Evaluation of a model on a campaign through the device code, compared with simpler models.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Result, bail};
use device_run::ReplayModels;
use device_run::networks::NetworkSet;
use firmware::config::constants;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::quantise::TableSet;
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::{NominalDesign, RecordingDescription};
use model_export::recordings::in_order;
use model_export::recordings::recording::fingerprint;
use model_export::recordings::recording::recording_name;
use model_export::recordings::stream::RawStream;
use rayon::prelude::*;

use crate::compare::ForceError;
use crate::compare::campaign_reader::check_sensor_scale;
use crate::notes::{Note, UncompensatedEffect};
use crate::progress;
use crate::replay::{AxisReplay, RecordingReplay, replay_each};
use crate::statistics::{Moments, pooled_rms};

/// Replays of a campaign with a model and, for comparison, with simpler models.
pub struct ReplayEvaluation {
    /// Fitted radial basis functions.
    pub fitted: Vec<RecordingReplay>,
    /// Best linear model of the same fit.
    pub linear: Vec<RecordingReplay>,
    /// Radial basis functions of the nominal design: the paper's ideal model.
    pub nominal: Vec<RecordingReplay>,
    /// Fitted functions without compensation, if the model has effects.
    pub uncompensated: Option<Vec<RecordingReplay>>,
    /// Fitted functions without networks, if there are networks.
    pub without_networks: Option<Vec<RecordingReplay>>,
    /// Names of the recordings that the model was fitted to or a network trained on.
    pub training_recordings: Vec<String>,
    /// Nominal range of each force axis in newtons, both signs.
    pub force_range_n: f64,
    /// Notes on the recordings and on parts that were not replayed.
    pub notes: Vec<Note>,
}

/// Replays `campaign` with the model and networks at these paths.
pub fn evaluate(
    model: &Path,
    campaign: &Path,
    network: Option<&Path>,
    alignment: Alignment,
) -> Result<ReplayEvaluation> {
    let building = progress::progress_bar("building tables", 2);
    let built = build(model, ModelVariant::Fitted)?;
    let networks = network.map(|path| NetworkSet::read(path, &built)).transpose()?;
    let uncompensated = UncompensatedEffect::of(&built).map(Note::Uncompensated);
    let uncompensated: Vec<Note> = uncompensated.collect();
    let DeviceModel { model: file, chosen: fitted, compensations, header, .. } = built;
    building.inc(1);
    let nominal = build(model, ModelVariant::Nominal)?.chosen;
    building.finish_and_clear();
    let folders = recording_folders(campaign)?;
    let scale = file.sensor_scale;
    let mut notes = differences(&folders, &file, alignment)?;
    notes.extend(uncompensated);
    let mut linear = TableSet::build(
        fitted.tables.id,
        &fitted.linear,
        &header.sensors,
        scale.gauss_per_lsb,
        scale.range_gauss,
    )?;
    for (linear, fitted) in linear.sensors.iter_mut().zip(&fitted.tables.sensors) {
        linear.axes = fitted.axes;
    }
    let variant = |tables, float, compensations, networks| ReplayModels {
        numbers: &header.sensors,
        tables,
        compensations,
        design: file.design.as_ref(),
        float,
        gauss_per_lsb: scale.gauss_per_lsb,
        networks,
    };
    let float = Some(fitted.models.as_slice());
    let mut models = vec![
        variant(&fitted.tables, float, &compensations, networks.as_ref()),
        variant(&linear, None, &[], None),
        variant(&nominal.tables, None, &[], None),
    ];
    if !header.effects.is_empty() {
        models.push(variant(&fitted.tables, None, &[], None));
    }
    if networks.is_some() {
        models.push(variant(&fitted.tables, None, &compensations, None));
    }
    let mut replayed = replay_all(&folders, &models, alignment)?.into_iter();
    let mut next = || replayed.next().unwrap_or_default();
    let (replayed, linear, nominal) = (next(), next(), next());
    let uncompensated = (!header.effects.is_empty()).then(&mut next);
    let without_networks = networks.as_ref().map(|_| next());
    let sensors = || replayed.iter().flat_map(|recording| &recording.sensors);
    if sensors().count() == 0 {
        bail!(
            "{}: no sensor of the model has its field and both its forces in these recordings",
            campaign.display()
        );
    }
    if sensors().all(|sensor| sensor.axes[0].error.rows() == 0.0) {
        bail!(
            "{}: no row has both a valid estimate and a measured force; if force.csv has forces, check the scale and unit of hall.csv, else replace it by the table of the reference sensor",
            campaign.display()
        );
    }
    for number in &header.sensors {
        if !sensors().any(|sensor| sensor.number == *number) {
            notes.push(Note::NotReplayed { sensor: *number });
        }
    }
    let missing_inputs: u64 = sensors().map(|sensor| sensor.missing_inputs).sum();
    if missing_inputs > 0 {
        notes.push(Note::MissingInputs {
            estimates: missing_inputs,
            effects: header.effects.clone(),
        });
    }
    Ok(ReplayEvaluation {
        linear,
        nominal,
        uncompensated,
        without_networks,
        fitted: replayed,
        training_recordings: training_recordings(&folders, &file, networks.as_ref())?,
        force_range_n: file
            .design
            .as_ref()
            .map_or(constants::FORCE_RANGE.value, NominalDesign::force_range_n),
        notes,
    })
}

/// Notes on recordings whose alignment or design differs from the model's.
fn differences(folders: &[PathBuf], model: &ModelFile, alignment: Alignment) -> Result<Vec<Note>> {
    let mut notes = Vec::new();
    let (fitted_ms, delay_ms) = (model.provenance.delay_ms, 1e-3 * alignment.delay_us);
    if delay_ms != fitted_ms {
        notes.push(Note::ReplayDelay { fitted_ms, delay_ms });
    }
    for folder in folders {
        let (description, _) = RecordingDescription::read(folder)?;
        check_sensor_scale(folder, &description, model)?;
        if description.design != model.design {
            notes.push(Note::OtherDesign { recording: folder.clone() });
        }
        let stream = RawStream::open(folder, &description, alignment)?;
        notes.extend(stream.rate_notice().map(Note::Recording));
    }
    Ok(notes)
}

/// Replays all recordings with each of the models, with progress: by model, in the order of the folders.
///
/// # Errors
/// A recording cannot be read.
pub fn replay_all(
    folders: &[PathBuf],
    models: &[ReplayModels],
    alignment: Alignment,
) -> Result<Vec<Vec<RecordingReplay>>> {
    let message = "replaying on the device's code";
    let bar = progress::recording_bar(message, folders.len());
    let rows = AtomicU64::new(0);
    let replay = |folder: &PathBuf| -> Result<Vec<RecordingReplay>> {
        let (description, _) = RecordingDescription::read(folder)?;
        let stream = RawStream::open(folder, &description, alignment)?;
        let before = Cell::new(0);
        let done = |count| {
            let new = count - before.replace(count);
            progress::show_rows(&bar, message, rows.fetch_add(new, Ordering::Relaxed) + new);
        };
        let of_each = replay_each(models, &recording_name(folder), stream, done, |_, _| ())?;
        bar.inc(1);
        Ok(of_each)
    };
    let replayed = in_order(folders.par_iter().map(replay))?;
    bar.finish_and_clear();
    let mut replays = vec![Vec::new(); models.len()];
    for of_each in replayed {
        replays.iter_mut().zip(of_each).for_each(|(of_model, replay)| of_model.push(replay));
    }
    Ok(replays)
}

fn training_recordings(
    folders: &[PathBuf],
    model: &ModelFile,
    networks: Option<&NetworkSet>,
) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for folder in folders {
        let hash = fingerprint(folder)?;
        let mut fitted = model.provenance.recordings.iter();
        let is_training = networks.is_some_and(|networks| networks.trained_on(&hash));
        if is_training || fitted.any(|recording| recording.sha256 == hash) {
            names.push(recording_name(folder));
        }
    }
    Ok(names)
}

/// One force of one sensor over all recordings.
pub struct PooledAxis {
    /// Number of the sensor.
    pub sensor: u32,
    /// 0: Fx, 1: Fz.
    pub axis: usize,
    /// One for each recording.
    pub recordings: Vec<AxisReplay>,
}

impl PooledAxis {
    /// Moments over all recordings.
    pub fn sum(&self, sums: impl Fn(&AxisReplay) -> Moments) -> Moments {
        self.recordings.iter().fold(Moments::default(), |sum, axis| sum.with(sums(axis)))
    }

    /// RMS of the white noise alone over all recordings.
    pub fn noise_n(&self) -> f64 {
        pooled_rms(self.recordings.iter().map(|axis| axis.noise_n))
    }

    /// Error after taring; `None` if a recording has no unloaded segment.
    pub fn tared(&self) -> Option<Moments> {
        let mut sum = Moments::default();
        for axis in &self.recordings {
            sum = sum.with(axis.tared()?);
        }
        Some(sum)
    }
}

/// Every force of every sensor, pooled over the recordings.
pub fn pooled(recordings: &[RecordingReplay]) -> Vec<PooledAxis> {
    let mut numbers: Vec<u32> =
        recordings.iter().flat_map(|r| r.sensors.iter().map(|s| s.number)).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let axes = |number: u32, axis: usize| {
        let sensors = recordings.iter().flat_map(|r| &r.sensors);
        sensors.filter(|s| s.number == number).map(|s| s.axes[axis]).collect()
    };
    numbers
        .into_iter()
        .flat_map(|sensor| {
            [0, 1].map(|axis| PooledAxis { sensor, axis, recordings: axes(sensor, axis) })
        })
        .collect()
}

/// Recorded seconds per second of reading and estimating, on one core.
pub fn times_real_time(recordings: &[RecordingReplay]) -> f64 {
    let spent: f64 = recordings.iter().map(|r| r.spent.as_secs_f64()).sum();
    recordings.iter().map(|r| r.span_s).sum::<f64>() / spent
}

/// Error over all forces; NaN without any.
pub fn pooled_error(recordings: &[RecordingReplay]) -> ForceError {
    let pooled = pooled(recordings);
    ForceError {
        rms_n: pooled_rms(pooled.iter().map(|axis| axis.sum(|track| track.error).rms())),
        noise_n: pooled_rms(pooled.iter().map(PooledAxis::noise_n)),
    }
}

/// Replays with and without networks, on held-out recordings if there are any.
pub struct NetworkComparison {
    /// True if the recordings are held out.
    pub held_out: bool,
    /// With networks.
    pub with: Vec<RecordingReplay>,
    /// Without networks.
    pub without: Vec<RecordingReplay>,
}

impl NetworkComparison {
    /// `None` without networks.
    pub fn of(evaluation: &ReplayEvaluation) -> Option<Self> {
        let alone = evaluation.without_networks.as_ref()?;
        let held_out = |recordings: &[RecordingReplay]| -> Vec<RecordingReplay> {
            let held_out = recordings
                .iter()
                .filter(|recording| !evaluation.training_recordings.contains(&recording.name));
            held_out.cloned().collect()
        };
        let (with, without) = (held_out(&evaluation.fitted), held_out(alone));
        Some(if with.is_empty() {
            Self { held_out: false, with: evaluation.fitted.clone(), without: alone.clone() }
        } else {
            Self { held_out: true, with, without }
        })
    }
}

/// Fractions of the errors within one and two standard deviations, of the rows that have one.
pub fn coverage_fractions(pooled: &PooledAxis) -> Option<[f64; 2]> {
    let rows = pooled.sum(|track| track.sigma).rows();
    let within = |width: usize| -> u64 { pooled.recordings.iter().map(|t| t.within[width]).sum() };
    (rows > 0.0).then(|| [0, 1].map(|width| within(width) as f64 / rows))
}

/// Fraction of a sensor's rows in which the device rejected the network output.
pub fn rejected_fraction(recordings: &[RecordingReplay], number: u32) -> f64 {
    let (mut rejected, mut rows) = (0, 0);
    for recording in recordings {
        for sensor in recording.sensors.iter().filter(|s| s.number == number) {
            rejected += sensor.diverged;
            rows += recording.rows;
        }
    }
    rejected as f64 / rows.max(1) as f64
}
