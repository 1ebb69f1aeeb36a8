//! The training itself, from epoch to epoch.

use firmware::params::FORCE_RANGE;

use super::Problem;
use super::adam::{Adam, clip};
use super::forward::{State, Weights, losses};
use super::judge::{Told, mean_losses, tell};
use super::lesson::{Scaled, Scaling, Sequence, Topology, weight_near_zero};
use super::parameters::{Parameters, Size};
use super::streams::Streams;
use crate::gru::network::{Network, OUTPUTS};

/// Share of the first rate that is left at the last epoch.
const LAST_RATE: f64 = 0.01;

/// How a training goes.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Settings {
    /// Seed of the first weights and of the cuts.
    pub seed: u64,
    /// Epochs over which the learning rate falls, by half a cosine; there are no more.
    pub epochs: u32,
    /// Epochs without a better held-out loss after which a network is done.
    pub patience: u32,
    /// Learning rate at the start.
    pub rate: f64,
    /// What a row without force counts beside one with much, see [`weight_near_zero`]; the weights
    /// are chosen by the even likelihood all the same.
    ///
    /// [`weight_near_zero`]: super::lesson::weight_near_zero
    #[serde(default = "even", skip_serializing_if = "is_even")]
    pub near_zero: f64,
    /// Force that each axis is designed for, either way, in newtons: what is near to zero is a share of it.
    #[serde(default = "usual_range", skip_serializing_if = "is_usual_range")]
    pub force_range_n: f64,
}

/// MAGPIE's, which files of networks leave out.
fn usual_range() -> f64 {
    FORCE_RANGE.value
}

#[allow(clippy::trivially_copy_pass_by_ref)] // The serialiser's signature.
fn is_usual_range(force_range_n: &f64) -> bool {
    *force_range_n == usual_range()
}

/// Weight of a row without force where all count the same.
fn even() -> f64 {
    1.0
}

#[allow(clippy::trivially_copy_pass_by_ref)] // The serialiser's signature.
fn is_even(near_zero: &f64) -> bool {
    *near_zero == even()
}

/// Where the best weights of a network were found.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Best {
    /// Epoch, from one on; zero before the first.
    pub epoch: u32,
    /// Mean held-out loss, in nats for each force in shares of its scale, without the constant;
    /// `None` before the first epoch.
    pub held_out_loss: Option<f64>,
    /// Mean loss over that epoch, of the rows that are learned from.
    pub training_loss: Option<f64>,
}

/// What an epoch came to: the mean of all networks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Epochs so far.
    pub epoch: u32,
    /// Loss over the epoch.
    pub training_loss: f64,
    /// Loss on the held-out recording after it.
    pub held_out_loss: f64,
}

/// A training between two epochs.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// How it goes.
    pub settings: Settings,
    /// What the networks see and tell.
    pub topology: Topology,
    /// Sensors of each network.
    pub groups: Vec<Vec<u32>>,
    /// How their inputs and outputs are scaled.
    pub scaling: Scaling,
    /// Epochs so far.
    pub epoch: u32,
    /// The weights now.
    pub parameters: Parameters,
    /// The optimiser.
    pub adam: Adam,
    /// The best weights so far, network by network.
    pub best: Parameters,
    /// Where they were found.
    pub found: Vec<Best>,
    lessons: Vec<Scaled>,
    held_out: Scaled,
}

impl Course {
    /// Before the first epoch. All sequences have the same sensors.
    pub fn new(
        settings: Settings,
        topology: Topology,
        lessons: &[Sequence],
        held_out: &Sequence,
    ) -> Result<Self, Problem> {
        for sequence in lessons.iter().chain([held_out]) {
            if let Some(track) = sequence.tracks.iter().find(|t| t.truth_n.is_empty()) {
                return Err(Problem::NoTruthAt {
                    recording: sequence.name.clone(),
                    sensor: track.number,
                });
            }
        }
        let sensors: Vec<u32> = held_out.tracks.iter().map(|track| track.number).collect();
        let groups = topology.groups(&sensors);
        let scaling = Scaling::of(lessons, &topology, &groups)?;
        let size = Size {
            networks: groups.len(),
            inputs: scaling.inputs[0].len(),
            hidden: topology.hidden,
            outputs: OUTPUTS * groups[0].len(),
        };
        let keys: Vec<u32> = groups.iter().map(|sensors| sensors[0]).collect();
        let parameters = Parameters::random(size, settings.seed, &keys);
        let range_n = settings.force_range_n;
        let scaled = |sequence, near_zero| {
            let counts = |n| weight_near_zero(n, range_n, near_zero);
            Scaled::of(sequence, &scaling, &groups, topology.target, counts)
        };
        let nowhere = Best {
            epoch: 0,
            held_out_loss: None,
            training_loss: None,
        };
        Ok(Self {
            adam: Adam::new(&parameters),
            best: parameters.clone(),
            parameters,
            found: vec![nowhere; groups.len()],
            epoch: 0,
            lessons: lessons
                .iter()
                .map(|lesson| scaled(lesson, settings.near_zero))
                .collect(),
            held_out: scaled(held_out, even()),
            settings,
            topology,
            groups,
            scaling,
        })
    }

