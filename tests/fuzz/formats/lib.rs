//! `effects` and `physics` of `model-export`, without fits and tables; files are read by `recordings`.
#![allow(dead_code)]

#[path = "../../../model-export/src/effects/mod.rs"]
pub mod effects;
#[path = "../../../model-export/src/physics/mod.rs"]
pub mod physics;

pub use recordings;
pub use recordings::{error, input, output};
