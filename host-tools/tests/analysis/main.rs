//! `magpie add`, `compare`, `demo`, `diagnose` and `effects` on small campaigns.

mod add;
mod compare;
mod demo;
mod diagnose;
mod diagnose_variants;
#[path = "../workdir/mod.rs"]
mod workdir;
