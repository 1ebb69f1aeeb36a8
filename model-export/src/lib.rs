//! Physics, parameter estimation and code generation: from recordings to a model file and the device's
//! tables. No terminal and no HTML.
//!
//! Modules in the order of the data flow:
//!
//! - [`recordings`]: campaigns on disk: validation, units, clock alignment, import.
//! - [`error`]: input errors and notices, each with file, line and column.
//! - [`input`]: regular files only, and the limits of all inputs.
//! - [`output`]: atomic writes that never overwrite foreign files.
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
pub mod error;
pub mod fit;
pub mod gru;
pub mod input;
pub mod inverse;
pub mod model_file;
pub mod output;
pub mod physics;
pub mod recordings;
pub mod stop;
