//! The command `magpie`.
//!
//! - [`cli`]: the commands and their arguments.
//! - [`commands`]: one file each.
//! - [`show`]: numbers and tables as people read them.
//! - [`progress`]: what long work shows while it runs.

pub mod cli;
pub mod commands;
pub mod progress;
pub mod show;
