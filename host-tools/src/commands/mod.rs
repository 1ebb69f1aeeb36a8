//! One file for each command.

pub mod demo;
pub mod export;
pub mod fit;
pub mod import;
pub mod replay;
