//! Weights brought back to what the device can hold.
//!
//! A weight has a greatest value of its own, and the device's sums wrap at 32 bits without a word: the
//! exporter refuses a row whose greatest sum might ([`crate::gru::quantise`]). So after every step a row
//! that could not be exported is shortened, its biases with it: it keeps its direction, and with it where
//! its gate is half open.

use firmware::model::network::{INPUT_BITS, OUTPUT_BITS};

use super::parameters::{Kind, Parameter, Parameters, place};
use crate::gru::network::GATES;
use crate::gru::quantise::{INPUT_LIMIT, SUM_LIMIT};

/// Greatest weight, either way: the device holds weights within eight.
pub const WEIGHT_LIMIT: f32 = 7.99;
/// The same for the candidate's recurrent weights, which the device holds within four.
pub const CANDIDATE_LIMIT: f32 = 3.99;

/// What rounding may add to a sum.
const ROUNDING: f32 = 0.1;
/// What calibrating sigma may add to a bias of the head: the logarithm of a factor of twenty.
const CALIBRATION: f32 = 3.0;
/// Greatest sum of a gate, of a candidate, and of the head.
const GREATEST_SUM: f32 = (SUM_LIMIT >> OUTPUT_BITS) as f32 - ROUNDING;
/// The same of a candidate's recurrent part, which has a fractional bit more.
const GREATEST_CANDIDATE: f32 = (SUM_LIMIT >> (OUTPUT_BITS + 1)) as f32 - ROUNDING;
/// Greatest input of the first layer; the second's are states, within one.
const GREATEST_INPUT: f32 = (INPUT_LIMIT >> INPUT_BITS) as f32;

impl Parameters {
    /// Brings every weight back to what the device can hold, and every row.
    pub fn limit(&mut self) {
        self.all.iter_mut().for_each(Parameter::limit);
        for network in 0..self.size.networks {
            for (layer, greatest_input) in [GREATEST_INPUT, 1.0].into_iter().enumerate() {
                for column in 0..GATES * self.size.hidden {
                    self.shorten(network, layer, column, greatest_input);
                }
            }
            let head = [place::HEAD_WEIGHTS, place::HEAD_BIAS];
            for output in 0..self.size.outputs {
                let sum: f32 = head
                    .iter()
                    .map(|&i| self.all[i].size(network, output))
                    .sum();
                let factor = factor(GREATEST_SUM - CALIBRATION, sum);
                head.iter()
                    .for_each(|&i| self.all[i].scale(network, output, factor));
            }
        }
    }

    /// Shortens one row of a layer.
    fn shorten(&mut self, network: usize, layer: usize, column: usize, greatest_input: f32) {
        let [input, state, bias] = place::LAYERS[layer];
        let from_inputs = greatest_input * self.all[input].size(network, column);
        let from_states = self.all[state].size(network, column);
        // Two biases, row by row: beside the inputs and beside the states.
        let biases = &self.all[bias];
        let (beside_inputs, beside_states) = biases.both(network, column);
        let sum = from_inputs + from_states + beside_inputs + beside_states;
        let candidate = column >= (GATES - 1) * self.size.hidden;
        let factor = match candidate {
            false => factor(GREATEST_SUM, sum),
            true => factor(GREATEST_SUM, sum)
                .min(factor(GREATEST_CANDIDATE, from_states + beside_states)),
        };
        for part in [input, state, bias] {
            self.all[part].scale(network, column, factor);
        }
    }
}

/// What brings a sum back to a limit; one where it is within.
fn factor(limit: f32, sum: f32) -> f32 {
    if sum > limit { limit / sum } else { 1.0 }
}

impl Parameter {
    fn columns(&self) -> usize {
        self.shape.last().copied().unwrap_or(1)
    }

    /// Sum of a column's sizes.
    fn size(&self, network: usize, column: usize) -> f32 {
        let values = self.of(network).iter().skip(column).step_by(self.columns());
        values.map(|value| value.abs()).sum()
    }

    /// Sizes of a column's two values.
    fn both(&self, network: usize, column: usize) -> (f32, f32) {
        let values = self.of(network);
        let at = |row: usize| values.get(row * self.columns() + column).copied();
        (at(0).unwrap_or(0.0).abs(), at(1).unwrap_or(0.0).abs())
    }

    fn scale(&mut self, network: usize, column: usize, factor: f32) {
        if factor < 1.0 {
            let columns = self.columns();
            let values = self.of_mut(network).iter_mut().skip(column);
            values.step_by(columns).for_each(|value| *value *= factor);
        }
    }

    /// Brings single weights back.
    fn limit(&mut self) {
        let columns = self.columns();
        let candidate = columns - columns / GATES;
        match self.kind {
            Kind::Weights => self
                .values
                .iter_mut()
                .for_each(|w| *w = w.clamp(-WEIGHT_LIMIT, WEIGHT_LIMIT)),
            Kind::State => {
                for row in self.values.chunks_exact_mut(columns) {
                    for (column, w) in row.iter_mut().enumerate() {
                        let limit = if column < candidate {
                            WEIGHT_LIMIT
                        } else {
                            CANDIDATE_LIMIT
                        };
                        *w = w.clamp(-limit, limit);
                    }
                }
            }
            Kind::LayerBias | Kind::HeadBias => {}
        }
    }
}
