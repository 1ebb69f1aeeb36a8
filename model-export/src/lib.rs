//! From recordings to a model: no terminal, no HTML, only the physics and the numbers.
//!
//! The modules stand in the order in which data flows; each uses only those above it.
//!
//! - [`quantity`]: units that people write, and the one unit that each quantity has here.
//! - [`recordings`]: campaigns on disk, checked as they are read, brought to one clock.
//! - [`output`]: files that the tool writes.
//! - [`physics`]: the forward model, from forces to the field at each Hall sensor.
//! - [`design`]: flexures, materials, and what a design can and cannot measure.
//! - [`effects`]: the catalogue of physical effects, and a user's own.
//! - [`fit`]: the forward model fitted to a campaign, with honest error bars.
//! - [`model_file`]: the human-readable result, `model.toml`.
//! - [`inverse`]: from fields to forces: the ideal model and the device's tables.
//! - [`gru`]: the recurrent network: training, quantisation, its tables.

pub mod design;
pub mod effects;
pub mod fit;
pub mod gru;
pub mod inverse;
pub mod model_file;
pub mod output;
pub mod physics;
pub mod quantity;
pub mod recordings;
