//! Recordings through the device's own code, compared with the reference.

pub mod bags;
pub mod corrections;
pub mod error_noise;
pub mod evaluation;
pub mod tare;

use std::time::{Duration, Instant};

use firmware::compensation::{Compensation, CompensationState};
use firmware::estimator::{Estimate, Estimator, Validity, estimate};
use firmware::fixed_point::{Field, Force};
use firmware::model::formats::Tables;
use firmware::sensors::hall::HallFrame;
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::grbf::{Grbf, GrbfLanes};
use model_export::recordings::DataError;
use model_export::recordings::stream::{RawRow, RawStream};
use model_export::stop;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::calibration::{Coverage, PredictedError, SIGMA_MULTIPLES, subtract_tare};
use crate::replay::corrections::{Irreducible, SampleCorrection, SensorCorrections};
use crate::replay::error_noise::ErrorNoise;
use crate::replay::tare::{TareEstimator, friction_n};
use crate::statistics::Moments;
use device_run::channel_map::SensorChannels;
use device_run::networks::{FloatForce, NetworkSet, ReplayNetworks};
use device_run::{DeviceRow, ReplayModels};

/// Rows that are read and estimated together, while the next ones are read; only reading and estimating are timed.
const CHUNK: usize = 1024;

/// Errors of one force of one sensor over one recording, in newtons.
#[derive(Clone, Copy, Debug, Default)]
pub struct AxisReplay {
    /// Whether the model has this force, and the recording its reference; the rest is empty otherwise.
    pub is_measured: bool,
    /// Device minus corrected reference, without the flagged rows.
    pub error: Moments,
    /// Device minus reference as recorded.
    pub recorded: Moments,
    /// Device minus reference where the device detects an event of its model.
    pub flagged: Moments,
    /// Floating point minus reference; no rows where it was not evaluated.
    pub float: Moments,
    /// Device minus floating point.
    pub fixed_minus_float: Moments,
    /// RMS error from white noise alone: of the sensor, measured in the estimates, and of the interpolated
    /// reference.
    pub noise_n: f64,
    /// Tare over an unloaded interval, and the length of the interval in seconds; `None` without one.
    pub tare: Option<(f64, f64)>,
    /// Tare of the floating-point estimate.
    pub float_tare: Option<f64>,
    /// Standard deviations predicted by a network, in newtons.
    pub sigma: Moments,
    /// Number of errors within [`SIGMA_MULTIPLES`] of the predicted standard deviation.
    pub within: [u64; SIGMA_MULTIPLES.len()],
}

impl AxisReplay {
    fn update_coverage(&mut self, sigma_n: f64, error_n: f64) {
        self.sigma.add(sigma_n);
        for (count, multiple) in self.within.iter_mut().zip(SIGMA_MULTIPLES) {
            *count += u64::from(error_n.abs() <= multiple * sigma_n);
        }
    }

    /// The device's error after the tare.
    pub fn tared(&self) -> Option<Moments> {
        self.tare.map(|(tare, _)| self.error.less(tare))
    }
}

/// One sensor over one recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorReplay {
    /// Number of the sensor.
    pub number: u32,
    /// Fx, Fz.
    pub axes: [AxisReplay; 2],
    /// Rows with an invalid estimate; they are not in the errors.
    pub invalid: u64,
    /// Rows in which an effect was not compensated because its input was not recorded.
    pub missing_inputs: u64,
    /// Rows in which the network had diverged ([`firmware::estimator::network_monitor`]) and the ideal model was used.
    pub diverged: u64,
}

#[derive(Clone, Debug, Default)]
pub struct RecordingReplay {
    /// Name of the recording.
    pub name: String,
    /// Sensors with a recorded force.
    pub sensors: Vec<SensorReplay>,
    /// Board rows.
    pub rows: u64,
    /// Duration in seconds.
    pub span_s: f64,
    /// Time for reading and for the device's code, on one core.
    pub spent: Duration,
    /// Intervals with the disturbance flag set, in seconds of the board's clock.
    pub disturbed_s: Vec<[f64; 2]>,
    /// Errors with the standard deviation that a network predicted: per sensor, Fx and Fz.
    pub predictions: Vec<[Vec<PredictedError>; 2]>,
}

/// Collects the intervals in which a flag is set.
#[derive(Clone, Debug, Default)]
struct FlagIntervals {
    flag: bool,
    intervals_s: Vec<[f64; 2]>,
}

