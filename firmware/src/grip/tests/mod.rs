//! The grasp as a whole, its motor replaced by one that does at once what it is asked.

mod faults;
mod foot;
mod holding;
mod layers;
mod paths;
mod power;
pub(super) mod rig;
