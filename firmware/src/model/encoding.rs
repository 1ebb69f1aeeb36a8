//! Encoding of tables and networks: as 32-bit words for their checksums, as bytes in flash and on the line.
//!
//! One description of each type serves both directions ([`Encode`], [`Decode`]). In bytes an integer has its own width,
//! little-endian.

use core::mem::take;

use crate::compensation::crosstalk::{EarthFieldTable, MotorLeakageTable, NeighbourMagnetTable};
use crate::compensation::flexure::{
    CREEP_PARTS, CreepTable, FingertipMassTable, HardStopTable, ViscousLagTable,
};
use crate::compensation::hysteresis::{HysteresisTable, SLIDERS, Slider};
use crate::compensation::lookup_table::{
    Covariate, CovariateFilter, FILTERS, FieldMap, ForceMap, LookupAxis, LookupTable, SIDES,
};
use crate::compensation::thermal::{
    MagnetTemperatureTable, SensorTemperatureTable, ThermalGapTable,
};
use crate::compensation::{Compensation, FieldEffect, ForceEffect, MAX_EFFECTS};
use crate::fixed_point::{Field, Force};
use crate::model::axis_map::AxisMap;
use crate::model::formats::{
    AxisScale, CentrePair, EXP_ENTRIES, GATES, Guard, Head, Input, InputSource, Linear, MOST_PAIRS,
    Network, OUTPUTS, PARITY_TERMS, Pair, Parity, Products, SensorTable, Tables, Target, UnitPair,
    Weights,
};

/// A value as a sequence of 32-bit words.
pub trait Encode {
    /// Number of words of any value of the type; 0 if it varies.
    const WORDS: usize;

    /// Passes all words to the window in order; may stop once the window is complete.
    fn visit(&self, window: &mut Window);
}

/// A range of a word sequence.
pub struct Window<'s> {
    /// Words before the range.
    skip: usize,
    /// Words in the range.
    left: usize,
    /// Receives each word and the bytes of its type.
    sink: &'s mut dyn FnMut(u32, usize),
}

impl<'s> Window<'s> {
    /// A range of `left` words after `skip`, passed to `sink` with the number of bytes of each.
    pub fn new(skip: usize, left: usize, sink: &'s mut dyn FnMut(u32, usize)) -> Self {
        Self { skip, left, sink }
    }

    /// Passes the next word of the sequence, of a type of `bytes` bytes.
    pub fn word(&mut self, word: u32, bytes: usize) {
        if let Some(skip) = self.skip.checked_sub(1) {
            self.skip = skip;
        } else if let Some(left) = self.left.checked_sub(1) {
            self.left = left;
            (self.sink)(word, bytes);
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
pub fn visit<T: Encode>(value: &T, window: &mut Window) {
    if window.left > 0 && window.skip_items(1, T::WORDS) == 0 {
        value.visit(window);
    }
}

fn visit_items<T: Encode>(items: &[T], window: &mut Window) {
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

/// Number of words of a value.
pub fn word_count(value: &impl Encode) -> usize {
    let mut sink = |_, _| {};
    let mut window = Window::new(usize::MAX, 1, &mut sink);
    visit(value, &mut window);
    usize::MAX.saturating_sub(window.skip)
}

/// Passes the bytes of a value to `sink`, an integer at a time.
pub fn encode(value: &impl Encode, sink: &mut dyn FnMut(&[u8])) {
    let mut words = |word: u32, bytes: usize| {
        sink(word.to_le_bytes().get(..bytes).unwrap_or_default());
    };
    visit(value, &mut Window::new(0, usize::MAX, &mut words));
}

/// Source of encoded bytes, and memory for the slices that are decoded from them.
pub struct Reader<'r, 'p> {
    /// Fills the whole buffer with the next bytes; `None` at the end.
    source: &'r mut dyn FnMut(&mut [u8]) -> Option<()>,
    /// Unused memory.
    pool: &'p mut [i32],
}

impl<'r, 'p> Reader<'r, 'p> {
    /// Reads from `source`; slices are placed in `pool`.
    pub fn new(source: &'r mut dyn FnMut(&mut [u8]) -> Option<()>, pool: &'p mut [i32]) -> Self {
        Self { source, pool }
    }

    /// The next bytes.
    pub fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let mut bytes = [0; N];
        (self.source)(&mut bytes)?;
        Some(bytes)
    }

    /// The next value.
    pub fn value<T: Decode<'p>>(&mut self) -> Option<T> {
        let mut value = T::ZERO;
        value.read(self)?;
        Some(value)
    }

    /// Takes memory for `length` integers and reads them.
    fn integers(&mut self, length: usize) -> Option<&'p [i32]> {
        let (own, rest) = take(&mut self.pool).split_at_mut_checked(length)?;
        self.pool = rest;
        for integer in own.iter_mut() {
            integer.read(self)?;
        }
        Some(own)
    }
}

/// A value that is read from bytes, in place because networks are larger than the stack.
pub trait Decode<'p>: Sized {
    /// A valid value.
    const ZERO: Self;

