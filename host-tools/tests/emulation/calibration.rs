//! A gripper with a hidden effect is calibrated as on a bench: the diagnosis names the effect, and the board compensates it under
//! new loads as well as a replay does.

use anyhow::{Result, anyhow, ensure};
use device::calibration_client;
use device::emulation::calibration::{evaluate, identify, record};
use device::emulation::line::EmulatedLine;
use device::session::{Credentials, with_session};
use device_run::networks::NetworkSet;
use emulator::Image;
use firmware::config::constants::TICK_US;
use libtest_mimic::{Failed, Trial};
use model_export::inverse::build::{ModelVariant, build};
use model_export::inverse::calibration::{CalibrationDescription, encode_calibration};
use sim::closed_loop::bench::EmulatedBench;
use sim::closed_loop::bench_programme::BenchSetup;
use sim::closed_loop::emulated_board::ChipConditions;
use sim::mountings::Mountings;
use tests::data;

use crate::Effort;
use crate::boards::{LOAD_WITHOUT_CACHES, TYPICAL, WORST_TICK_WITHOUT_CACHES_US, image};
use crate::images::Variant;
use crate::motion::{grip_and_release, home, keeps_limits};
use crate::workdir::WorkDir;

/// One effect for each way in which the board obtains its input: a register of the sensors, encoder and homing, the history of
/// the forces.
const EFFECTS: [&str; 3] = ["magnet_temperature", "neighbour_magnet", "hysteresis"];
/// The one whose gripper is also driven, with compensation and networks: its input depends on the motion.
const WITH_NETWORKS: &str = "neighbour_magnet";
/// Largest ratio of the board's error to that of a replay of the same rows.
const MAX_RATIO: f64 = 1.05;
/// Bounds of a gripper without effects: the error of a replay in newtons, and the share of valid forces.
const MAX_ERROR_N: f64 = 0.3;
const MIN_VALID: f64 = 0.9;

/// All columns of a recording that do not belong to a sensor.
const COVARIATES: &str = "opening_mm,motor_iq_a,motor_angle_rad,accel_x_mps2,accel_y_mps2,accel_z_mps2,roll_rad,pitch_rad,yaw_rad";

pub fn trials(effort: Effort) -> Vec<Trial> {
    let trial = |effect: &'static str| {
        Trial::test(format!("calibration_of_{effect}"), move || calibrates(effect))
    };
    let mut trials: Vec<Trial> = EFFECTS.into_iter().map(trial).collect();
    let seconds = if effort == Effort::Acceptance { 100 } else { 5 };
    trials.push(Trial::test("calibration_of_turned_sensors", calibrates_turned_sensors));
    trials.push(Trial::test("recording_loses_no_tick", move || records(seconds)));
    trials
}

/// Every tick of a moving gripper arrives, with all columns, where no access to flash is served by a cache.
fn records(seconds: u32) -> Result<(), Failed> {
    let setup = BenchSetup {
        seed: 1,
        excitation_seed: 1,
        scatter: 1.0,
        mountings: Mountings::default(),
        effects: Vec::new(),
        recordings: 1,
        seconds: seconds.into(),
    };
    let folder = tempfile::tempdir()?;
    let image = image(Variant::Nominal)?.image.clone();
    let mut bench = EmulatedBench::power_on(image, ChipConditions::SLOW, &setup)?;
    bench.home(true)?;
    let forces = record(&mut bench, &setup, 0, folder.path())?;
    println!("{} ticks in {seconds} s, {}", forces.len(), bench.report());
    let times = forces.keys().zip(forces.keys().skip(1));
    let steps_us: Vec<u64> = times.map(|(first, second)| second - first).collect();
    // A tick may begin late by 50 us. Both ends of the recording may be ticks; the last ones are on their way at its end.
    assert!(steps_us.iter().all(|step_us| *step_us <= TICK_US + 60), "{steps_us:?}");
    let expected = 1000 * seconds as usize;
    assert!((expected - 2..=expected + 1).contains(&forces.len()), "{}", forces.len());
    let rows = std::fs::read_to_string(folder.path().join("hall.csv"))?;
    let mut lines = rows.lines();
    let header = lines.next().unwrap_or_default();
    assert!(header.ends_with(COVARIATES), "{header}");
    let empty = lines.clone().filter(|line| line.split(',').any(str::is_empty)).count();
    assert_eq!((lines.count(), empty), (forces.len(), 0));
    Ok(())
}

