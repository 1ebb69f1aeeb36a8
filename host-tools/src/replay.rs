//! Recorded data through the device's own code, row by row, beside the reference.

use std::time::{Duration, Instant};

use firmware::compensate::{Compensation, Memory};
use firmware::estimator::Estimator;
use firmware::force::{Validity, estimate};
use firmware::frame::Frame;
use firmware::params;
use firmware::units::{Field, Force};
use model_export::inverse::build::Built;
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::grbf::Grbf;
use model_export::inverse::quantise::TableSet;
use model_export::recordings::Problem;
use model_export::recordings::description::Design;
use model_export::recordings::noise::WhiteNoise;
use model_export::recordings::raw::RawStream;
use nalgebra::Vector3;

use crate::coverage::{Coverage, Told, WIDTHS, tared};
use crate::networks::{FloatForce, Networks, Underway};
pub use crate::sums::Sums;
use crate::surroundings::Covariates;
use crate::tare::{Rest, held_n};
use crate::wiring::{Wiring, reading, readings, wire};

/// Rows that are read and estimated at once; only these two are timed.
const CHUNK: usize = 4096;
/// Noise on a straight line between two noisy rows, as a share of a row's, root mean square: the mean
/// of (1-s)^2 + s^2 is 2/3.
const BETWEEN_ROWS: f64 = 0.816_496_580_927_726;

/// One force of one sensor over one recording, in newtons.
#[derive(Clone, Copy, Debug, Default)]
pub struct Track {
    /// Device minus reference.
    pub error: Sums,
    /// Floating point minus reference.
    pub float: Sums,
    /// Device minus floating point.
    pub fixed_minus_float: Sums,
    /// Root mean square that white noise alone would leave: that of the sensor, seen in the
    /// estimates, and that of the reference on the line between two of its rows.
    pub noise_n: f64,
    /// Tare over an unloaded stretch, and the stretch's length in seconds; `None` where the force never
    /// rested.
    pub tare: Option<(f64, f64)>,
    /// The same of floating point.
    pub float_tare: Option<f64>,
    /// Standard deviations that a network told, in newtons.
    pub sigma: Sums,
    /// Errors within [`WIDTHS`] of these.
    pub within: [u64; WIDTHS.len()],
}

impl Track {
    /// Counts an error beside the standard deviation that a network told of it.
    fn tell(&mut self, sigma_n: f64, error_n: f64) {
        self.sigma.add(sigma_n);
        for (count, width) in self.within.iter_mut().zip(WIDTHS) {
            *count += u64::from(error_n.abs() <= width * sigma_n);
        }
    }

    /// The error after the tare.
    pub fn tared(&self) -> Option<Sums> {
        self.tare.map(|(tare, _)| self.error.less(tare))
    }

    /// The error of floating point after its tare.
    pub fn float_tared(&self) -> Option<Sums> {
        self.float_tare.map(|tare| self.float.less(tare))
    }
}

/// One sensor over one recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorReplay {
    /// Number of the sensor.
    pub number: u32,
    /// Fx, Fz.
    pub axes: [Track; 2],
    /// Rows that the device called invalid: they are not in the errors.
    pub invalid: u64,
    /// Rows in which an effect could not be undone since its input was not recorded.
    pub lacking: u64,
    /// Rows in which the device did not believe the sensor's network ([`firmware::astray`]), and told
    /// the ideal model's forces.
    pub astray: u64,
}

/// One recording.
#[derive(Clone, Debug, Default)]
pub struct RecordingReplay {
    /// Its name.
    pub name: String,
    /// Sensors whose two forces were recorded.
    pub sensors: Vec<SensorReplay>,
    /// Rows of the board.
    pub rows: u64,
    /// Seconds that they span.
    pub span_s: f64,
    /// Time for reading and for the device's code, on one core.
    pub spent: Duration,
    /// When the device noticed a foreign magnet, and until when: seconds of the board's clock.
    pub disturbed_s: Vec<[f64; 2]>,
    /// What networks told, for each of the sensors: errors of Fx and Fz beside their standard deviation.
    pub told: Vec<[Vec<Told>; 2]>,
}

/// Stretches in which the device saw a foreign magnet.
#[derive(Clone, Debug, Default)]
struct Disturbances {
    up: bool,
    found_s: Vec<[f64; 2]>,
}

impl Disturbances {
    fn note(&mut self, time_s: f64, flag: bool) {
        match (self.up, flag) {
            (false, true) => self.found_s.push([time_s; 2]),
            (true, true) => {
                if let Some([_, until]) = self.found_s.last_mut() {
                    *until = time_s;
                }
            }
            (_, false) => {}
        }
        self.up = flag;
    }
}

