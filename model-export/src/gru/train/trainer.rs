//! Trainer: epochs, learning rate schedule, early stopping.

use firmware::config::constants::FORCE_RANGE;
use rayon::prelude::*;

use crate::gru::network::{Network, OUTPUTS};
use crate::gru::recurrence::add_scaled;
use crate::gru::train::TrainError;
use crate::gru::train::adam::{Adam, clip_gradients};
use crate::gru::train::backprop::{NetworkWeights, StreamPass};
use crate::gru::train::dataset::{ScaledSequence, Scaling, Sequence, Topology, zero_force_weight};
use crate::gru::train::parameters::{NetworkSize, TrainableParameters};
use crate::gru::train::predictions::{Prediction, mean_losses, predict};
use crate::gru::train::tbptt::{StreamBatches, WINDOW_ROWS};

/// Final learning rate relative to the initial one.
const FINAL_RATE: f64 = 0.01;

/// Training settings.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainingSettings {
    /// Seed of the initial weights and of the batches.
    pub seed: u64,
    /// Maximum number of epochs, over which the learning rate decays by half a cosine.
    pub epochs: u32,
    /// Patience of early stopping in epochs, by the held-out loss.
    pub patience: u32,
    /// Initial learning rate.
    pub rate: f64,
    /// Weight of rows at zero force, see [`zero_force_weight`]; weights are selected by the unweighted
    /// likelihood.
    ///
    /// [`zero_force_weight`]: super::dataset::zero_force_weight
    #[serde(default = "unweighted", skip_serializing_if = "is_unweighted")]
    pub near_zero: f64,
    /// Force range of each axis in newtons, either way.
    #[serde(default = "default_range", skip_serializing_if = "is_default_range")]
    pub force_range_n: f64,
}

/// MAGPIE's range, omitted in network files.
fn default_range() -> f64 {
    FORCE_RANGE.value
}

#[allow(clippy::trivially_copy_pass_by_ref)] // The serialiser's signature.
fn is_default_range(force_range_n: &f64) -> bool {
    *force_range_n == default_range()
}

/// Weight of zero force without weighting.
fn unweighted() -> f64 {
    1.0
}

#[allow(clippy::trivially_copy_pass_by_ref)] // The serialiser's signature.
fn is_unweighted(near_zero: &f64) -> bool {
    *near_zero == unweighted()
}

/// Best epoch of a network.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct BestEpoch {
    /// Epoch, from one on; zero before the first.
    pub epoch: u32,
    /// Mean held-out loss in nats for each force, relative to its scale, without the constant; `None` before
    /// the first epoch.
    pub held_out_loss: Option<f64>,
    /// Mean training loss over that epoch.
    pub training_loss: Option<f64>,
}

/// Losses of an epoch, mean of all networks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpochResult {
    /// Epochs so far.
    pub epoch: u32,
    /// Training loss.
    pub training_loss: f64,
    /// Held-out loss after the epoch.
    pub held_out_loss: f64,
}

/// State of a training between two epochs.
#[derive(Clone, Debug, PartialEq)]
pub struct Trainer {
    /// Settings.
    pub settings: TrainingSettings,
    /// Inputs and outputs of the networks.
    pub topology: Topology,
    /// Sensors of each network.
    pub groups: Vec<Vec<u32>>,
    /// How their inputs and outputs are scaled.
    pub scaling: Scaling,
    /// Epochs so far.
    pub epoch: u32,
    /// Current weights.
    pub parameters: TrainableParameters,
    /// The optimiser.
    pub adam: Adam,
    /// Best weights of each network so far.
    pub best: TrainableParameters,
    /// Best epoch of each network.
    pub found: Vec<BestEpoch>,
    training_data: Vec<ScaledSequence>,
    held_out: ScaledSequence,
}

impl Trainer {
    /// Before the first epoch. All sequences have the same sensors.
    pub fn new(
        settings: TrainingSettings,
        topology: Topology,
        training_data: &[Sequence],
        held_out: &Sequence,
    ) -> Result<Self, TrainError> {
        for sequence in training_data.iter().chain([held_out]) {
            if let Some(track) = sequence.tracks.iter().find(|t| t.truth_n.is_empty()) {
                return Err(TrainError::NoTruthAt {
                    recording: sequence.name.clone(),
                    sensor: track.number,
                });
            }
        }
        let sensors: Vec<u32> = held_out.tracks.iter().map(|track| track.number).collect();
        let groups = topology.groups(&sensors);
        let scaling = Scaling::of(training_data, &topology, &groups)?;
        let size = NetworkSize {
            networks: groups.len(),
            inputs: scaling.inputs[0].len(),
            hidden: topology.hidden,
            outputs: OUTPUTS * groups[0].len(),
        };
        let keys: Vec<u32> = groups.iter().map(|sensors| sensors[0]).collect();
        let parameters = TrainableParameters::random(size, settings.seed, &keys);
        let range_n = settings.force_range_n;
        let scaled = |sequence, near_zero| {
            let counts = |n| zero_force_weight(n, range_n, near_zero);
            ScaledSequence::of(sequence, &scaling, &groups, topology.target, counts)
        };
        let initial = BestEpoch { epoch: 0, held_out_loss: None, training_loss: None };
        Ok(Self {
            adam: Adam::new(&parameters),
            best: parameters.clone(),
            parameters,
            found: vec![initial; groups.len()],
            epoch: 0,
            training_data: training_data
                .iter()
                .map(|recording| scaled(recording, settings.near_zero))
                .collect(),
            held_out: scaled(held_out, unweighted()),
            settings,
            topology,
            groups,
            scaling,
        })
    }

