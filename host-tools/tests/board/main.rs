//! The board in virtual time: replay, services, and the commands that watch and record it.

#[cfg(unix)]
mod calibration;
mod key_store;
#[cfg(unix)]
mod live;
mod replay;
mod services;
#[path = "../workdir/mod.rs"]
mod workdir;
