//! `magpie train`: trains recurrent networks on recordings.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, bail};
use clap::ValueEnum;
use indicatif::HumanDuration;
use model_export::gru::network::Target;
use model_export::gru::tensors::TensorFileKind;
use model_export::gru::train::checkpoint;
use model_export::gru::train::dataset::Topology;
use model_export::gru::train::trainer::{Trainer, TrainingSettings};
use model_export::output::{Output, Overwrite};
use model_export::recordings::campaign::fingerprints;

use crate::commands::args::{AlignArgs, ForceArg};
use crate::commands::interrupt::{INTERRUPTED, first_interrupt};
use crate::commands::output::print_notes;
use analysis::network_training::dataset::TrainingData;
use analysis::network_training::{
    DEFAULT_PATIENCE, DEFAULT_RATE, MAX_HIDDEN, TrainingResult, check_settings, default_epochs,
    default_hidden,
};
use analysis::progress;
use report::text::terminal;
use report::text::training::{format_report, to_json};

/// Trainings that may take longer than this announce it.
const ANNOUNCED: Duration = Duration::from_secs(30);

/// Train a recurrent network that estimates each force with its standard deviation.
///
/// The inputs are those on the gripper: the field after the device's compensation, at the sampling rate of the board.
/// The weights are those of the epoch with the best likelihood on the held-out recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie train model.toml my-campaign -o network.safetensors
  cargo magpie train model.toml my-campaign --quick -o network.safetensors
  cargo magpie train model.toml my-campaign --shared --hidden 32 -o network.safetensors
  cargo magpie train model.toml my-campaign -o network.safetensors \\
    --checkpoint training.safetensors --resume")]
pub struct Args {
    /// Model file written by `magpie fit`.
    model: PathBuf,
    /// Folder of at least two recordings.
    campaign: PathBuf,
    /// Smaller networks and fewer epochs: a first impression in a small part of the time.
    #[arg(long)]
    quick: bool,
    /// Units of each of the two layers [default: 16, 32 with --shared, or 8 with --quick].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MAX_HIDDEN as i64))]
    hidden: Option<u16>,
    /// Held-out recording, counted from 1 in the campaign's order [default: the last].
    #[arg(long, value_name = "NUMBER")]
    hold_out: Option<usize>,
    /// Maximum number of epochs [default: 80, or 15 with --quick].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    epochs: Option<u32>,
    /// Early stopping: epochs without a better held-out likelihood.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_PATIENCE, value_parser = clap::value_parser!(u32).range(1..))]
    patience: u32,
    /// Initial learning rate; it decreases to a hundredth.
    #[arg(long, default_value_t = DEFAULT_RATE)]
    rate: f64,
    /// Weight of rows without force in the likelihood: 1 + (WEIGHT - 1) exp(-(F / W)^2 / 2), where W is a tenth of the force range.
    #[arg(long, value_name = "WEIGHT", default_value_t = 1.0)]
    zero_weight: f64,
    /// Seed of the initial weights.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Clock alignment.
    #[command(flatten)]
    align: AlignArgs,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
    /// Network file to write.
    #[arg(short, long, value_name = "NETWORK")]
    output: Option<PathBuf>,
    #[command(flatten)]
    force: ForceArg,
    /// Field axes that are inputs.
    #[arg(long, value_enum, default_value = "xyz")]
    axes: Axes,
    /// Inputs.
    #[arg(long, value_enum, default_value = "field")]
    inputs: Inputs,
    /// Output: the force, or the residual of the ideal model.
    #[arg(long, value_enum, default_value = "force")]
    target: TargetArg,
    /// One network for all sensors instead of one per sensor.
    #[arg(long)]
    shared: bool,
    /// Checkpoint file, written after every epoch. Ctrl-C writes one next to the output as well.
    #[arg(long, value_name = "PATH")]
    checkpoint: Option<PathBuf>,
    /// Resume from the checkpoint if it exists.
    #[arg(long, requires = "checkpoint")]
    resume: bool,
}

