//! The ideal inverse: from the field at a sensor to its two forces, in floating point and as the
//! device's integers.
//!
//! - [`at_rest`]: what is inverted: the forward model with the effects of the present forces.
//! - [`design_box`]: the loads that a model is built for, and where their fields lie.
//! - [`samples`]: fields with the forces that explain them best.
//! - [`grbf`]: Gaussian radial basis functions on top of a linear part, in floating point.
//! - [`search`]: centres, width and ridge chosen by held-out error.
//! - [`quantise`]: the device's tables, with the proof that nothing overflows.
//! - [`parity`]: the surface on which the fields lie: three axes against two forces.
//! - [`error_map`]: where in the box an inverse errs.
//! - [`compensation`]: the effects that the device undoes around the inverse, in its formats.
//! - [`map`]: a user's own effect as a table.
//! - [`build`]: from a model file to the device's tables.
//! - [`emit`]: the tables as Rust source.

pub mod at_rest;
pub mod build;
pub mod compensation;
pub mod design_box;
pub mod emit;
pub mod error_map;
pub mod grbf;
pub mod map;
pub mod parity;
pub mod quantise;
pub mod samples;
pub mod search;
