//! Integrity of tables and weights in memory.
//!
//! The exporter writes the CRC-32 of all fields into the tables ([`checksum`]). The device recomputes it at the start
//! and continuously while it runs ([`Scrubber`]), over the memory that the kernels read. Any single flipped bit and any
//! burst of 32 are detected. Corrupt tables must prevent arming.
//!
//! The CRC is over the fields as 32-bit words ([`super::encoding`]), so that padding bytes do not count.

use core::hint::black_box;

use crate::checksum::{CRC32, Digest32};
use crate::model::encoding::{Encode, Window, visit, word_count};
use crate::model::formats::{Network, Tables};

/// Digest after `count` words from `skip`, little-endian.
fn update(value: &impl Encode, skip: usize, count: usize, mut digest: Digest32) -> Digest32 {
    let mut sink = |word: u32, _| digest.update(&word.to_le_bytes());
    visit(value, &mut Window::new(skip, count, &mut sink));
    digest
}

/// CRC-32 of all words, little-endian.
pub fn checksum(value: &impl Encode) -> u32 {
    update(value, 0, usize::MAX, CRC32.digest()).finalize()
}

/// A value with its own checksum, which is not part of its words.
pub trait Checksummed: Encode + Sized {
    /// Checksum written by the exporter.
    fn check(&self) -> u32;

    /// Whether all fields agree with the checksum. Takes tens of milliseconds on the device: for hosts.
    fn is_intact(&self) -> bool {
        // Prevents the compiler from using the initial value of a static instead of its memory.
        let in_memory = black_box(self);
        checksum(in_memory) == in_memory.check()
    }
}

impl Checksummed for Tables<'_> {
    fn check(&self) -> u32 {
        self.check
    }
}

impl Tables<'_> {
    /// Sets the checksum.
    pub fn checked(self) -> Self {
        Self { check: checksum(&self), ..self }
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> Checksummed
    for Network<INPUTS, HIDDEN, SENSORS>
{
    fn check(&self) -> u32 {
        self.check
    }
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>
    Network<INPUTS, HIDDEN, SENSORS>
{
    /// Sets the checksum.
    pub fn checked(self) -> Self {
        Self { check: checksum(&self), ..self }
    }
}

/// Maximum number of calls of [`Scrubber::step`] per pass while the device runs.
const CALLS: usize = 100;
/// The same of a pass without pauses, whose steps must be short.
const UNPAUSED_CALLS: usize = 1000;
/// Calls per second for a pass in at most five seconds.
pub const CALLS_PER_S: u32 = 20;

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScrubResult {
    /// The pass is incomplete.
    Pending,
    /// The pass is complete without an error.
    Intact,
    /// The pass is complete with a checksum error.
    Corrupt,
}

/// A value whose checksum is checked in steps.
pub trait Scrub {
    /// Checks the next part ([`Scrubber::step`]).
    fn scrub(&self, scrubber: &mut Scrubber) -> ScrubResult;
}

impl<T: Checksummed> Scrub for T {
    fn scrub(&self, scrubber: &mut Scrubber) -> ScrubResult {
        scrubber.step(self)
    }
}

/// Continuous check in passes of a number of steps. Each step first finds its place in the value, so that many small ones take
/// longer than a few large ones.
#[derive(Clone)]
pub struct Scrubber {
    calls: usize,
    at: usize,
    digest: Option<Digest32>,
}

impl Scrubber {
    /// State before a pass at [`CALLS_PER_S`]: some thirty words per step for the ideal model of four sensors.
    pub const NEW: Self = Self { calls: CALLS, at: 0, digest: None };
    /// State before a pass without pauses.
    pub const UNPAUSED: Self = Self { calls: UNPAUSED_CALLS, ..Self::NEW };

    /// Checks the next part of `value`, always the same value. A bit that flips behind the current position is found
    /// at the end of the next pass: at [`CALLS_PER_S`] within ten seconds.
    pub fn step(&mut self, value: &impl Checksummed) -> ScrubResult {
        let value = black_box(value);
        let words = word_count(value);
        let count = words.div_ceil(self.calls.max(1)).max(1);
        let digest = self.digest.take().unwrap_or_else(|| CRC32.digest());
        let digest = update(value, self.at, count, digest);
        let to = self.at.saturating_add(count);
        if to < words {
            (self.at, self.digest) = (to, Some(digest));
            return ScrubResult::Pending;
        }
        self.at = 0;
        if digest.finalize() == value.check() { ScrubResult::Intact } else { ScrubResult::Corrupt }
    }
}

#[cfg(test)]
mod tests;