/// Field axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Axes {
    /// The plane of motion.
    Xz,
    /// All three axes.
    Xyz,
}

/// Inputs of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Inputs {
    /// The compensated field.
    Field,
    /// The compensated field and the ideal model's force.
    #[value(name = "field+ideal")]
    FieldAndIdeal,
}

/// Output of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TargetArg {
    /// The force.
    Force,
    /// The residual of the ideal model.
    Residual,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    args.check()?;
    if args.checkpoint.is_some() && args.output == args.checkpoint {
        bail!("network and checkpoint need different files");
    }
    let check = |path| {
        let (mark, overwrite) = (TensorFileKind::Network.mark(), args.force.overwrite());
        Output::check(path, mark, fingerprints(&args.campaign)?, overwrite)
    };
    let output = args.output.as_deref().map(check).transpose()?;
    let start = Instant::now();
    let delay_ms = args.align.given_ms()?;
    let data = TrainingData::read(&args.model, &args.campaign, args.hold_out, delay_ms)?;
    print_notes(&data.notes);
    // A training resumes from no file but its own.
    let overwrite = if args.resume { Overwrite::Forced } else { args.force.overwrite() };
    let checkpoint = args.checkpoint.as_deref();
    let checkpoint = checkpoint.map(|path| data.checkpoint(path, overwrite)).transpose()?;
    let mut trainer = Trainer::new(
        args.settings(data.built.model.force_range_n()),
        args.topology(),
        &data.training,
        &data.held_out,
    )?;
    if let Some(interrupted) = train(args, checkpoint.as_ref(), &mut trainer, &data)? {
        eprintln!("{interrupted}");
        std::process::exit(INTERRUPTED);
    }
    let evaluation = TrainingResult::of(&trainer, &data, start.elapsed())?;
    terminal::print_result(
        args.json,
        || to_json(&evaluation, &data.notes),
        || format_report(&evaluation),
    )?;
    if let Some(output) = &output {
        evaluation.network_file(&trainer, &data).write(output)?;
    }
    if !args.json {
        terminal::print(&match &args.output {
            Some(path) if !evaluation.reduces_the_error() => format!(
                "Written to {}. Do not use it on a gripper: the ideal model's error is lower.\n",
                path.display(),
            ),
            Some(path) => format!(
                "Written to {path}.\nNext: cargo magpie replay \"{}\" \"{}\" --network \"{path}\"\n",
                args.model.display(),
                args.campaign.display(),
                path = path.display(),
            ),
            None => "Not written; use -o network.safetensors.\n".to_owned(),
        })?;
    }
    Ok(())
}

impl Args {
    /// Checks the ranges that the parser does not check.
    fn check(&self) -> Result<()> {
        // The range of the forces is known once the recordings are read.
        check_settings(&self.settings(0.0), self.units()).map_err(|error| anyhow!("--{error}"))
    }

    /// Units per layer.
    fn units(&self) -> usize {
        self.hidden.map_or_else(|| default_hidden(self.shared, self.quick), usize::from)
    }

    fn epochs(&self) -> u32 {
        self.epochs.unwrap_or_else(|| default_epochs(self.quick))
    }

    /// Settings of the trainer for sensors with this force range.
    fn settings(&self, force_range_n: f64) -> TrainingSettings {
        TrainingSettings {
            seed: self.seed,
            epochs: self.epochs(),
            patience: self.patience,
            rate: self.rate,
            near_zero: self.zero_weight,
            force_range_n,
        }
    }

    fn topology(&self) -> Topology {
        Topology {
            axes: match self.axes {
                Axes::Xz => vec![0, 2],
                Axes::Xyz => vec![0, 1, 2],
            },
            ideal: self.inputs == Inputs::FieldAndIdeal,
            target: match self.target {
                TargetArg::Force => Target::Force,
                TargetArg::Residual => Target::Residual,
            },
            shared: self.shared,
            hidden: self.units(),
        }
    }
}

