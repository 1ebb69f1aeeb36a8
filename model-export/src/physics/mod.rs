//! The forward model: from the forces on a finger to the field at its Hall sensor.
//!
//! - [`magnet`]: exact field of an axially magnetised cylinder, and its gradient.
//! - [`sensor`]: flexures, placement and the sensor's own orientation around it.

pub mod magnet;
pub mod sensor;

pub use magnet::Cylinder;
pub use sensor::{ForwardModel, Frames, Response};
