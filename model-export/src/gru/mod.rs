//! The recurrent network: trained in floating point, quantised for the device.
//!
//! - [`network`]: what a trained network is, whoever trained it.

pub mod network;
