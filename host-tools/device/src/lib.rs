//! Access to a real, virtual or emulated gripper: transport, session, state, recording.
//!
//! - [`source`]: trait of a transport; [`connect`]: opens one by its name.
//! - [`serial_port`], [`socket_can`], [`socketcand`]: serial line, CAN bus of this machine, CAN bus over TCP.
//! - [`pty`]: pseudo terminal.
//! - [`virtual_board`]: the firmware's tasks in virtual time, synchronised to the wall clock, behind pseudo terminals.
//! - [`emulation`]: the image in the emulated chip, with its serial line and CAN bus as ports of this machine.
//! - [`control`]: motions, grasps and landings in sessions, with their results.
//! - [`session`]: sessions, authenticated requests, refusals.
//! - [`key_file`]: the key that a gripper and its hosts share.
//! - [`reader`]: a transport read in its own thread.
//! - [`calibration_client`]: upload of calibrations, and what is on a gripper.
//! - [`bringup`]: the first power-up of a board, step by step.
//! - [`params_client`]: reading and writing parameters.
//! - [`state`]: latest state of a gripper, recent forces, extended board clock.
//! - [`view`], [`mod@format`]: the state on a terminal, as a line of text, as JSON.
//! - [`board_topics`], [`foxglove`]: what the board sends as topics of an MCAP file, and live for Foxglove.
//! - [`http`]: servers on this machine, with time-outs and a limit of connections.
//! - [`csv_writer`]: CSV output that is valid whenever the process is killed.
//! - [`mod@reference`]: reference force sensor next to the gripper.
//! - [`recorder`]: assembly of rows, writing of a recording, and the ranges that it covers.

pub mod board_topics;
pub mod bringup;
pub mod calibration_client;
pub mod connect;
pub mod control;
pub mod csv_writer;
#[cfg(unix)]
pub mod emulation;
pub mod format;
pub mod foxglove;
pub mod http;
pub mod key_file;
pub mod params_client;
#[cfg(unix)]
pub mod pty;
pub mod reader;
pub mod recorder;
pub mod reference;
pub mod serial_port;
pub mod session;
pub mod socket_can;
pub mod socketcand;
pub mod source;
pub mod state;
pub mod view;
pub mod virtual_board;
