//! Calibration of an emulated gripper with hidden effects, as on a real one: recordings over its serial line with a reference,
//! fit, diagnosis, tables on the board, and the errors of the board's forces under new loads.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use analysis::compare::campaign_reader::read_campaign;
use analysis::diagnose::observer::Observer;
use analysis::diagnose::{Scope, StaircaseStep, diagnose};
use analysis::edit_model::refit;
use analysis::fit::fit_model;
use analysis::model::Model;
use analysis::reference_delay::align_recording;
use analysis::replay::replay_with;
use anyhow::{Context, Result, bail, ensure};
use device_run::ReplayModels;
use emulator::Image;
use firmware::config::constants;
use firmware::protocol::serial::Packet;
use firmware::sensors::hall::SENSORS;
use model_export::effects::{EffectTerm, find};
use model_export::fit::FitOptions;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::calibration::{CalibrationDescription, encode_calibration};
use model_export::model_file::BaseKind;
use model_export::recordings::align::Alignment;
use model_export::recordings::description::{NominalDesign, RecordingDescription};
use model_export::recordings::stream::RawStream;
use sim::campaign::recording::force_columns;
use sim::closed_loop::bench::EmulatedBench;
use sim::closed_loop::bench_programme::BenchSetup;
use sim::closed_loop::emulated_board::ChipConditions;
use sim::effects::Effect;
use sim::random::{Purpose, normal, stream};

use crate::calibration_client;
use crate::emulation::line::EmulatedLine;
use crate::recorder::{Recorder, SensorRowAssembler};
use crate::reference::ReferenceClock;
use crate::session::{Credentials, with_session};

/// Period of the reference, its delay and its white noise, as of a load cell with an amplifier.
const REFERENCE_S: f64 = 0.01;
const REFERENCE_DELAY_S: f64 = 0.02;
const REFERENCE_NOISE_N: f64 = 0.15;
/// Validity code of a force that the device considers valid.
const VALID: u8 = 0;
/// Rows over which errors are averaged: a period of the reference. The noise of single rows would hide the effects.
const BLOCK_ROWS: u32 = 10;
/// The clocks are aligned by the recorder.
const ALIGNED: Alignment = Alignment { delay_us: 0.0 };

/// Model of a gripper with hidden effects.
pub struct Identification {
    /// Model file of the fit without effects.
    pub plain: PathBuf,
    /// Model file with the effects that the diagnosis names; that of the fit if it names none.
    pub model: PathBuf,
    /// Accepted steps of the diagnosis, each one effect or several equivalent ones.
    pub accepted: Vec<Vec<String>>,
    /// Held-out error of the field relative to the noise floor, without and with the effects.
    pub floors: [f64; 2],
}

impl Identification {
    /// Whether the diagnosis names these effects, each alone or among equivalent ones, and no other; of those outside the
    /// catalogue, whether it finds formulas.
    pub fn names(&self, hidden: &[Effect]) -> bool {
        let is_in = |step: &[String], effect: &Effect| {
            step.iter().any(|id| match effect.kind.is_in_catalogue {
                true => id == effect.kind.id,
                false => find(id).is_err(),
            })
        };
        hidden.iter().all(|effect| self.accepted.iter().any(|step| is_in(step, effect)))
            && self.accepted.iter().all(|step| hidden.iter().any(|effect| is_in(step, effect)))
    }
}

/// RMS errors of the forces over all sensors and axes of a recording, averaged over ten rows, on the same rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceErrors {
    pub board_n: f64,
    /// Of a replay of its readings, in newtons.
    pub replay_n: f64,
    /// Largest difference between the forces of board and replay in one row, in newtons.
    pub max_difference_n: f64,
    /// Share of the forces that board and replay consider valid.
    pub valid: f64,
}

/// Forces that the board reported with each row, by the row's time in microseconds since the first.
pub type BoardForces = BTreeMap<u64, [Option<[f64; 2]>; SENSORS]>;

/// Uploads the model of the nominal design, and records a campaign. `nominal` is any model of this design; `done` is called after
/// each recording.
///
/// # Errors
/// A step fails, as it would on a real gripper.
pub fn record_campaign(
    image: Image,
    nominal: &Path,
    setup: &BenchSetup,
    conditions: ChipConditions,
    campaign: &Path,
    done: impl Fn(),
) -> Result<()> {
    let mut bench = EmulatedBench::power_on(image, conditions, setup)?;
    upload(&mut bench, &build(nominal, ModelVariant::Nominal)?)?;
    bench.home(true).context("with the nominal tables")?;
    for recording in 0..setup.recordings {
        record(&mut bench, setup, recording, &campaign.join((recording + 1).to_string()))?;
        done();
    }
    Ok(())
}

