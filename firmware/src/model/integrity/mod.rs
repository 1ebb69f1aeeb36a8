//! Integrity of tables and weights in flash.
//!
//! The exporter writes the CRC-32 of all fields into the tables ([`checksum`]). The device recomputes it at the start
//! and continuously while it runs ([`Scrubber`]), over the memory that the kernels read. Any single flipped bit and any
//! burst of 32 are detected. Corrupt tables must prevent arming.
//!
//! The CRC is over the fields as 32-bit words ([`WordStream`]), so that padding bytes do not count.

use core::hint::black_box;

use crate::checksum::{CRC32, Digest32};
use crate::compensation::crosstalk::{
    EarthFieldTable, KNOTS, MotorLeakageTable, NeighbourMagnetTable,
};
use crate::compensation::flexure::{
    CREEP_PARTS, CreepTable, FingertipMassTable, HardStopTable, ViscousLagTable,
};
use crate::compensation::hysteresis::{HysteresisTable, SLIDERS, Slider};
use crate::compensation::lookup_table::{Covariate, LookupAxis, LookupTable};
use crate::compensation::thermal::{
    MagnetTemperatureTable, SensorTemperatureTable, ThermalGapTable,
};
use crate::compensation::{Compensation, FieldEffect, ForceEffect, MAX_EFFECTS};
use crate::fixed_point::{Field, Force};
use crate::model::formats::{
    AxisScale, CentrePair, EXP_ENTRIES, GATES, Guard, Head, Input, InputSource, Linear, MOST_PAIRS,
    Network, OUTPUTS, PARITY_TERMS, Pair, Parity, Products, SensorTable, Tables, Target, UnitPair,
    Weights,
};

/// A value as a sequence of 32-bit words.
pub trait WordStream {
    /// Number of words of any value of the type; 0 if it varies.
    const WORDS: usize;

    /// Passes all words to the window in order; may stop once the window is complete.
    fn visit(&self, window: &mut Window);
}

/// A range of a word sequence that enters a checksum.
pub struct Window {
    /// Words before the range.
    skip: usize,
    /// Words in the range.
    left: usize,
    digest: Digest32,
}

impl Window {
    fn new(skip: usize, left: usize, digest: Digest32) -> Self {
        Self { skip, left, digest }
    }

    /// Passes the next word of the sequence.
    pub fn word(&mut self, word: u32) {
        if let Some(skip) = self.skip.checked_sub(1) {
            self.skip = skip;
        } else if let Some(left) = self.left.checked_sub(1) {
            self.left = left;
            self.digest.update(&word.to_le_bytes());
        }
    }

    /// Skips items of `words` words that are entirely before the range; returns their number.
    fn skip_items(&mut self, count: usize, words: usize) -> usize {
        let items = self.skip.checked_div(words).unwrap_or(0).min(count);
        self.skip = self.skip.saturating_sub(items.saturating_mul(words));
        items
    }
}

/// Visits a value unless it is outside the window.
fn visit<T: WordStream>(value: &T, window: &mut Window) {
    if window.left > 0 && window.skip_items(1, T::WORDS) == 0 {
        value.visit(window);
    }
}

fn visit_items<T: WordStream>(items: &[T], window: &mut Window) {
    let before = match T::WORDS {
        0 => 0,
        words => window.skip_items(items.len(), words),
    };
    for item in items.get(before..).unwrap_or_default() {
        if window.left == 0 {
            return;
        }
        visit(item, window);
    }
}

fn word_count(value: &impl WordStream) -> usize {
    let mut window = Window::new(usize::MAX, 1, CRC32.digest());
    visit(value, &mut window);
    usize::MAX.saturating_sub(window.skip)
}

/// CRC-32 of all words, little-endian.
pub fn checksum(value: &impl WordStream) -> u32 {
    let mut window = Window::new(0, usize::MAX, CRC32.digest());
    visit(value, &mut window);
    window.digest.finalize()
}

/// A value with its own checksum, which is not part of its words.
pub trait Checksummed: WordStream + Sized {
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

/// Maximum number of calls of [`Scrubber::step`] per pass.
pub const CALLS: usize = 1000;
/// Calls per second for a pass in at most five seconds.
pub const CALLS_PER_S: u32 = 200;

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

/// Continuous check in passes of [`CALLS`] steps: three words per step for the ideal model of four sensors.
#[derive(Clone, Default)]
pub struct Scrubber {
    at: usize,
    digest: Option<Digest32>,
}

impl Scrubber {
    /// State before the first pass.
    pub const NEW: Self = Self { at: 0, digest: None };

