//! The recordings that a network is trained with, as the device would see them.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::gru::file::{Provenance, Recorded};
use model_export::gru::train::course::Course;
use model_export::gru::train::lesson::Sequence;
use model_export::inverse::build::{Built, Variant, build};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, name_of, recording_folders};
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;

use super::Args;
use crate::commands::replay::same_scale;
use crate::lessons::sequence;
use crate::progress;
use crate::replay::Models;

/// What is learned from, and where it comes from.
pub struct Campaign {
    /// Recordings that are learned from.
    pub lessons: Vec<Sequence>,
    /// The one that is not.
    pub held_out: Sequence,
    name: String,
    recordings: Vec<Recorded>,
    model_sha256: String,
    delay_ms: f64,
    /// The physics that the networks stand behind.
    pub built: Built,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Campaign {
    /// Runs every recording through the device's code.
    pub fn read(args: &Args) -> Result<Self> {
        let alignment = args.clocks.alignment()?;
        let folders = recording_folders(&args.campaign)?;
        let held_out = held_out(&args.campaign, folders.len(), args.hold_out)?;
        let built = build(&args.model, Variant::Fitted)?;
        let mut recordings = Vec::new();
        for (i, folder) in folders.iter().enumerate() {
            recordings.push(Recorded {
                name: name_of(folder),
                sha256: fingerprint(folder)?,
                held_out: i == held_out,
            });
        }
        refuse_copies(&args.campaign, &recordings)?;
        let mut lessons = sequences(&folders, &built, alignment)?;
        same_sensors(&args.campaign, &lessons)?;
        let held_out = lessons.remove(held_out);
        let notes = notes(&built, &recordings, &held_out);
        notes.iter().for_each(|note| eprintln!("note: {note}"));
        Ok(Self {
            lessons,
            held_out,
            name: args
                .campaign
                .canonicalize()
                .map_or_else(|_| name_of(&args.campaign), |absolute| name_of(&absolute)),
            recordings,
            model_sha256: built.header.inputs_sha256.clone(),
            delay_ms: 1e-3 * alignment.delay_us,
            built,
            notes,
        })
    }

    /// Tells what is learned from: the same text, the same data.
    pub fn key(&self) -> String {
        let hashes = self.recordings.iter().map(|recording| {
            let part = if recording.held_out { "-" } else { "+" };
            format!(" {part}{}", recording.sha256)
        });
        let hashes: String = hashes.collect();
        format!("{} {}ms{hashes}", self.model_sha256, self.delay_ms)
    }

    /// For the network's file.
    pub fn provenance(&self, course: &Course) -> Provenance {
        Provenance {
            tool: format!("magpie {}", env!("CARGO_PKG_VERSION")),
            model_sha256: self.model_sha256.clone(),
            campaign: self.name.clone(),
            recordings: self.recordings.clone(),
            delay_ms: self.delay_ms,
            topology: course.topology.clone(),
            settings: course.settings.clone(),
            found: course.found.clone(),
        }
    }
}

/// Place of the held-out recording.
pub fn held_out(campaign: &Path, recordings: usize, asked: Option<usize>) -> Result<usize> {
    if recordings < 2 {
        bail!(
            "{}: there is one recording, and one more is needed to tell when to stop: split it in two, or record again",
            campaign.display()
        );
    }
    match asked {
        None => Ok(recordings - 1),
        Some(number @ 1..) if number <= recordings => Ok(number - 1),
        Some(number) => {
            bail!("--hold-out {number}: there are {recordings} recordings, counted from 1")
        }
    }
}

fn sequences(folders: &[PathBuf], built: &Built, alignment: Alignment) -> Result<Vec<Sequence>> {
    let bar = progress::rows("through the device's code");
    let mut sequences = Vec::new();
    for folder in folders {
        let (description, _) = Description::read(folder)?;
        same_scale(folder, &description, &built.model)?;
        let stream = RawStream::open(folder, &description, alignment)?;
        let before = bar.position();
        let done = |rows| bar.set_position(before + rows);
        sequences.push(sequence(Models::of(built), &name_of(folder), stream, done)?);
    }
    bar.finish_and_clear();
    Ok(sequences)
}

fn numbers(sequence: &Sequence) -> Vec<u32> {
    sequence.tracks.iter().map(|track| track.number).collect()
}

/// A network needs each of its sensors in every recording.
fn same_sensors(campaign: &Path, sequences: &[Sequence]) -> Result<()> {
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
                "{}: recording {} has field and both forces of sensors {:?}, recording {} of {:?}; train with recordings that have the same",
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

/// The same recording twice would be learned from and held out at once.
fn refuse_copies(campaign: &Path, recordings: &[Recorded]) -> Result<()> {
    for (i, one) in recordings.iter().enumerate() {
        if let Some(other) = recordings[..i].iter().find(|r| r.sha256 == one.sha256) {
            bail!(
                "{}: recordings {} and {} are the same data; remove one, or the held-out error would not be held out",
                campaign.display(),
                other.name,
                one.name
            );
        }
    }
    Ok(())
}

fn notes(built: &Built, recordings: &[Recorded], held_out: &Sequence) -> Vec<String> {
    let fitted = &built.model.provenance.recordings;
    let seen = recordings
        .iter()
        .find(|recording| recording.held_out)
        .filter(|recording| fitted.iter().any(|r| r.sha256 == recording.sha256));
    let mut notes = Vec::new();
    if let Some(recording) = seen {
        notes.push(format!(
            "the model was fitted to recording {} as well: the ideal model's error there is not held out",
            recording.name
        ));
    }
    for number in &built.header.sensors {
        if !numbers(held_out).contains(number) {
            notes.push(format!(
                "sensor {number} of the model gets no network: its field or its forces are not in these recordings"
            ));
        }
    }
    notes
}
