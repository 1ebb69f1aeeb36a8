//! Benchmark of eight force estimators on a held-out recording: Table I of the paper.
//!
//! - [`variants`]: the estimators, and the paper's results.
//! - [`data`]: training data, held-out recording, and the physics fitted to the training data alone.
//! - [`train_variants`]: the networks.
//! - [`mod@evaluate`]: each estimator on the held-out recording through the device's code, and the learning curve.
//! - [`disturbance`]: detection of magnetic disturbances.
//!
//! A network that does not fit the device is left out with the reason. The held-out recording selects nothing:
//! no weight, parameter, epoch or scale.

pub mod data;
pub mod disturbance;
pub mod evaluate;
pub mod train_variants;
pub mod variants;

use anyhow::Result;
use model_export::gru::file::fingerprint;
use model_export::gru::quantise::QuantiseError;
use model_export::gru::train::trainer::BestEpoch;

use crate::benchmark::data::{BenchmarkData, refit};
use crate::benchmark::disturbance::{DisturbanceResult, evaluate_disturbance, network_variant};
use crate::benchmark::evaluate::{LearningPoint, VariantResult, evaluate, learning_curve};
use crate::benchmark::train_variants::{TrainingData, VariantTrainer};
use crate::benchmark::variants::EstimatorVariant;
use crate::notes::Note;

/// The networks of a variant.
#[derive(Clone, Debug)]
pub struct TrainedNetwork {
    /// The variant.
    pub variant: EstimatorVariant,
    /// The selected epoch of each network.
    pub found: Vec<BestEpoch>,
    /// SHA-256 over the weights.
    pub sha256: String,
}

/// Results of the benchmark.
#[derive(Debug)]
pub struct Benchmark {
    /// Names of the training recordings, and of the held-out one.
    pub recordings: (Vec<String>, String),
    /// Duration of the training data.
    pub training_s: f64,
    /// Duration of the validation set at its end.
    pub validation_s: f64,
    /// Results in the order of [`EstimatorVariant::ALL`].
    pub results: Vec<VariantResult>,
    /// Networks of these variants.
    pub trained: Vec<TrainedNetwork>,
    /// Learning curve: errors by duration of the training data.
    pub learning_curve: Vec<LearningPoint>,
    /// Detection of magnetic disturbances, where requested.
    pub disturbance: Option<DisturbanceResult>,
    /// Whether the recordings are simulated.
    pub simulated: bool,
    /// Effects of the physics model.
    pub effects: Vec<String>,
    /// Notes on the recordings, and on effects and networks that were left out.
    pub notes: Vec<Note>,
}

impl Benchmark {
    /// Result of a variant, where it was evaluated.
    pub fn of(&self, variant: EstimatorVariant) -> Option<&VariantResult> {
        self.results.iter().find(|result| result.variant == variant)
    }

    /// RMS error of Fx and Fz from white noise alone, in newtons, for estimates from single readings.
    pub fn noise_n(&self) -> Option<[f64; 2]> {
        self.of(EstimatorVariant::IdealFitted).map(|result| result.axes.map(|axis| axis.noise_n))
    }
}

/// Fits, trains and evaluates all variants, then the disturbance detector over `disturbance_hours`.
///
/// # Errors
/// A fit or a training fails, or a recording cannot be read.
pub fn run_benchmark(
    data: &BenchmarkData,
    trainer: &VariantTrainer,
    disturbance_hours: f64,
) -> Result<Benchmark> {
    let training_s = data.training_s();
    let physics = refit(data, training_s)?;
    let training = TrainingData::of(data, &physics, training_s)?;
    let mut notes = data.notes.clone();
    notes.extend(physics.notes.iter().cloned());
    let (mut results, mut trained) = (Vec::new(), Vec::new());
    let mut networks = None;
    for variant in EstimatorVariant::ALL {
        let Some(built) = physics.at(variant.physics()) else {
            continue;
        };
        let set = match trainer.train(variant, &training, built, training_s) {
            Err(error) if error.is::<QuantiseError>() => {
                notes.push(Note::NetworkLeftOut { variant, error: format!("{error:#}") });
                continue;
            }
            set => set?,
        };
        results.push(evaluate(data, variant, built, set.as_ref())?);
        if let Some(set) = set {
            trained.push(TrainedNetwork {
                variant,
                sha256: fingerprint(&set.file.networks),
                found: set.file.provenance.found.clone(),
            });
            if variant == network_variant(&physics) {
                networks = Some(set);
            }
        }
    }
    let learning_curve = learning_curve(data, trainer, &results)?;
    trainer.close();
    let disturbance = evaluate_disturbance(data, &physics, networks.as_ref(), disturbance_hours)?;
    Ok(Benchmark {
        recordings: (data.names(), data.held_out_name()),
        training_s,
        validation_s: training.validation_s,
        results,
        trained,
        learning_curve,
        disturbance,
        simulated: data.simulated,
        effects: physics.effects,
        notes,
    })
}

/// Benefit of a network on top of the physics with effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NetworkBenefit {
    /// The physics alone is at the noise floor of each force.
    Floor,
    /// The network does not reduce the error significantly.
    Nothing,
    /// It reduces the error by this fraction.
    Share(f64),
    /// It increases the error by this fraction.
    Harm(f64),
}

/// At the noise floor: RMS error within this factor of white noise. Stricter than [`crate::compare::AT_FLOOR`]: the
/// noise of a force is measured in the estimates themselves, the floor of a field is calculated.
const FORCE_AT_FLOOR: f64 = 1.1;
/// Minimum relative change of the error that counts.
pub const MIN_BENEFIT: f64 = 0.02;

/// Benefit of the network; `None` where the model has no effects.
pub fn network_benefit(benchmark: &Benchmark) -> Option<NetworkBenefit> {
    let physics = benchmark.of(EstimatorVariant::Physics)?;
    let both = benchmark.of(EstimatorVariant::PhysicsGru)?;
    let errors = physics.axes.iter().zip(benchmark.noise_n()?);
    let at_floor = { errors }.all(|(axis, floor)| axis.fixed.rms() <= FORCE_AT_FLOOR * floor);
    let ratio = both.rmse_n() / physics.rmse_n();
    Some(match ratio {
        _ if ratio > 1.0 + MIN_BENEFIT => NetworkBenefit::Harm(ratio - 1.0),
        _ if at_floor => NetworkBenefit::Floor,
        _ if ratio > 1.0 - MIN_BENEFIT => NetworkBenefit::Nothing,
        _ => NetworkBenefit::Share(1.0 - ratio),
    })
}
