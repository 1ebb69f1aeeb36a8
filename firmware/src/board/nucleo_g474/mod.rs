//! The reference board, a NUCLEO-G474RE: `table.rs` has its pins and what the board must provide (`firmware/BOARD.md`).

#[cfg(target_os = "none")]
mod calibration_memory;
#[cfg(target_os = "none")]
pub mod can;
#[cfg(target_os = "none")]
pub mod clock;
#[cfg(target_os = "none")]
pub mod crash;
#[cfg(target_os = "none")]
pub mod drive;
#[cfg(target_os = "none")]
pub mod feedback;
#[cfg(target_os = "none")]
pub mod flash;
#[cfg(target_os = "none")]
pub mod i2c;
#[cfg(target_os = "none")]
pub mod imu;
#[cfg(target_os = "none")]
pub mod mem;
#[cfg(target_os = "none")]
pub mod peripherals;
#[cfg(target_os = "none")]
pub mod pwm;
#[cfg(target_os = "none")]
pub mod random;
#[cfg(target_os = "none")]
pub mod sync;
pub mod table;
#[cfg(target_os = "none")]
pub mod tasks;
#[cfg(target_os = "none")]
pub mod thermometer;

/// The board as a type.
#[derive(Clone, Copy, Debug)]
pub struct NucleoG474;