impl FlagIntervals {
    fn update(&mut self, time_s: f64, flag: bool) {
        match (self.flag, flag) {
            (false, true) => self.intervals_s.push([time_s; 2]),
            (true, true) => {
                if let Some([_, end]) = self.intervals_s.last_mut() {
                    *end = time_s;
                }
            }
            (_, false) => {}
        }
        self.flag = flag;
    }
}

/// One valid estimate with its reference.
#[derive(Clone, Copy, Debug)]
pub struct ForceSample {
    /// Index of the sensor in [`RecordingReplay::sensors`].
    pub sensor: usize,
    /// The board's clock in seconds.
    pub time_s: f64,
    /// Interpolated reference in newtons, corrected for its errors: lateral, longitudinal; NaN for a force that was not measured.
    pub reference_n: [f64; 2],
    /// The same as recorded.
    pub recorded_n: [f64; 2],
    /// The device's estimate in newtons.
    pub estimate_n: [f64; 2],
    /// Whether the device detects an event of its model in this row ([`ReplayInput::counts_events`]).
    pub is_flagged: bool,
    /// Standard deviations predicted by a network, in newtons.
    pub sigma_n: Option<[f64; 2]>,
}

/// Models of one replay, and what separates the recording from the conditions of their tables.
#[derive(Clone, Copy, Debug)]
pub struct ReplayInput<'a> {
    /// Tables and networks.
    pub models: ReplayModels<'a>,
    pub corrections: &'a [SensorCorrections],
    /// Whether the field that no model compensates is subtracted.
    pub irreducible: Irreducible,
    /// Whether the model contains an event: rows in which the device detects a disturbance are counted apart.
    pub counts_events: bool,
}

impl<'a> From<ReplayModels<'a>> for ReplayInput<'a> {
    fn from(models: ReplayModels<'a>) -> Self {
        Self { models, corrections: &[], irreducible: Irreducible::Kept, counts_events: false }
    }
}

impl ReplayInput<'_> {
    fn correction(&self, sensor: u32, time_s: f64) -> Option<SampleCorrection> {
        let of_sensor = self.corrections.iter().find(|one| one.sensor == sensor);
        of_sensor?.at(time_s, self.irreducible)
    }
}

/// Replays one recording and passes every valid estimate to `on_sample`. `done` receives the number of rows so
/// far.
///
/// # Errors
/// The recording cannot be read.
pub fn replay_with(
    models: ReplayModels,
    name: &str,
    stream: RawStream,
    done: impl Fn(u64),
    mut on_sample: impl FnMut(ForceSample),
) -> Result<RecordingReplay, DataError> {
    let inputs = [models.into()];
    let replayed = replay_each(&inputs, name, stream, done, |_, sample| on_sample(sample))?;
    Ok(replayed.into_iter().next().unwrap_or_default())
}

/// Replays one recording with several models in one pass and passes every valid estimate, with the index of
/// its model, to `on_sample`. The models have the sensors, design and scale of the first.
///
/// # Errors
/// The recording cannot be read.
pub fn replay_each(
    inputs: &[ReplayInput],
    name: &str,
    stream: RawStream,
    done: impl Fn(u64),
    mut on_sample: impl FnMut(usize, ForceSample),
) -> Result<Vec<RecordingReplay>, DataError> {
    let Some(first) = inputs.first() else {
        return Ok(Vec::new());
    };
    let mut input = first.models.rows(stream);
    let sensors = input.sensors().to_vec();
    let compensations: Vec<Vec<Compensation>> =
        inputs.iter().map(|input| input.models.compensation_views()).collect();
    let tables: Vec<Tables> = inputs
        .iter()
        .zip(&compensations)
        .map(|(input, compensations)| input.models.tables.tables(compensations))
        .collect();
    let mut replays: Vec<ModelReplay> = inputs
        .iter()
        .zip(&tables)
        .map(|(input, tables)| ModelReplay::new(*input, tables, name, &sensors))
        .collect();
    let mut read = |rows: &mut Vec<DeviceRow>| -> Result<Duration, DataError> {
        rows.clear();
        let start = Instant::now();
        while rows.len() < CHUNK
            && let Some(row) = input.next().transpose()?
        {
            rows.push(row);
        }
        Ok(start.elapsed())
    };
    let (mut rows, mut next) = (Vec::with_capacity(CHUNK), Vec::with_capacity(CHUNK));
    let mut reading = read(&mut rows)?;
    let mut count = 0;
    while !rows.is_empty() {
        stop::check();
        count += rows.len() as u64;
        let evaluate = |replay: &mut ModelReplay| {
            replay.evaluation.result.spent += reading;
            replay.update(&rows, &sensors);
        };
        let (next_reading, ()) =
            rayon::join(|| read(&mut next), || replays.par_iter_mut().for_each(evaluate));
        reading = next_reading?;
        for (model, replay) in replays.iter_mut().enumerate() {
            replay.samples.drain(..).for_each(|sample| on_sample(model, sample));
        }
        done(count);
        std::mem::swap(&mut rows, &mut next);
    }
    let force_noise = input.stream().force_noise();
    Ok(replays.into_iter().map(|replay| replay.finish(&sensors, &force_noise)).collect())
}

