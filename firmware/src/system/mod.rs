//! What keeps the device running: faults, watchdog, crash records, non-volatile storage.

pub mod crash;
pub mod faults;
pub mod nv_storage;
pub mod task_watchdog;
