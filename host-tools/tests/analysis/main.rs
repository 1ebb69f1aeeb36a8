//! `magpie add`, `compare`, `demo`, `diagnose`, `effects` and `train` on small campaigns, and setup errors in
//! them: one program, since each links the whole workspace.

mod add;
mod catalogue;
mod compare;
mod demo;
mod diagnose;
mod diagnose_variants;
mod force_error;
mod independent_campaigns;
mod logger_campaigns;
mod networks;
mod orientation;
mod parameters;
mod recording_differences;
mod setup_errors;
mod signal_unit;
#[path = "../workdir/mod.rs"]
mod workdir;
