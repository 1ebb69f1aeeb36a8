//! The whole grip controller on a motor that follows its set-point at once.

mod faults;
mod ground_contact;
mod holding;
mod power_layer;
pub(super) mod rig;
mod safety;
mod setpoints;
mod task_layer;
mod transitions;