    /// Replaces the value by the next one; `None` if the bytes are none of this type, or the memory is exhausted.
    fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()>;
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
        impl Encode for $type {
            const WORDS: usize = 1;

            fn visit(&self, window: &mut Window) {
                window.word(*self as u32, size_of::<Self>());
            }
        }

        impl Decode<'_> for $type {
            const ZERO: Self = 0;

            #[inline(never)] // Its many calls are smaller than its code.
            fn read(&mut self, reader: &mut Reader) -> Option<()> {
                *self = Self::from_le_bytes(reader.bytes()?);
                Some(())
            }
        }
    )*};
}
integers!(u8, u16, u32, i16, i32);

macro_rules! newtypes {
    ($($type:ident),*) => {$(
        impl Encode for $type {
            const WORDS: usize = 1;

            fn visit(&self, window: &mut Window) {
                self.0.visit(window);
            }
        }

        impl Decode<'_> for $type {
            const ZERO: Self = Self(0);

            fn read(&mut self, reader: &mut Reader) -> Option<()> {
                self.0.read(reader)
            }
        }
    )*};
}
newtypes!(Field, Force);

impl Encode for AxisMap {
    const WORDS: usize = 1;

    fn visit(&self, window: &mut Window) {
        self.0.visit(window);
    }
}

impl Decode<'_> for AxisMap {
    // No rotation, but zero: memory for tables that are not used takes no flash.
    const ZERO: Self = Self(0);

    fn read(&mut self, reader: &mut Reader) -> Option<()> {
        self.0.read(reader)?;
        self.is_rotation().then_some(())
    }
}

impl<T: Encode> Encode for &T {
    const WORDS: usize = T::WORDS;

    fn visit(&self, window: &mut Window) {
        T::visit(self, window);
    }
}

impl<T: Encode, const N: usize> Encode for [T; N] {
    const WORDS: usize = N * T::WORDS;

    fn visit(&self, window: &mut Window) {
        visit_items(self, window);
    }
}

impl<'p, T: Decode<'p>, const N: usize> Decode<'p> for [T; N] {
    const ZERO: Self = [const { T::ZERO }; N];

    fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
        self.iter_mut().try_for_each(|item| item.read(reader))
    }
}

/// The length, then the items.
impl<T: Encode> Encode for &[T] {
    const WORDS: usize = 0;

    fn visit(&self, window: &mut Window) {
        window.word(self.len() as u32, size_of::<u32>());
        visit_items(self, window);
    }
}

impl<'p> Decode<'p> for &'p [i32] {
    const ZERO: Self = &[];

    fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
        let length = reader.value::<u32>()?;
        *self = reader.integers(length as usize)?;
        Some(())
    }
}

impl<'p> Decode<'p> for &'p [[i32; 3]] {
    const ZERO: Self = &[];

    fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
        let length = reader.value::<u32>()?;
        (*self, _) = reader.integers((length as usize).checked_mul(3)?)?.as_chunks();
        Some(())
    }
}

/// 0, or 1 and the value.
impl<T: Encode> Encode for Option<T> {
    const WORDS: usize = 0;

    fn visit(&self, window: &mut Window) {
        window.word(u32::from(self.is_some()), size_of::<u8>());
        if let Some(value) = self {
            visit(value, window);
        }
    }
}

impl<'p, T: Decode<'p>> Decode<'p> for Option<T> {
    const ZERO: Self = None;

    fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
        *self = match reader.value::<u8>()? {
            0 => None,
            1 => Some(reader.value()?),
            _ => return None,
        };
        Some(())
    }
}

