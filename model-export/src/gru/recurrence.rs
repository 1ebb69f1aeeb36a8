//! One layer of gated recurrent units over consecutive rows, forward and backward.
//!
//! The loops run over the units of a row, so that the compiler vectorises them. No sum is formed across the lanes of a vector:
//! results are the same bits on every processor.

#![allow(unsafe_code)] // Instructions that not every processor has, loads and stores of eight numbers at once.

use firmware::model::formats::GATES;

#[derive(Clone, Copy, Debug)]
pub struct LayerWeights<'a> {
    /// `inputs x GATES*hidden`.
    pub input: &'a [f32],
    /// `hidden x GATES*hidden`.
    pub state: &'a [f32],
    /// `2 x GATES*hidden`: the input's and the state's bias.
    pub bias: &'a [f32],
}

/// Gradients of the loss by the weights, in the shapes of [`LayerWeights`].
#[derive(Debug)]
pub struct LayerGradients<'a> {
    /// By the input's weights.
    pub input: &'a mut [f32],
    /// By the recurrent weights.
    pub state: &'a mut [f32],
    /// By both biases.
    pub bias: &'a mut [f32],
}

/// Values saved for the backward pass per unit and row: reset, update, candidate, and the candidate's recurrent
/// sum before the reset.
const SAVED: usize = 4;

/// States of a layer, with what its backward pass needs.
#[derive(Clone, Debug)]
pub struct LayerTape {
    hidden: usize,
    /// `(rows + 1) x hidden`; the first is the state before the first row.
    states: Vec<f32>,
    /// `rows x SAVED*hidden`.
    saved: Vec<f32>,
    /// Weighted sums of the inputs, `rows x GATES*hidden`; after the backward pass the gradients by them.
    input_sums: Vec<f32>,
    /// The same of the states.
    state_sums: Vec<f32>,
}

impl LayerTape {
    /// Of `rows` rows, from the reset state.
    pub fn new(hidden: usize, rows: usize) -> Self {
        let sums = vec![0.0; rows * GATES * hidden];
        Self {
            hidden,
            states: vec![0.0; (rows + 1) * hidden],
            saved: vec![0.0; rows * SAVED * hidden],
            input_sums: sums.clone(),
            state_sums: sums,
        }
    }

    /// States after each row, `rows x hidden`.
    pub fn states(&self) -> &[f32] {
        &self.states[self.hidden..]
    }

    /// Returns to the reset state.
    pub fn reset(&mut self) {
        self.states.fill(0.0);
    }

    /// Continues from the last state.
    #[inline(always)]
    pub fn carry_state(&mut self) {
        let last = self.states.len() - self.hidden;
        self.states.copy_within(last.., 0);
    }

    /// [`LayerTape::forward`] by itself, with the instructions of this processor.
    pub fn predict(&mut self, weights: LayerWeights, inputs: &[f32]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has these instructions.
            return unsafe { self.forward_avx2(weights, inputs) };
        }
        self.forward(weights, inputs);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn forward_avx2(&mut self, weights: LayerWeights, inputs: &[f32]) {
        self.forward(weights, inputs);
    }

    /// Forward pass over `inputs`, `rows x inputs`.
    #[inline(always)]
    pub fn forward(&mut self, weights: LayerWeights, inputs: &[f32]) {
        let hidden = self.hidden;
        let width = GATES * hidden;
        let (input_bias, state_bias) = weights.bias.split_at(width);
        let rows = inputs.chunks_exact(weights.input.len() / width);
        let sums = self.input_sums.chunks_exact_mut(width);
        let sums = sums.zip(self.state_sums.chunks_exact_mut(width));
        let saved = self.saved.chunks_exact_mut(SAVED * hidden);
        for (row, ((input, saved), (outer, inner))) in rows.zip(saved).zip(sums).enumerate() {
            let (before, after) = self.states.split_at_mut((row + 1) * hidden);
            let (before, after) = (&before[row * hidden..], &mut after[..hidden]);
            weighted_sums(outer, input_bias, input, weights.input);
            weighted_sums(inner, state_bias, before, weights.state);
            let (gates, candidates) = saved.split_at_mut(2 * hidden);
            let (candidates, saved_inner) = candidates.split_at_mut(hidden);
            for (gate, (outer, inner)) in gates.iter_mut().zip(outer.iter().zip(&*inner)) {
                *gate = sigmoid(outer + inner);
            }
            let (reset, update) = gates.split_at(hidden);
            let (outer, inner) = (&outer[2 * hidden..], &inner[2 * hidden..]);
            saved_inner.copy_from_slice(inner);
            let sums = outer.iter().zip(reset.iter().zip(inner));
            for (candidate, (outer, (reset, inner))) in candidates.iter_mut().zip(sums) {
                *candidate = outer + reset * inner;
            }
            // By itself, since the compiler does not vectorise the loop of both.
            candidates.iter_mut().for_each(|candidate| *candidate = tanh(*candidate));
            let known = before.iter().zip(update.iter().zip(&*candidates));
            for (after, (before, (update, candidate))) in after.iter_mut().zip(known) {
                *after = candidate + update * (before - candidate);
            }
        }
    }

