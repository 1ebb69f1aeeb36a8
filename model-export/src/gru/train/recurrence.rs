//! The recurrence of one layer as a single operation, forward and backward.
//!
//! Products that have no order in time are the library's. The recurrence itself has as many small
//! steps as rows, and an operation of the library for each piece of each step costs many times the
//! arithmetic; here a step is a few loops. Streams do not touch each other, so they run on any number
//! of threads and give the same bits.

use std::sync::OnceLock;

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Storage, Tensor, bail};
use rayon::prelude::*;

use super::curves::{sigmoid, tanh};
use crate::gru::network::GATES;

/// What the way back needs of each unit and row beside the states: reset, update, candidate, and the
/// candidate's recurrent sum before the reset.
const KEPT: usize = 4;

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
    /// What the way forward leaves for the way back.
    pub kept: OnceLock<Vec<f32>>,
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
        (states, kept): (&mut [f32], &mut [f32]),
    ) {
        let hidden = self.hidden;
        let (input_bias, state_bias) = bias.split_at(GATES * hidden);
        let mut state = start.to_vec();
        let mut sums = vec![0.0; GATES * hidden];
        let rows = products.chunks_exact(GATES * hidden);
        let left = states.chunks_exact_mut(hidden);
        let left = left.zip(kept.chunks_exact_mut(KEPT * hidden));
        for (product, (states, kept)) in rows.zip(left) {
            sums.copy_from_slice(state_bias);
            for (&h, row) in state.iter().zip(weights.chunks_exact(GATES * hidden)) {
                add_scaled(&mut sums, h, row);
            }
            // Loops of one kind each, so that the compiler takes several units at once.
            let (gates, candidates) = kept.split_at_mut(2 * hidden);
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

    /// One stream backward: `turned` holds the recurrent weights row by row of the sums.
    fn backward(
        &self,
        start: &[f32],
        turned: &[f32],
        (states, kept): (&[f32], &[f32]),
        gradient: &[f32],
        products: &mut [f32],
    ) -> Slopes {
        let hidden = self.hidden;
        let mut slopes = Slopes::zero(hidden);
        let mut carried = vec![0.0; hidden];
        let mut sums = vec![0.0; GATES * hidden];
        for row in (0..self.rows).rev() {
            let kept_row = &kept[row * KEPT * hidden..][..KEPT * hidden];
            let before = match row {
                0 => start,
                _ => &states[(row - 1) * hidden..][..hidden],
            };
            let product = &mut products[row * GATES * hidden..][..GATES * hidden];
            let wanted = &gradient[row * hidden..][..hidden];
            for i in 0..hidden {
                let [reset, update, candidate, inner] =
                    [0, 1, 2, 3].map(|kind| kept_row[kind * hidden + i]);
                let state = carried[i] + wanted[i];
                let d_candidate = state * (1.0 - update) * (1.0 - candidate * candidate);
                let d_update = state * (before[i] - candidate) * update * (1.0 - update);
                let d_reset = d_candidate * inner * reset * (1.0 - reset);
                carried[i] = state * update;
                product[i] = d_reset;
                product[hidden + i] = d_update;
                product[2 * hidden + i] = d_candidate;
                sums[i] = d_reset;
                sums[hidden + i] = d_update;
                sums[2 * hidden + i] = d_candidate * reset;
            }
            for (&slope, weights) in sums.iter().zip(turned.chunks_exact(hidden)) {
                add_scaled(&mut carried, slope, weights);
            }
            let rows = slopes.weights.chunks_exact_mut(GATES * hidden);
            for (&h, weights) in before.iter().zip(rows) {
                add_scaled(weights, h, &sums);
            }
            let (input_bias, state_bias) = slopes.bias.split_at_mut(GATES * hidden);
            add_scaled(input_bias, 1.0, product);
            add_scaled(state_bias, 1.0, &sums);
        }
        slopes
    }

    /// Rows and columns of every network's recurrent weights exchanged.
    fn turned(&self, weights: &[f32]) -> Vec<f32> {
        let (hidden, sums) = (self.hidden, GATES * self.hidden);
        let of_network = |weights: &[f32]| -> Vec<f32> {
            (0..sums * hidden)
                .map(|i| weights[(i % hidden) * sums + i / hidden])
                .collect()
        };
        weights
            .chunks_exact(hidden * sums)
            .flat_map(of_network)
            .collect()
    }
}

/// What the weights of one stream are blamed for.
struct Slopes {
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Slopes {
    fn zero(hidden: usize) -> Self {
        Self {
            weights: vec![0.0; GATES * hidden * hidden],
            bias: vec![0.0; 2 * GATES * hidden],
        }
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
        let mut kept = vec![0.0; streams * self.rows * KEPT * hidden];
        let left = states.par_chunks_mut(self.rows * hidden);
        left.zip(kept.par_chunks_mut(self.rows * KEPT * hidden))
            .zip(products.par_chunks(self.rows * GATES * hidden))
            .enumerate()
            .for_each(|(stream, (left, products))| {
                let network = stream / self.streams;
                let weights = &weights[network * GATES * hidden * hidden..];
                let bias = &bias[network * 2 * GATES * hidden..][..2 * GATES * hidden];
                self.forward(self.start_of(stream), products, weights, bias, left);
            });
        if self.kept.set(kept).is_err() {
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
        let Some(kept) = self.kept.get() else {
            bail!("the recurrence goes forward before it goes back");
        };
        let gradient = gradient.contiguous()?;
        let (weights_lock, weights_layout) = weights.storage_and_layout();
        let (states_lock, states_layout) = states.storage_and_layout();
        let (gradient_lock, gradient_layout) = gradient.storage_and_layout();
        let turned = self.turned(values(on_cpu(&weights_lock)?, weights_layout)?);
        let states = values(on_cpu(&states_lock)?, states_layout)?;
        let gradient = values(on_cpu(&gradient_lock)?, gradient_layout)?;
        let streams = networks * self.streams;
        let mut d_products = vec![0.0; streams * self.rows * GATES * hidden];
        let known = states.par_chunks(self.rows * hidden);
        let known = known.zip(kept.par_chunks(self.rows * KEPT * hidden));
        let slopes: Vec<Slopes> = d_products
            .par_chunks_mut(self.rows * GATES * hidden)
            .zip(known.zip(gradient.par_chunks(self.rows * hidden)))
            .enumerate()
            .map(|(stream, (products, (known, gradient)))| {
                let turned = &turned[stream / self.streams * GATES * hidden * hidden..];
                let turned = &turned[..GATES * hidden * hidden];
                self.backward(self.start_of(stream), turned, known, gradient, products)
            })
            .collect();
        // In the order of the streams, whoever was ready first.
        let (mut d_weights, mut d_bias) = (Vec::new(), Vec::new());
        for of_network in slopes.chunks(self.streams) {
            let mut sum = Slopes::zero(hidden);
            of_network.iter().for_each(|slopes| sum.add(slopes));
            d_weights.extend(sum.weights);
            d_bias.extend(sum.bias);
        }
        let like = |values: Vec<f32>, like: &Tensor| {
            Tensor::from_vec(values, like.shape(), like.device()).map(Some)
        };
        Ok((
            like(d_products, products)?,
            like(d_weights, weights)?,
            like(d_bias, bias)?,
        ))
    }
}
