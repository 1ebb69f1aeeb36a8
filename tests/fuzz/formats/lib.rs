//! The modules of `model-export` that formulas reach, and the reading of files, without the rest, which no input reaches.
#![allow(dead_code)]

#[path = "../../../model-export/src/effects/mod.rs"]
pub mod effects;
#[path = "../../../model-export/src/physics/mod.rs"]
pub mod physics;

pub use recordings;
pub use recordings::{error, input, output};
