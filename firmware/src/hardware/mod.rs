//! What knows the chip. The only part of the library, with `tasks`, that is not on a computer.

pub mod board;
pub mod can;
pub mod clock;
pub mod crash;
pub mod flash;
pub mod sensor_bus;
pub mod watchdog;
