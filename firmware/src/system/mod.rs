//! What keeps the device running: faults, watchdog, crash records, non-volatile storage, queues between interrupts.

pub mod crash;
pub mod faults;
pub mod nv_storage;
pub mod queue;
pub mod task_watchdog;