    /// Whether the epochs or the patience of all networks are exhausted.
    pub fn finished(&self) -> bool {
        let networks = 0..self.groups.len();
        self.epoch >= self.settings.epochs
            || networks.into_iter().all(|network| self.stopped(network))
    }

    fn stopped(&self, network: usize) -> bool {
        self.epoch - self.found[network].epoch >= self.settings.patience
    }

    /// Learning rate of the next epoch.
    fn rate(&self) -> f64 {
        let share = f64::from(self.epoch) / f64::from(self.settings.epochs);
        let fall = 0.5 * (1.0 + libm::cos(std::f64::consts::PI * share));
        self.settings.rate * (FINAL_RATE + (1.0 - FINAL_RATE) * fall)
    }

    /// Trains one epoch and evaluates the held-out recording.
    pub fn epoch(&mut self) -> Result<EpochResult, TrainError> {
        let networks = self.groups.len();
        let done: Vec<bool> = (0..networks).map(|network| self.stopped(network)).collect();
        let training = self.train_epoch();
        self.epoch += 1;
        let held_out = mean_losses(&predict(&self.parameters, &self.held_out));
        for network in 0..networks {
            let loss = held_out[network];
            if !loss.is_finite() || !training[network].is_finite() {
                return Err(TrainError::Diverged {
                    sensors: self.groups[network].clone(),
                    epoch: self.epoch,
                });
            }
            let found = &mut self.found[network];
            if !done[network] && found.held_out_loss.is_none_or(|best| loss < best) {
                *found = BestEpoch {
                    epoch: self.epoch,
                    held_out_loss: Some(loss),
                    training_loss: Some(training[network]),
                };
                self.best.copy_network(network, &self.parameters);
            }
        }
        let mean = |losses: &[f64]| losses.iter().sum::<f64>() / networks as f64;
        Ok(EpochResult {
            epoch: self.epoch,
            training_loss: mean(&training),
            held_out_loss: mean(&held_out),
        })
    }

    /// Trains one epoch; the mean loss of each network.
    fn train_epoch(&mut self) -> Vec<f64> {
        let networks = self.parameters.size.networks;
        let rate = self.rate();
        let streams = StreamBatches::sample(&self.training_data, self.settings.seed, self.epoch);
        let mut passes: Vec<Vec<StreamPass>> = (0..networks)
            .map(|_| vec![StreamPass::new(&self.parameters, WINDOW_ROWS); streams.count()])
            .collect();
        let mut sums = vec![(0.0, 0.0); networks];
        for window in 0..streams.windows {
            passes.par_iter_mut().enumerate().for_each(|(network, passes)| {
                let weights = NetworkWeights::of(&self.parameters, network);
                passes.par_iter_mut().enumerate().for_each(|(stream, pass)| {
                    let place = (stream, window);
                    streams.window(&self.training_data, network, place, &mut pass.rows);
                    pass.train(&weights);
                });
            });
            let mut gradients = TrainableParameters::zero(self.parameters.size);
            for (network, (passes, sum)) in passes.iter().zip(&mut sums).enumerate() {
                let weights = passes.iter().flat_map(|pass| &pass.rows.weight);
                let count: f32 = weights.sum();
                let loss: f64 = passes.iter().map(|pass| pass.loss).sum();
                *sum = (sum.0 + loss, sum.1 + f64::from(count));
                // Mean of each network, so that the effective rate does not depend on its number of references.
                let share = 1.0 / count.max(1.0);
                // Summed in a fixed order, for equal bits.
                for (tensor, gradient) in gradients.all.iter_mut().enumerate() {
                    for pass in passes {
                        add_scaled(gradient.of_mut(network), share, &pass.gradients[tensor]);
                    }
                }
            }
            clip_gradients(&mut gradients);
            self.adam.step(&mut self.parameters, &gradients, rate);
            self.parameters.clip_to_device();
        }
        sums.iter().map(|(sum, count)| sum / count).collect()
    }

    /// Predictions of the best weights on the held-out recording: `[network][force]`.
    pub fn predictions(&self) -> Vec<Vec<Vec<Prediction>>> {
        predict(&self.best, &self.held_out)
    }

    /// The best networks so far.
    pub fn networks(&self) -> Vec<Network> {
        let network = |(i, sensors): (usize, &Vec<u32>)| {
            let (head_weights, head_bias) = self.best.head(i);
            Network {
                sensors: sensors.clone(),
                inputs: self.scaling.inputs[i].clone(),
                target: self.topology.target,
                hidden: self.topology.hidden,
                layers: [self.best.layer(i, 0), self.best.layer(i, 1)],
                head_weights,
                head_bias,
                force_n: self.scaling.force_n,
                guards: Vec::new(),
            }
        };
        self.groups.iter().enumerate().map(network).collect()
    }
}
