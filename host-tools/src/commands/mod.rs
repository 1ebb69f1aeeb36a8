//! One file for each command, and what several share.

pub mod add;
pub mod beside;
pub mod change;
pub mod clocks;
pub mod compare;
pub mod dbc;
pub mod demo;
pub mod design;
pub mod diagnose;
pub mod drop;
pub mod effects;
pub mod emulate;
pub mod export;
pub mod faults;
pub mod fit;
pub mod formulas;
pub mod grip;
pub mod import;
pub mod live;
pub mod monitor;
pub mod record;
pub mod replay;
pub mod simulate;
pub mod train;