    /// Whether no epoch is left, or none is worth it.
    pub fn finished(&self) -> bool {
        let networks = 0..self.groups.len();
        self.epoch >= self.settings.epochs || networks.into_iter().all(|network| self.done(network))
    }

    fn done(&self, network: usize) -> bool {
        self.epoch - self.found[network].epoch >= self.settings.patience
    }

    /// The learning rate of the epoch that comes.
    fn rate(&self) -> f64 {
        let share = f64::from(self.epoch) / f64::from(self.settings.epochs);
        let fall = 0.5 * (1.0 + libm::cos(std::f64::consts::PI * share));
        self.settings.rate * (LAST_RATE + (1.0 - LAST_RATE) * fall)
    }

    /// Goes through all recordings once and judges on the held-out one.
    pub fn epoch(&mut self) -> Result<Progress, Problem> {
        let networks = self.groups.len();
        let done: Vec<bool> = (0..networks).map(|network| self.done(network)).collect();
        let training = self.learn()?;
        self.epoch += 1;
        let held_out = mean_losses(&tell(&self.parameters, &self.held_out)?);
        for network in 0..networks {
            let loss = held_out[network];
            if !loss.is_finite() || !training[network].is_finite() {
                return Err(Problem::Diverged {
                    sensors: self.groups[network].clone(),
                    epoch: self.epoch,
                });
            }
            let found = &mut self.found[network];
            if !done[network] && found.held_out_loss.is_none_or(|best| loss < best) {
                *found = Best {
                    epoch: self.epoch,
                    held_out_loss: Some(loss),
                    training_loss: Some(training[network]),
                };
                self.best.copy_network(network, &self.parameters);
            }
        }
        let mean = |losses: &[f64]| losses.iter().sum::<f64>() / networks as f64;
        Ok(Progress {
            epoch: self.epoch,
            training_loss: mean(&training),
            held_out_loss: mean(&held_out),
        })
    }

    /// One epoch of steps; the mean loss of each network over it.
    fn learn(&mut self) -> Result<Vec<f64>, Problem> {
        let size = self.parameters.size;
        let rate = self.rate();
        let streams = Streams::cut(&self.lessons, self.settings.seed, self.epoch);
        let mut state = State::zero(size, streams.count());
        let mut sums = vec![(0.0, 0.0); size.networks];
        for window in 0..streams.windows {
            let batch = streams.batch(&self.lessons, size.networks, window)?;
            let weights = Weights::of(&self.parameters)?;
            let outputs = weights.forward(&batch.inputs, streams.count(), &mut state)?;
            let losses = losses(&outputs, &batch.truth, &batch.weight)?;
            let each = losses.to_vec1::<f32>()?;
            for (sum, (loss, count)) in sums.iter_mut().zip(each.iter().zip(&batch.counts)) {
                *sum = (sum.0 + f64::from(*loss), sum.1 + f64::from(*count));
            }
            // The mean of each network, so that none learns faster for having more truth.
            let shares: Vec<f32> = batch.counts.iter().map(|n| 1.0 / n.max(1.0)).collect();
            let shares = candle_core::Tensor::new(shares, losses.device())?;
            let gradients = (losses * shares)?.sum_all()?.backward()?;
            let mut slopes = Vec::with_capacity(weights.all.len());
            for variable in &weights.all {
                slopes.push(match gradients.get(variable) {
                    Some(slope) => slope.flatten_all()?.to_vec1::<f32>()?,
                    None => vec![0.0; variable.elem_count()],
                });
            }
            clip(&mut slopes, size.networks);
            self.adam.step(&mut self.parameters, &slopes, rate);
            self.parameters.limit();
        }
        Ok(sums.iter().map(|(sum, count)| sum / count).collect())
    }

    /// What the best weights tell of the held-out recording: `[network][force]`.
    pub fn told(&self) -> Result<Vec<Vec<Vec<Told>>>, Problem> {
        Ok(tell(&self.best, &self.held_out)?)
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