/// What is replayed: the device's tables, and the model in floating point beside them.
#[derive(Clone, Copy, Debug)]
pub struct Models<'a> {
    /// Numbers of the sensors, in the order of the tables.
    pub numbers: &'a [u32],
    /// The device's.
    pub tables: &'a TableSet,
    /// What is undone around them.
    pub compensations: &'a [OwnedCompensation],
    /// Design of the gripper, for what the covariates mean.
    pub design: Option<&'a Design>,
    /// Floating point, in the same order.
    pub float: &'a [Grbf],
    /// Scale of a count.
    pub gauss_per_lsb: f64,
    /// Recurrent networks behind them.
    pub networks: Option<&'a Networks>,
}

impl<'a> Models<'a> {
    /// Everything that was built of a model.
    pub fn of(built: &'a Built) -> Self {
        Self {
            numbers: &built.header.sensors,
            tables: &built.chosen.tables,
            compensations: &built.compensations,
            design: built.model.design.as_ref(),
            float: &built.chosen.models,
            gauss_per_lsb: built.model.sensor_scale.gauss_per_lsb,
            networks: None,
        }
    }
}

/// One valid estimate beside the reference.
#[derive(Clone, Copy, Debug)]
pub struct Observed {
    /// Place of the sensor in [`RecordingReplay::sensors`].
    pub sensor: usize,
    /// The board's clock in seconds.
    pub time_s: f64,
    /// The reference, on the line between its rows: lateral, longitudinal, in newtons.
    pub reference_n: [f64; 2],
    /// The device's estimate.
    pub found_n: [f64; 2],
    /// Its standard deviations, where a network tells them.
    pub sigma_n: Option<[f64; 2]>,
}

/// Replays one recording; `done` is told the rows so far.
pub fn replay(
    models: Models,
    name: &str,
    stream: RawStream,
    done: impl Fn(u64),
) -> Result<RecordingReplay, Problem> {
    replay_watched(models, name, stream, done, |_| ())
}

