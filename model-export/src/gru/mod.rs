//! The recurrent network: trained in floating point, quantised for the device.
//!
//! - [`network`]: what a trained network is, whoever trained it.
//! - [`tensors`]: arrays of numbers in a file.
//! - [`train`]: from recordings to weights.
//! - [`file`](mod@file): trained networks in a file.

pub mod file;
pub mod network;
pub mod tensors;
pub mod train;
