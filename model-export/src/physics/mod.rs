//! Forward model: from the forces on a finger to the field at its Hall sensor.
//!
//! - [`magnet`]: closed-form fields of cylinder, tube, cube and sphere, and their gradients.
//! - [`mounting`]: orientation of a sensor by right angles, polarity of its magnet.
//! - [`response`]: the state that effects modify, the sensor's transfer function, and derivatives.
//! - [`sensor`]: flexures, magnet placement and sensor orientation.

pub mod magnet;
pub mod mounting;
pub mod response;
pub mod sensor;

pub use magnet::{Cylinder, Magnet, MagnetBody, Magnetisation};
pub use mounting::{SensorMounting, SensorOrientation};
pub use response::{FieldResponse, PhysicalState};
pub use sensor::{ForwardModel, ModelFrames};
