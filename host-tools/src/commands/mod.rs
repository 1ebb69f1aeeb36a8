//! One module for each command, and what several commands share: [`args`] and [`connection`].

pub mod args;
pub mod benchmark;
pub mod compare;
pub mod connection;
pub mod dbc;
pub mod demo;
pub mod design;
pub mod diagnose;
pub mod edit_model;
pub mod effects;
pub mod emulate;
pub mod export;
pub mod fault_campaign;
pub mod fit;
pub mod grasp;
pub mod import;
pub mod monitor;
pub mod record;
pub mod replay;
pub mod simulate;
pub mod train;
