//! Evaluation of a model on a campaign through the device code, compared with simpler models.

use std::cell::Cell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Result, bail};
use device_run::ReplayModels;
use device_run::networks::NetworkSet;
use model_export::effects::ErrorOrigin;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::quantise::TableSet;
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::in_order;
use model_export::recordings::recording::fingerprint;
use model_export::recordings::recording::recording_name;
use model_export::recordings::stream::RawStream;
use rayon::prelude::*;

use crate::compare::campaign_excitation::{CampaignExcitation, recording_corrections};
use crate::compare::campaign_reader::{Caching, CampaignReader, check_sensor_scale};
use crate::compare::{EffectOrigin, ErrorRows, FlaggedRows, ForceError};
use crate::model::Model;
use crate::notes::{Note, UncompensatedEffect};
use crate::progress;
use crate::replay::corrections::{Irreducible, SensorCorrections};
use crate::replay::{AxisReplay, RecordingReplay, ReplayInput, replay_each};
use crate::statistics::{Moments, pooled_rms};

/// Replays of a campaign with a model and, for comparison, with simpler models.
pub struct ReplayEvaluation {
    /// Fitted radial basis functions.
    pub fitted: Vec<RecordingReplay>,
    /// Best linear model of the same fit.
    pub linear: Vec<RecordingReplay>,
    /// Radial basis functions of the nominal design: the paper's ideal model; `None` with the polynomial base.
    pub nominal: Option<Vec<RecordingReplay>>,
    /// Fitted functions without compensation, if the model has effects.
    pub uncompensated: Option<Vec<RecordingReplay>>,
    /// Fitted functions without networks, if there are networks.
    pub without_networks: Option<Vec<RecordingReplay>>,
    /// Fitted functions without the field that no model of the device compensates, if the model contains one.
    pub reducible: Option<Vec<RecordingReplay>>,
    /// Effects of the model whose error is not one of the device's model.
    pub origins: Vec<EffectOrigin>,
    /// Names of the recordings that the model was fitted to or a network trained on.
    pub training_recordings: Vec<String>,
    /// Nominal range of each force axis in newtons, both signs.
    pub force_range_n: f64,
    /// Notes on the recordings and on parts that were not replayed.
    pub notes: Vec<Note>,
}

/// Replays `campaign` with the model and networks at these paths; without a delay with that of the model.
pub fn evaluate(
    model: &Path,
    campaign: &Path,
    network: Option<&Path>,
    delay_ms: Option<f64>,
) -> Result<ReplayEvaluation> {
    let building = progress::progress_bar("building tables", 2);
    let built = build(model, ModelVariant::Fitted)?;
    let networks = network.map(|path| NetworkSet::read(path, &built)).transpose()?;
    let uncompensated = UncompensatedEffect::of(&built).map(Note::Uncompensated);
    let uncompensated: Vec<Note> = uncompensated.collect();
    let DeviceModel { model: file, chosen: fitted, compensations, header, .. } = built;
    let alignment = file.alignment(delay_ms);
    building.inc(1);
    let nominal = match file.design {
        Some(_) => Some(build(model, ModelVariant::Nominal)?.chosen),
        None => None,
    };
    building.finish_and_clear();
    let folders = recording_folders(campaign)?;
    let scale = file.sensor_scale;
    let mut notes = differences(&folders, &file, alignment)?;
    notes.extend(Note::other_delay(model, &file, alignment));
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
    let model = Model::of(model, file.clone())?;
    let counts_events = model.has_origin(|origin| origin == ErrorOrigin::Event);
    let variant = |tables, float, compensations, networks| ReplayInput {
        models: ReplayModels {
            numbers: &header.sensors,
            forces: &header.forces,
            tables,
            compensations,
            design: file.design.as_ref(),
            float,
            gauss_per_lsb: scale.gauss_per_lsb,
            force_range_n: file.force_range_n(),
            networks,
        },
        corrections: &[],
        irreducible: Irreducible::Kept,
        counts_events,
    };
    let float = Some(fitted.models.as_slice());
    let mut models = vec![
        variant(&fitted.tables, float, &compensations, networks.as_ref()),
        variant(&linear, None, &[], None),
    ];
    models.extend(nominal.iter().map(|nominal| variant(&nominal.tables, None, &[], None)));
    if !header.effects.is_empty() {
        models.push(variant(&fitted.tables, None, &[], None));
    }
    if networks.is_some() {
        models.push(variant(&fitted.tables, None, &compensations, None));
    }
    let is_irreducible = model.has_origin(ErrorOrigin::is_irreducible);
    if is_irreducible {
        let variant = variant(&fitted.tables, None, &compensations, networks.as_ref());
        models.push(ReplayInput { irreducible: Irreducible::Subtracted, ..variant });
    }
    let corrections = corrections(campaign, &model, alignment)?;
    let mut replayed = replay_all(&folders, &models, &corrections, alignment)?.into_iter();
    let mut next = || replayed.next().unwrap_or_default();
    let (replayed, linear) = (next(), next());
    let nominal = nominal.is_some().then(&mut next);
    let uncompensated = (!header.effects.is_empty()).then(&mut next);
    let without_networks = networks.as_ref().map(|_| next());
    let reducible = is_irreducible.then(&mut next);
    let sensors = || replayed.iter().flat_map(|recording| &recording.sensors);
    if sensors().count() == 0 {
        bail!(
            "{}: no sensor of the model has its field and the forces of its model in these recordings",
            campaign.display()
        );
    }
    if sensors().flat_map(|sensor| &sensor.axes).all(|axis| axis.error.rows() == 0.0) {
        bail!(
            "{}: no row has both a valid estimate and a measured force; if force.csv has forces, check the scale and unit of hall.csv, else replace it by the table of the reference sensor",
            campaign.display()
        );
    }
    for number in &header.sensors {
        if !sensors().any(|sensor| sensor.number == *number) {
            notes.push(Note::NotReplayed { sensor: *number });
        }
        let own = sensors().filter(|sensor| sensor.number == *number);
        let mut measured = own.flat_map(|own| &own.axes).filter(|axis| axis.is_measured).peekable();
        if measured.peek().is_some() && measured.all(|axis| axis.error.rows() == 0.0) {
            notes.push(Note::NoValidEstimate { sensor: *number });
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
        reducible,
        origins: EffectOrigin::of(&file.effects),
        fitted: replayed,
        training_recordings: training_recordings(&folders, &file, networks.as_ref())?,
        force_range_n: file.force_range_n(),
        notes,
    })
}

