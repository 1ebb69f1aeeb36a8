//! What the gripper's firmware, the replay, the simulator and the tests share.
//!
//! The modules stand in the order in which data flows; each uses only those above it.
//!
//! - [`params`]: every design constant with its unit and source, assumptions marked.
#![no_std]

pub mod params;