/// The fields of a struct in this order. The pattern is exhaustive: a forgotten field does not compile. A checksum is left
/// out.
macro_rules! fields {
    ([$($generic:tt)*] $type:ty { $($field:ident: $part:ty),* $(; without $left:ident)? }) => {
        fields! { only encoded: [$($generic)*] $type { $($field: $part),* $(; without $left)? } }

        impl<'p, $($generic)*> Decode<'p> for $type {
            const ZERO: Self = Self { $($field: <$part>::ZERO,)* $($left: 0)? };

            fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
                $(self.$field.read(reader)?;)*
                Some(())
            }
        }
    };
    // With slices, which have the lifetime of the memory.
    (in memory: $type:ident { $($field:ident: $part:ty),* }) => {
        fields! { only encoded: [] $type<'_> { $($field: $part),* } }

        impl<'p> Decode<'p> for $type<'p> {
            const ZERO: Self = Self { $($field: Decode::ZERO,)* };

            fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
                $(self.$field.read(reader)?;)*
                Some(())
            }
        }
    };
    (only encoded: [$($generic:tt)*] $type:ty { $($field:ident: $part:ty),* $(; without $left:ident)? }) => {
        impl<$($generic)*> Encode for $type {
            const WORDS: usize = total(&[$(<$part as Encode>::WORDS),*]);

            fn visit(&self, window: &mut Window) {
                let Self { $($field,)* $($left: _)? } = self;
                $(visit($field, window);)*
            }
        }
    };
}

/// Variants with a value: the variant's number, then the value.
macro_rules! variants {
    ($type:ident { $first:literal $zero:ident $(, $number:literal $variant:ident)* }) => {
        impl Encode for $type<'_> {
            const WORDS: usize = 0;

            fn visit(&self, window: &mut Window) {
                let number = match self {
                    Self::$zero(_) => $first,
                    $(Self::$variant(_) => $number,)*
                };
                window.word(number, size_of::<u8>());
                match self {
                    Self::$zero(value) => visit(value, window),
                    $(Self::$variant(value) => visit(value, window),)*
                }
            }
        }

        impl<'p> Decode<'p> for $type<'p> {
            const ZERO: Self = Self::$zero(Decode::ZERO);

            fn read(&mut self, reader: &mut Reader<'_, 'p>) -> Option<()> {
                *self = match reader.value::<u8>()? {
                    $first => Self::$zero(reader.value()?),
                    $($number => Self::$variant(reader.value()?),)*
                    _ => return None,
                };
                Some(())
            }
        }
    };
}

/// Variants as a fixed number of words: how they are encoded, and decoded.
macro_rules! plain_variants {
    ($type:ty as $words:literal, zero $zero:ident {
        $($variant:pat => $list:expr),* ; $($read:pat => $value:expr),*
    }) => {
        impl Encode for $type {
            const WORDS: usize = $words;

            fn visit(&self, window: &mut Window) {
                let words: [u32; $words] = match *self {
                    $($variant => $list,)*
                };
                for word in words {
                    window.word(word, size_of::<u8>());
                }
            }
        }

        impl Decode<'_> for $type {
            const ZERO: Self = Self::$zero;

            fn read(&mut self, reader: &mut Reader) -> Option<()> {
                *self = match reader.bytes::<$words>()? {
                    $($read => $value,)*
                    _ => return None,
                };
                Some(())
            }
        }
    };
}

// The ideal model.
fields! { only encoded: ['a] Tables<'a> {
    id: u16, exp: &'a [u32; EXP_ENTRIES], sensors: &'a [SensorTable], compensations: &'a [Compensation<'a>];
    without check
} }
fields! { [] SensorTable {
    number: u8, axes: AxisMap, scale: [AxisScale; 3], limit_counts: i16, linear: Linear, pairs: [CentrePair; MOST_PAIRS],
    used_pairs: u8, shift: [u8; 2], parity: Parity
} }
fields! { [] AxisScale { offset: i32, gain: i32 } }
fields! { [] Linear { bias: [i32; 2], slope: [[i32; 3]; 2] } }
fields! { [] CentrePair { xy: [[i16; 2]; 2], z: [i16; 2], weight: [[i16; 2]; 2] } }
fields! { [] Parity { axis: u8, terms: [i32; PARITY_TERMS], sigma: i32 } }

