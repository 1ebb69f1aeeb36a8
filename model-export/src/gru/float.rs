//! A network's step in floating point, written from its equation alone.

use super::network::{Layer, Network};

/// States of both layers.
#[derive(Clone, Debug, PartialEq)]
pub struct FloatState([Vec<f64>; 2]);

impl FloatState {
    /// Every unit of both layers at `value`; zero after a reset.
    pub fn at(network: &Network, value: f64) -> Self {
        Self([vec![value; network.hidden], vec![value; network.hidden]])
    }

    /// Of one layer, in order.
    pub fn layer(&self, layer: usize) -> &[f64] {
        &self.0[layer]
    }

    /// One step over scaled inputs; the outputs.
    pub fn step(&mut self, network: &Network, inputs: &[f64]) -> Vec<f64> {
        let [first, second] = &mut self.0;
        *first = next(&network.layers[0], inputs, first);
        *second = next(&network.layers[1], first, second);
        let rows = network.head_weights.chunks(network.hidden);
        let outputs = rows.zip(&network.head_bias);
        outputs
            .map(|(row, &bias)| f64::from(bias) + product(row, second))
            .collect()
    }
}

fn next(layer: &Layer, inputs: &[f64], state: &[f64]) -> Vec<f64> {
    let units = state.len();
    let input = |row: usize| {
        let weights = &layer.input_weights[row * inputs.len()..][..inputs.len()];
        f64::from(layer.input_bias[row]) + product(weights, inputs)
    };
    let recurrent = |row: usize| {
        let weights = &layer.state_weights[row * units..][..units];
        f64::from(layer.state_bias[row]) + product(weights, state)
    };
    (0..units)
        .map(|unit| {
            let [reset_row, update_row, candidate_row] = [unit, units + unit, 2 * units + unit];
            let reset = sigmoid(input(reset_row) + recurrent(reset_row));
            let update = sigmoid(input(update_row) + recurrent(update_row));
            let candidate = libm::tanh(input(candidate_row) + reset * recurrent(candidate_row));
            (1.0 - update) * candidate + update * state[unit]
        })
        .collect()
}

fn product(weights: &[f32], values: &[f64]) -> f64 {
    let products = weights.iter().zip(values);
    products
        .map(|(&weight, value)| f64::from(weight) * value)
        .sum()
}

fn sigmoid(at: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-at))
}
