//! The whole grip controller on a motor that follows its set-point at once.

mod faults;
mod ground_contact;
mod holding;
pub(super) mod rig;
mod safety;
mod transitions;
