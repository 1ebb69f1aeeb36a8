//! The modules of `model-export` that read files and formulas, without the rest, which no input reaches.
#![allow(dead_code)]

#[path = "../../../model-export/src/effects/mod.rs"]
pub mod effects;
#[path = "../../../model-export/src/error.rs"]
pub mod error;
#[path = "../../../model-export/src/input.rs"]
pub mod input;
#[path = "../../../model-export/src/output.rs"]
pub mod output;
#[path = "../../../model-export/src/physics/mod.rs"]
pub mod physics;
#[path = "../../../model-export/src/recordings/mod.rs"]
pub mod recordings;
