//! Adam with decoupled weight decay; its moments are public for checkpoints.

use crate::gru::train::parameters::{TensorKind, TrainableParameters};

/// Decay of the mean gradient.
const FIRST: f64 = 0.9;
/// Decay of the mean squared gradient.
const SECOND: f64 = 0.999;
/// Added to the root of the mean squared gradient.
const FLOOR: f64 = 1e-8;
/// Weight decay per step of unit rate. Biases do not decay: that of the update gate sets a unit's memory.
pub const WEIGHT_DECAY: f64 = 0.01;
/// Maximum gradient norm of one network.
pub const MAX_GRADIENT_NORM: f64 = 1.0;

/// State of the optimiser.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Steps so far.
    pub steps: u32,
    /// Mean gradient of each parameter.
    pub first: TrainableParameters,
    /// Mean squared gradient.
    pub second: TrainableParameters,
}

impl Adam {
    /// Before the first step.
    pub fn new(parameters: &TrainableParameters) -> Self {
        let zero = TrainableParameters::zero(parameters.size);
        Self { steps: 0, first: zero.clone(), second: zero }
    }

    pub fn step(
        &mut self,
        parameters: &mut TrainableParameters,
        gradients: &TrainableParameters,
        rate: f64,
    ) {
        self.steps += 1;
        let steps = f64::from(self.steps);
        let mean = 1.0 / (1.0 - libm::pow(FIRST, steps));
        let squares = 1.0 / (1.0 - libm::pow(SECOND, steps));
        for (i, gradients) in gradients.all.iter().enumerate() {
            let kind = parameters.all[i].kind;
            let decays = matches!(kind, TensorKind::Weights | TensorKind::State);
            let kept = if decays { 1.0 - rate * WEIGHT_DECAY } else { 1.0 };
            let values = parameters.all[i].values.iter_mut().zip(&gradients.values);
            let memory = self.first.all[i].values.iter_mut();
            let memory = memory.zip(self.second.all[i].values.iter_mut());
            for ((value, &gradient), (first, second)) in values.zip(memory) {
                let gradient = f64::from(gradient);
                let m = FIRST * f64::from(*first) + (1.0 - FIRST) * gradient;
                let v = SECOND * f64::from(*second) + (1.0 - SECOND) * gradient * gradient;
                (*first, *second) = (m as f32, v as f32);
                let step = rate * m * mean / ((v * squares).sqrt() + FLOOR);
                *value = (kept * f64::from(*value) - step) as f32;
            }
        }
    }
}

/// Scales the gradient of each network to at most [`MAX_GRADIENT_NORM`].
pub fn clip_gradients(gradients: &mut TrainableParameters) {
    for network in 0..gradients.size.networks {
        let squares = gradients.all.iter().flat_map(|tensor| tensor.of(network));
        let length = squares.map(|s| f64::from(*s).powi(2)).sum::<f64>().sqrt();
        if length > MAX_GRADIENT_NORM {
            let factor = (MAX_GRADIENT_NORM / length) as f32;
            for tensor in &mut gradients.all {
                tensor.of_mut(network).iter_mut().for_each(|s| *s *= factor);
            }
        }
    }
}