impl ReplayEvaluation {
    /// Which of the recordings the model was fitted to or a network trained on.
    pub fn rows(&self) -> ErrorRows {
        let is_fitted =
            |recording: &&RecordingReplay| self.training_recordings.contains(&recording.name);
        match self.fitted.iter().filter(is_fitted).count() {
            0 => ErrorRows::Unseen,
            fitted if fitted == self.fitted.len() => ErrorRows::Fitted,
            _ => ErrorRows::PartlyFitted,
        }
    }
}

/// Notes on recordings whose alignment or design differs from the model's.
fn differences(folders: &[PathBuf], model: &ModelFile, alignment: Alignment) -> Result<Vec<Note>> {
    let mut notes = Vec::new();
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

/// Corrections of each recording, by its folder, for the tables of a model.
fn corrections(
    campaign: &Path,
    model: &Model,
    alignment: Alignment,
) -> Result<HashMap<PathBuf, Vec<SensorCorrections>>> {
    let mut all = HashMap::new();
    if !model.needs_corrections() {
        return Ok(all);
    }
    let source = CampaignReader::open(campaign, alignment, Caching::IfFew)?;
    let mut excitation = CampaignExcitation::of(std::iter::once(model));
    for (place, named) in source.names.iter().enumerate() {
        let excitation = excitation.next(place, |place| source.read(place))?;
        let first_s = source.read(place)?.time_s.first().copied().unwrap_or(0.0);
        let clock_s = first_s + 1e-6 * alignment.delay_us;
        let of_sensors = recording_corrections(named, model, &excitation, clock_s);
        all.insert(named.folder.clone(), of_sensors);
    }
    Ok(all)
}

/// Replays all recordings with each of the models, with progress: by model, in the order of the folders.
///
/// # Errors
/// A recording cannot be read.
fn replay_all(
    folders: &[PathBuf],
    models: &[ReplayInput],
    corrections: &HashMap<PathBuf, Vec<SensorCorrections>>,
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
        let corrections = corrections.get(folder).map_or(&[][..], Vec::as_slice);
        let inputs = models.iter().map(|input| ReplayInput { corrections, ..*input });
        let inputs: Vec<ReplayInput> = inputs.collect();
        let of_each = replay_each(&inputs, &recording_name(folder), stream, done, |_, _| ())?;
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

/// Every measured force of every sensor, pooled over the recordings.
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
        .filter(|pooled| pooled.recordings.iter().any(|axis| axis.is_measured))
        .collect()
}

/// Recorded seconds per second of reading and estimating, on one core.
pub fn times_real_time(recordings: &[RecordingReplay]) -> f64 {
    let spent: f64 = recordings.iter().map(|r| r.spent.as_secs_f64()).sum();
    recordings.iter().map(|r| r.span_s).sum::<f64>() / spent
}

/// Error over all forces of these rows; NaN without any. `reducible` is without what no model of the device compensates.
pub fn pooled_error(
    recordings: &[RecordingReplay],
    reducible: Option<&[RecordingReplay]>,
    rows: ErrorRows,
) -> ForceError {
    let rms = |recordings: &[RecordingReplay], of: fn(&AxisReplay) -> Moments| {
        let moments = pooled(recordings).into_iter().map(|axis| axis.sum(of));
        pooled_rms(moments.filter(|moments| moments.rows() > 0.0).map(|moments| moments.rms()))
    };
    let count = |of: fn(&AxisReplay) -> Moments| {
        pooled(recordings).iter().map(|axis| axis.sum(of).rows()).sum::<f64>()
    };
    let (flagged, kept) = (count(|axis| axis.flagged), count(|axis| axis.error));
    ForceError {
        rms_n: rms(recordings, |axis| axis.error),
        noise_n: pooled_rms(pooled(recordings).iter().map(PooledAxis::noise_n)),
        recorded_rms_n: rms(recordings, |axis| axis.recorded),
        reducible_rms_n: rms(reducible.unwrap_or(recordings), |axis| axis.error.with(axis.flagged)),
        flagged: (flagged > 0.0).then(|| FlaggedRows {
            share: flagged / (flagged + kept),
            rms_n: rms(recordings, |axis| axis.flagged),
        }),
        rows,
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
    /// Whether the recordings are held out.
    pub fn rows(&self) -> ErrorRows {
        if self.held_out { ErrorRows::Unseen } else { ErrorRows::Fitted }
    }

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
