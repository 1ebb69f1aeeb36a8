//! Calibration of the predicted standard deviations on the held-out recording, and the guards that reject the
//! network outside its training range.
//!
//! The held-out recording selects the weights and one factor per standard deviation. Coverage is cross-validated:
//! odd blocks of five seconds are evaluated with the factor of the even blocks, and vice versa. `magpie replay`
//! evaluates independent recordings. Errors are those after the device's tare, whose deadband depends on sigma.

use model_export::gru::network::{Network, OUTPUTS, TrainedRange};
use model_export::gru::train::dataset::{SensorSequence, Sequence};
use model_export::gru::train::predictions::Prediction as Share;
use model_export::gru::train::trainer::Trainer;
use model_export::inverse::build::DeviceModel;

use crate::calibration::{Coverage, PredictedError, sigma_factor, subtract_tare};
use crate::replay::tare::{TareEstimator, friction_n};

/// Sampling rate of the board in Hz.
const ROWS_PER_S: f64 = firmware::config::constants::SENSE_RATE.value;
/// Margin on the maximum difference between network and ideal model.
const DISAGREEMENT_MARGIN: f64 = 1.25;

/// Sigma factors and guards of all networks.
pub struct NetworkCalibration {
    /// Factors of Fx and Fz by sensor, in the order of the network heads.
    pub factors: Vec<(u32, [f64; 2])>,
    /// Coverage of the uncalibrated standard deviations.
    pub before: Option<Coverage>,
    /// Cross-validated coverage of the calibrated standard deviations.
    pub after: Option<Coverage>,
    guards: Vec<(u32, TrainedRange)>,
}

impl NetworkCalibration {
    /// Calibrates a completed training; `built` is the physical model that precedes the networks.
    pub fn of(
        trainer: &Trainer,
        training: &[Sequence],
        held_out: &Sequence,
        built: &DeviceModel,
    ) -> anyhow::Result<Self> {
        let mut calibration =
            Self { factors: Vec::new(), before: None, after: None, guards: Vec::new() };
        let (mut before, mut after) = (Vec::new(), Vec::new());
        for (sensors, forces) in trainer.groups.iter().zip(trainer.predictions()) {
            for (place, &sensor) in sensors.iter().enumerate() {
                let mut factors = [1.0; 2];
                let mut disagreement_n = [0.0_f64; 2];
                for (axis, chosen) in factors.iter_mut().enumerate() {
                    let scale_n = trainer.scaling.force_n[axis];
                    let samples = in_newtons(&forces, 2 * place + axis, scale_n);
                    let track = held_out.track(sensor);
                    if let Some(track) = track {
                        disagreement_n[axis] =
                            DISAGREEMENT_MARGIN * max_disagreement(track, axis, &samples);
                    }
                    let deadband_n = friction_n(&built.compensations, sensor);
                    let tare = |sigma: f64| {
                        let tare = track.and_then(|track| {
                            let rest = TareEstimator::new(built.model.force_range_n(), deadband_n);
                            tare(track, axis, &samples, rest, sigma)
                        });
                        subtract_tare(&samples, tare.unwrap_or(0.0)).collect::<Vec<_>>()
                    };
                    // Tare and sigma depend on each other: two iterations.
                    let first = sigma_factor(&tare(1.0)).unwrap_or(1.0);
                    let errors = tare(first);
                    *chosen = sigma_factor(&errors).unwrap_or(first);
                    after.extend(cross_calibrated(&errors));
                    before.extend(errors);
                }
                calibration.factors.push((sensor, factors));
                calibration.guards.push((
                    sensor,
                    TrainedRange {
                        parity_residual_g: parity_range(training, sensor),
                        newtons_per_g: newtons_per_g(built, sensor),
                        disagreement_n,
                    },
                ));
            }
        }
        calibration.before = Coverage::of(before);
        calibration.after = Coverage::of(after);
        Ok(calibration)
    }

