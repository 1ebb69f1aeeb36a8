//! Training of recurrent networks on recordings, and their evaluation on the held-out recording.

use std::time::Duration;

use anyhow::Result;
use model_export::gru::file::NetworkFile;
use model_export::gru::train::dataset::Sequence;
use model_export::gru::train::predictions::Prediction;
use model_export::gru::train::trainer::{BestEpoch, Trainer, TrainingSettings};

use crate::network_calibration::NetworkCalibration;
use crate::network_training::dataset::TrainingData;
use crate::statistics::Moments;

pub mod dataset;

/// Default patience of early stopping in epochs.
pub const DEFAULT_PATIENCE: u32 = 25;
/// Default initial learning rate.
pub const DEFAULT_RATE: f64 = 5e-3;

/// Learning rates: below, the weights do not change; above, the training diverges.
const MIN_RATE: f64 = 1e-9;
const MAX_RATE: f64 = 1.0;
/// Maximum weight of rows without force; its inverse is the minimum.
const MAX_ZERO_WEIGHT: f64 = 100.0;
/// Maximum number of units of a layer that the device computes.
pub const MAX_HIDDEN: usize = 32;

/// Checks what a user sets.
///
/// # Errors
/// The name of a setting, its value, and what is possible.
pub fn check_settings(settings: &TrainingSettings, hidden: usize) -> Result<(), String> {
    let check = |name: &str, value: f64, from: f64, to: f64| {
        let refusal = || format!("{name} {value:?} is not possible here; give {from} to {to}");
        (from..=to).contains(&value).then_some(()).ok_or_else(refusal)
    };
    let TrainingSettings { epochs, patience, rate, near_zero, .. } = settings;
    check("rate", *rate, MIN_RATE, MAX_RATE)?;
    check("zero-weight", *near_zero, MAX_ZERO_WEIGHT.recip(), MAX_ZERO_WEIGHT)?;
    check("hidden", hidden as f64, 1.0, MAX_HIDDEN as f64)?;
    check("epochs", f64::from(*epochs), 1.0, f64::from(u32::MAX))?;
    check("patience", f64::from(*patience), 1.0, f64::from(u32::MAX))
}

/// Default units of each layer: with three inputs and 16 units the device computes a network within the time that the paper
/// states for a computer.
pub fn default_hidden(is_shared: bool, is_quick: bool) -> usize {
    match (is_quick, is_shared) {
        (true, _) => 8,
        (false, false) => 16,
        (false, true) => 32,
    }
}

/// Default maximum number of epochs.
pub fn default_epochs(is_quick: bool) -> u32 {
    if is_quick { 15 } else { 80 }
}

/// One force of one sensor on the held-out recording.
pub struct ForceEvaluation {
    pub sensor: u32,
    /// 0: Fx, 1: Fz.
    pub axis: usize,
    /// Network minus reference in newtons.
    pub error: Moments,
    /// Ideal model minus reference in newtons.
    pub ideal: Moments,
    /// Predicted standard deviations in newtons.
    pub sigma: Moments,
    /// Range of the reference force in newtons.
    pub range_n: [f64; 2],
    /// Coverage of one and two standard deviations.
    pub coverage: [f64; 2],
    /// Mean negative log-likelihood of a force in newtons, in nats.
    pub nats: f64,
}

pub struct TrainingResult {
    /// Every force of every sensor.
    pub forces: Vec<ForceEvaluation>,
    /// Name of the held-out recording.
    pub held_out: String,
    /// Seed of the initial weights.
    pub seed: u64,
    pub epochs: u32,
    /// Sensors of each network.
    pub sensors: Vec<Vec<u32>>,
    /// Selected epoch of each network.
    pub found: Vec<BestEpoch>,
    /// Computing time, including reading.
    pub spent: Duration,
    /// Calibration of the standard deviations.
    pub sigma: NetworkCalibration,
}

impl TrainingResult {
    /// RMS error over all forces in newtons: of the networks, and of the ideal model on the same rows.
    pub fn pooled_rms_n(&self) -> [f64; 2] {
        let pooled = |of: fn(&ForceEvaluation) -> Moments| {
            self.forces.iter().map(of).fold(Moments::default(), Moments::with).rms()
        };
        [pooled(|row| row.error), pooled(|row| row.ideal)]
    }

    /// Whether the networks are better than the ideal model.
    pub fn reduces_the_error(&self) -> bool {
        let [own, ideal] = self.pooled_rms_n();
        own < ideal
    }

    /// Evaluates the best weights on the held-out recording, and calibrates their standard deviations.
    ///
    /// # Errors
    /// The networks cannot be evaluated.
    pub fn of(trainer: &Trainer, data: &TrainingData, spent: Duration) -> Result<Self> {
        let held_out = &data.held_out;
        let sigma = NetworkCalibration::of(trainer, &data.training, held_out, &data.built)?;
        let mut evaluated = Vec::new();
        for (sensors, forces) in trainer.groups.iter().zip(trainer.predictions()) {
            for (force, samples) in forces.iter().enumerate() {
                let (sensor, axis) = (sensors[force / 2], force % 2);
                let factor = sigma.sigma_factor(sensor, axis);
                let axis = (sensor, axis);
                evaluated.push(ForceEvaluation::of(trainer, held_out, axis, samples, factor));
            }
        }
        Ok(Self {
            forces: evaluated,
            held_out: held_out.name.clone(),
            seed: trainer.settings.seed,
            epochs: trainer.epoch,
            sensors: trainer.groups.clone(),
            found: trainer.found.clone(),
            spent,
            sigma,
        })
    }

    /// The networks, calibrated.
    pub fn network_file(&self, trainer: &Trainer, data: &TrainingData) -> NetworkFile {
        let mut networks = trainer.networks();
        self.sigma.apply(&mut networks);
        NetworkFile { provenance: data.provenance(trainer), networks }
    }
}

impl ForceEvaluation {
    /// Standard deviations are multiplied by `factor`.
    fn of(
        trainer: &Trainer,
        held_out: &Sequence,
        (sensor, axis): (u32, usize),
        samples: &[Prediction],
        factor: f64,
    ) -> Self {
        let scale_n = trainer.scaling.force_n[axis];
        let mut row = Self {
            sensor,
            axis,
            error: Moments::default(),
            ideal: Moments::default(),
            sigma: Moments::default(),
            range_n: [f64::INFINITY, f64::NEG_INFINITY],
            coverage: [0.0; 2],
            nats: 0.0,
        };
        let mut covered = [0_usize; 2];
        for sample in samples {
            let error = scale_n * (sample.mean - sample.truth);
            let sigma = factor * scale_n * sample.log_sigma.exp();
            row.error.add(error);
            row.sigma.add(sigma);
            for (count, width) in covered.iter_mut().zip([1.0, 2.0]) {
                *count += usize::from(error.abs() <= width * sigma);
            }
            let z = error / sigma;
            row.nats += 0.5 * z * z + sigma.ln() + 0.5 * std::f64::consts::TAU.ln();
        }
        let track = held_out.tracks.iter().find(|track| track.number == sensor);
        for (at, truth) in track.iter().flat_map(|track| {
            let ideal = |row: usize| track.ideal_n[row][axis];
            track.truth_n.iter().map(move |(at, n)| (ideal(*at), n[axis]))
        }) {
            let truth = f64::from(truth);
            row.ideal.add(f64::from(at) - truth);
            row.range_n = [row.range_n[0].min(truth), row.range_n[1].max(truth)];
        }
        row.coverage = covered.map(|count| count as f64 / samples.len() as f64);
        row.nats /= samples.len() as f64;
        row
    }
}