    /// Checks the next part of `value`, always the same value. A bit that flips behind the current position is found
    /// at the end of the next pass: at [`CALLS_PER_S`] within ten seconds.
    pub fn step(&mut self, value: &impl Checksummed) -> ScrubResult {
        let value = black_box(value);
        let words = word_count(value);
        let count = words.div_ceil(CALLS).max(1);
        let digest = self.digest.take().unwrap_or_else(|| CRC32.digest());
        let mut window = Window::new(self.at, count, digest);
        visit(value, &mut window);
        let to = self.at.saturating_add(count);
        if to < words {
            (self.at, self.digest) = (to, Some(window.digest));
            return ScrubResult::Pending;
        }
        self.at = 0;
        if window.digest.finalize() == value.check() {
            ScrubResult::Intact
        } else {
            ScrubResult::Corrupt
        }
    }
}

/// Sum of the parts' word counts; 0 if any varies.
const fn total(mut parts: &[usize]) -> usize {
    let mut sum = 0;
    while let [part, others @ ..] = parts {
        if *part == 0 {
            return 0;
        }
        (sum, parts) = (sum + *part, others);
    }
    sum
}

macro_rules! integers {
    ($($type:ty),*) => {$(
        impl WordStream for $type {
            const WORDS: usize = 1;

            fn visit(&self, window: &mut Window) {
                window.word(*self as u32);
            }
        }
    )*};
}
integers!(u8, u16, u32, i16, i32);

macro_rules! newtypes {
    ($($type:ty),*) => {$(
        impl WordStream for $type {
            const WORDS: usize = 1;

            fn visit(&self, window: &mut Window) {
                self.0.visit(window);
            }
        }
    )*};
}
newtypes!(Field, Force);

impl<T: WordStream> WordStream for &T {
    const WORDS: usize = T::WORDS;

    fn visit(&self, window: &mut Window) {
        T::visit(self, window);
    }
}

impl<T: WordStream, const N: usize> WordStream for [T; N] {
    const WORDS: usize = N * T::WORDS;

    fn visit(&self, window: &mut Window) {
        visit_items(self, window);
    }
}

/// The length, then the items.
impl<T: WordStream> WordStream for &[T] {
    const WORDS: usize = 0;

    fn visit(&self, window: &mut Window) {
        window.word(self.len() as u32);
        visit_items(self, window);
    }
}

/// 0, or 1 and the value.
impl<T: WordStream> WordStream for Option<T> {
    const WORDS: usize = 0;