// The compensation.
fields! { in memory: Compensation {
    number: u8, filters: [Option<CovariateFilter>; FILTERS],
    field: [Option<FieldEffect<'_>>; MAX_EFFECTS], force: [Option<ForceEffect<'_>>; MAX_EFFECTS]
} }
variants! { FieldEffect {
    1 SensorTemperature, 2 MotorLeakage, 3 EarthField, 4 NeighbourMagnet, 5 Map, 6 MagnetTemperature,
    7 ThermalGap
} }
variants! { ForceEffect {
    1 ViscousLag, 2 Creep, 3 HardStop, 4 Hysteresis, 5 FingertipMass, 6 Map
} }
fields! { [] SensorTemperatureTable { offset: [i32; 3], gain: i32 } }
fields! { [] MotorLeakageTable { per_ma: [[i32; 3]; 3] } }
fields! { [] EarthFieldTable { world: [i32; 3], element: [[i32; 3]; 3] } }
fields! { in memory: NeighbourMagnetTable { knots: &[[i32; 3]] } }
fields! { [] MagnetTemperatureTable { without: [i32; 3], per_count: i32 } }
fields! { [] ThermalGapTable { at: [i32; 3], rest: [i32; 3], bend: [[i32; 3]; 3] } }
fields! { [] ViscousLagTable { lead: [i32; 2], rate: i32 } }
fields! { [] CreepTable { share: [[i32; CREEP_PARTS]; 2], rate: [i32; CREEP_PARTS] } }
fields! { [] HardStopTable { knee: [i32; 2], beyond: [[i32; 2]; 2] } }
fields! { [] HysteresisTable { sliders: [[Slider; SLIDERS]; 2] } }
fields! { [] Slider { reach: i32, share: i32 } }
fields! { [] FingertipMassTable { mass: i32 } }
fields! { in memory: FieldMap { table: LookupTable<'_>, along: [i32; 3], matrix: [[i32; 3]; 3] } }
fields! { in memory: ForceMap { table: LookupTable<'_>, along: [i32; 2] } }
fields! { in memory: LookupTable { sides: [Option<LookupAxis>; SIDES], values: &[i32] } }
fields! { [] CovariateFilter { covariate: Covariate, gain: i32 } }
fields! { [] LookupAxis { covariate: Covariate, from: i32, step: i32, knots: u16 } }
plain_variants! { Covariate as 2, zero Opening {
    Self::Opening => [1, 0], Self::MotorIq => [2, 0], Self::MotorAngle => [3, 0],
    Self::Acceleration(axis) => [4, axis.into()], Self::Temperature => [5, 0],
    Self::Force(axis) => [6, axis.into()], Self::Lagged(filter) => [7, filter.into()],
    Self::Rate(filter) => [8, filter.into()];
    [1, _] => Self::Opening, [2, _] => Self::MotorIq, [3, _] => Self::MotorAngle,
    [4, axis] => Self::Acceleration(axis), [5, _] => Self::Temperature,
    [6, axis] => Self::Force(axis), [7, filter] => Self::Lagged(filter),
    [8, filter] => Self::Rate(filter)
} }

// Recurrent networks.
fields! { [const I: usize, const H: usize, const S: usize] Network<I, H, S> {
    sensors: [u8; S], target: Target, inputs: [[Input; 2]; I], force: [i32; 2], warm_up: u16,
    guards: [Guard; S], weights: Weights<I, H, S>;
    without check
} }
plain_variants! { Target as 1, zero Force {
    Self::Force => [1], Self::Rest => [2]; [1] => Self::Force, [2] => Self::Rest
} }
fields! { [] Input { source: InputSource, offset: i32, gain: i32 } }
plain_variants! { InputSource as 3, zero None {
    Self::None => [0; 3], Self::Field { sensor, axis } => [1, sensor.into(), axis.into()],
    Self::Ideal { sensor, axis } => [2, sensor.into(), axis.into()];
    [0, ..] => Self::None, [1, sensor, axis] => Self::Field { sensor, axis },
    [2, sensor, axis] => Self::Ideal { sensor, axis }
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
