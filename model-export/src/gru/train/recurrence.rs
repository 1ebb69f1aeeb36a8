//! Recurrence of one GRU layer as a single operation, forward and backward.
//!
//! Time-independent products use the tensor library. The recurrence has one small step per row, for which
//! single tensor operations cost many times the arithmetic; here a step is a few loops. Streams are
//! independent, so the result does not depend on the number of threads.

use crate::gru::network::GATES;
use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Storage, Tensor, bail};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Values saved for the backward pass per unit and row: reset, update, candidate, and the candidate's recurrent
/// sum before the reset.
const SAVED: usize = 4;

/// The recurrence over `streams` of every network, from a state.
///
/// - first argument, `networks x streams x rows x GATES*hidden`: the products of the inputs, without bias;
/// - second, `networks x hidden x GATES*hidden`: the recurrent weights;
/// - third, `networks x 2 x GATES*hidden`: the input's and the state's bias;
/// - result, `networks x streams x rows x hidden`: the states.
pub struct Recurrence {
    /// Units.
    pub hidden: usize,
    /// Streams of a network.
    pub streams: usize,
    /// Rows of a stream.
    pub rows: usize,
    /// The state before the first row, `networks x streams x hidden`.
    pub start: Vec<f32>,
    /// Values saved by the forward pass.
    pub saved: OnceLock<Vec<f32>>,
}

fn values<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    match layout.contiguous_offsets() {
        Some((from, to)) => Ok(&storage.as_slice::<f32>()?[from..to]),
        None => bail!("the recurrence needs its arguments in one piece"),
    }
}

fn on_cpu(storage: &Storage) -> Result<&CpuStorage> {
    match storage {
        Storage::Cpu(storage) => Ok(storage),
        _ => bail!("the recurrence runs on the processor"),
    }
}

/// `sum += factor * row`.
fn add_scaled(sum: &mut [f32], factor: f32, row: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(row) {
        *sum += factor * value;
    }
}

impl Recurrence {
    fn start_of(&self, stream: usize) -> &[f32] {
        &self.start[stream * self.hidden..][..self.hidden]
    }

    /// One stream forward.
    fn forward(
        &self,
        start: &[f32],
        products: &[f32],
        weights: &[f32],
        bias: &[f32],
        (states, saved): (&mut [f32], &mut [f32]),
    ) {
        let hidden = self.hidden;
        let (input_bias, state_bias) = bias.split_at(GATES * hidden);
        let mut state = start.to_vec();
        let mut sums = vec![0.0; GATES * hidden];
        let rows = products.chunks_exact(GATES * hidden);
        let left = states.chunks_exact_mut(hidden);
        let left = left.zip(saved.chunks_exact_mut(SAVED * hidden));
        for (product, (states, saved)) in rows.zip(left) {
            sums.copy_from_slice(state_bias);
            for (&h, row) in state.iter().zip(weights.chunks_exact(GATES * hidden)) {
                add_scaled(&mut sums, h, row);
            }
            // Separate loops, so that the compiler vectorises them.
            let (gates, candidates) = saved.split_at_mut(2 * hidden);
            let (candidates, inner) = candidates.split_at_mut(hidden);
            for (i, gate) in gates.iter_mut().enumerate() {
                *gate = sigmoid(product[i] + input_bias[i] + sums[i]);
            }
            inner.copy_from_slice(&sums[2 * hidden..]);
            let (reset, update) = gates.split_at(hidden);
            let bias = product[2 * hidden..].iter().zip(&input_bias[2 * hidden..]);
            let outer = bias.zip(reset.iter().zip(&*inner));
            for (candidate, ((product, bias), (reset, inner))) in candidates.iter_mut().zip(outer) {
                *candidate = tanh(product + bias + reset * inner);
            }
            for (h, (candidate, update)) in state.iter_mut().zip(candidates.iter().zip(update)) {
                *h = candidate + update * (*h - candidate);
            }
            states.copy_from_slice(&state);
        }
    }

