//! A gripper with a hidden effect is calibrated as on a bench: the diagnosis names the effect, and the board compensates it under
//! new loads as well as a replay does.

use anyhow::{Result, anyhow, ensure};
use device::emulation::calibration::{evaluate, identify};
use libtest_mimic::{Failed, Trial};
use sim::closed_loop::bench::BenchSetup;
use tests::data;

use crate::boards::{TYPICAL, image};
use crate::images::Variant;

/// One effect for each way in which the board obtains its input: a register of the sensors, encoder and homing, the history of
/// the forces.
const EFFECTS: [&str; 3] = ["magnet_temperature", "neighbour_magnet", "hysteresis"];
/// Largest ratio of the board's error to that of a replay of the same rows.
const MAX_RATIO: f64 = 1.05;

pub fn trials() -> Vec<Trial> {
    let trial = |effect: &'static str| {
        Trial::test(format!("calibration_of_{effect}"), move || calibrates(effect))
    };
    EFFECTS.into_iter().map(trial).collect()
}

fn calibrates(effect: &str) -> Result<(), Failed> {
    let setup = BenchSetup {
        seed: 1,
        excitation_seed: 1,
        scatter: 1.0,
        effects: vec![effect.parse().map_err(|error| format!("{error:#}"))?],
        recordings: 3,
        seconds: 9.0,
    };
    let evaluation = BenchSetup { excitation_seed: 2, recordings: 1, ..setup.clone() };
    let run = || -> Result<()> {
        let folder = tempfile::tempdir()?;
        let image = image(Variant::Default).map_err(|failed| anyhow!("{failed:?}"))?.image;
        let nominal = data("default/model.toml");
        let found = identify(image.clone(), &nominal, &setup, TYPICAL, folder.path())?;
        println!("{effect}: {:?}, {:.2?} noise floors", found.accepted, found.floors);
        ensure!(found.names(&setup.effects), "{:?}", found.accepted);
        let recording = folder.path().join("evaluation");
        let errors = evaluate(image, &found.model, &evaluation, TYPICAL, &recording)?;
        println!("{effect}: {errors:?}");
        ensure!(errors.board_n <= MAX_RATIO * errors.replay_n, "{errors:?}");
        Ok(())
    };
    run().map_err(|error| Failed::from(format!("{error:#}")))
}
