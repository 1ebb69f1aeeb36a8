//! `magpie simulate`: a campaign of a gripper whose physics are known.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use model_export::design::Design;
use model_export::output::write_output;
use model_export::physics::ForwardModel;
use serde_json::{Value, json};

use crate::bench::effects::{Effect, hide};
use crate::bench::element::{NoiseKind, Part};
use crate::bench::programme::Programme;
use crate::bench::sizes::SIZES;
use crate::bench::truth::{self, Truth};
use crate::bench::{self, Settings};
use crate::{new_folder, progress, show};

/// Write a campaign of a simulated gripper with physical effects of your choice, or hidden ones.
#[derive(Debug, clap::Args)]
#[command(after_help = after_help())]
pub struct Args {
    /// Folder of the new campaign; must be empty or not exist yet.
    #[arg(short, long, value_name = "CAMPAIGN")]
    output: PathBuf,
    /// An effect, with its size where it is not typical; may be given several times.
    #[arg(long = "effect", value_name = "ID[=SIZE]", value_parser = parse_effect)]
    effects: Vec<Effect>,
    /// Draw so many effects and name them nowhere but in the truth.
    #[arg(long, value_name = "N", conflicts_with = "effects")]
    hide: Option<usize>,
    /// Multiplies the typical sizes of hidden effects.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "hide")]
    strength: f64,
    /// What is done to the gripper.
    #[arg(long, value_enum, default_value = "bench")]
    programme: Programme,
    /// Number of recordings.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    recordings: u32,
    /// Length of each recording.
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    seconds: f64,
    /// The nominal design that the gripper is made to; otherwise MAGPIE's own.
    #[arg(long, value_name = "PATH")]
    design: Option<PathBuf>,
    /// Number of sensors; otherwise the design's.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_SENSORS)))]
    sensors: Option<u32>,
    /// Multiplies the scatter of manufacture; 0 makes a perfect gripper.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scatter: f64,
    /// Multiplies every load.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    load: f64,
    /// Everything is so much warmer.
    #[arg(
        long,
        value_name = "K",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    warmer: f64,
    /// Noise of the field beside white noise.
    #[arg(long, value_enum, default_value = "white")]
    noise: NoiseKind,
    /// White noise of one field sample; otherwise that of the design's sensor.
    #[arg(long, value_name = "G")]
    field_noise: Option<f64>,
    /// White noise of the reference.
    #[arg(long, value_name = "N", default_value_t = 0.15)]
    reference_noise: f64,
    /// Seed of everything that is drawn: the same seed, the same bytes.
    // TOML, and with it the truth, has no larger integers.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seed: u64,
    /// Where the truth goes; otherwise beside the campaign, as CAMPAIGN-truth.toml.
    #[arg(long, value_name = "PATH")]
    truth: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Examples, then every effect that the bench knows.
fn after_help() -> String {
    let mut text = "\
Examples:
  cargo magpie simulate -o clean
  cargo magpie simulate -o warm --effect magnet_temperature --effect creep=3
  cargo magpie simulate -o stuck --effect hysteresis=2.5:both --programme isothermal
  cargo magpie simulate -o passed --effect external_magnet=60   # passed-truth.toml says when
  cargo magpie simulate -o hard --load 1.3 --warmer 15    # the same gripper, beyond what it knew
  cargo magpie simulate -o other --design design.toml     # another magnet, other stiffness, other sensors
  cargo magpie simulate -o riddle --hide 2 --seed 7    # riddle-truth.toml has the answer

Effects, each with its typical size (friction takes :lateral, :longitudinal or :both after it):
"
    .to_owned();
    for size in SIZES {
        let typical = format!("{}={}", size.id, size.typical());
        text += &format!("  {typical:<28} {:<6} {}\n", size.unit(), size.meaning);
    }
    text
}

fn parse_effect(text: &str) -> Result<Effect, String> {
    text.parse()
        .map_err(|error: anyhow::Error| format!("{error:#}"))
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let settings = settings(args)?;
    let truth_path = match &args.truth {
        Some(path) => path.clone(),
        None => truth::default_path(&args.output)?,
    };
    truth::check_outside(&truth_path, &args.output)?;
    check_free(&args.output, &truth_path)?;
    let draft = new_folder::draft(&args.output, ".magpie-simulate-")?;
    let bar = progress::bar("simulating recordings", settings.recordings as usize);
    let truth = bench::simulate(&settings, draft.path(), || bar.inc(1))?;
    bar.finish_and_clear();
    write_output(&truth_path, truth.text()?.as_bytes(), truth::MARK)?;
    std::fs::rename(draft.keep(), &args.output)
        .with_context(|| format!("{} cannot be written", args.output.display()))?;
    let page = match args.json {
        true => format!("{}\n", report_json(args, &settings, &truth, &truth_path)),
        false => report(args, &settings, &truth, &truth_path),
    };
    show::page(&page)?;
    Ok(())
}

fn settings(args: &Args) -> Result<Settings> {
    let at_least_zero = [
        ("--strength", args.strength),
        ("--scatter", args.scatter),
        ("--load", args.load),
        ("--field-noise", args.field_noise.unwrap_or_default()),
        ("--reference-noise", args.reference_noise),
    ];
    for (option, value) in at_least_zero {
        if !(value.is_finite() && value >= 0.0) {
            bail!("{option} {value} is not possible here; give a number that is not below zero");
        }
    }
    if args.scatter > MOST_SCATTER {
        bail!(
            "--scatter {} is not possible here; beyond {MOST_SCATTER} the parts collide",
            args.scatter
        );
    }
    if args.load > MOST_LOAD || !args.warmer.is_finite() || args.warmer.abs() > MOST_WARMER_K {
        bail!(
            "--load {} --warmer {} is not possible here; give a load of up to {MOST_LOAD} and up to {MOST_WARMER_K} K either way",
            args.load,
            args.warmer
        );
    }
    if !(SECONDS[0]..=SECONDS[1]).contains(&args.seconds) {
        bail!(
            "--seconds {} is not possible here; give {} to {}",
            args.seconds,
            SECONDS[0],
            SECONDS[1]
        );
    }
    let design = match &args.design {
        Some(path) => Design::read(path)?,
        None => Design::magpie(),
    };
    let sensors = args.sensors.unwrap_or(design.sensors);
    if !(1..=MOST_SENSORS).contains(&sensors) {
        bail!("sensors = {sensors} is not possible here; give 1 to {MOST_SENSORS}");
    }
    check_range(&design)?;
    Ok(Settings {
        seed: args.seed,
        programme: args.programme,
        recordings: args.recordings,
        seconds: args.seconds,
        sensors,
        design: design.nominal(),
        part: Part {
            gauss_per_lsb: design.sensor.gauss_per_lsb,
            range_gauss: design.sensor.range_gauss,
        },
        scatter: args.scatter,
        noise: args.noise,
        harder: args.load,
        warmer_k: args.warmer,
        field_noise_g: args.field_noise.unwrap_or(design.sensor.noise_gauss),
        reference_noise_n: args.reference_noise,
        effects: match args.hide {
            Some(count) => hide(args.seed, count, args.strength)?,
            None => args.effects.clone(),
        },
        hidden: args.hide.is_some(),
    })
}

/// Sensors of a bench; the board reads four.
const MOST_SENSORS: u32 = 8;

/// Refuses a design whose field at rest the sensor cannot read.
fn check_range(design: &Design) -> Result<()> {
    let rest_g = ForwardModel::nominal(&design.nominal())
        .field([0.0; 2])
        .amax();
    let range_g = design.sensor.range_gauss;
    if rest_g >= range_g {
        bail!(
            "the design's magnet gives {rest_g:.0} G at rest, beyond the sensor's {range_g:.0} G; take a weaker one or a wider gap"
        );
    }
    Ok(())
}

/// Lengths of a recording: long enough for the load to come up, short enough for its clocks.
const SECONDS: [f64; 2] = [3.0, 3600.0];

/// Beyond this load the magnet leaves the sensor's range, beyond this warmth the board its own.
const MOST_LOAD: f64 = 2.0;
const MOST_WARMER_K: f64 = 60.0;

/// Five standard deviations of the stiffness at this scatter are its whole.
const MOST_SCATTER: f64 = 4.0;

/// Nothing is overwritten.
fn check_free(campaign: &Path, truth: &Path) -> Result<()> {
    new_folder::check_free(campaign)?;
    match truth.symlink_metadata() {
        Ok(_) => new_folder::occupied(truth),
        Err(_) => Ok(()),
    }
}

/// The effects as lines, unless they are hidden.
fn told(settings: &Settings, truth: &Truth) -> String {
    if settings.hidden {
        let count = settings.effects.len();
        let what = if count == 1 {
            "effect is"
        } else {
            "effects are"
        };
        return format!("{count} {what} hidden in it.\n");
    }
    if truth.effect.is_empty() {
        return "It has no effects beyond the magnet on two flexures.\n".to_owned();
    }
    let mut table = show::table(["effect", "unit", "size"]);
    for effect in &truth.effect {
        table.add_row([
            effect.id.clone(),
            effect.unit.clone(),
            show::plain(effect.size, 6),
        ]);
    }
    show::right_align(&mut table, 2);
    format!("{table}\n")
}

fn report(args: &Args, settings: &Settings, truth: &Truth, truth_path: &Path) -> String {
    let model = "model.toml";
    format!(
        "Simulated: {} recordings of {} s, {} sensors, programme {}, noise {}, seed {}.\n{}\
         Written to {}; what is in it, to {}.\n\
         Next: cargo magpie fit {:?} -o {model}\n",
        settings.recordings,
        show::plain(settings.seconds, 3),
        settings.sensors,
        name(&settings.programme),
        name(&settings.noise),
        settings.seed,
        told(settings, truth),
        args.output.display(),
        truth_path.display(),
        args.output,
    )
}

fn report_json(args: &Args, settings: &Settings, truth: &Truth, truth_path: &Path) -> Value {
    let effects = truth
        .effect
        .iter()
        .map(|effect| json!({ "id": effect.id, "size": effect.size, "unit": effect.unit }));
    let effects: Option<Vec<Value>> = (!settings.hidden).then(|| effects.collect());
    json!({
        "campaign": args.output,
        "truth": truth_path,
        "seed": settings.seed,
        "programme": settings.programme,
        "noise": settings.noise,
        "recordings": settings.recordings,
        "seconds": settings.seconds,
        "sensors": settings.sensors,
        "hidden": settings.hidden.then_some(settings.effects.len()),
        "effects": effects,
    })
}

/// The word by which an argument is chosen.
fn name(value: &impl clap::ValueEnum) -> String {
    value
        .to_possible_value()
        .map_or_else(String::new, |value| value.get_name().to_owned())
}