/// The same; `watch` is told every valid estimate.
pub fn replay_watched(
    models: Models,
    name: &str,
    mut stream: RawStream,
    done: impl Fn(u64),
    mut watch: impl FnMut(Observed),
) -> Result<RecordingReplay, Problem> {
    let wiring = wire(models.numbers, &stream);
    let mut result = RecordingReplay {
        name: name.to_owned(),
        sensors: wiring
            .iter()
            .map(|w| SensorReplay {
                number: w.number,
                ..Default::default()
            })
            .collect(),
        told: wiring.iter().map(|_| Default::default()).collect(),
        ..Default::default()
    };
    let mut noises = vec![[WhiteNoise::default(), WhiteNoise::default()]; wiring.len()];
    // Of the device, and of floating point.
    let range_n = models
        .design
        .map_or(params::FORCE_RANGE.value, Design::force_range_n);
    let rest = |wires: &Wiring| Rest::new(range_n, held_n(models.compensations, wires.number));
    let mut rests: Vec<[Rest; 2]> = wiring.iter().map(|wires| [rest(wires); 2]).collect();
    let compensations: Vec<Compensation> = models
        .compensations
        .iter()
        .map(OwnedCompensation::view)
        .collect();
    let tables = models.tables.tables(&compensations);
    let needs_temperature = models
        .compensations
        .iter()
        .any(OwnedCompensation::needs_temperature);
    let covariates = Covariates::find(stream.layout(), models.design);
    let mut estimator = Estimator::new(&tables, models.networks.map(Networks::start));
    // Of sensors that the board has no place for.
    let mut memories = vec![Memory::default(); wiring.len()];
    let mut disturbances = Disturbances::default();
    let mut first_s = None;
    let mut rows = Vec::with_capacity(CHUNK);
    let mut estimates = Vec::with_capacity(CHUNK * wiring.len());
    let mut believed = Vec::with_capacity(CHUNK * wiring.len());
    loop {
        rows.clear();
        estimates.clear();
        believed.clear();
        estimator.networks().iter_mut().for_each(Underway::forget);
        let start = Instant::now();
        while rows.len() < CHUNK
            && let Some(row) = stream.next_row()?
        {
            let around = covariates.at(&row);
            let sensed = Frame {
                readings: readings(&row, &wiring, models.gauss_per_lsb),
                ..Frame::default()
            };
            let told = estimator.step(&sensed, &around);
            disturbances.note(row.time_s, estimator.detector().flag());
            for (wires, memory) in wiring.iter().zip(&mut memories) {
                let number = wires.number as usize;
                believed.push(!estimator.is_astray(number));
                estimates.push(told.get(number).copied().unwrap_or_else(|| {
                    let reading = Some(reading(&row, wires, models.gauss_per_lsb));
                    estimate(&tables, number, reading, &around, memory)
                }));
            }
            rows.push(row);
        }
        result.spent += start.elapsed();
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
            break;
        };
        result.span_s = last.time_s - *first_s.get_or_insert(first.time_s);
        result.rows += rows.len() as u64;
        let estimates = estimates.chunks(wiring.len().max(1));
        let mut believed = believed.iter().copied();
        let networks = estimator.networks();
        for (at, (row, estimates)) in rows.iter().zip(estimates).enumerate() {
            let floats = networks.as_mut().map(|networks| networks.float(at));
            for (i, (wires, estimate)) in wiring.iter().zip(estimates).enumerate() {
                let sensor = &mut result.sensors[i];
                let reference = wires.forces.map(|force| row.forces[force]);
                let cold = needs_temperature && wires.temperature.is_none();
                let is_believed = believed.next().unwrap_or(true);
                sensor.astray += u64::from(!is_believed);
                sensor.lacking += u64::from(estimate.lacking || cold);
                if estimate.validity != Validity::Valid {
                    sensor.invalid += 1;
                } else if reference.iter().all(|n| n.is_finite()) {
                    let found = estimate.force.map(Force::newtons);
                    let counts = estimate.field.map(Field::counts);
                    let shown = models.float[wires.table]
                        .force(&(Vector3::from(counts) * models.gauss_per_lsb));
                    let seen = networks.as_ref().and_then(|networks| networks.saw(at));
                    let number = wires.number as usize;
                    let ideal = seen.and_then(|seen| seen.get(number)).unwrap_or(estimate);
                    // Which network is believed the device decides: what is compared is the arithmetic.
                    let network = floats
                        .filter(|_| is_believed)
                        .and_then(|floats| *floats.get(number)?);
                    let mut floats_n = [0.0; 2];
                    for axis in 0..2 {
                        // What is undone on the forces is integer arithmetic alone.
                        let undone = ideal.force[axis].newtons() - estimate.shown[axis].newtons();
                        let float = FloatForce::over(network, axis, shown[axis] + undone);
                        floats_n[axis] = float;
                        noises[i][axis].push(found[axis]);
                        let track = &mut sensor.axes[axis];
                        track.error.add(found[axis] - reference[axis]);
                        track.float.add(float - reference[axis]);
                        track.fixed_minus_float.add(found[axis] - float);
                        if let Some(sigma) = estimate.sigma {
                            let told = Told {
                                time_s: row.time_s,
                                error_n: found[axis] - reference[axis],
                                sigma_n: sigma[axis].newtons(),
                            };
                            track.tell(told.sigma_n, told.error_n);
                            result.told[i][axis].push(told);
                        }
                    }
                    let sigma_n = estimate.sigma.map(|sigma| sigma.map(Force::newtons));
                    for (rest, told) in rests[i].iter_mut().zip([found, floats_n]) {
                        rest.add(row.time_s, reference, told, sigma_n);
                    }
                    watch(Observed {
                        sensor: i,
                        time_s: row.time_s,
                        reference_n: reference,
                        found_n: found,
                        sigma_n,
                    });
                }
            }
        }
        done(result.rows);
    }
    result.disturbed_s = disturbances.found_s;
    let force_noise = stream.force_noise();
    let seen = wiring.iter().zip(&noises).zip(rests);
    for (sensor, ((wires, noise), rest)) in result.sensors.iter_mut().zip(seen) {
        let [tare, float_tare] = rest.map(Rest::tare);
        for (axis, track) in sensor.axes.iter_mut().enumerate() {
            track.tare = tare.map(|(mean, length)| (mean[axis], length));
            track.float_tare = float_tare.map(|(mean, _)| mean[axis]);
            let own = noise[axis].estimate().unwrap_or(0.0);
            let reference = force_noise[wires.forces[axis]].unwrap_or(0.0);
            track.noise_n = own.hypot(reference * BETWEEN_ROWS);
        }
    }
    Ok(result)
}

/// Shares within the standard deviations that were told, after the tare, over all forces; a recording
/// follows the other by far, so that no block of time holds rows of two.
pub fn coverage(recordings: &[RecordingReplay]) -> Option<Coverage> {
    const APART_S: f64 = 1e4;
    let mut forces = Vec::new();
    for (place, recording) in recordings.iter().enumerate() {
        for (sensor, told) in recording.sensors.iter().zip(&recording.told) {
            for (track, told) in sensor.axes.iter().zip(told) {
                let mut told = tared(told, track.tare.map_or(0.0, |(tare, _)| tare));
                let first_s = told.first().map_or(0.0, |one| one.time_s);
                let shift_s = APART_S * place as f64 - first_s;
                told.iter_mut().for_each(|one| one.time_s += shift_s);
                forces.push(told);
            }
        }
    }
    Coverage::of(forces.iter().map(Vec::as_slice))
}
