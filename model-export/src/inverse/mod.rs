//! Inverse model: forces from the field at a sensor, in floating point and as the device's integer tables.
//!
//! - [`static_model`]: the forward model to invert, with its design box of loads.
//! - [`grbf`]: Gaussian radial basis functions on a linear part, fitted to sampled fields.
//! - [`model_selection`]: centres, width and ridge selected by held-out error.
//! - [`quantise`]: the device's tables, with the proof that no sum overflows.
//! - [`parity`]: the surface of possible fields: three axes, two forces.
//! - [`compensation`]: effects that the device compensates before and after the inverse.
//! - [`build`]: from a model file to the device's tables.
//! - [`calibration`]: tables and networks as the bytes of an upload.
//! - [`device_support`]: whether the device compensates an effect, and if not, why.
//! - [`codegen`]: tables and networks as Rust source.

pub mod build;
pub mod calibration;
pub mod codegen;
pub mod compensation;
pub mod device_support;
pub mod grbf;
pub mod model_selection;
pub mod parity;
pub mod quantise;
pub mod static_model;
