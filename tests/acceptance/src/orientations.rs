//! Sensors in all orientations, calibrated as emulated boards: orientation found, and the board's forces.

use analysis::fit::fit_model;
use analysis::progress;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use device::emulation::calibration::{ForceErrors, evaluate as evaluate_board, record_campaign};
use emulator::Image;
use firmware::sensors::hall::SENSORS;
use model_export::fit::FitOptions;
use model_export::model_file::BaseKind;
use model_export::physics::{SensorMounting, SensorOrientation};
use model_export::recordings::align::Alignment;
use rayon::prelude::*;
use sim::closed_loop::bench_programme::BenchSetup;
use sim::closed_loop::emulated_board::ChipConditions;
use sim::mountings::Mountings;
use tests::image::compile;

use crate::results::{Section, markdown_table, seeds_text};
use crate::{DefaultSeeds, Options, magpie};

const SEEDS: DefaultSeeds = DefaultSeeds { first: 1, full: 1, quick: 1 };
/// Length of a recording in seconds.
const SECONDS: f64 = 24.0;
/// Boards on which each orientation is that of one sensor.
const BOARDS: usize = 12;
/// Largest ratio of the force error to that of the board with nominal sensors.
const MAX_RATIO: f64 = 1.02;

/// Runs all boards: each orientation on two sensors.
pub fn evaluate(options: &Options) -> Result<Section> {
    let seeds = options.seeds(SEEDS);
    let boards = if options.quick { 1 } else { BOARDS };
    let all: Vec<SensorOrientation> = SensorOrientation::all().collect();
    // The second six boards have the orientations of the first six, each at another place.
    let of_board = |board: usize| -> Vec<SensorOrientation> {
        let place = |sensor: usize| board % 6 + 6 * ((sensor + board / 6) % SENSORS);
        (0..SENSORS).filter_map(|sensor| all.get(place(sensor)).copied()).collect()
    };
    let nominal = vec![SensorOrientation::default(); SENSORS];
    let cases: Vec<(u64, Vec<SensorOrientation>)> = seeds
        .clone()
        .flat_map(|seed| {
            let turned = (0..boards).map(of_board);
            std::iter::once(nominal.clone()).chain(turned).map(move |turned| (seed, turned))
        })
        .collect();
    let image = Image::read(&compile("default", None).map_err(|error| anyhow!(error))?)?;
    let bar = progress::progress_bar("boards", cases.len());
    let results: Vec<Outcome> = cases
        .par_iter()
        .map(|(seed, turned)| {
            let outcome = run(*seed, turned, &image).with_context(|| names(turned).join(" "))?;
            bar.inc(1);
            Ok(outcome)
        })
        .collect::<Result<_>>()?;
    bar.finish_and_clear();
    let nominal_n = |seed: u64| {
        let nominal = cases.iter().zip(&results).find(|((of, turned), _)| {
            *of == seed && turned.iter().all(SensorOrientation::is_nominal)
        });
        nominal.map_or(f64::NAN, |(_, outcome)| outcome.errors.board_n)
    };
    let turned = || {
        let all = cases.iter().zip(&results);
        all.filter(|((_, turned), _)| !turned.iter().all(SensorOrientation::is_nominal))
    };
    let ratio = |seed: u64, outcome: &Outcome| outcome.errors.board_n / nominal_n(seed);
    let (mut good, mut sensors) = (0, 0);
    for ((seed, _), outcome) in turned() {
        sensors += SENSORS;
        good += if ratio(*seed, outcome) <= MAX_RATIO { outcome.found } else { 0 };
    }
    let rows = cases.iter().zip(&results).map(|((seed, turned), outcome)| {
        [
            names(turned).join(", "),
            seed.to_string(),
            format!("{} of {SENSORS}", outcome.found),
            format!("{:.3}", outcome.errors.board_n),
            format!("{:.3}", outcome.errors.replay_n),
            format!("{:.3}", ratio(*seed, outcome)),
            format!("{:.1} %", 100.0 * outcome.errors.valid),
        ]
    });
    Ok(Section {
        id: "orientations",
        title: "Turned sensors on emulated boards",
        extent: format!(
            "{} boards, {}, three recordings of {SECONDS} s each",
            cases.len(),
            seeds_text(&seeds)
        ),
        conditions: format!(
            "The unmodified image in the emulated chip, with the drivetrain at its pins and a gripper of manufacturing tolerances \
             whose sensors are turned by right angles, each in two places. Recorded with the model of another gripper's campaign at \
             rest, which gives the orientations, fitted, uploaded, and run under other loads. RMS force errors over all sensors and axes of means over 10 ms. Specified: the orientation is \
             found, and the board's error is at most {MAX_RATIO} times that of the same board with nominal sensors ({good} of \
             {sensors} sensors)."
        ),
        tables: markdown_table(
            [
                "orientations",
                "seed",
                "found",
                "board, N",
                "replay, N",
                "board / nominal board",
                "valid rows",
            ],
            rows,
        ),
        is_met: Some(good == sensors),
    })
}

