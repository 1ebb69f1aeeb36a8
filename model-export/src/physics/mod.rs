//! The forward model: from the forces on a finger to the field at its Hall sensor.
//!
//! - [`magnet`]: exact fields of cylinder, tube, cube and sphere, and their gradients.
//! - [`state`]: what acts on a sensor at one instant, beside its geometry.
//! - [`response`]: the field at a state, and how it answers to a change of it.
//! - [`sensor`]: flexures, placement and the sensor's own orientation around the magnet.

pub mod magnet;
pub mod response;
pub mod sensor;
pub mod state;

pub use magnet::{Body, Cylinder, Magnet, Magnetised};
pub use response::Response;
pub use sensor::{ForwardModel, Frames};
pub use state::State;