    /// Backward pass of one stream; `transposed` are the recurrent weights row by row of the sums.
    fn backward(
        &self,
        start: &[f32],
        transposed: &[f32],
        (states, saved): (&[f32], &[f32]),
        gradient: &[f32],
        products: &mut [f32],
    ) -> Gradients {
        let hidden = self.hidden;
        let mut gradients = Gradients::zero(hidden);
        let mut state_gradient = vec![0.0; hidden];
        let mut sums = vec![0.0; GATES * hidden];
        for row in (0..self.rows).rev() {
            let saved_row = &saved[row * SAVED * hidden..][..SAVED * hidden];
            let before = match row {
                0 => start,
                _ => &states[(row - 1) * hidden..][..hidden],
            };
            let product = &mut products[row * GATES * hidden..][..GATES * hidden];
            let expected = &gradient[row * hidden..][..hidden];
            for i in 0..hidden {
                let [reset, update, candidate, inner] =
                    [0, 1, 2, 3].map(|kind| saved_row[kind * hidden + i]);
                let state = state_gradient[i] + expected[i];
                let d_candidate = state * (1.0 - update) * (1.0 - candidate * candidate);
                let d_update = state * (before[i] - candidate) * update * (1.0 - update);
                let d_reset = d_candidate * inner * reset * (1.0 - reset);
                state_gradient[i] = state * update;
                product[i] = d_reset;
                product[hidden + i] = d_update;
                product[2 * hidden + i] = d_candidate;
                sums[i] = d_reset;
                sums[hidden + i] = d_update;
                sums[2 * hidden + i] = d_candidate * reset;
            }
            for (&gradient, weights) in sums.iter().zip(transposed.chunks_exact(hidden)) {
                add_scaled(&mut state_gradient, gradient, weights);
            }
            let rows = gradients.weights.chunks_exact_mut(GATES * hidden);
            for (&h, weights) in before.iter().zip(rows) {
                add_scaled(weights, h, &sums);
            }
            let (input_bias, state_bias) = gradients.bias.split_at_mut(GATES * hidden);
            add_scaled(input_bias, 1.0, product);
            add_scaled(state_bias, 1.0, &sums);
        }
        gradients
    }

    /// Transposed recurrent weights of every network.
    fn transposed(&self, weights: &[f32]) -> Vec<f32> {
        let (hidden, sums) = (self.hidden, GATES * self.hidden);
        let of_network = |weights: &[f32]| -> Vec<f32> {
            (0..sums * hidden).map(|i| weights[(i % hidden) * sums + i / hidden]).collect()
        };
        weights.chunks_exact(hidden * sums).flat_map(of_network).collect()
    }
}

/// Gradients of the weights of one stream.
struct Gradients {
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Gradients {
    fn zero(hidden: usize) -> Self {
        Self { weights: vec![0.0; GATES * hidden * hidden], bias: vec![0.0; 2 * GATES * hidden] }
    }

    fn add(&mut self, other: &Self) {
        add_scaled(&mut self.weights, 1.0, &other.weights);
        add_scaled(&mut self.bias, 1.0, &other.bias);
    }
}

impl CustomOp3 for Recurrence {
    fn name(&self) -> &'static str {
        "recurrence"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (products, weights, bias) = (values(s1, l1)?, values(s2, l2)?, values(s3, l3)?);
        let (hidden, networks) = (self.hidden, l2.dims()[0]);
        let streams = networks * self.streams;
        let mut states = vec![0.0; streams * self.rows * hidden];
        let mut saved = vec![0.0; streams * self.rows * SAVED * hidden];
        let left = states.par_chunks_mut(self.rows * hidden);
        left.zip(saved.par_chunks_mut(self.rows * SAVED * hidden))
            .zip(products.par_chunks(self.rows * GATES * hidden))
            .enumerate()
            .for_each(|(stream, (left, products))| {
                let network = stream / self.streams;
                let weights = &weights[network * GATES * hidden * hidden..];
                let bias = &bias[network * 2 * GATES * hidden..][..2 * GATES * hidden];
                self.forward(self.start_of(stream), products, weights, bias, left);
            });
        if self.saved.set(saved).is_err() {
            bail!("the recurrence goes forward once");
        }
        let shape = (networks, self.streams, self.rows, hidden);
        Ok((CpuStorage::F32(states), shape.into()))
    }