    /// Backward pass over the rows of the forward pass. `gradient` is that by the states, `rows x hidden`;
    /// `transposed_state` are the recurrent weights, `GATES*hidden x hidden`.
    #[inline(always)]
    pub fn backward(
        &mut self,
        transposed_state: &[f32],
        inputs: &[f32],
        gradient: &[f32],
        into: LayerGradients,
    ) {
        let hidden = self.hidden;
        let width = GATES * hidden;
        // By the state after the row.
        let mut later = vec![0.0; hidden];
        let mut by_gate = vec![0.0; width];
        let zero = vec![0.0; hidden];
        let sums = self.input_sums.chunks_exact_mut(width);
        let sums = sums.zip(self.state_sums.chunks_exact_mut(width));
        let rows = self.saved.chunks_exact(SAVED * hidden).zip(gradient.chunks_exact(hidden));
        let rows = rows.zip(self.states.chunks_exact(hidden)).zip(sums);
        for (((saved, gradient), before), (outer, inner)) in rows.rev() {
            let (reset, saved) = saved.split_at(hidden);
            let (update, saved) = saved.split_at(hidden);
            let (candidate, sum) = saved.split_at(hidden);
            let (outer_reset, outer) = outer.split_at_mut(hidden);
            let (outer_update, outer_candidate) = outer.split_at_mut(hidden);
            let (inner_gates, inner_candidate) = inner.split_at_mut(2 * hidden);
            for i in 0..hidden {
                let state = later[i] + gradient[i];
                let d_candidate = state * (1.0 - update[i]) * (1.0 - candidate[i] * candidate[i]);
                outer_candidate[i] = d_candidate;
                outer_update[i] =
                    state * (before[i] - candidate[i]) * update[i] * (1.0 - update[i]);
                outer_reset[i] = d_candidate * sum[i] * reset[i] * (1.0 - reset[i]);
                inner_candidate[i] = d_candidate * reset[i];
                later[i] = state * update[i];
            }
            inner_gates[..hidden].copy_from_slice(outer_reset);
            inner_gates[hidden..].copy_from_slice(outer_update);
            let gates = by_gate.chunks_exact_mut(hidden).zip(inner.chunks_exact(hidden));
            for ((by_gate, inner), weights) in
                gates.zip(transposed_state.chunks_exact(hidden * hidden))
            {
                weighted_sums(by_gate, &zero, inner, weights);
                add_scaled(&mut later, 1.0, by_gate);
            }
        }
        outer_products(into.input, inputs, (&self.input_sums, width));
        outer_products(into.state, &self.states, (&self.state_sums, width));
        let (input_bias, state_bias) = into.bias.split_at_mut(width);
        for (bias, sums) in [(input_bias, &self.input_sums), (state_bias, &self.state_sums)] {
            bias.fill(0.0);
            sums.chunks_exact(width).for_each(|row| add_scaled(bias, 1.0, row));
        }
    }

    /// Gradient by the inputs after the backward pass, `rows x inputs`; `transposed_input` are the input's weights,
    /// `GATES*hidden x inputs`.
    #[inline(always)]
    pub fn input_gradient(&self, transposed_input: &[f32], gradient: &mut [f32]) {
        let width = GATES * self.hidden;
        let inputs = transposed_input.len() / width;
        let zero = vec![0.0; inputs];
        let rows = gradient.chunks_exact_mut(inputs).zip(self.input_sums.chunks_exact(width));
        for (gradient, sums) in rows {
            weighted_sums(gradient, &zero, sums, transposed_input);
        }
    }
}

/// `sums = bias + values * weights`, where the weights have a row for each value.
#[inline(always)]
pub fn weighted_sums(sums: &mut [f32], bias: &[f32], values: &[f32], weights: &[f32]) {
    strided_sums(sums, bias, (values, 1), weights);
}

/// Sum over all rows of the outer products of a row on the left and a row of `width` on the right.
#[inline(always)]
pub fn outer_products(products: &mut [f32], left: &[f32], (right, width): (&[f32], usize)) {
    let height = products.len() / width;
    let zero = vec![0.0; width];
    for (at, products) in products.chunks_exact_mut(width).enumerate() {
        strided_sums(products, &zero, (&left[at..], height), right);
    }
}

