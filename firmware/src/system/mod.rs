//! What keeps the device running: faults, watchdog, crash records, non-volatile storage; also the path of the clock for
//! hosts.

pub mod crash;
pub mod faults;
pub mod nv_storage;
pub mod task_watchdog;

pub use crate::clock;
