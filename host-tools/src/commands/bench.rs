//! `magpie bench`: a test bench with an emulated gripper that has hidden effects, loads and a reference force sensor.

use std::path::PathBuf;

use analysis::{numbers, progress};
use anyhow::{Context, Result, bail, ensure};
use clap::Subcommand;
use device::emulation::calibration::{evaluate, record_campaign};
use emulator::Image;
use firmware::sensors::hall::SENSORS;
use model_export::input;
use model_export::output::check_absent;
use report::text::terminal;
use serde_json::json;
use sim::closed_loop::bench::BenchSetup;
use sim::closed_loop::emulated_board::ChipConditions;
use sim::effects::{Effect, draw_random_effects};
use sim::mountings::{MountedSensor, Mountings};

use crate::commands::emulate::default_image;
use crate::commands::simulate::parse_effect;

/// Calibrate an emulated gripper with hidden effects, as a real one.
///
/// The unmodified firmware image runs in the emulated chip; a simulated gripper of manufacturing tolerances with hidden
/// effects is at its pins, on a bench with varying loads, openings, temperatures and orientations and a reference force
/// sensor (100 Hz, 0.15 N of noise, 20 ms late). Recordings and uploads use the serial line. In between: `fit`, `diagnose`,
/// `add`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  # any model of this design
  cargo magpie fit tests/data/demo -o any.toml
  cargo magpie bench record any.toml -o bench --random-effects 1 --seed 5
  cargo magpie fit bench -o plain.toml
  cargo magpie diagnose plain.toml bench                                   # what is hidden?
  cargo magpie add plain.toml bench hysteresis -o model.toml               # what it names
  cargo magpie bench evaluate model.toml -o new-loads --random-effects 1 --seed 5 --reveal")]
pub struct Args {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    Record(RecordArgs),
    Evaluate(EvaluateArgs),
}

/// The hidden gripper; equal options give the same one.
#[derive(Debug, clap::Args)]
struct HiddenArgs {
    /// Hidden effect with its magnitude [default: typical]; may be given several times.
    #[arg(long = "effect", value_name = "ID[=MAGNITUDE]", value_parser = parse_effect)]
    effects: Vec<Effect>,
    /// Hide N random effects.
    #[arg(long, value_name = "N", conflicts_with = "effects")]
    random_effects: Option<usize>,
    /// Orientation of a sensor, as of `simulate`; may be given several times.
    #[arg(long = "orientation", value_name = "SENSOR=AXES[:reversed]")]
    orientations: Vec<MountedSensor>,
    /// Seed of the gripper, its noise and its effects.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length of a recording in seconds; its emulation takes about as long.
    #[arg(long, value_name = "S", default_value_t = 24.0)]
    seconds: f64,
    /// Firmware image (ELF) [default: the newest build of `cargo image` or `.ci/image`].
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Upload the tables of the nominal design, and record a campaign with the reference.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  cargo magpie bench record any.toml -o bench --effect hysteresis --effect magnet_temperature")]
struct RecordArgs {
    /// Any model of the gripper's design; its nominal tables are used.
    model: PathBuf,
    /// Folder of the new campaign; must not exist yet.
    #[arg(short, long, value_name = "CAMPAIGN")]
    output: PathBuf,
    /// Number of recordings.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(2..=10))]
    recordings: u32,
    #[command(flatten)]
    hidden: HiddenArgs,
}

/// Upload a model, run the gripper under new loads, and compare the board's forces with the reference.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  cargo magpie bench evaluate model.toml -o new-loads --random-effects 1 --seed 5 --reveal")]
struct EvaluateArgs {
    /// Model file.
    model: PathBuf,
    /// Folder of the new recording; must not exist yet.
    #[arg(short, long, value_name = "RECORDING")]
    output: PathBuf,
    /// Print which effects are hidden.
    #[arg(long)]
    reveal: bool,
    #[command(flatten)]
    hidden: HiddenArgs,
}

/// Range of the length of a recording in seconds.
const SECONDS: std::ops::RangeInclusive<f64> = 5.0..=600.0;

impl HiddenArgs {
    /// `excitation` numbers the loads.
    fn setup(&self, recordings: u32, excitation: u64) -> Result<BenchSetup> {
        ensure!(
            SECONDS.contains(&self.seconds),
            "--seconds {}: give {} to {}",
            self.seconds,
            SECONDS.start(),
            SECONDS.end()
        );
        let effects = match self.random_effects {
            Some(count) => draw_random_effects(self.seed, count, 1.0)?,
            None => self.effects.clone(),
        };
        if let Some(effect) = effects.iter().find(|effect| effect.kind.is_campaign_only()) {
            bail!(
                "{} is simulated in campaigns only; use cargo magpie simulate --effect {0}",
                effect.kind.id
            );
        }
        Ok(BenchSetup {
            seed: self.seed,
            excitation_seed: self.seed.wrapping_mul(2).wrapping_add(excitation),
            scatter: 1.0,
            mountings: Mountings::new(&self.orientations, SENSORS as u32)?,
            effects,
            recordings,
            seconds: self.seconds,
        })
    }

