//! Runs every scenario of `tests/scenarios` on the board in virtual time.

mod evaluate;
mod file;
mod rig;
#[path = "../workdir/mod.rs"]
mod workdir;

use std::path::{Path, PathBuf};

use file::{Detector, Scenario};
use firmware::config::limits::DetectionLimits;
use firmware::parameters::Parameters;
use firmware::parameters::schema::id;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use rig::{Layer, ScenarioRig};
use sim::board::world::PressedWorld;
use sim::board::{Program, VirtualTimeBoard};
use workdir::fitted_model;

const SEED: u64 = 1;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests")
}

/// Gripper of all scenarios.
fn gripper() -> DeviceModel {
    build(&fitted_model("clean"), ModelVariant::Fitted).unwrap()
}

fn scenarios() -> Vec<(String, Scenario)> {
    let folder = std::fs::read_dir(root().join("scenarios")).unwrap();
    let paths = folder.map(|entry| entry.unwrap().path());
    let mut found: Vec<_> = paths
        .filter(|path| path.extension().is_some_and(|end| end == "toml"))
        .map(|path| {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let text = std::fs::read_to_string(&path).unwrap();
            let scenario = toml::from_str(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
            (name, scenario)
        })
        .collect();
    found.sort_by(|(a, _), (b, _)| a.cmp(b));
    found
}

/// Limits and settings with a detector disabled.
fn without(detector: Option<Detector>) -> (DetectionLimits, Parameters) {
    let (mut limits, mut parameters) = (DetectionLimits::GRIPPER, Parameters::DEFAULT);
    match detector {
        None => {}
        Some(Detector::LostTicks) => limits.lost_ticks = u8::MAX,
        Some(Detector::FrozenAxes) => limits.frozen_axes = None,
        Some(Detector::FailedTransfers) => limits.failed_transfers = u8::MAX,
        Some(Detector::StuckTicks) => limits.stuck_ticks = u8::MAX,
        Some(Detector::Unbalanced) => limits.unbalanced_n = i32::MAX,
        Some(Detector::OutsideTicks) => limits.outside_ticks = u8::MAX,
        Some(Detector::FloodFrames) => limits.flood_frames = u8::MAX,
        // The maximum of the setting.
        Some(Detector::CommandTimeout) => parameters.set(id::COMMAND_TIMEOUT, 500).unwrap(),
    }
    (limits, parameters)
}

fn play(built: &DeviceModel, scenario: &Scenario, off: Option<Detector>) -> rig::Observed {
    let (limits, parameters) = without(off);
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        description: "",
        parameters,
        limits,
    };
    let left_n = scenario.grip_n / 2.0;
    let right_n = scenario.right_n.unwrap_or(scenario.grip_n) / 2.0;
    let world = PressedWorld::new(&built.model, SEED, move |_| {
        [left_n, left_n, -right_n, -right_n].map(|n| [n, 0.0])
    });
    let board = VirtualTimeBoard::start(program, Box::new(world));
    let (observed, _) = ScenarioRig::new(Layer::Loops(Box::new(board))).play(scenario);
    observed
}

#[test]
fn every_scenario_needs_its_detector_to_pass() {
    let built = gripper();
    let scenarios = scenarios();
    assert!(scenarios.len() >= 10);
    let mut wrong = Vec::new();
    for (name, scenario) in &scenarios {
        let observed = play(&built, scenario, None);
        let (differences, latencies) = evaluate::evaluate(scenario, &observed, 0.0);
        for (fault, ms) in latencies {
            println!("{name}: {fault} after {ms:.2} ms ({})", scenario.shows);
        }
        wrong.extend(differences.iter().map(|text| format!("{name}: {text}")));
        if let Some(detector) = scenario.detector {
            let observed = play(&built, scenario, Some(detector));
            let (differences, _) = evaluate::evaluate(scenario, &observed, 0.0);
            if differences.is_empty() {
                wrong.push(format!("{name}: passes without {detector:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
