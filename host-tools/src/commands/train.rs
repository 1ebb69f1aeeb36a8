//! `magpie train`: a recurrent network trained on recordings.

pub mod campaign;
pub mod report;
pub mod sigma;
pub mod table;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::ValueEnum;
use model_export::gru::file::NetworkFile;
use model_export::gru::network::Target;
use model_export::gru::tensors::Kind;
use model_export::gru::train::checkpoint;
use model_export::gru::train::course::{Course, Settings};
use model_export::gru::train::lesson::Topology;
use model_export::output::check_output;

use super::clocks::Clocks;
use crate::{progress, show};
use campaign::Campaign;
use report::Outcome;
use sigma::Sigma;

/// Units of a layer, if not given: with three inputs the device computes it within the time that the
/// paper states for a computer.
const HIDDEN: usize = 16;
/// The same for one network of all sensors.
const HIDDEN_SHARED: usize = 32;

/// Beyond this the rows near zero would be all that is learned; below its inverse none of it.
const MOST_NEAR_ZERO: f64 = 100.0;

/// Hours of the foreign magnet, if not given: a few seconds.
const MAGNET_HOURS: f64 = 0.2;
/// More than this is no experiment any more.
const MOST_MAGNET_HOURS: f64 = 1000.0;

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
    --checkpoint training.safetensors --resume
  cargo magpie train --table model.toml my-campaign -o report.html")]
pub struct Args {
    /// Model file, as `magpie fit` writes it.
    model: PathBuf,
    /// Folder of at least two recordings.
    campaign: PathBuf,
    /// All ways of telling the force side by side, as in the paper's Table I: the ideal model, networks
    /// of 2 and 3 axes, with the ideal model's force, physics with MODEL's effects, alone and with a
    /// network; everything fitted and trained anew without the recording held out.
    #[arg(long, conflicts_with_all = ["axes", "inputs", "target", "shared", "checkpoint"])]
    table: bool,
    /// Where the network goes, or with --table the report (a page to open); without it nothing is
    /// written.
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
    #[arg(long, value_name = "N", default_value_t = 80, value_parser = clap::value_parser!(u32).range(1..))]
    epochs: u32,
    /// Stop after this many epochs without a better held-out likelihood.
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    patience: u32,
    /// Learning rate at the start; it falls to a hundredth.
    #[arg(long, default_value_t = 5e-3)]
    rate: f64,
    /// What a row without force counts beside one with much, on the likelihood that is learned:
    /// 1 + (WEIGHT - 1) exp(-(F / 25 N)^2 / 2); 1 if not given, 4 in the table's row.
    #[arg(long, value_name = "WEIGHT")]
    near_zero: Option<f64>,
    /// With --table: hours without a magnet in which the device may call one in vain, and as many with
    /// magnets that pass; 0 leaves them out. Ten hours take some ten minutes.
    #[arg(long, value_name = "H", default_value_t = MAGNET_HOURS)]
    magnet_hours: f64,
    /// With --table: leave out how the error falls with the seconds that are learned from, which takes as
    /// long as the table again.
    #[arg(long, requires = "table")]
    without_curve: bool,
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
    if let Some(weight) = args.near_zero
        && !(MOST_NEAR_ZERO.recip()..=MOST_NEAR_ZERO).contains(&weight)
    {
        bail!("--near-zero {weight} is not possible here; give 0.01 to {MOST_NEAR_ZERO}");
    }
    if !(0.0..=MOST_MAGNET_HOURS).contains(&args.magnet_hours) {
        bail!(
            "--magnet-hours {} is not possible here; give 0 to {MOST_MAGNET_HOURS}",
            args.magnet_hours
        );
    }
    if args.table {
        return table::run(args);
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
        args.settings(campaign.built.model.force_range_n()),
        args.topology(),
        &campaign.lessons,
        &campaign.held_out,
    )?;
    teach(args, &mut course, &campaign.key())?;
    let sigma = Sigma::of(
        &course,
        &campaign.lessons,
        &campaign.held_out,
        &campaign.built,
    )?;
    let outcome = Outcome::of(&course, &campaign.held_out, sigma, start.elapsed())?;
    let text = match args.json {
        true => format!("{}\n", report::json(&outcome, &campaign.notes)),
        false => report::text(&outcome),
    };
    show::page(&text)?;
    if let Some(path) = &args.output {
        let mut networks = course.networks();
        outcome.sigma.apply(&mut networks);
        let file = NetworkFile {
            provenance: campaign.provenance(&course),
            networks,
        };
        file.write(path)?;
    }
    if !args.json {
        show::page(&match &args.output {
            Some(path) => format!(
                "Written to {path}.\nNext: cargo magpie replay \"{}\" \"{}\" --network \"{path}\"\n",
                args.model.display(),
                args.campaign.display(),
                path = path.display(),
            ),
            None => "Not written: give -o network.safetensors to keep it.\n".to_owned(),
        })?;
    }
    Ok(())
}

impl Args {
    /// For a sensor that measures up to `force_range_n`.
    fn settings(&self, force_range_n: f64) -> Settings {
        Settings {
            seed: self.seed,
            epochs: self.epochs,
            patience: self.patience,
            rate: self.rate,
            near_zero: self.near_zero.unwrap_or(1.0),
            force_range_n,
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