    fn image(&self) -> Result<Image> {
        let path = self.image.clone().map_or_else(default_image, Ok)?;
        Ok(Image::parse(input::read_bytes(&path, input::MAX_IMAGE_BYTES)?, &path)?)
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    match &args.step {
        Step::Record(args) => record(args),
        Step::Evaluate(args) => evaluate_model(args),
    }
}

fn record(args: &RecordArgs) -> Result<()> {
    check_absent(&args.output)?;
    let setup = args.hidden.setup(args.recordings, 0)?;
    let bar = progress::progress_bar("homing and recording", args.recordings as usize);
    record_campaign(
        args.hidden.image()?,
        &args.model,
        &setup,
        ChipConditions::TYPICAL,
        &args.output,
        || bar.inc(1),
    )
    .with_context(|| args.output.display().to_string())?;
    bar.finish_and_clear();
    terminal::print_result(
        args.hidden.json,
        || json!({ "campaign": args.output, "recordings": args.recordings, "seed": args.hidden.seed }),
        || {
            format!(
                "Recorded to {}: {} recordings of {} s with a reference.\n\nNext:\n  cargo magpie fit {} -o plain.toml\n",
                args.output.display(),
                args.recordings,
                args.hidden.seconds,
                args.output.display()
            )
        },
    )
}

fn evaluate_model(args: &EvaluateArgs) -> Result<()> {
    check_absent(&args.output)?;
    let setup = args.hidden.setup(1, 1)?;
    let spinner = progress::status_spinner("uploading, homing and recording");
    let errors =
        evaluate(args.hidden.image()?, &args.model, &setup, ChipConditions::TYPICAL, &args.output)
            .with_context(|| args.model.display().to_string())?;
    spinner.finish_and_clear();
    let hidden: Vec<String> = setup
        .effects
        .iter()
        .map(|effect| format!("{}={}", effect.kind.id, numbers::decimal(effect.size, 3)))
        .collect();
    let hidden = args.reveal.then_some(hidden);
    terminal::print_result(
        args.hidden.json,
        || {
            json!({
                "board_n": errors.board_n,
                "replay_n": errors.replay_n,
                "max_difference_n": errors.max_difference_n,
                "valid": errors.valid,
                "hidden": hidden,
            })
        },
        || {
            let mut text = format!(
                "Force error on the board, RMS of means over 10 ms: {} N; of a replay of its readings: {} N.\n\
                 {} % of the forces are valid on both.\n",
                numbers::decimal(errors.board_n, 3),
                numbers::decimal(errors.replay_n, 3),
                numbers::decimal(100.0 * errors.valid, 1)
            );
            if let Some(hidden) = &hidden {
                text += &format!("Hidden: {}.\n", hidden.join(", "));
            }
            text
        },
    )
}