/// One model over one recording.
struct ModelReplay<'a> {
    input: ReplayInput<'a>,
    tables: &'a Tables<'a>,
    estimator: Estimator<'a, Option<ReplayNetworks<'a>>>,
    /// Of sensors without a slot on the board.
    memories: Vec<CompensationState>,
    needs_temperature: bool,
    disturbances: FlagIntervals,
    first_s: Option<f64>,
    estimates: Vec<Estimate>,
    network_valid: Vec<bool>,
    /// Whether the device detects a disturbance, by row.
    disturbed: Vec<bool>,
    samples: Vec<ForceSample>,
    evaluation: Evaluation<'a>,
}

impl<'a> ModelReplay<'a> {
    fn new(
        input: ReplayInput<'a>,
        tables: &'a Tables<'a>,
        name: &str,
        sensors: &[SensorChannels],
    ) -> Self {
        let models = input.models;
        let mut owned = models.compensations.iter();
        Self {
            input,
            tables,
            estimator: Estimator::new(tables, models.networks.map(NetworkSet::start)),
            memories: vec![CompensationState::default(); sensors.len()],
            needs_temperature: owned.any(OwnedCompensation::needs_temperature),
            disturbances: FlagIntervals::default(),
            first_s: None,
            estimates: Vec::with_capacity(CHUNK * sensors.len()),
            network_valid: Vec::with_capacity(CHUNK * sensors.len()),
            disturbed: Vec::with_capacity(CHUNK),
            samples: Vec::with_capacity(CHUNK * sensors.len()),
            evaluation: Evaluation::new(models, name, sensors),
        }
    }

