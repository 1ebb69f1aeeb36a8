//! The firmware's tasks in virtual time, synchronised to the wall clock, with a serial line that other programs can
//! open.

#[cfg(unix)]
mod running;
pub mod world;

#[cfg(unix)]
pub use running::VirtualBoard;

/// Not available without pseudo terminals.
#[cfg(not(unix))]
pub enum VirtualBoard {}
