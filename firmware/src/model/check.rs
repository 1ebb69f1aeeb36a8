//! Whether tables and weights are still those that were exported.
//!
//! The exporter writes the checksum of every field ([`sum`]) into the tables; the device computes it anew
//! piece by piece, at the start and while it runs ([`Scrub`]). What is checked is
//! what the kernels read, in flash. Any single bit that turned is noticed, and any 32 in a row. Tables
//! that are not sound must not arm.
//!
//! What is walked are the fields, one by one, each as a word of 32 bits: never the bytes between them.

mod types;

use core::hint::black_box;

use super::network::Network;
use super::table::Tables;
use crate::checksum::{CRC32, Digest32};

/// Fields one by one, as words of 32 bits.
pub trait Walk {
    /// How many words every value of the type has; 0 where they differ.
    const FIXED: usize;

    /// Hands all words to the window, in their order; may stop where it wants no more.
    fn visit(&self, window: &mut Window);
}

/// Walks over a part, or passes it where the window begins behind it.
fn walk(part: &impl Walk, window: &mut Window) {
    fn fixed<T: Walk>(_: &T) -> usize {
        T::FIXED
    }
    if window.left > 0 && window.skip_items(1, fixed(part)) == 0 {
        part.visit(window);
    }
}

/// Words of a walk that enter its checksum.
pub struct Window {
    /// Words still to be passed.
    skip: usize,
    /// Words still wanted behind those.
    left: usize,
    digest: Digest32,
}

impl Window {
    fn new(skip: usize, left: usize, digest: Digest32) -> Self {
        Self { skip, left, digest }
    }

    /// The next word of the walk.
    pub fn word(&mut self, word: u32) {
        if let Some(skip) = self.skip.checked_sub(1) {
            self.skip = skip;
        } else if let Some(left) = self.left.checked_sub(1) {
            self.left = left;
            self.digest.update(&word.to_le_bytes());
        }
    }

    /// How many of these items, of so many words each, lie before the window: they are passed at once.
    fn skip_items(&mut self, count: usize, words: usize) -> usize {
        let items = self.skip.checked_div(words).unwrap_or(0).min(count);
        self.skip = self.skip.saturating_sub(items.saturating_mul(words));
        items
    }
}

/// How many words there are.
fn words(of: &impl Walk) -> usize {
    let mut window = Window::new(usize::MAX, 1, CRC32.digest());
    walk(of, &mut window);
    usize::MAX.saturating_sub(window.skip)
}

/// The checksum of all words: CRC-32 over their bytes, least significant first.
pub fn sum(of: &impl Walk) -> u32 {
    let mut window = Window::new(0, usize::MAX, CRC32.digest());
    walk(of, &mut window);
    window.digest.finalize()
}

/// What carries its checksum, which is none of its words.
pub trait Checked: Walk + Sized {
    /// As the exporter wrote it.
    fn check(&self) -> u32;

    /// Whether every field is as the exporter wrote it. Walks all of it at once, which takes tens of milliseconds on the
    /// device: for hosts.
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
        let words = words(of);
        let count = words.div_ceil(CALLS).max(1);
        let digest = self.digest.take().unwrap_or_else(|| CRC32.digest());
        let mut window = Window::new(self.at, count, digest);
        walk(of, &mut window);
        let to = self.at.saturating_add(count);
        if to < words {
            (self.at, self.digest) = (to, Some(window.digest));
            return Found::Nothing;
        }
        self.at = 0;
        match window.digest.finalize() == of.check() {
            true => Found::Sound,
            false => Found::Broken,
        }
    }
}

#[cfg(test)]
mod tests;
