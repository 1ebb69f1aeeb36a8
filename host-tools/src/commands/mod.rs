//! One file for each command.

pub mod export;
pub mod fit;
pub mod import;
pub mod replay;
