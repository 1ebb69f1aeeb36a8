//! The recurrent network: trained in floating point, quantised for the device.
//!
//! - [`network`]: what a trained network is, whoever trained it.
//! - [`float`]: its step in floating point, which the device's is measured against.
//! - [`tensors`]: arrays of numbers in a file.
//! - [`train`]: from recordings to weights.
//! - [`file`](mod@file): trained networks in a file.
//! - [`quantise`]: its numbers in the device's formats, with the proof that nothing overflows.
//! - [`unfit`]: what they cannot hold, by its row's name.
//! - [`warm_up`]: how long a network remembers how it began.
//! - [`pack`]: the numbers in the device's order, for the sizes that the device knows.
//! - [`emit`]: the same as Rust source.

pub mod emit;
pub mod file;
pub mod float;
pub mod network;
pub mod pack;
pub mod quantise;
pub mod tensors;
pub mod train;
pub mod unfit;
pub mod warm_up;

#[cfg(test)]
mod tests;
