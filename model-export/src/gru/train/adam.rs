//! Adam with decoupled decay, and its memory where a checkpoint can reach it.

use super::parameters::{Kind, Parameters};

/// Decay of the mean slope.
const FIRST: f64 = 0.9;
/// Decay of the mean squared slope.
const SECOND: f64 = 0.999;
/// Added to the root of the mean squared slope.
const FLOOR: f64 = 1e-8;
/// Share of a weight that goes with each step of rate one. Biases do not decay: that of the update
/// gate is a unit's memory.
pub const DECAY: f64 = 0.01;
/// Greatest slope of one network, root of the sum of squares; a greater one is shortened to it.
pub const GREATEST_SLOPE: f64 = 1.0;

/// The optimiser's memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Steps so far.
    pub steps: u32,
    /// Mean slope of each parameter.
    pub first: Parameters,
    /// Mean squared slope.
    pub second: Parameters,
}

impl Adam {
    /// Before the first step.
    pub fn new(parameters: &Parameters) -> Self {
        let zero = Parameters::zero(parameters.size);
        Self {
            steps: 0,
            first: zero.clone(),
            second: zero,
        }
    }

    /// One step down the slopes, which are given in the parameters' order.
    pub fn step(&mut self, parameters: &mut Parameters, slopes: &[Vec<f32>], rate: f64) {
        self.steps += 1;
        let steps = f64::from(self.steps);
        let mean = 1.0 / (1.0 - libm::pow(FIRST, steps));
        let squares = 1.0 / (1.0 - libm::pow(SECOND, steps));
        for (i, slopes) in slopes.iter().enumerate() {
            let kind = parameters.all[i].kind;
            let decays = matches!(kind, Kind::Weights | Kind::State);
            let kept = if decays { 1.0 - rate * DECAY } else { 1.0 };
            let values = parameters.all[i].values.iter_mut().zip(slopes);
            let memory = self.first.all[i].values.iter_mut();
            let memory = memory.zip(self.second.all[i].values.iter_mut());
            for ((value, &slope), (first, second)) in values.zip(memory) {
                let slope = f64::from(slope);
                let m = FIRST * f64::from(*first) + (1.0 - FIRST) * slope;
                let v = SECOND * f64::from(*second) + (1.0 - SECOND) * slope * slope;
                (*first, *second) = (m as f32, v as f32);
                let step = rate * m * mean / ((v * squares).sqrt() + FLOOR);
                *value = (kept * f64::from(*value) - step) as f32;
            }
        }
    }
}

/// Shortens the slope of each network to [`GREATEST_SLOPE`].
pub fn clip(slopes: &mut [Vec<f32>], networks: usize) {
    for network in 0..networks {
        let part = |slopes: &Vec<f32>| {
            let each = slopes.len() / networks;
            network * each..(network + 1) * each
        };
        let squares = slopes.iter().flat_map(|s| &s[part(s)]);
        let length = squares.map(|s| f64::from(*s).powi(2)).sum::<f64>().sqrt();
        if length > GREATEST_SLOPE {
            let factor = (GREATEST_SLOPE / length) as f32;
            for slopes in slopes.iter_mut() {
                let range = part(slopes);
                slopes[range].iter_mut().for_each(|s| *s *= factor);
            }
        }
    }
}
