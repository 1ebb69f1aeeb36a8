//! What comes from outside, into the gripper's code: one function for each way in. Each takes any bytes,
//! makes a story of them, and panics where the gripper breaks a promise.
//!
//! - [`bag`]: bags of ROS 2, as MCAP files and as databases.
//! - [`bag_files`]: bags with changes where their structure is.
//! - [`blob`]: encoded calibrations, to forces.
//! - [`can`]: frames on the CAN bus, with their times.
//! - [`serial`]: bytes on the serial line.
//! - [`formula`]: formulas of user-defined effects.
//! - [`mapping`]: mapping files and tables of other test benches.
//! - [`plan`]: plans of recordings.
//! - [`sensing`]: bytes of the sensors, to forces.
//! - [`store`]: pages of flash, and saves that are cut short.
//! - [`upload`]: uploads of calibrations, with power cuts.
//! - [`bytes`]: how a story is read from bytes.
//! - [`counters`]: how far the executions of a target get.
//! - [`check`]: checksums and stuffing by their definitions, beside the tables of the gripper's libraries.

pub mod bag;
pub mod bag_files;
pub mod blob;
pub mod bytes;
pub mod can;
pub mod check;
pub mod counters;
pub mod formula;
pub mod mapping;
pub mod plan;
pub mod sensing;
pub mod serial;
pub mod store;
pub mod upload;
