//! Training data: recordings through the device code.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::gru::file::{NetworkProvenance, TrainingRecording};
use model_export::gru::tensors::TensorFileKind;
use model_export::gru::train::dataset::Sequence;
use model_export::gru::train::trainer::Trainer;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::output::{Output, Overwrite};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::recording::fingerprint;
use model_export::recordings::recording::recording_name;
use model_export::recordings::stream::RawStream;

use crate::compare::campaign_reader::{check_distinct, check_sensor_scale, held_out_index};
use crate::notes::Note;
use crate::progress;
use device_run::{ReplayModels, training_sequence};

/// Training and held-out sequences with their provenance.
pub struct TrainingData {
    /// Training recordings.
    pub training: Vec<Sequence>,
    /// Held-out recording.
    pub held_out: Sequence,
    name: String,
    recordings: Vec<TrainingRecording>,
    model_sha256: String,
    delay_ms: f64,
    /// The physical model that precedes the networks.
    pub built: DeviceModel,
    /// Notes on the held-out recording and on sensors without a network.
    pub notes: Vec<Note>,
}

impl TrainingData {
    /// Runs every recording of `campaign` through the device code with the tables of `model`. The held-out recording
    /// is counted from 1; the default is the last. Without a delay of the reference, that of the model applies.
    ///
    /// # Errors
    /// A recording cannot be read, two are the same data, or their sensors differ.
    pub fn read(
        model: &Path,
        campaign: &Path,
        hold_out: Option<usize>,
        delay_ms: Option<f64>,
    ) -> Result<Self> {
        let folders = recording_folders(campaign)?;
        let index = held_out_index(campaign, folders.len(), hold_out)?;
        let built = build(model, ModelVariant::Fitted)?;
        let alignment = built.model.alignment(delay_ms);
        let mut recordings = Vec::new();
        for (i, folder) in folders.iter().enumerate() {
            recordings.push(TrainingRecording {
                name: recording_name(folder),
                sha256: fingerprint(folder)?,
                held_out: i == index,
            });
        }
        let sources = recordings.iter();
        check_distinct(&campaign.display().to_string(), sources.map(|r| (&*r.name, &*r.sha256)))?;
        let mut training = read_sequences(&folders, &built, alignment)?;
        check_same_sensors(campaign, &training)?;
        let held_out = training.remove(index);
        let mut notes = notes(&built, &recordings, &held_out);
        notes.extend(Note::other_delay(model, &built.model, alignment));
        Ok(Self {
            training,
            held_out,
            name: campaign
                .canonicalize()
                .map_or_else(|_| recording_name(campaign), |absolute| recording_name(&absolute)),
            recordings,
            model_sha256: built.header.inputs_sha256.clone(),
            delay_ms: alignment.delay_us / 1e3,
            built,
            notes,
        })
    }

    /// Identifies the data: equal keys mean equal training data.
    pub fn key(&self) -> String {
        let hashes = self.recordings.iter().map(|recording| {
            let part = if recording.held_out { "-" } else { "+" };
            format!(" {part}{}", recording.sha256)
        });
        let hashes: String = hashes.collect();
        format!("{} {}ms{hashes}", self.model_sha256, self.delay_ms)
    }

    /// A file for checkpoints of a training on this data.
    ///
    /// # Errors
    /// The path holds another file.
    pub fn checkpoint(&self, path: &Path, overwrite: Overwrite) -> Result<Output> {
        let mark = TensorFileKind::Checkpoint.mark();
        Ok(Output::check(path, mark, vec![self.key()], overwrite)?)
    }

    /// Provenance for the network file.
    pub fn provenance(&self, trainer: &Trainer) -> NetworkProvenance {
        NetworkProvenance {
            tool: format!("magpie {}", env!("CARGO_PKG_VERSION")),
            model_sha256: self.model_sha256.clone(),
            campaign: self.name.clone(),
            recordings: self.recordings.clone(),
            delay_ms: self.delay_ms,
            topology: trainer.topology.clone(),
            settings: trainer.settings.clone(),
            found: trainer.found.clone(),
        }
    }
}

fn read_sequences(
    folders: &[PathBuf],
    built: &DeviceModel,
    alignment: Alignment,
) -> Result<Vec<Sequence>> {
    let message = "running the device's code";
    let bar = progress::recording_bar(message, folders.len());
    let rows = Cell::new(0);
    let mut sequences = Vec::new();
    for folder in folders {
        let (description, _) = RecordingDescription::read(folder)?;
        check_sensor_scale(folder, &description, &built.model)?;
        let stream = RawStream::open(folder, &description, alignment)?;
        let before = rows.get();
        let done = |count| {
            rows.set(before + count);
            progress::show_rows(&bar, message, rows.get());
        };
        sequences.push(training_sequence(
            ReplayModels::of(built),
            &recording_name(folder),
            stream,
            done,
        )?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(sequences)
}

fn numbers(sequence: &Sequence) -> Vec<u32> {
    sequence.tracks.iter().map(|track| track.number).collect()
}

/// Fails unless all recordings have the same sensors.
fn check_same_sensors(campaign: &Path, sequences: &[Sequence]) -> Result<()> {
    let Some((first, others)) = sequences.split_first() else {
        return Ok(());
    };
    if first.tracks.is_empty() {
        bail!(
            "{}: no sensor of the model has its field and both its forces in recording {}",
            campaign.display(),
            first.name
        );
    }
    for other in others {
        if numbers(other) != numbers(first) {
            bail!(
                "{}: recording {} has field and both forces of sensors {:?}, recording {} of {:?}; all recordings must have the same sensors",
                campaign.display(),
                other.name,
                numbers(other),
                first.name,
                numbers(first)
            );
        }
    }
    Ok(())
}

fn notes(built: &DeviceModel, recordings: &[TrainingRecording], held_out: &Sequence) -> Vec<Note> {
    let fitted = &built.model.provenance.recordings;
    let fitted_too = recordings
        .iter()
        .find(|recording| recording.held_out)
        .filter(|recording| fitted.iter().any(|r| r.sha256 == recording.sha256));
    let mut notes = Vec::new();
    if let Some(recording) = fitted_too {
        notes.push(Note::IdealModelNotHeldOut { recording: recording.name.clone() });
    }
    for number in &built.header.sensors {
        if !numbers(held_out).contains(number) {
            notes.push(Note::NoNetwork { sensor: *number });
        }
    }
    notes
}