/// Uploads the model of the nominal design, records a campaign, fits the physics, and adds the effects that the diagnosis names.
/// `nominal` is any model of this design; `folder` receives all files.
///
/// # Errors
/// A step fails, as it would on a real gripper.
pub fn identify(
    image: Image,
    nominal: &Path,
    setup: &BenchSetup,
    conditions: ChipConditions,
    folder: &Path,
) -> Result<Identification> {
    let campaign = folder.join("campaign");
    record_campaign(image, nominal, setup, conditions, &campaign, || ())?;
    let options = FitOptions::default();
    let [plain, better] = ["plain.toml", "model.toml"].map(|name| folder.join(name));
    let fit = fit_model(&campaign, BaseKind::Cylinder, None, ALIGNED, options)?;
    fit.model.write(&plain)?;
    let recordings = read_campaign(&campaign, ALIGNED)?;
    let model = Model::of(&plain, fit.model)?;
    let (diagnosis, _) = diagnose(
        (&recordings, ALIGNED),
        &model,
        &[],
        Scope::CATALOGUE,
        options,
        &Observer::default(),
    )?;
    let effects: Vec<EffectTerm> =
        diagnosis.accepted_steps()?.into_iter().flat_map(|(_, terms)| terms).collect();
    let path = if effects.is_empty() {
        plain.clone()
    } else {
        let edit = refit(recordings, &model, effects, ALIGNED, options)?;
        edit.model.write(&better)?;
        better
    };
    let floors = |step: Option<&StaircaseStep>| {
        step.map_or(f64::NAN, |step| step.held_out_rms_g / step.floor_g)
    };
    let stairs = &diagnosis.staircase;
    Ok(Identification {
        plain,
        model: path,
        floors: [floors(stairs.first()), floors(stairs.last())],
        accepted: diagnosis.accepted,
    })
}

/// Uploads a model, runs the board under the loads of `setup`, and compares its forces with the reference. `folder` receives the
/// recording.
///
/// # Errors
/// The device cannot compensate an effect of the model, or the board does not home or record.
pub fn evaluate(
    image: Image,
    model: &Path,
    setup: &BenchSetup,
    conditions: ChipConditions,
    folder: &Path,
) -> Result<ForceErrors> {
    let built = build(model, ModelVariant::Fitted)?;
    if let Some((effect, reason)) = built.uncompensated.first() {
        bail!("the device never compensates {effect}: {reason}");
    }
    let mut bench = EmulatedBench::power_on(image, conditions, setup)?;
    upload(&mut bench, &built)?;
    bench.home(false).context("with the fitted tables")?;
    let forces = record(&mut bench, setup, 0, folder)?;
    errors(&built, folder, &forces)
}

/// Uploads a calibration over the serial line and reboots the board.
fn upload(bench: &mut EmulatedBench, built: &DeviceModel) -> Result<()> {
    bench.start()?;
    let bytes = encode_calibration(built, &[], &CalibrationDescription::of(built, &[]))?;
    let link = bench.cell.board.connections.line.clone();
    let mut line = EmulatedLine::new(link, || bench.step());
    with_session(&mut line, Credentials::UNPROTECTED, |session| {
        calibration_client::upload(session, &bytes, |_| ())?;
        calibration_client::reboot_into(session, built.chosen.tables.id)
    })
}