fn names(orientations: &[SensorOrientation]) -> Vec<String> {
    orientations.iter().map(ToString::to_string).collect()
}

/// Result of a board.
struct Outcome {
    /// Sensors whose orientation was found.
    found: usize,
    errors: ForceErrors,
}

fn run(seed: u64, turned: &[SensorOrientation], image: &Image) -> Result<Outcome> {
    let mounted = turned.iter().map(|orientation| SensorMounting {
        orientation: *orientation,
        ..SensorMounting::default()
    });
    let setup = BenchSetup {
        seed,
        excitation_seed: 2 * seed,
        scatter: 1.0,
        mountings: (0_u32..).zip(mounted).collect::<Mountings>(),
        effects: Vec::new(),
        recordings: 3,
        seconds: SECONDS,
    };
    let loads = BenchSetup { excitation_seed: 2 * seed + 1, recordings: 1, ..setup.clone() };
    let folder = tempfile::tempdir()?;
    let (campaign, conditions) = (folder.path().join("campaign"), ChipConditions::TYPICAL);
    // The board needs the orientations to home: they are those of a campaign without its motor, of another gripper.
    let still = folder.path().join("still");
    let nominal = folder.path().join("still.toml");
    simulate_still(&still, turned)?;
    magpie::run(&["fit".as_ref(), &*still, "-o".as_ref(), &*nominal], Some(1))?;
    record_campaign(image.clone(), &nominal, &setup, conditions, &campaign, || ())?;
    let aligned = Alignment { delay_us: 0.0 };
    let fit = fit_model(&campaign, BaseKind::Cylinder, None, aligned, FitOptions::default())?;
    let model = folder.path().join("model.toml");
    fit.model.write(&model)?;
    let is_found = |(sensor, orientation): &(u32, &SensorOrientation)| {
        fit.model.sensors.iter().any(|of| of.number == *sensor && of.orientation == **orientation)
    };
    Ok(Outcome {
        found: (0..).zip(turned).filter(is_found).count(),
        errors: evaluate_board(
            image.clone(),
            &model,
            &loads,
            conditions,
            &folder.path().join("evaluation"),
        )?,
    })
}

fn simulate_still(folder: &Path, turned: &[SensorOrientation]) -> Result<()> {
    let folder = folder.to_string_lossy();
    let mut arguments = vec!["simulate", "--programme", "still", "--seconds", "6", "--seed", "9"];
    let orientations: Vec<String> =
        turned.iter().enumerate().map(|(sensor, of)| format!("{sensor}={of}")).collect();
    arguments.extend(orientations.iter().flat_map(|of| ["--orientation", of]));
    arguments.extend(["-o", &folder]);
    magpie::run(&arguments, Some(1)).map(drop)
}
