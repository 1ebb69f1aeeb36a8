//! Physics, parameter estimation and code generation: from recordings to a model file and the device's
//! tables. No terminal and no HTML.
//!
//! Modules in the order of the data flow:
//!
//! - [`recordings`]: campaigns on disk, with the errors, limits and writing of all files: a crate of its own.
//! - [`physics`]: forward model from forces to the field at each Hall sensor.
//! - [`design`]: flexures, materials, and the measurement limits of a design.
//! - [`effects`]: catalogue of physical effects, and user-defined formulas.
//! - [`fit`]: parameter estimation with standard errors, cross-validation and model selection.
//! - [`model_file`]: `model.toml`, the human-readable result.
//! - [`inverse`]: inverse model from fields to forces, and the device's tables.
//! - [`gru`]: recurrent network: training, quantisation, tables.
//! - [`stop`]: long computations that can be stopped.

#![warn(missing_docs)]

pub mod design;
pub mod effects;
pub mod fit;
pub mod gru;
pub mod inverse;
pub mod model_file;
pub mod physics;
pub mod stop;

pub use recordings;
pub use recordings::{error, input, output};