/// Records over the serial line, with the loads as the reference; `recording` counts from 0.
///
/// # Errors
/// The board cannot continue, a tick is lost, or the reference cannot be aligned.
pub fn record(
    bench: &mut EmulatedBench,
    setup: &BenchSetup,
    recording: u32,
    folder: &Path,
) -> Result<BoardForces> {
    bench.run_to(recording as usize)?;
    let begin_s = bench.time_s();
    let columns = force_columns(0..SENSORS as u32).split_off(1);
    let mut rows = SensorRowAssembler::of_ticks();
    let mut recorder =
        Recorder::new(folder, description(recording), rows.period_us(), Some(columns))?;
    let mut clock = ReferenceClock::default();
    let mut rng = stream(setup.excitation_seed, Purpose::ReferenceNoise, recording);
    let mut forces = BoardForces::new();
    let mut first_us = None;
    let mut samples = 0;
    while bench.time_s() < begin_s + setup.seconds {
        for (at_s, packet) in bench.record()? {
            let Ok(row) = rows.take(at_s, &packet) else {
                bail!("the board restarted: {}", bench.report())
            };
            let (Some(row), Packet::Tick(tick)) = (row, packet) else { continue };
            let time_us = row.time_us - *first_us.get_or_insert(row.time_us);
            let newtons = tick.sensors.map(|sensor| {
                let valid = sensor.validity == VALID;
                valid.then(|| sensor.force.map(|force| f64::from(force) / 1024.0))
            });
            forces.insert(time_us, newtons);
            clock.board(at_s, row.time_us);
            recorder.take(row)?;
        }
        // A sample arrives later than it was measured.
        while begin_s + f64::from(samples) * REFERENCE_S + REFERENCE_DELAY_S <= bench.time_s() {
            let time_s = begin_s + f64::from(samples) * REFERENCE_S;
            samples += 1;
            let loads = (0..SENSORS).flat_map(|sensor| bench.programme().load_n(sensor, time_s));
            let force_n = loads.map(|load_n| load_n + REFERENCE_NOISE_N * normal(&mut rng));
            let force_n: Vec<f64> = force_n.collect();
            if let Some(board_us) = clock.board_us(time_s + REFERENCE_DELAY_S, Some(time_s)) {
                recorder.take_reference(board_us, &force_n)?;
            }
        }
    }
    let counts = recorder.finish()?;
    let alignment = align_recording(folder)?;
    ensure!(
        counts.lost == 0 && counts.left_out == 0 && alignment.doubt.is_none(),
        "{counts:?} {alignment:?}: {}",
        bench.report()
    );
    Ok(forces)
}

fn description(recording: u32) -> RecordingDescription {
    let mut description =
        RecordingDescription::new("emulated gripper on a bench", 600.0 * f64::from(recording));
    description.gauss_per_lsb = Some(constants::SENSOR_SCALE.value);
    description.range_gauss = Some(constants::SENSOR_RANGE.value);
    let mut design = NominalDesign::magpie();
    let pole_pairs = constants::POLE_PAIRS.value as i64;
    design.more.insert("motor_pole_pairs".to_owned(), pole_pairs.into());
    description.design = Some(design);
    description
}

/// Errors of the board and of a replay of the same rows.
fn errors(built: &DeviceModel, folder: &Path, forces: &BoardForces) -> Result<ForceErrors> {
    let stream = RawStream::open_folder(folder, ALIGNED)?;
    let mut blocks = [[ErrorBlock::default(); 2]; SENSORS];
    let mut means: Vec<[f64; 2]> = Vec::new();
    let (mut valid, mut max_difference_n) = (0_usize, 0.0_f64);
    replay_with(
        ReplayModels::of(built),
        "evaluation",
        stream,
        |_| (),
        |sample| {
            let time_us = (1e6 * sample.time_s).round() as u64;
            let reported = forces.get(&time_us).and_then(|forces| forces[sample.sensor]);
            let Some(reported) = reported else { return };
            valid += 1;
            for axis in 0..2 {
                let (board_n, replay_n) = (reported[axis], sample.estimate_n[axis]);
                max_difference_n = max_difference_n.max((board_n - replay_n).abs());
                let errors_n =
                    [board_n, replay_n].map(|force_n| force_n - sample.reference_n[axis]);
                means.extend(blocks[sample.sensor][axis].add(errors_n));
            }
        },
    )?;
    ensure!(!means.is_empty(), "no row has a valid force of the board");
    let rms = |of: usize| {
        let squares: f64 = means.iter().map(|errors_n| errors_n[of].powi(2)).sum();
        (squares / means.len() as f64).sqrt()
    };
    Ok(ForceErrors {
        board_n: rms(0),
        replay_n: rms(1),
        max_difference_n,
        valid: valid as f64 / (SENSORS * forces.len()) as f64,
    })
}

/// Sum of the errors of board and replay over successive rows.
#[derive(Clone, Copy, Debug, Default)]
struct ErrorBlock {
    rows: u32,
    sums_n: [f64; 2],
}

impl ErrorBlock {
    /// Adds a row; the means where it completes the block.
    fn add(&mut self, errors_n: [f64; 2]) -> Option<[f64; 2]> {
        self.rows += 1;
        for (sum_n, error_n) in self.sums_n.iter_mut().zip(errors_n) {
            *sum_n += error_n;
        }
        if self.rows < BLOCK_ROWS {
            return None;
        }
        let means_n = self.sums_n.map(|sum_n| sum_n / f64::from(BLOCK_ROWS));
        *self = Self::default();
        Some(means_n)
    }
}
