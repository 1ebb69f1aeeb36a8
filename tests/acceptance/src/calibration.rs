//! Grippers with hidden effects, calibrated as emulated boards: named effects, and force errors on the board.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use analysis::progress;
use anyhow::{Context, Result, anyhow};
use device::emulation::calibration::{ForceErrors, evaluate as evaluate_board, identify};
use emulator::Image;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use sim::closed_loop::bench_programme::BenchSetup;
use sim::closed_loop::emulated_board::ChipConditions;
use sim::effects::Effect;
use sim::mountings::Mountings;
use tests::image::compile;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 1, quick: 1 };
/// Effects that a device compensates, each alone, with a magnitude where the typical one is hidden by the noise of a bench whose
/// motor carries a few amperes; pairs; then effects that only formulas represent.
const HIDDEN: [&str; 22] = [
    "neighbour_magnet",
    "magnet_temperature",
    "hysteresis",
    "motor_leakage=8",
    "earth_field",
    "sensor_temperature",
    "thermal_gap",
    "fingertip_mass",
    "viscous_lag",
    "creep",
    "hard_stop",
    "geometric_stiffening",
    "tip_slope",
    "cross_coupling",
    "sensor_compression",
    "neighbour_magnet+magnet_temperature",
    "hysteresis+cross_coupling",
    "guide_ripple",
    "body_bending",
    "overhang",
    "cable_pull",
    "rate_gain",
];
const QUICK: [&str; 2] = ["magnet_temperature", "hysteresis"];
/// Length of a recording in seconds.
const SECONDS: [f64; 2] = [24.0, 9.0];
/// Largest ratio of the board's error to that of a replay of the same rows.
const MAX_RATIO: f64 = 1.05;
/// Least share of campaigns whose effects are named.
const MIN_NAMED: f64 = 0.95;

/// Calibrate emulated grippers with hidden effects, and compare the board's forces with the loads.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  cargo acceptance calibration hysteresis neighbour_magnet+creep=4"
)]
pub struct Args {
    /// Hidden effects as EFFECT or EFFECT=MAGNITUDE, joined by + [default: all that a device compensates, and two pairs].
    #[arg(value_name = "EFFECTS")]
    hidden: Vec<String>,
    /// Length of each of the three recordings in seconds [default: 24; quick: 9].
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Folder that receives recordings and models.
    #[arg(long, value_name = "FOLDER")]
    keep: Option<PathBuf>,
}

/// Runs one calibration per seed and set of effects.
pub fn evaluate(args: &Args, options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let default = if options.quick { QUICK.as_slice() } else { HIDDEN.as_slice() };
    let hidden: Vec<&str> = match args.hidden.as_slice() {
        [] => default.to_vec(),
        given => given.iter().map(String::as_str).collect(),
    };
    let seconds = args.seconds.unwrap_or(SECONDS[usize::from(options.quick)]);
    let cases: Vec<(&str, u64)> =
        hidden.iter().flat_map(|effects| seeds.clone().map(|seed| (*effects, seed))).collect();
    let image = Image::read(&compile("default", None).map_err(|error| anyhow!(error))?)?;
    let bar = progress::progress_bar("calibrations", cases.len());
    let log = Mutex::new(());
    let results: Vec<Outcome> = cases
        .par_iter()
        .map(|&(effects, seed)| {
            let outcome = run(effects, seed, seconds, &image, args.keep.as_deref())
                .with_context(|| format!("{effects}, seed {seed}"))?;
            bar.inc(1);
            let _log = log.lock();
            bar.suspend(|| eprintln!("{effects}, seed {seed}: {}", outcome.cells().join(" | ")));
            Ok(outcome)
        })
        .collect::<Result<_>>()?;
    bar.finish_and_clear();
    let named = results.iter().filter(|outcome| outcome.is_named).count();
    let has_errors = |outcome: &Outcome| outcome.ratio().is_some_and(|ratio| ratio <= MAX_RATIO);
    let is_met = named as f64 >= MIN_NAMED * results.len() as f64 && results.iter().all(has_errors);
    Ok(Section {
        id: "calibration",
        title: "Calibration of emulated boards",
        extent: format!(
            "{} calibrations, {}, three recordings of {seconds} s each",
            results.len(),
            seeds_text(&seeds)
        ),
        conditions: format!(
            "The unmodified image in the emulated chip, with the drivetrain at its pins and a gripper of manufacturing tolerances \
             with hidden effects. With the nominal model uploaded, recorded over the serial line with a reference (100 Hz, 0.15 N of noise, 20 ms late), fitted, \
             diagnosed, and run again under other loads after an upload of the new model. Force errors are RMS over all sensors and axes of \
             means over 10 ms, in newtons, of board and replay on the same rows. Before: with the fit without effects. Specified: effects named, \
             alone or among equivalent ones, in at least {:.0} % ({named} of {}), and a board's error of at most {MAX_RATIO} times \
             that of a replay.",
            100.0 * MIN_NAMED,
            results.len()
        ),
        tables: markdown_table(
            [
                "hidden effects",
                "seed",
                "named",
                "accepted",
                "held-out error, noise floors",
                "board before, N",
                "board after, N",
                "replay after, N",
                "board / replay",
                "max difference of a row, N",
                "valid rows",
            ],
            cases.iter().zip(&results).map(|((effects, seed), outcome)| {
                let [named, accepted, floors, before, after, replay, ratio, difference, valid] =
                    outcome.cells();
                let (effects, seed) = ((*effects).to_owned(), seed.to_string());
                [
                    effects, seed, named, accepted, floors, before, after, replay, ratio,
                    difference, valid,
                ]
            }),
        ),
        is_met: Some(is_met),
    })
}

