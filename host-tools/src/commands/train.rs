//! `magpie train`: a recurrent network trained on recordings.

pub mod report;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::ValueEnum;
use model_export::gru::file::{NetworkFile, Provenance, Recorded};
use model_export::gru::network::Target;
use model_export::gru::tensors::Kind;
use model_export::gru::train::checkpoint;
use model_export::gru::train::course::{Course, Settings};
use model_export::gru::train::lesson::{Sequence, Topology};
use model_export::inverse::build::{Built, Variant, build};
use model_export::output::check_output;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, recording_folders};
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;

use super::clocks::Clocks;
use crate::lessons::sequence;
use crate::replay::Models;
use crate::{progress, show};
use report::Outcome;

/// Units of a layer, if not given: with three inputs the device computes it within the time that the
/// paper states for a computer.
const HIDDEN: usize = 16;
/// The same for one network of all sensors.
const HIDDEN_SHARED: usize = 32;

/// Train a recurrent network that tells each force with its uncertainty.
///
/// The network sees what it would see on the gripper: the field after the device's compensation, at
/// the board's own rate. Its weights are those of the epoch with the best likelihood on the held-out
/// recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie train model.toml my-campaign -o network.safetensors
  cargo magpie train model.toml my-campaign --shared --hidden 32 -o network.safetensors
  cargo magpie train model.toml my-campaign -o network.safetensors \\
    --checkpoint training.safetensors --resume")]
pub struct Args {
    /// Model file, as `magpie fit` writes it.
    model: PathBuf,
    /// Folder of at least two recordings.
    campaign: PathBuf,
    /// Where the network goes; without it nothing is written.
    #[arg(short, long, value_name = "NETWORK")]
    output: Option<PathBuf>,
    /// Axes of the field that the network sees.
    #[arg(long, value_enum, default_value = "xyz")]
    axes: Axes,
    /// What it sees beside: nothing, or the ideal model's force.
    #[arg(long, value_enum, default_value = "field")]
    inputs: Inputs,
    /// What it tells: the force, or what the ideal model leaves of it.
    #[arg(long, value_enum, default_value = "force")]
    target: TargetChoice,
    /// Units of each of its two layers; 16, or 32 with --shared.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=128))]
    hidden: Option<u16>,
    /// One network for all sensors instead of one for each.
    #[arg(long)]
    shared: bool,
    /// Recording that is not learned from, counted from 1 in the campaign's order; the last if not
    /// given.
    #[arg(long, value_name = "NUMBER")]
    hold_out: Option<usize>,
    /// Greatest number of times to go through the recordings.
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..))]
    epochs: u32,
    /// Stop after this many epochs without a better held-out likelihood.
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..))]
    patience: u32,
    /// Learning rate at the start; it falls to a hundredth.
    #[arg(long, default_value_t = 5e-3)]
    rate: f64,
    /// Seed of the first weights: the same seed, the same network.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Keep the training here after every epoch.
    #[arg(long, value_name = "PATH")]
    checkpoint: Option<PathBuf>,
    /// Go on from the checkpoint, where there is one.
    #[arg(long, requires = "checkpoint")]
    resume: bool,
    #[command(flatten)]
    clocks: Clocks,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Axes of the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Axes {
    /// The plane of motion.
    Xz,
    /// All three.
    Xyz,
}

/// What the network sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Inputs {
    /// The compensated field.
    Field,
    /// The field and the ideal model's force.
    #[value(name = "field+ideal")]
    FieldAndIdeal,
}

/// What the network tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TargetChoice {
    /// The force.
    Force,
    /// What the ideal model leaves.
    Rest,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if !(args.rate.is_finite() && args.rate > 0.0) {
        bail!("--rate must be a positive number");
    }
    if let Some(path) = &args.output {
        check_output(path, Kind::Network.mark())?;
    }
    if let Some(path) = &args.checkpoint {
        check_output(path, Kind::Checkpoint.mark())?;
        if args.output.as_ref() == Some(path) {
            bail!("the network and the checkpoint need a file each");
        }
    }
    let start = Instant::now();
    let campaign = Campaign::read(args)?;
    let mut course = Course::new(
        args.settings(),
        args.topology(),
        &campaign.lessons,
        &campaign.held_out,
    )?;
    teach(args, &mut course, &campaign.key())?;
    let outcome = Outcome::of(&course, &campaign.held_out, start.elapsed())?;
    let text = match args.json {
        true => format!("{}\n", report::json(&outcome, &campaign.notes)),
        false => report::text(&outcome),
    };
    show::page(&text)?;
    if let Some(path) = &args.output {
        let file = NetworkFile {
            provenance: campaign.provenance(&course),
            networks: course.networks(),
        };
        file.write(path)?;
    }
    if !args.json {
        show::page(&match &args.output {
            Some(path) => format!("Written to {}.\n", path.display()),
            None => "Not written: give -o network.safetensors to keep it.\n".to_owned(),
        })?;
    }
    Ok(())
}

