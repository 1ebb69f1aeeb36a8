//! The design of a sensor: flexure, magnet, gap, material.
//!
//! - [`beam`]: a flexure under large deflections.
//! - [`material`]: what flexures are made of.
//! - [`interference`]: what moves the field beside the forces.

pub mod beam;
pub mod interference;
pub mod material;

pub use beam::{Beam, Bent, Support};
