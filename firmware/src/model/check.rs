//! Whether tables and weights are still those that were exported.
//!
//! The exporter writes the checksum of every field ([`sum`]) into the tables; the device computes it anew
//! at the start ([`Checked::is_sound`]) and piece by piece while it runs ([`Scrub`]). What is checked is
//! what the kernels read, in flash. Any single bit that turned is noticed, and any 32 in a row. Tables
//! that are not sound must not arm.
//!
//! What is walked are the fields, one by one, each as a word of 32 bits: never the bytes between them.

mod walk;

use core::hint::black_box;

use super::network::Network;
use super::table::Tables;
use crate::checksum::{CRC32, Digest32};

/// Fields one by one, as words of 32 bits.
pub trait Walk {
    /// How many words every value of the type has; 0 where they differ.
    const FIXED: usize;

    /// How many words there are.
    fn words(&self) -> usize;

    /// The word at this place; 0 behind the last.
    fn word(&self, at: usize) -> u32;
}

/// The checksum of all words: CRC-32 over their bytes, least significant first.
pub fn sum(of: &impl Walk) -> u32 {
    let mut digest = CRC32.digest();
    take(&mut digest, of, 0, of.words());
    digest.finalize()
}

fn take(digest: &mut Digest32, of: &impl Walk, from: usize, to: usize) {
    for at in from..to {
        digest.update(&of.word(at).to_le_bytes());
    }
}

/// What carries its checksum, which is none of its words.
pub trait Checked: Walk + Sized {
    /// As the exporter wrote it.
    fn check(&self) -> u32;

    /// Whether every field is as the exporter wrote it. Walks all of it: for the start.
    fn is_sound(&self) -> bool {
        // The compiler knows the bytes of a static; what counts are those in memory.
        let in_memory = black_box(self);
        sum(in_memory) == in_memory.check()
    }
}

impl Checked for Tables<'_> {
    fn check(&self) -> u32 {
        self.check
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> Checked
    for Network<INPUTS, HIDDEN, SENSORS>
{
    fn check(&self) -> u32 {
        self.check
    }
}

/// Calls of [`Scrub::step`] for one whole walk, at the most.
pub const CALLS: usize = 1000;
/// Calls in a second for which a walk takes five seconds at the most.
pub const CALLS_PER_S: u32 = 200;

/// What a step of a scrub has found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// The walk is not yet at its end.
    Nothing,
    /// It has ended: all is as it was.
    Sound,
    /// It has ended: something has changed.
    Broken,
}

/// One walk after another, a thousandth at each call: three words of the ideal model of four sensors.
#[derive(Clone, Default)]
pub struct Scrub {
    at: usize,
    digest: Option<Digest32>,
}

impl Scrub {
    /// At the beginning.
    pub const NEW: Self = Self {
        at: 0,
        digest: None,
    };

    /// Walks on; always over the same. A bit that turns behind the walk is found at the end of the next: at
    /// [`CALLS_PER_S`] after ten seconds at the latest.
    pub fn step(&mut self, of: &impl Checked) -> Found {
        let of = black_box(of);
        let words = of.words();
        let to = self
            .at
            .saturating_add(words.div_ceil(CALLS).max(1))
            .min(words);
        let mut digest = self.digest.take().unwrap_or_else(|| CRC32.digest());
        take(&mut digest, of, self.at, to);
        if to < words {
            (self.at, self.digest) = (to, Some(digest));
            return Found::Nothing;
        }
        self.at = 0;
        match digest.finalize() == of.check() {
            true => Found::Sound,
            false => Found::Broken,
        }
    }
}

#[cfg(test)]
mod tests;
