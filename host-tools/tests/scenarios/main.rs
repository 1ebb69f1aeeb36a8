//! Every file in `tests/scenarios` happens to the board in virtual time.

mod bench;
mod file;
mod judge;

use std::path::{Path, PathBuf};
use std::process::Command;

use bench::{Bench, Layer};
use file::{Detector, Scenario};
use firmware::limits::Limits;
use firmware::parameters::Parameters;
use firmware::parameters::table::id;
use host_tools::board::pressed::Pressed;
use host_tools::board::{Board, Program};
use model_export::inverse::build::{Built, Variant, build};
use tempfile::TempDir;

const SEED: u64 = 1;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests")
}

/// The gripper on which all scenarios happen.
fn gripper() -> Built {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.toml");
    let status = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .arg("fit")
        .arg(root().join("data/clean"))
        .arg("-o")
        .arg(&path)
        .output()
        .unwrap()
        .status;
    assert!(status.success());
    build(&path, Variant::Fitted).unwrap()
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

/// Limits and parameters with a detector switched off.
fn without(detector: Option<Detector>) -> (Limits, Parameters) {
    let (mut limits, mut parameters) = (Limits::GRIPPER, Parameters::DEFAULT);
    match detector {
        None => {}
        Some(Detector::LostTicks) => limits.lost_ticks = u8::MAX,
        Some(Detector::FrozenAxes) => limits.frozen_axes = u8::MAX,
        Some(Detector::FailedTransfers) => limits.failed_transfers = u8::MAX,
        Some(Detector::StuckTicks) => limits.stuck_ticks = u8::MAX,
        Some(Detector::Unbalanced) => limits.unbalanced_n = i32::MAX,
        Some(Detector::OutsideTicks) => limits.outside_ticks = u8::MAX,
        Some(Detector::FloodFrames) => limits.flood_frames = u8::MAX,
        // As late as a host may ask for.
        Some(Detector::CommandTimeout) => parameters.set(id::COMMAND_TIMEOUT, 500).unwrap(),
    }
    (limits, parameters)
}

fn play(built: &Built, scenario: &Scenario, off: Option<Detector>) -> bench::Seen {
    let (limits, parameters) = without(off);
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        parameters,
        limits,
    };
    let left_n = scenario.grip_n / 2.0;
    let right_n = scenario.right_n.unwrap_or(scenario.grip_n) / 2.0;
    let world = Pressed::new(&built.model, SEED, move |_| {
        [left_n, left_n, -right_n, -right_n].map(|n| [n, 0.0])
    });
    let board = Board::start(program, Box::new(world));
    let (seen, _) = Bench::new(Layer::Loops(Box::new(board))).play(scenario);
    seen
}

#[test]
fn every_scenario_goes_as_its_file_says_and_not_without_its_detector() {
    let built = gripper();
    let scenarios = scenarios();
    assert!(scenarios.len() >= 10);
    let mut wrong = Vec::new();
    for (name, scenario) in &scenarios {
        let seen = play(&built, scenario, None);
        let (differences, latencies) = judge::judge(scenario, &seen, 0.0);
        for (fault, ms) in latencies {
            println!("{name}: {fault} after {ms:.2} ms ({})", scenario.shows);
        }
        wrong.extend(differences.iter().map(|words| format!("{name}: {words}")));
        if let Some(detector) = scenario.detector {
            let seen = play(&built, scenario, Some(detector));
            let (differences, _) = judge::judge(scenario, &seen, 0.0);
            if differences.is_empty() {
                wrong.push(format!("{name}: goes the same without {detector:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
