//! The gripper's portable `no_std` library, shared by the device, the replay, the simulator and the tests.
//!
//! - [`config`]: design constants, detection thresholds, run-time parameters.
//! - [`fixed_point`]: saturating integer arithmetic and fixed-point quantities.
//! - [`sensors`]: drivers of the Hall sensors and the inertial sensor.
//! - [`model`]: formats of the tables, their integrity, and the integer kernels over them.
//! - [`estimator`]: from readings to forces: compensation, ideal model, networks, disturbance detection, tare.
//! - [`motor`]: current, velocity and position control.
//! - [`grip`]: the state machine of grasp and ground contact.
//! - [`protocol`]: messages on the CAN bus and on the serial line, sessions.
//! - [`system`]: faults, watchdog, crash records, non-volatile storage, time.
//! - [`tasks`]: the portable bodies of the tasks; they run on the chip and in virtual time.
//! - [`board`]: one folder for each board.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod board;
pub mod config;
pub mod estimator;
pub mod fixed_point;
pub mod grip;
pub mod model;
pub mod motor;
pub mod protocol;
pub mod sensors;
pub mod system;
pub mod tasks;
