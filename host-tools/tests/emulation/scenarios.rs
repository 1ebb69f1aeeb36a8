//! The scenario files of `tests/scenarios` on the image.

use std::path::Path;

use libtest_mimic::{Failed, Trial};
use sim::board::world::PressedWorld;
use sim::closed_loop::emulated_board::{ChipConditions, EmulatedBoard};
use sim::drivetrain::parameters::{Lead, PlantParameters};

use crate::boards::{gripper, image, violations};
use crate::evaluate::evaluate;
use crate::file::Scenario;
use crate::images::Variant;
use crate::rig::{Layer, ScenarioRig};

/// Longest estimate, and whatever is more urgent meanwhile.
const EXECUTION_MS: f64 = 0.3;

pub fn trials() -> Vec<Trial> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenarios");
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files = paths.filter(|path| path.extension().is_some_and(|end| end == "toml"));
    let mut trials: Vec<_> = files
        .map(|path| {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let text = std::fs::read_to_string(&path).unwrap();
            let scenario: Scenario =
                toml::from_str(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
            Trial::test(format!("scenario_{name}"), move || play(&scenario))
        })
        .collect();
    trials.sort_by(|a, b| a.name().cmp(b.name()));
    trials
}

fn play(scenario: &Scenario) -> Result<(), Failed> {
    let made = image(Variant::Clean)?;
    let left_n = scenario.grip_n / 2.0;
    let right_n = scenario.right_n.unwrap_or(scenario.grip_n) / 2.0;
    let forces = [left_n, left_n, -right_n, -right_n].map(|newtons| [newtons, 0.0]);
    let world = PressedWorld::new(&made.built.model, 1, move |_| forces);
    // The motor is armed: a rotor sensor without noise would be one that is stuck.
    let gripper = gripper(PlantParameters::nominal(Lead::A), 40.0, 1);
    let board =
        EmulatedBoard::start(made.image.clone(), ChipConditions::SLOW, Box::new(world), gripper)?;
    let (seen, layer) = ScenarioRig::new(Layer::Image(Box::new(board))).play(scenario);
    let (mut wrong, latencies) = evaluate(scenario, &seen, EXECUTION_MS);
    for (fault, ms) in latencies {
        println!("{fault} after {ms:.2} ms ({})", scenario.shows);
    }
    if let Layer::Image(board) = layer {
        wrong.extend(violations(&board));
        wrong.extend(board.chip.resets.iter().map(|reset| format!("{reset:?}")));
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n").into()) }
}