    /// Applies factors (as an offset of log sigma) and guards to the networks.
    pub fn apply(&self, networks: &mut [Network]) {
        for network in networks {
            let find = |sensor: &u32| {
                let factors = self.factors.iter().find(|(number, _)| number == sensor)?;
                let guard = self.guards.iter().find(|(number, _)| number == sensor)?;
                Some((factors.1, guard.1))
            };
            let found: Option<Vec<([f64; 2], TrainedRange)>> =
                network.sensors.iter().map(find).collect();
            let heads = network.head_bias.chunks_mut(OUTPUTS);
            let found = found.unwrap_or_default();
            for (bias, (factors, _)) in heads.zip(&found) {
                for (bias, factor) in bias.iter_mut().skip(2).zip(factors) {
                    *bias += factor.ln() as f32;
                }
            }
            network.guards = found.into_iter().map(|(_, guard)| guard).collect();
        }
    }

    /// Factor on the standard deviation of a force.
    pub fn sigma_factor(&self, sensor: u32, axis: usize) -> f64 {
        let found = self.factors.iter().find(|(number, _)| *number == sensor);
        found.map_or(1.0, |(_, factors)| factors[axis])
    }
}

/// Fx and Fz at rest per gauss in the plane of the sensor, in newtons.
fn newtons_per_g(built: &DeviceModel, sensor: u32) -> [f64; 2] {
    let mut sensors = built.header.sensors.iter().zip(&built.chosen.forward);
    let newtons = |slope: nalgebra::Vector3<f64>| 1.0 / slope.norm().max(f64::MIN_POSITIVE);
    let found = sensors.find(|(number, _)| **number == sensor);
    found.map_or([0.0; 2], |(_, model)| model.per_newton([0.0; 2]).map(newtons))
}

/// Errors and standard deviations of one force in newtons.
fn in_newtons(forces: &[Vec<Share>], output: usize, scale_n: f64) -> Vec<PredictedError> {
    let samples = forces.get(output).into_iter().flatten();
    let newtons = samples.map(|one| PredictedError {
        time_s: one.row as f64 / ROWS_PER_S,
        error_n: scale_n * (one.mean - one.truth),
        sigma_n: scale_n * one.log_sigma.exp(),
    });
    newtons.collect()
}

/// The tare of the network with its sigma times a factor; `None` without an unloaded segment.
fn tare(
    track: &SensorSequence,
    axis: usize,
    samples: &[PredictedError],
    mut rest: TareEstimator,
    factor: f64,
) -> Option<f64> {
    for ((_, truth), one) in track.truth_n.iter().zip(samples) {
        let truth = truth.map(f64::from);
        let estimate = truth.map(|n| n + one.error_n);
        rest.add(one.time_s, truth, estimate, Some([factor * one.sigma_n; 2]));
    }
    rest.tare().map(|(tare, _)| tare[axis])
}

/// Odd blocks with the factor of the even blocks, and vice versa.
fn cross_calibrated(errors: &[PredictedError]) -> Vec<PredictedError> {
    let of = |odd: usize| -> Vec<PredictedError> {
        let chosen = errors.iter().filter(|one| one.block() % 2 == odd);
        chosen.copied().collect()
    };
    let halves = [of(0), of(1)];
    let factors = [&halves[1], &halves[0]].map(|others| sigma_factor(others).unwrap_or(1.0));
    let calibrated = halves.iter().zip(factors).flat_map(|(half, factor)| {
        half.iter().map(move |one| PredictedError { sigma_n: factor * one.sigma_n, ..*one })
    });
    calibrated.collect()
}

/// Maximum difference between network and ideal model in newtons.
fn max_disagreement(track: &SensorSequence, axis: usize, samples: &[PredictedError]) -> f64 {
    let differences = track.truth_n.iter().zip(samples).map(|((row, truth), one)| {
        let mean_n = f64::from(truth[axis]) + one.error_n;
        (mean_n - f64::from(track.ideal_n[*row][axis])).abs()
    });
    differences.fold(0.0, f64::max)
}

/// Minimum and maximum parity residual of a sensor's field.
fn parity_range(training: &[Sequence], sensor: u32) -> [f64; 2] {
    let tracks = training.iter().flat_map(|sequence| &sequence.tracks);
    let all =
        tracks.filter(|track| track.number == sensor).flat_map(|track| &track.parity_residual_g);
    all.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], g| {
        [min.min(f64::from(*g)), max.max(f64::from(*g))]
    })
}