    /// Estimates and evaluates these rows; valid estimates are added to `samples`.
    fn update(&mut self, rows: &[DeviceRow], sensors: &[SensorChannels]) {
        let estimator = &mut self.estimator;
        self.estimates.clear();
        self.network_valid.clear();
        self.disturbed.clear();
        estimator.networks().iter_mut().for_each(ReplayNetworks::clear_inputs);
        let gauss_per_lsb = self.evaluation.models.gauss_per_lsb;
        let start = Instant::now();
        for row in rows {
            let corrected = |channels: &SensorChannels| {
                let correction = self.input.correction(channels.number, row.raw.time_s)?;
                let field_g = correction.field_g(channels.field_g(&row.raw));
                Some(channels.reading_of(field_g, &row.raw, gauss_per_lsb))
            };
            let mut frame = HallFrame { readings: row.readings, ..HallFrame::default() };
            for channels in sensors {
                if let Some(slot) = frame.readings.get_mut(channels.number as usize)
                    && let Some(reading) = corrected(channels)
                {
                    *slot = Some(reading);
                }
            }
            let on_board = estimator.update(&frame, &row.inputs);
            let is_disturbed = estimator.detector().flag();
            self.disturbances.update(row.raw.time_s, is_disturbed);
            self.disturbed.push(is_disturbed);
            for (channels, memory) in sensors.iter().zip(&mut self.memories) {
                let number = channels.number as usize;
                self.network_valid.push(!estimator.network_diverged(number));
                self.estimates.push(on_board.get(number).copied().unwrap_or_else(|| {
                    let own = || channels.reading(&row.raw, gauss_per_lsb);
                    let reading = Some(corrected(channels).unwrap_or_else(own));
                    estimate(self.tables, number, reading, &row.inputs, memory)
                }));
            }
        }
        let result = &mut self.evaluation.result;
        result.spent += start.elapsed();
        if let (Some(first), Some(last)) = (rows.first(), rows.last()) {
            result.span_s = last.raw.time_s - *self.first_s.get_or_insert(first.raw.time_s);
        }
        result.rows += rows.iter().filter(|row| row.is_recorded).count() as u64;
        let estimates = self.estimates.chunks(sensors.len().max(1));
        let mut network_valid = self.network_valid.iter().copied();
        let networks = estimator.networks();
        for (at, (row, estimates)) in rows.iter().zip(estimates).enumerate() {
            let has_float = self.evaluation.float.is_some();
            let floats = networks.as_mut().filter(|_| has_float).map(|networks| networks.float(at));
            for (i, (channels, estimate)) in sensors.iter().zip(estimates).enumerate() {
                let number = channels.number as usize;
                let network_valid = network_valid.next().unwrap_or(true);
                if !row.is_recorded {
                    continue;
                }
                let sensor = &mut self.evaluation.result.sensors[i];
                sensor.diverged += u64::from(!network_valid);
                let no_temperature = self.needs_temperature && channels.temperature.is_none();
                sensor.missing_inputs += u64::from(estimate.missing_inputs || no_temperature);
                if estimate.validity != Validity::Valid {
                    sensor.invalid += 1;
                    continue;
                }
                let inputs = networks.as_ref().and_then(|networks| networks.inputs(at));
                let ideal = inputs.and_then(|inputs| inputs.get(number));
                // The device selects between network and ideal model; only the arithmetic is compared.
                let network =
                    floats.filter(|_| network_valid).and_then(|floats| *floats.get(number)?);
                let ideal = ideal.unwrap_or(estimate);
                let correction = self.input.correction(channels.number, row.raw.time_s);
                let estimates = (estimate, ideal, network);
                let is_disturbed = self.disturbed.get(at).copied().unwrap_or_default();
                let is_flagged = is_disturbed && self.input.counts_events;
                let how = (correction, is_flagged, row.at_reference_row);
                let sample = self.evaluation.update((i, channels), &row.raw, estimates, how);
                self.samples.extend(sample);
            }
        }
    }

    fn finish(
        mut self,
        sensors: &[SensorChannels],
        force_noise: &[Option<f64>],
    ) -> RecordingReplay {
        self.evaluation.result.disturbed_s = self.disturbances.intervals_s;
        self.evaluation.finish(sensors, force_noise)
    }
}

/// Running statistics of a replay.
struct Evaluation<'a> {
    models: ReplayModels<'a>,
    float: Option<Vec<GrbfLanes>>,
    result: RecordingReplay,
    noises: Vec<[ErrorNoise; 2]>,
    /// Of the device, of floating point.
    tares: Vec<[TareEstimator; 2]>,
}

impl<'a> Evaluation<'a> {
    fn new(models: ReplayModels<'a>, name: &str, sensors: &[SensorChannels]) -> Self {
        let range_n = models.force_range_n;
        let tare = |channels: &SensorChannels| {
            let friction_n = friction_n(models.compensations, channels.number);
            [TareEstimator::new(range_n, friction_n); 2]
        };
        let sensor = |channels: &SensorChannels| SensorReplay {
            number: channels.number,
            axes: channels
                .forces
                .map(|force| AxisReplay { is_measured: force.is_some(), ..AxisReplay::default() }),
            ..SensorReplay::default()
        };
        Self {
            models,
            float: models.float.map(|models| models.iter().map(Grbf::lanes).collect()),
            result: RecordingReplay {
                name: name.to_owned(),
                sensors: sensors.iter().map(sensor).collect(),
                predictions: sensors.iter().map(|_| Default::default()).collect(),
                ..Default::default()
            },
            noises: sensors.iter().map(|_| Default::default()).collect(),
            tares: sensors.iter().map(tare).collect(),
        }
    }

