//! Constants of the design and detection thresholds. Every value states its source, or that it is assumed.

pub mod constants;
pub mod limits;
