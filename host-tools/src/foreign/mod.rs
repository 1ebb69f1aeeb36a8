//! How surely, how soon and how often in vain the device notices a foreign magnet.
//!
//! Rows of a gripper go through the device's code twice, with the same noise: as they are, which counts
//! false alarms, and with magnets that pass at random distances, directions and speeds, which counts those
//! that move a force by more than 8 % of its range (20 N of 250) and are noticed within 20 ms of that. Fields
//! add up, so that a magnet can pass a recording that was made without one.
//!
//! - [`rows`]: what the device reads: of a recording, or of a simulated gripper as long as it is wanted.
//! - [`passage`]: the magnets, and what became of each.
//! - [`pass`]: rows through the device's code, twice.
//! - [`tally`]: the counts.
//! - [`words`]: the same for people and machines.

pub mod pass;
pub mod passage;
pub mod rows;
pub mod tally;
pub mod words;

use anyhow::Result;
use indicatif::ProgressBar;
use rayon::prelude::*;

use pass::Device;
use rows::World;
use tally::Tally;

/// Runs `hours` of a world through the device's code.
///
/// # Errors
/// A recording cannot be read.
pub fn count(device: &Device, world: &World, hours: f64, bar: &ProgressBar) -> Result<Tally> {
    let runs = (hours * 3600.0 / world.seconds()).ceil().max(1.0) as u32;
    bar.inc_length(u64::from(runs));
    let tally = |number: u32| {
        let tally = pass::run(device, world, number);
        bar.inc(1);
        tally
    };
    let parts = (0..runs).into_par_iter().map(tally);
    parts.try_reduce(Tally::default, |all, part| Ok(all.with(part)))
}