/// Result of a calibration.
struct Outcome {
    is_named: bool,
    accepted: Vec<Vec<String>>,
    floors: [f64; 2],
    /// With the fit without effects.
    before: Result<ForceErrors>,
    /// With the effects that the diagnosis names.
    after: Result<ForceErrors>,
}

impl Outcome {
    /// Error of the board relative to that of a replay.
    fn ratio(&self) -> Option<f64> {
        self.after.as_ref().ok().map(|after| after.board_n / after.replay_n)
    }

    fn cells(&self) -> [String; 9] {
        let newtons = |run: &Result<ForceErrors>, of: fn(&ForceErrors) -> f64, decimals| match run {
            Ok(errors) => format!("{:.decimals$}", of(errors)),
            Err(error) => format!("{error:#}"),
        };
        let [plain, full] = self.floors;
        let steps: Vec<String> = self.accepted.iter().map(|step| step.join(" or ")).collect();
        [
            if self.is_named { "yes" } else { "NO" }.to_owned(),
            steps.join(", "),
            format!("{plain:.2} to {full:.2}"),
            newtons(&self.before, |errors| errors.board_n, 3),
            newtons(&self.after, |errors| errors.board_n, 3),
            newtons(&self.after, |errors| errors.replay_n, 3),
            newtons(&self.after, |errors| errors.board_n / errors.replay_n, 3),
            newtons(&self.after, |errors| errors.max_difference_n, 3),
            newtons(&self.after, |errors| 100.0 * errors.valid, 1) + " %",
        ]
    }
}

fn run(
    hidden: &str,
    seed: u64,
    seconds: f64,
    image: &Image,
    keep: Option<&Path>,
) -> Result<Outcome> {
    let effects = hidden.split('+').map(str::parse).collect::<Result<Vec<Effect>>>()?;
    let setup = BenchSetup {
        seed,
        excitation_seed: 2 * seed,
        scatter: 1.0,
        mountings: Mountings::default(),
        effects,
        recordings: 3,
        seconds,
    };
    let loads = BenchSetup { excitation_seed: 2 * seed + 1, recordings: 1, ..setup.clone() };
    let name: String = hidden.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
    let name = format!("calibration-{name}-{seed}");
    let temporary = tempfile::tempdir()?;
    let folder = keep.map_or_else(|| temporary.path().to_owned(), |folder| folder.join(&name));
    let conditions = ChipConditions::TYPICAL;
    let nominal = tests::data("default/model.toml");
    let found = identify(image.clone(), &nominal, &setup, conditions, &folder)?;
    let board = |model: &Path, name: &str| {
        evaluate_board(image.clone(), model, &loads, conditions, &folder.join(name))
    };
    Ok(Outcome {
        is_named: found.names(&setup.effects),
        before: board(&found.plain, "before"),
        after: board(&found.model, "after"),
        accepted: found.accepted,
        floors: found.floors,
    })
}
