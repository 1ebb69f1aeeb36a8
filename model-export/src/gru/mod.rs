//! Recurrent network (GRU): trained in floating point, quantised for the device.
//!
//! - [`network`]: a trained network, its floating point step and its warm-up time.
//! - `recurrence`: one GRU layer, forward and backward, with its activations.
//! - [`tensors`]: named arrays in a safetensors file.
//! - [`train`]: back-propagation through time.
//! - [`file`](mod@file): trained networks in a file.
//! - [`quantise`]: integer weights, with the proof that no accumulator wraps.
//! - [`pack`]: quantised weights in the layout of the device, for each supported size.

pub mod file;
pub mod network;
pub mod pack;
pub mod quantise;
mod recurrence;
pub mod tensors;
pub mod train;

#[cfg(test)]
mod tests;