    fn visit(&self, window: &mut Window) {
        window.word(u32::from(self.is_some()));
        if let Some(value) = self {
            visit(value, window);
        }
    }
}

/// The fields of a struct in this order. The pattern is exhaustive: a forgotten field does not compile.
macro_rules! fields {
    ([$($generic:tt)*] $type:ty { $($field:ident: $part:ty),* $(; without $left:ident)? }) => {
        impl<$($generic)*> WordStream for $type {
            const WORDS: usize = total(&[$(<$part as WordStream>::WORDS),*]);

            fn visit(&self, window: &mut Window) {
                let Self { $($field,)* $($left: _)? } = self;
                $(visit($field, window);)*
            }
        }
    };
}

/// Variants with a value: the variant's number, then the value.
macro_rules! variants {
    ($type:ty { $($number:literal $variant:ident),* }) => {
        impl WordStream for $type {
            const WORDS: usize = 0;

            fn visit(&self, window: &mut Window) {
                match self {
                    $(Self::$variant(value) => {
                        window.word($number);
                        visit(value, window);
                    })*
                }
            }
        }
    };
}

/// Variants as a fixed number of words.
macro_rules! plain_variants {
    ($type:ty as $words:literal { $($variant:pat => $list:expr),* }) => {
        impl WordStream for $type {
            const WORDS: usize = $words;

            fn visit(&self, window: &mut Window) {
                let words: [u32; $words] = match *self {
                    $($variant => $list,)*
                };
                words.visit(window);
            }
        }
    };
}

// The ideal model.
fields! { ['a] Tables<'a> {
    id: u16, exp: &'a [u32; EXP_ENTRIES], sensors: &'a [SensorTable], compensations: &'a [Compensation<'a>];
    without check
} }
fields! { [] SensorTable {
    number: u8, scale: [AxisScale; 3], limit_counts: i16, linear: Linear, pairs: [CentrePair; MOST_PAIRS],
    used_pairs: u8, shift: [u8; 2], parity: Parity
} }
fields! { [] AxisScale { offset: i32, gain: i32 } }
fields! { [] Linear { bias: [i32; 2], slope: [[i32; 3]; 2] } }
fields! { [] CentrePair { xy: [[i16; 2]; 2], z: [i16; 2], weight: [[i16; 2]; 2] } }
fields! { [] Parity { axis: u8, terms: [i32; PARITY_TERMS], sigma: i32 } }

// The compensation.
fields! { ['a] Compensation<'a> {
    number: u8, field: [Option<FieldEffect<'a>>; MAX_EFFECTS], force: [Option<ForceEffect<'a>>; MAX_EFFECTS]
} }
variants! { FieldEffect<'_> {
    1 SensorTemperature, 2 MotorLeakage, 3 EarthField, 4 NeighbourMagnet, 5 Map, 6 MagnetTemperature,
    7 ThermalGap
} }
variants! { ForceEffect<'_> {
    1 ViscousLag, 2 Creep, 3 HardStop, 4 Hysteresis, 5 FingertipMass, 6 Map
} }
fields! { [] SensorTemperatureTable { offset: [i32; 3], gain: i32 } }
fields! { [] MotorLeakageTable { per_ma: [[i32; 3]; 3] } }
fields! { [] EarthFieldTable { world: [i32; 3], element: [[i32; 3]; 3] } }
fields! { ['a] NeighbourMagnetTable<'a> { knots: &'a [[i16; 3]; KNOTS] } }
fields! { [] MagnetTemperatureTable { without: [i32; 3], per_count: i32 } }
fields! { [] ThermalGapTable { at: [i32; 3], rest: [i32; 3], bend: [[i32; 3]; 3] } }
fields! { [] ViscousLagTable { lead: [i32; 2], rate: i32 } }
fields! { [] CreepTable { share: [[i32; CREEP_PARTS]; 2], rate: [i32; CREEP_PARTS] } }
fields! { [] HardStopTable { knee: [i32; 2], beyond: [[i32; 2]; 2] } }
fields! { [] HysteresisTable { sliders: [[Slider; SLIDERS]; 2] } }
fields! { [] Slider { reach: i32, share: i32 } }
fields! { [] FingertipMassTable { mass: i32 } }
fields! { ['a] LookupTable<'a> { sides: [Option<LookupAxis>; 2], values: &'a [i32] } }
fields! { [] LookupAxis { covariate: Covariate, from: i32, step: i32, knots: u16 } }
plain_variants! { Covariate as 2 {
    Self::Opening => [1, 0], Self::MotorIq => [2, 0], Self::MotorAngle => [3, 0],
    Self::Acceleration(axis) => [4, axis.into()], Self::Temperature => [5, 0]
} }

// Recurrent networks.
fields! { [const I: usize, const H: usize, const S: usize] Network<I, H, S> {
    sensors: [u8; S], target: Target, inputs: [[Input; 2]; I], force: [i32; 2], warm_up: u16,
    guards: [Guard; S], weights: Weights<I, H, S>;
    without check
} }
plain_variants! { Target as 1 { Self::Force => [1], Self::Rest => [2] } }
fields! { [] Input { source: InputSource, offset: i32, gain: i32 } }
plain_variants! { InputSource as 3 {
    Self::None => [0; 3], Self::Field { sensor, axis } => [1, sensor.into(), axis.into()],
    Self::Ideal { sensor, axis } => [2, sensor.into(), axis.into()]
} }
fields! { [] Guard { residual: [Field; 2], force: [i32; 2], deviation: [Force; 2] } }
fields! { [const I: usize, const H: usize, const S: usize] Weights<I, H, S> {
    first: [UnitPair<I, H>; H], second: [UnitPair<H, H>; H], heads: [Head<H>; S]
} }
fields! { [const I: usize, const H: usize] UnitPair<I, H> {
    bias: [[i32; GATES]; 2], input: [Products; I], state_bias: [i32; 2],
    state: [Products; H]
} }
fields! { [const H: usize] Head<H> { bias: [i32; OUTPUTS], weights: [[Pair; OUTPUTS]; H] } }

#[cfg(test)]
mod tests;
