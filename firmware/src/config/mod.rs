//! Design constants, detection thresholds, and the parameters that a host may change.

pub mod constants;
pub mod limits;
pub mod parameters;
pub mod schema;