/// [`weighted_sums`] of every value at a distance of `stride`.
#[inline(always)]
fn strided_sums(sums: &mut [f32], bias: &[f32], values: (&[f32], usize), weights: &[f32]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has these instructions.
        return unsafe { strided_sums_avx2(sums, bias, values, weights) };
    }
    sums_from(0, sums, bias, values, weights);
}

/// Sums from the place `first` on.
#[inline(always)]
fn sums_from(
    first: usize,
    sums: &mut [f32],
    bias: &[f32],
    (values, stride): (&[f32], usize),
    weights: &[f32],
) {
    let columns = sums.len();
    let sums = &mut sums[first..];
    sums.copy_from_slice(&bias[first..columns]);
    for (at, row) in weights.chunks_exact(columns).enumerate() {
        add_scaled(sums, values[at * stride], &row[first..]);
    }
}

/// The same sums, to the bit: products are rounded before they are added, without fused instructions.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn strided_sums_avx2(sums: &mut [f32], bias: &[f32], values: (&[f32], usize), weights: &[f32]) {
    let (mut at, columns) = (0, sums.len());
    // The three gates of eight units.
    while at + 3 * LANES <= columns {
        vector_sums::<3>(at, sums, bias, values, weights);
        at += 3 * LANES;
    }
    while at + 2 * LANES <= columns {
        vector_sums::<2>(at, sums, bias, values, weights);
        at += 2 * LANES;
    }
    if at + LANES <= columns {
        vector_sums::<1>(at, sums, bias, values, weights);
        at += LANES;
    }
    if at < columns {
        sums_from(at, sums, bias, values, weights);
    }
}

/// Numbers in a vector.
#[cfg(target_arch = "x86_64")]
const LANES: usize = 8;

/// Sums of as many vectors from the place `first` on, in registers.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn vector_sums<const VECTORS: usize>(
    first: usize,
    sums: &mut [f32],
    bias: &[f32],
    (values, stride): (&[f32], usize),
    weights: &[f32],
) {
    use std::arch::x86_64::{
        _mm256_add_ps, _mm256_loadu_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_setzero_ps,
        _mm256_storeu_ps,
    };
    let columns = sums.len();
    let places = first..first + VECTORS * LANES;
    let mut vectors = [_mm256_setzero_ps(); VECTORS];
    let bias = &bias[places.clone()];
    for (i, vector) in vectors.iter_mut().enumerate() {
        // SAFETY: eight numbers of a slice of as many vectors.
        *vector = unsafe { _mm256_loadu_ps(bias[i * LANES..].as_ptr()) };
    }
    for (at, row) in weights.chunks_exact(columns).enumerate() {
        let value = _mm256_set1_ps(values[at * stride]);
        let row = &row[places.clone()];
        for (i, vector) in vectors.iter_mut().enumerate() {
            // SAFETY: eight numbers of a slice of as many vectors.
            let weights = unsafe { _mm256_loadu_ps(row[i * LANES..].as_ptr()) };
            *vector = _mm256_add_ps(*vector, _mm256_mul_ps(value, weights));
        }
    }
    let sums = &mut sums[places];
    for (i, vector) in vectors.iter().enumerate() {
        // SAFETY: eight numbers of a slice of as many vectors.
        unsafe { _mm256_storeu_ps(sums[i * LANES..].as_mut_ptr(), *vector) };
    }
}

/// Transposes rows of `columns` values.
pub fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|column| values.iter().skip(column).step_by(columns).copied()).collect()
}

/// `sum += factor * row`.
#[inline(always)]
pub fn add_scaled(sum: &mut [f32], factor: f32, row: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(row) {
        *sum += factor * value;
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
#[inline(always)]
pub fn exp(x: f32) -> f32 {
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
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// The hyperbolic tangent, to 4e-7.
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    2.0 * sigmoid(2.0 * x) - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_give_the_bits_of_single_numbers() {
        let noise = |count: usize, phase: f32| -> Vec<f32> {
            (0..count).map(|i| (1.7 * i as f32 + phase).sin() / 3.0).collect()
        };
        for (columns, stride) in
            [1, 3, 8, 11, 16, 24, 41, 48, 50].into_iter().zip([1, 2, 3].repeat(3))
        {
            let (values, weights) = (noise(20 * stride, 0.1), noise(20 * columns, 0.2));
            let bias = noise(columns, 0.3);
            let (mut found, mut expected) = (vec![0.0; columns], vec![0.0; columns]);
            strided_sums(&mut found, &bias, (&values, stride), &weights);
            sums_from(0, &mut expected, &bias, (&values, stride), &weights);
            assert_eq!(found, expected, "{columns}");
            let last: f32 = (0..20).fold(bias[columns - 1], |sum, row| {
                sum + values[row * stride] * weights[(row + 1) * columns - 1]
            });
            assert_eq!(found.last(), Some(&last));
        }
    }

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