    /// Adds a valid estimate; `None` where a reference force is missing. `ideal` is the estimate before the
    /// networks, `network` the output of the floating-point network.
    fn update(
        &mut self,
        (i, channels): (usize, &SensorChannels),
        row: &RawRow,
        (estimate, ideal, network): (&Estimate, &Estimate, Option<FloatForce>),
        (correction, is_flagged, at_reference_row): (Option<SampleCorrection>, bool, bool),
    ) -> Option<ForceSample> {
        let recorded = channels.force_n(row);
        let is_measured = channels.forces.map(|force| force.is_some());
        if (0..2).any(|axis| is_measured[axis] && !recorded[axis].is_finite()) {
            return None;
        }
        let reference = correction.map_or(recorded, |of| of.reference_n(recorded));
        let of_row = |force_n| correction.map_or(force_n, |of| of.estimate_n(force_n));
        let found = of_row(estimate.force.map(Force::newtons));
        let counts = estimate.field.map(Field::counts);
        let field_g = Vector3::from(counts) * self.models.gauss_per_lsb;
        let float = self.float.as_ref().map(|models| models[channels.table].force(&field_g));
        let float = float.map(|ideal_n| {
            of_row([0, 1].map(|axis| {
                // Compensations of the forces exist in integer arithmetic alone.
                let compensation =
                    ideal.force[axis].newtons() - estimate.uncompensated[axis].newtons();
                FloatForce::over(network, axis, ideal_n[axis] + compensation)
            }))
        });
        for axis in (0..2).filter(|axis| is_measured[*axis]) {
            self.noises[i][axis].push(found[axis], found[axis] - reference[axis], at_reference_row);
            let replay = &mut self.result.sensors[i].axes[axis];
            if is_flagged {
                replay.flagged.add(found[axis] - reference[axis]);
                continue;
            }
            replay.error.add(found[axis] - reference[axis]);
            replay.recorded.add(found[axis] - recorded[axis]);
            if let Some(float) = float {
                replay.float.add(float[axis] - reference[axis]);
                replay.fixed_minus_float.add(found[axis] - float[axis]);
            }
            if let Some(sigma) = estimate.sigma {
                let prediction = PredictedError {
                    time_s: row.time_s,
                    error_n: found[axis] - reference[axis],
                    sigma_n: sigma[axis].newtons(),
                };
                replay.update_coverage(prediction.sigma_n, prediction.error_n);
                self.result.predictions[i][axis].push(prediction);
            }
        }
        let sigma_n = estimate.sigma.map(|sigma| sigma.map(Force::newtons));
        let [tare, float_tare] = &mut self.tares[i];
        tare.add(row.time_s, reference, found, sigma_n);
        if let Some(float) = float {
            float_tare.add(row.time_s, reference, float, sigma_n);
        }
        Some(ForceSample {
            sensor: i,
            time_s: row.time_s,
            reference_n: reference,
            recorded_n: recorded,
            estimate_n: found,
            is_flagged,
            sigma_n,
        })
    }

    fn finish(self, sensors: &[SensorChannels], force_noise: &[Option<f64>]) -> RecordingReplay {
        let mut result = self.result;
        let statistics = sensors.iter().zip(&self.noises).zip(self.tares);
        for (sensor, ((channels, noise), tares)) in result.sensors.iter_mut().zip(statistics) {
            let [tare, float_tare] = tares.map(TareEstimator::tare);
            for (axis, replay) in sensor.axes.iter_mut().enumerate() {
                replay.tare = tare.map(|(mean, length)| (mean[axis], length));
                replay.float_tare = float_tare.map(|(mean, _)| mean[axis]);
                let channel = channels.forces[axis];
                let reference_n = channel.and_then(|channel| force_noise[channel]).unwrap_or(0.0);
                replay.noise_n = noise[axis].estimate(reference_n);
            }
        }
        result
    }
}

/// Coverage of the predicted standard deviations after the tare, over all forces. Recordings are shifted
/// in time so that no bootstrap block contains rows of two.
pub fn coverage(recordings: &[RecordingReplay]) -> Option<Coverage> {
    const RECORDING_OFFSET_S: f64 = 1e4;
    let errors = recordings.iter().enumerate().flat_map(|(place, recording)| {
        let sensors = recording.sensors.iter().zip(&recording.predictions);
        let forces = sensors.flat_map(|(sensor, predictions)| sensor.axes.iter().zip(predictions));
        forces.flat_map(move |(replay, errors)| {
            let first_s = errors.first().map_or(0.0, |error| error.time_s);
            let shift_s = RECORDING_OFFSET_S * place as f64 - first_s;
            let tared = subtract_tare(errors, replay.tare.map_or(0.0, |(tare, _)| tare));
            tared.map(move |error| PredictedError { time_s: error.time_s + shift_s, ..error })
        })
    });
    Coverage::of(errors)
}
