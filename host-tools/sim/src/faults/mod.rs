//! Fault injection: each fault of the fault matrix in each operating state of the whole gripper, in virtual time.
//!
//! - [`hazards`]: the hazard table, from which the campaign takes its expectations.
//! - [`injection`]: the faults, their specification and how each is injected.
//! - [`operating_state`]: the states in which they are injected.
//! - [`contact_force`], [`opening`], [`retention`]: force on a hand, RELEASE under faults, parts that stay gripped.
//! - [`run`]: one fault in one state, and the transitions that the state tables allow.
//! - [`campaign`]: all faults on all cores; hours without faults for the false alarm rate.
//!
//! Phase over-current at the gate drivers and a wrong clock need hardware. `host-tools/tests/emulation` has those that need the image.

pub mod campaign;
pub mod contact_force;
pub mod hazards;
pub mod injection;
pub mod opening;
pub mod operating_state;
pub mod retention;
pub mod run;