    fn bwd(
        &self,
        products: &Tensor,
        weights: &Tensor,
        bias: &Tensor,
        states: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (hidden, networks) = (self.hidden, weights.dims()[0]);
        let Some(saved) = self.saved.get() else {
            bail!("the recurrence goes forward before it goes back");
        };
        let gradient = gradient.contiguous()?;
        let (weights_lock, weights_layout) = weights.storage_and_layout();
        let (states_lock, states_layout) = states.storage_and_layout();
        let (gradient_lock, gradient_layout) = gradient.storage_and_layout();
        let transposed = self.transposed(values(on_cpu(&weights_lock)?, weights_layout)?);
        let states = values(on_cpu(&states_lock)?, states_layout)?;
        let gradient = values(on_cpu(&gradient_lock)?, gradient_layout)?;
        let streams = networks * self.streams;
        let mut d_products = vec![0.0; streams * self.rows * GATES * hidden];
        let known = states.par_chunks(self.rows * hidden);
        let known = known.zip(saved.par_chunks(self.rows * SAVED * hidden));
        let gradients: Vec<Gradients> = d_products
            .par_chunks_mut(self.rows * GATES * hidden)
            .zip(known.zip(gradient.par_chunks(self.rows * hidden)))
            .enumerate()
            .map(|(stream, (products, (known, gradient)))| {
                let transposed = &transposed[stream / self.streams * GATES * hidden * hidden..];
                let transposed = &transposed[..GATES * hidden * hidden];
                self.backward(self.start_of(stream), transposed, known, gradient, products)
            })
            .collect();
        // Summed in a fixed order, for equal bits.
        let (mut d_weights, mut d_bias) = (Vec::new(), Vec::new());
        for of_network in gradients.chunks(self.streams) {
            let mut sum = Gradients::zero(hidden);
            of_network.iter().for_each(|gradients| sum.add(gradients));
            d_weights.extend(sum.weights);
            d_bias.extend(sum.bias);
        }
        let like = |values: Vec<f32>, like: &Tensor| {
            Tensor::from_vec(values, like.shape(), like.device()).map(Some)
        };
        Ok((like(d_products, products)?, like(d_weights, weights)?, like(d_bias, bias)?))
    }
}

/// Limit beyond which the sigmoid is 0 or 1 and the exponential still finite.
const EXP_LIMIT: f32 = 80.0;
/// Adding and subtracting this rounds to the nearest integer, which is then in the lowest bits of the sum.
const ROUNDING: f32 = 12_582_912.0;
/// Upper part of the natural logarithm of two: its product with a whole number below 128 is exact.
const LN_2_UPPER: f32 = 0.693_359_4;
/// Lower part.
const LN_2_LOWER: f32 = -2.121_944_4e-4;
/// Exponent bias of the format, and its bit position.
const EXPONENT: (u32, u32) = (127, 23);

/// Exponential, relative error 3e-7, argument clamped to ±80.
fn exp(x: f32) -> f32 {
    let x = x.clamp(-EXP_LIMIT, EXP_LIMIT);
    let sum = x * std::f32::consts::LOG2_E + ROUNDING;
    let whole = sum - ROUNDING;
    let rest = x - whole * LN_2_UPPER - whole * LN_2_LOWER;
    // Taylor series; the next term is below 1.2e-7.
    let mut series = 1.0 / 720.0;
    for factor in [1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        series = series * rest + factor;
    }
    let (one, place) = EXPONENT;
    series * f32::from_bits(sum.to_bits().wrapping_add(one) << place)
}

/// `1 / (1 + exp(-x))`, to 2e-7.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// The hyperbolic tangent, to 4e-7.
pub fn tanh(x: f32) -> f32 {
    2.0 * sigmoid(2.0 * x) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn activations_are_exact_to_a_few_1e_7() {
        for i in -200_000..=200_000 {
            let x = i as f32 * 1e-4;
            let exact = f64::from(x);
            let error = f64::from(exp(x)) / exact.exp() - 1.0;
            assert!(error.abs() < 3e-7, "{x}: {error}");
            let error = f64::from(sigmoid(x)) - 1.0 / (1.0 + (-exact).exp());
            assert!(error.abs() < 2e-7, "{x}: {error}");
            let error = f64::from(tanh(x)) - exact.tanh();
            assert!(error.abs() < 4e-7, "{x}: {error}");
        }
    }

    #[test]
    fn activations_saturate_for_large_arguments() {
        for x in [90.0, 1e4, f32::MAX] {
            assert_eq!((sigmoid(x), tanh(x), tanh(-x)), (1.0, 1.0, -1.0));
            assert!(sigmoid(-x) < 1e-30);
        }
        assert!(sigmoid(f32::NAN).is_nan());
    }
}
