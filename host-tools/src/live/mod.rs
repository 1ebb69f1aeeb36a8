//! The gripper live: what it tells, on a terminal and in a recording.
//!
//! - [`source`]: where packets come from.
//! - [`serial_port`], [`socket_can`], [`socketcand`]: a gripper's line, its bus on this machine, its bus over TCP.
//! - [`pty`]: a pseudo terminal.
//! - [`virtual_board`]: the board in virtual time that keeps to the wall's clock, behind pseudo terminals.
//! - [`emulation`]: the image in the emulated chip, with its serial line and CAN bus as ports of this machine.
//! - [`session`]: arming and sealed commands; [`client`]: a host that commands a gripper; [`answers`]: its states and
//!   refusals in words.
//! - [`hearing`]: a source heard in a thread of its own.
//! - [`asking`]: parameters of a gripper, read and written.
//! - [`board_clock`]: the board's clock over its turns.
//! - [`faults`]: faults as people read them.
//! - [`history`]: forces of the last seconds.
//! - [`state`]: what is known of a gripper.
//! - [`view`], [`words`], [`json`]: the same for a terminal, a pipe and a program.
//! - [`rows`]: what the sensors read, tick by tick.
//! - [`paged`]: a table that is whole whenever its writer is killed.
//! - [`recorder`]: rows into a recording.

pub mod answers;
pub mod asking;
pub mod board_clock;
pub mod client;
#[cfg(unix)]
pub mod emulation;
pub mod faults;
pub mod hearing;
pub mod history;
pub mod json;
pub mod paged;
#[cfg(unix)]
pub mod pty;
pub mod recorder;
pub mod rows;
pub mod serial_port;
pub mod session;
pub mod socket_can;
pub mod socketcand;
pub mod source;
pub mod state;
pub mod view;
pub mod virtual_board;
pub mod words;
