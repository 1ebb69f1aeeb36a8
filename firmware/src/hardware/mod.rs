//! What knows the chip. The only part of the library, with `tasks`, that is not on a computer.

pub mod board;
pub mod can;
pub mod clock;
pub mod copy;
pub mod crash;
pub mod critical;
pub mod drive;
pub mod flash;
pub mod phase_currents;
pub mod power_stage;
pub mod queue;
pub mod rotor_sensor;
pub mod sensor_bus;
pub mod watchdog;
