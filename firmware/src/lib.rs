//! What the gripper's firmware, the replay, the simulator and the tests share.
//!
//! The modules stand in the order in which data flows; each uses only those above it.
//!
//! - [`params`]: every design constant with its unit and source, assumptions marked.
//! - [`units`]: fixed-point quantities.
//! - [`hall`]: Hall sensors, from bytes on the bus to readings.
//! - [`frame`]: one millisecond of sensing.
//! - [`model`]: tables, and the integer arithmetic that turns a field into forces.
//! - [`force`]: the estimate, with its validity.
//! - [`wire`]: the messages on the CAN bus.
//! - `hardware`: only on the chip: the board.
//! - `tasks`: only on the chip: what runs, and every static with its one writer.
#![no_std]

pub mod params;
pub mod units;

pub mod hall;

pub mod frame;

pub mod model;

pub mod force;

pub mod wire;

#[cfg(target_os = "none")]
pub mod hardware;

#[cfg(target_os = "none")]
pub mod tasks;