fn calibrates(effect: &str) -> Result<(), Failed> {
    let setup = BenchSetup {
        seed: 1,
        excitation_seed: 1,
        scatter: 1.0,
        mountings: Mountings::default(),
        effects: vec![effect.parse().map_err(|error| format!("{error:#}"))?],
        recordings: 3,
        seconds: 4.0,
    };
    let evaluation =
        BenchSetup { excitation_seed: 2, recordings: 1, seconds: 3.0, ..setup.clone() };
    let run = || -> Result<()> {
        let dir = WorkDir::empty();
        let folder = dir.0.path();
        let image = image(Variant::Default).map_err(|failed| anyhow!("{failed:?}"))?.image.clone();
        let nominal = data("default/model.toml");
        let found = identify(image.clone(), &nominal, &setup, TYPICAL, folder)?;
        println!("{effect}: {:?}, {:.2?} noise floors", found.accepted, found.floors);
        ensure!(found.names(&setup.effects), "{:?}", found.accepted);
        let recording = folder.join("evaluation");
        let errors = evaluate(image.clone(), &found.model, &evaluation, TYPICAL, &recording)?;
        println!("{effect}: {errors:?}");
        ensure!(errors.board_n <= MAX_RATIO * errors.replay_n, "{errors:?}");
        if effect == WITH_NETWORKS {
            grips_with_networks(image, &dir, &evaluation)?;
        }
        Ok(())
    };
    run().map_err(|error| Failed::from(format!("{error:#}")))
}

/// The sensors of the second finger are turned, one of them by 180 degrees as in a mirrored finger, the other one with a reversed
/// magnet. The board needs their orientations to home, which a campaign without its motor gives.
fn calibrates_turned_sensors() -> Result<(), Failed> {
    let orientations = ["2=-x+y-z", "3=+z+x+y:reversed"];
    let mounted = orientations.map(|text| text.parse().expect("an orientation"));
    let setup = BenchSetup {
        seed: 1,
        excitation_seed: 1,
        scatter: 1.0,
        mountings: Mountings::new(&mounted, 4)?,
        effects: Vec::new(),
        recordings: 3,
        seconds: 4.0,
    };
    let evaluation =
        BenchSetup { excitation_seed: 2, recordings: 1, seconds: 4.0, ..setup.clone() };
    let dir = WorkDir::empty();
    let options = orientations.map(|text| format!("--orientation {text}")).join(" ");
    dir.stdout(&format!("simulate -o still --programme still --seconds 6 --seed 9 {options}"));
    dir.stdout("fit still -o still.toml");
    let image = image(Variant::Default)?.image.clone();
    let folder = dir.0.path();
    let found = identify(image.clone(), &dir.path("still.toml"), &setup, TYPICAL, folder)?;
    assert_eq!(found.accepted.len(), 0, "{:?}", found.accepted);
    let errors = evaluate(image, &found.model, &evaluation, TYPICAL, &folder.join("evaluation"))?;
    println!("turned sensors: {errors:?}");
    assert!(errors.board_n <= MAX_RATIO * errors.replay_n, "{errors:?}");
    assert!(errors.replay_n < MAX_ERROR_N && errors.valid > MIN_VALID, "{errors:?}");
    Ok(())
}

/// The gripper grips with everything that a board can run, compensation and a network for each sensor, where no access to flash
/// is served by a cache.
fn grips_with_networks(image: Image, dir: &WorkDir, setup: &BenchSetup) -> Result<()> {
    dir.stdout("train model.toml campaign -o networks.safetensors --target residual --epochs 6");
    let built = build(&dir.0.path().join("model.toml"), ModelVariant::Fitted)?;
    let networks = NetworkSet::read(&dir.0.path().join("networks.safetensors"), &built)?;
    let networks = &networks.file.networks;
    let bytes =
        encode_calibration(&built, networks, &CalibrationDescription::of(&built, networks))?;
    // Nothing presses on the fingertips but the object.
    let setup = BenchSetup { recordings: 1, seconds: 0.1, ..setup.clone() };
    let mut bench = EmulatedBench::power_on(image, ChipConditions::SLOW, &setup)?;
    bench.start()?;
    let begun_s = bench.time_s();
    let cell = &mut bench.cell;
    let link = cell.board.connections.line.clone();
    let mut line = EmulatedLine::new(link, || cell.step());
    with_session(&mut line, Credentials::UNPROTECTED, |session| {
        calibration_client::upload(session, &bytes, |_| ())?;
        calibration_client::reboot_into(session, built.chosen.tables.id)
    })?;
    drop(line);
    println!("{} bytes in {:.2} s", bytes.len(), bench.time_s() - begun_s);
    bench.start()?;
    let cell = &mut bench.cell;
    // So far the board ran the tables of another gripper.
    cell.host.received.faults.clear();
    cell.board.chip.clear_profile();
    home(cell);
    grip_and_release(cell, 2.0);
    keeps_limits(cell, LOAD_WITHOUT_CACHES, WORST_TICK_WITHOUT_CACHES_US);
    Ok(())
}