impl Args {
    fn settings(&self) -> Settings {
        Settings {
            seed: self.seed,
            epochs: self.epochs,
            patience: self.patience,
            rate: self.rate,
        }
    }

    fn topology(&self) -> Topology {
        let usual = if self.shared { HIDDEN_SHARED } else { HIDDEN };
        Topology {
            axes: match self.axes {
                Axes::Xz => vec![0, 2],
                Axes::Xyz => vec![0, 1, 2],
            },
            ideal: self.inputs == Inputs::FieldAndIdeal,
            target: match self.target {
                TargetChoice::Force => Target::Force,
                TargetChoice::Rest => Target::Rest,
            },
            shared: self.shared,
            hidden: self.hidden.map_or(usual, usize::from),
        }
    }
}

/// Epoch after epoch, with a checkpoint after each where one is wanted.
fn teach(args: &Args, course: &mut Course, key: &str) -> Result<()> {
    if let Some(path) = &args.checkpoint {
        match (args.resume, path.exists()) {
            (true, true) => checkpoint::resume(path, course, key)?,
            (true, false) => eprintln!(
                "note: {}: no checkpoint yet; the training begins anew",
                path.display()
            ),
            (false, _) => {}
        }
    }
    let bar = progress::epochs("training", args.epochs, course.epoch);
    while !course.finished() {
        let progress = course.epoch()?;
        bar.set_message(format!(
            "training (loss {:.3}, held out {:.3})",
            progress.training_loss, progress.held_out_loss
        ));
        bar.inc(1);
        if let Some(path) = &args.checkpoint {
            checkpoint::write(path, course, key)?;
        }
    }
    bar.finish_and_clear();
    Ok(())
}

/// What is learned from, and where it comes from.
struct Campaign {
    lessons: Vec<Sequence>,
    held_out: Sequence,
    name: String,
    recordings: Vec<Recorded>,
    model_sha256: String,
    delay_ms: f64,
    notes: Vec<String>,
}

impl Campaign {
    /// Runs every recording through the device's code.
    fn read(args: &Args) -> Result<Self> {
        let alignment = args.clocks.alignment()?;
        let folders = recording_folders(&args.campaign)?;
        let held_out = held_out(&args.campaign, folders.len(), args.hold_out)?;
        let built = build(&args.model, Variant::Fitted)?;
        let mut recordings = Vec::new();
        for (i, folder) in folders.iter().enumerate() {
            recordings.push(Recorded {
                name: name(folder),
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
                .map_or_else(|_| name(&args.campaign), |absolute| name(&absolute)),
            recordings,
            model_sha256: built.header.inputs_sha256,
            delay_ms: 1e-3 * alignment.delay_us,
            notes,
        })
    }

    /// The same text, the same data.
    fn key(&self) -> String {
        let hashes = self.recordings.iter().map(|recording| {
            let part = if recording.held_out { "-" } else { "+" };
            format!(" {part}{}", recording.sha256)
        });
        let hashes: String = hashes.collect();
        format!("{} {}ms{hashes}", self.model_sha256, self.delay_ms)
    }

    fn provenance(&self, course: &Course) -> Provenance {
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

fn name(folder: &Path) -> String {
    folder
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Place of the held-out recording.
fn held_out(campaign: &Path, recordings: usize, asked: Option<usize>) -> Result<usize> {
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
        let own = built.model.sensor_scale.gauss_per_lsb;
        if let Some(other) = description.gauss_per_lsb.filter(|other| *other != own) {
            bail!(
                "{}: gauss_per_lsb is {other}, and the model's tables are for {own}; fit these recordings, or correct recording.toml",
                folder.display()
            );
        }
        let stream = RawStream::open(folder, &description, alignment)?;
        let before = bar.position();
        let done = |rows| bar.set_position(before + rows);
        sequences.push(sequence(Models::of(built), &name(folder), stream, done)?);
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
