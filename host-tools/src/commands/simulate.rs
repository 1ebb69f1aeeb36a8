//! `magpie simulate`: generates a campaign of a simulated gripper with known physics.

use analysis::progress;
use std::path::PathBuf;

use anyhow::{Result, anyhow, bail};
use model_export::design::SensorDesign;
use report::text::simulate::{format_report, to_json};
use report::text::terminal;
use sim::campaign;
use sim::campaign::plan::RecordingPlan;
use sim::campaign::settings::{
    CampaignSettings, DEFAULT_RECORDINGS, DEFAULT_REFERENCE_NOISE_N, DEFAULT_SECONDS,
    MAX_RECORDINGS, MAX_SENSORS,
};
use sim::effects::{EFFECT_KINDS, Effect, EffectKind, MAX_STRENGTH, draw_random_effects};
use sim::hall_sensor::NoiseKind;
use sim::motion::Programme;
use sim::mountings::{MountedSensor, Mountings};

/// Generate a campaign of a simulated gripper with given or random physical effects.
#[derive(Debug, clap::Args)]
#[command(after_help = after_help())]
pub struct Args {
    /// Folder of the new campaign; must be empty or not exist yet.
    #[arg(short, long, value_name = "CAMPAIGN")]
    output: PathBuf,
    /// Effect with its magnitude [default: typical]; may be given several times.
    #[arg(long = "effect", value_name = "ID[=MAGNITUDE]", value_parser = parse_effect)]
    effects: Vec<Effect>,
    /// Add N random effects, recorded only in the truth file.
    #[arg(long, value_name = "N", conflicts_with = "effects")]
    random_effects: Option<usize>,
    /// Factor on the typical magnitudes of random effects.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "random_effects")]
    strength: f64,
    /// Excitation programme.
    #[arg(long, value_enum, default_value = "bench")]
    programme: Programme,
    /// Number of recordings.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_RECORDINGS, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_RECORDINGS)))]
    recordings: u32,
    /// Length of each recording.
    #[arg(long, value_name = "S", default_value_t = DEFAULT_SECONDS)]
    seconds: f64,
    /// Plan of more recordings of the same gripper, after the others.
    #[arg(long, value_name = "PLAN")]
    plan: Option<PathBuf>,
    /// Nominal design of the gripper [default: MAGPIE].
    #[arg(long, value_name = "PATH")]
    design: Option<PathBuf>,
    /// Number of sensors [default: that of the design].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SENSORS)))]
    sensors: Option<u32>,
    /// Orientation of a sensor by right angles: the gripper's axis along each of its own, x to z [default: +x+y+z]; with :reversed the
    /// poles of its magnet are exchanged. May be given several times; recorded only in the truth file.
    #[arg(long = "orientation", value_name = "SENSOR=AXES[:reversed]")]
    orientations: Vec<MountedSensor>,
    /// Factor on the manufacturing scatter; 0 is a nominal gripper.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scatter: f64,
    /// Factor on every load.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    load: f64,
    /// Temperature offset of the gripper and its environment.
    #[arg(long, value_name = "K", default_value_t = 0.0, allow_negative_numbers = true)]
    warmer: f64,
    /// Field noise model.
    #[arg(long, value_enum, default_value = "white")]
    noise: NoiseKind,
    /// White noise per field sample [default: that of the design's sensor].
    #[arg(long, value_name = "G")]
    field_noise: Option<f64>,
    /// White noise per reference sample.
    #[arg(long, value_name = "N", default_value_t = DEFAULT_REFERENCE_NOISE_N)]
    reference_noise: f64,
    /// Seed of all random numbers; the same seed gives identical files.
    // TOML (the truth file) has no larger integers.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seed: u64,
    /// File for the true parameters [default: CAMPAIGN-truth.toml].
    #[arg(long, value_name = "PATH")]
    truth: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Examples and the list of effects.
fn after_help() -> String {
    let mut text = "\
Examples:
  cargo magpie simulate -o clean
  cargo magpie simulate -o warm --effect magnet_temperature --effect creep=3
  cargo magpie simulate -o friction --effect hysteresis=2.5:both --programme isothermal
  cargo magpie simulate -o disturbed --effect external_magnet=60   # times in disturbed-truth.toml
  cargo magpie simulate -o hard --load 1.3 --warmer 15    # the same gripper beyond the fitted range
  cargo magpie simulate -o other --design design.toml     # another magnet, stiffness, number of sensors
  cargo magpie simulate -o mirrored --orientation 2=-x+y-z --orientation 3=-x+y-z    # two sensors turned about y
  cargo magpie simulate -o ripple --effect guide_ripple   # no effect of the catalogue
  cargo magpie simulate -o decided --programme single-sine --effect viscous_lag --plan plan.toml    # of diagnose --plan
  cargo magpie simulate -o blind --random-effects 2 --seed 7    # the solution is in blind-truth.toml

Effects with typical magnitudes (friction accepts the suffix :lateral, :longitudinal or :both):
"
    .to_owned();
    text += &effect_list(true);
    text += "\nEffects that no effect of the catalogue represents; never drawn at random:\n";
    text += &effect_list(false);
    text
}

/// Lines of the effects with their typical magnitudes.
fn effect_list(is_in_catalogue: bool) -> String {
    let kinds = EFFECT_KINDS.iter().filter(|kind| kind.is_in_catalogue == is_in_catalogue);
    let line = |kind: &EffectKind| {
        let typical = format!("{}={}", kind.id, kind.typical);
        format!("  {typical:<28} {:<6} {}\n", kind.unit, kind.magnitude.meaning)
    };
    kinds.map(line).collect()
}

/// Reads `ID` or `ID=MAGNITUDE`.
///
/// # Errors
/// An unknown effect, or a magnitude that is no number.
pub fn parse_effect(text: &str) -> Result<Effect, String> {
    text.parse().map_err(|error: anyhow::Error| format!("{error:#}"))
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let settings = settings(args)?;
    let bar = progress::progress_bar("simulating recordings", settings.numbers().count());
    let (truth, truth_path) =
        campaign::write(&settings, &args.output, args.truth.as_deref(), || bar.inc(1))?;
    bar.finish_and_clear();
    terminal::print_result(
        args.json,
        || to_json(&settings, &truth, &args.output, &truth_path),
        || format_report(&settings, &truth, &args.output, &truth_path),
    )
}

fn settings(args: &Args) -> Result<CampaignSettings> {
    if !(0.0..=MAX_STRENGTH).contains(&args.strength) {
        bail!("--strength {:?} is not possible here; give 0 to {MAX_STRENGTH}", args.strength);
    }
    let design = SensorDesign::read_or_magpie(args.design.as_deref())?;
    let sensors = args.sensors.unwrap_or(design.sensors);
    let settings = CampaignSettings {
        seed: args.seed,
        programme: args.programme,
        recordings: args.recordings,
        seconds: args.seconds,
        sensors,
        mountings: Mountings::new(&args.orientations, sensors)?,
        scatter: args.scatter,
        noise: args.noise,
        harder: args.load,
        warmer_k: args.warmer,
        field_noise_g: args.field_noise.unwrap_or(design.sensor.noise_gauss),
        reference_noise_n: args.reference_noise,
        effects: match args.random_effects {
            Some(count) => draw_random_effects(args.seed, count, args.strength)?,
            None => args.effects.clone(),
        },
        hidden: args.random_effects.is_some(),
        plan: args.plan.as_deref().map(RecordingPlan::read).transpose()?,
        ..CampaignSettings::of_design(&design)
    };
    settings.check_ranges().map_err(|error| anyhow!("--{error}"))?;
    Ok(settings)
}
