//! One file for each command.

pub mod fit;
pub mod import;
