//! The gripper's portable `no_std` library, shared by the device, the replay, the simulator and the tests.
//!
//! Each module uses only those above it:
//! - [`fixed_point`], [`math`], [`checksum`], [`clock`]: fixed-point quantities with saturating arithmetic; single-precision
//!   functions; checksums; time.
//! - [`config`]: design constants and detection thresholds.
//! - [`sensors`]: drivers of the Hall sensors and the inertial sensor.
//! - [`compensation`]: compensation of physical effects on fields and forces, and its auxiliary inputs.
//! - [`model`]: formats of the tables, their integrity, and the integer kernels over them.
//! - [`estimator`]: from readings to forces: ideal model, networks, disturbance detection, tare.
//! - [`motor`]: current, velocity and position control.
//! - [`protocol`]: messages on the CAN bus and on the serial line, sessions.
//! - [`parameters`]: parameters that a host may change, and their schema.
//! - [`system`]: faults, watchdog, crash records, non-volatile storage.
//! - [`grip`]: the state machine of grasp and ground contact.
//! - [`tasks`]: the portable bodies of the tasks; they run on the chip and in virtual time.
//! - [`board`]: one folder for each board.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod board;
pub mod checksum;
pub mod clock;
pub mod compensation;
pub mod config;
pub mod estimator;
pub mod fixed_point;
pub mod grip;
pub mod math;
pub mod model;
pub mod motor;
pub mod parameters;
pub mod protocol;
pub mod sensors;
pub mod system;
pub mod tasks;