/// Trains until early stopping, with a checkpoint after each epoch if requested. If Ctrl-C ended it, returns how it resumes.
fn train(
    args: &Args,
    output: Option<&Output>,
    trainer: &mut Trainer,
    data: &TrainingData,
) -> Result<Option<String>> {
    let interrupted = first_interrupt()?;
    let key = data.key();
    if let Some(path) = &args.checkpoint {
        match (args.resume, path.exists()) {
            (true, true) => checkpoint::resume(path, trainer, &key)?,
            (true, false) => {
                eprintln!("note: {}: no checkpoint; starting from the beginning", path.display())
            }
            (false, _) => {}
        }
    }
    let epochs = args.epochs();
    let bar = progress::epoch_bar("training", epochs, trainer.epoch);
    let start = Instant::now();
    let mut is_announced = false;
    while !trainer.finished() {
        let progress = trainer.epoch()?;
        bar.set_message(format!(
            "training (loss {:.3}, held out {:.3})",
            progress.training_loss, progress.held_out_loss
        ));
        bar.inc(1);
        if let Some(output) = output {
            checkpoint::write(output, trainer, &key)?;
        }
        if interrupted.load(Ordering::Relaxed) {
            bar.finish_and_clear();
            return Ok(Some(saved(args, output, trainer, data)?));
        }
        let longest = start.elapsed() * epochs.saturating_sub(trainer.epoch);
        if !is_announced && longest > ANNOUNCED {
            bar.suspend(|| eprintln!("{}", announcement(args, start.elapsed(), longest)));
        }
        is_announced = true;
    }
    bar.finish_and_clear();
    Ok(None)
}

/// How long a training takes, from the time of one epoch.
fn announcement(args: &Args, epoch: Duration, longest: Duration) -> String {
    let quick = if args.quick { "" } else { "; --quick gives a first impression much sooner" };
    format!(
        "An epoch takes {:.1} s: at most {} more, less if {} epochs bring no improvement{quick}.",
        epoch.as_secs_f64(),
        HumanDuration(longest),
        args.patience,
    )
}

/// A name next to the network's that no file has.
fn vacant_checkpoint(network: &Path) -> Option<PathBuf> {
    let names = std::iter::once("checkpoint.safetensors".to_owned())
        .chain((2..1000).map(|number| format!("checkpoint-{number}.safetensors")));
    names.map(|end| network.with_extension(end)).find(|path| !path.exists())
}

/// Writes a checkpoint of an interrupted training, unless there is no place for it; how it resumes.
fn saved(
    args: &Args,
    output: Option<&Output>,
    trainer: &Trainer,
    data: &TrainingData,
) -> Result<String> {
    let done = format!("Interrupted after epoch {}", trainer.epoch);
    let vacant = args.output.as_deref().and_then(vacant_checkpoint);
    let new = |path: PathBuf| data.checkpoint(&path, args.force.overwrite());
    let new = vacant.filter(|_| output.is_none()).map(new).transpose()?;
    let Some(output) = output.or(new.as_ref()) else {
        return Ok(format!(
            "{done}; nothing is saved, because neither -o nor --checkpoint was given."
        ));
    };
    checkpoint::write(output, trainer, &data.key())?;
    let words: Vec<String> = std::env::args().skip(1).collect();
    let mut words: Vec<&str> =
        ["cargo", "magpie"].into_iter().chain(words.iter().map(String::as_str)).collect();
    let name = output.path().display().to_string();
    if args.checkpoint.is_none() {
        words.extend(["--checkpoint", &name]);
    }
    if !args.resume {
        words.push("--resume");
    }
    Ok(format!("{done}; saved to {name}. Continue with:\n  {}", shell_words::join(words)))
}
