//! The design of a sensor: flexure, magnet, gap, material.
//!
//! - [`beam`]: a flexure under large deflections.
//! - [`material`]: what flexures are made of.

pub mod beam;
pub mod material;

pub use beam::{Beam, Bent, Support};
