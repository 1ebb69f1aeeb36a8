//! The words of every type in the tables.

use super::{Walk, Window, walk};
use crate::compensate::map::{self, Covariate, Side};
use crate::compensate::{
    Compensation, MOST, OnField, OnForce, creep, earth_field, fingertip_mass, hard_stop,
    hysteresis, magnet_temperature, motor_leakage, neighbour_magnet, sensor_temperature,
    thermal_gap, viscous_lag,
};
use crate::model::network::{
    GATES, Guard, Head, Input, Network, OUTPUTS, Pair, Products, Source, Target, UnitPair, Weights,
};
use crate::model::parity::{Parity, TERMS};
use crate::model::table::{
    AxisScale, CentrePair, EXP_ENTRIES, Linear, MOST_PAIRS, SensorTable, Tables,
};
use crate::units::{Field, Force};

/// Words of a whole that has these parts; 0 where a part's differ.
const fn fixed(mut parts: &[usize]) -> usize {
    let mut sum = 0;
    while let [part, others @ ..] = parts {
        if *part == 0 {
            return 0;
        }
        (sum, parts) = (sum + *part, others);
    }
    sum
}

macro_rules! number {
    ($($type:ty),*) => {$(
        impl Walk for $type {
            const FIXED: usize = 1;

            fn visit(&self, window: &mut Window) {
                window.word(*self as u32);
            }
        }
    )*};
}
number!(u8, u16, u32, i16, i32);

/// Declares the fields of a struct, in the order of the walk. None can be forgotten: the pattern names all.
macro_rules! fields {
    ([$($generic:tt)*] $type:ty { $($field:ident: $part:ty),* $(; without $left:ident)? }) => {
        impl<$($generic)*> Walk for $type {
            const FIXED: usize = fixed(&[$(<$part as Walk>::FIXED),*]);

            fn visit(&self, window: &mut Window) {
                let Self { $($field,)* $($left: _)? } = self;
                $(walk($field, window);)*
            }
        }
    };
}

impl<T: Walk> Walk for &T {
    const FIXED: usize = T::FIXED;

    fn visit(&self, window: &mut Window) {
        T::visit(self, window);
    }
}

/// Items one behind the other.
fn walk_items<T: Walk>(items: &[T], window: &mut Window) {
    let before = match T::FIXED {
        0 => 0,
        each => window.skip_items(items.len(), each),
    };
    for item in items.get(before..).unwrap_or_default() {
        if window.left == 0 {
            return;
        }
        walk(item, window);
    }
}

impl<T: Walk, const N: usize> Walk for [T; N] {
    const FIXED: usize = N * T::FIXED;

    fn visit(&self, window: &mut Window) {
        walk_items(self, window);
    }
}

/// Its length, then its items.
impl<T: Walk> Walk for &[T] {
    const FIXED: usize = 0;

    fn visit(&self, window: &mut Window) {
        window.word(self.len() as u32);
        walk_items(self, window);
    }
}

/// Whether there is something, then that.
impl<T: Walk> Walk for Option<T> {
    const FIXED: usize = 0;

    fn visit(&self, window: &mut Window) {
        window.word(u32::from(self.is_some()));
        if let Some(inside) = self {
            walk(inside, window);
        }
    }
}

/// Declares kinds that hold one thing each: a number for the kind, then what it holds.
macro_rules! kinds {
    ($type:ty { $($number:literal $kind:ident),* }) => {
        impl Walk for $type {
            const FIXED: usize = 0;

            fn visit(&self, window: &mut Window) {
                match self {
                    $(Self::$kind(inside) => {
                        window.word($number);
                        walk(inside, window);
                    })*
                }
            }
        }
    };
}

/// Declares kinds that are a few words themselves.
macro_rules! plain_kinds {
    ($type:ty as $words:literal { $($kind:pat => $list:expr),* }) => {
        impl Walk for $type {
            const FIXED: usize = $words;

            fn visit(&self, window: &mut Window) {
                let words: [u32; $words] = match *self {
                    $($kind => $list,)*
                };
                words.visit(window);
            }
        }
    };
}

impl Walk for Field {
    const FIXED: usize = 1;

    fn visit(&self, window: &mut Window) {
        self.0.visit(window);
    }
}

impl Walk for Force {
    const FIXED: usize = 1;

    fn visit(&self, window: &mut Window) {
        self.0.visit(window);
    }
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
fields! { [] Parity { axis: u8, terms: [i32; TERMS], spread: i32 } }

// What is undone around it.
fields! { ['a] Compensation<'a> {
    number: u8, field: [Option<OnField<'a>>; MOST], force: [Option<OnForce<'a>>; MOST]
} }
kinds! { OnField<'_> {
    1 SensorTemperature, 2 MotorLeakage, 3 EarthField, 4 NeighbourMagnet, 5 Map, 6 MagnetTemperature,
    7 ThermalGap
} }
kinds! { OnForce<'_> { 1 ViscousLag, 2 Creep, 3 HardStop, 4 Hysteresis, 5 FingertipMass, 6 Map } }
fields! { [] sensor_temperature::Table { offset: [i32; 3], gain: i32 } }
fields! { [] motor_leakage::Table { per_ma: [[i32; 3]; 3] } }
fields! { [] earth_field::Table { world: [i32; 3], element: [[i32; 3]; 3] } }
fields! { ['a] neighbour_magnet::Table<'a> { knots: &'a [[i16; 3]; neighbour_magnet::KNOTS] } }
fields! { [] magnet_temperature::Table { without: [i32; 3], per_count: i32 } }
fields! { [] thermal_gap::Table { at: [i32; 3], rest: [i32; 3], bend: [[i32; 3]; 3] } }
fields! { [] viscous_lag::Table { lead: [i32; 2], rate: i32 } }
fields! { [] creep::Table { share: [[i32; creep::PARTS]; 2], rate: [i32; creep::PARTS] } }
fields! { [] hard_stop::Table { knee: [i32; 2], beyond: [[i32; 2]; 2] } }
fields! { [] hysteresis::Table { sliders: [[hysteresis::Slider; hysteresis::SLIDERS]; 2] } }
fields! { [] hysteresis::Slider { reach: i32, share: i32 } }
fields! { [] fingertip_mass::Table { mass: i32 } }
fields! { ['a] map::Table<'a> { sides: [Option<Side>; 2], values: &'a [i32] } }
fields! { [] Side { covariate: Covariate, from: i32, step: i32, knots: u16 } }
plain_kinds! { Covariate as 2 {
    Self::Opening => [1, 0], Self::MotorIq => [2, 0], Self::MotorAngle => [3, 0],
    Self::Acceleration(axis) => [4, axis.into()], Self::Temperature => [5, 0]
} }

// Recurrent networks.
fields! { [const I: usize, const H: usize, const S: usize] Network<I, H, S> {
    sensors: [u8; S], target: Target, inputs: [[Input; 2]; I], force: [i32; 2], warm_up: u16,
    guards: [Guard; S], weights: Weights<I, H, S>;
    without check
} }
plain_kinds! { Target as 1 { Self::Force => [1], Self::Rest => [2] } }
fields! { [] Input { source: Source, offset: i32, gain: i32 } }
plain_kinds! { Source as 3 {
    Self::None => [0; 3], Self::Field { sensor, axis } => [1, sensor.into(), axis.into()],
    Self::Ideal { sensor, axis } => [2, sensor.into(), axis.into()]
} }
fields! { [] Guard { departure: [Field; 2], force: [i32; 2], split: [Force; 2] } }
fields! { [const I: usize, const H: usize, const S: usize] Weights<I, H, S> {
    first: [UnitPair<I, H>; H], second: [UnitPair<H, H>; H], heads: [Head<H>; S]
} }
fields! { [const I: usize, const H: usize] UnitPair<I, H> {
    bias: [[i32; GATES]; 2], input: [Products; I], state_bias: [i32; 2],
    state: [Products; H]
} }
fields! { [const H: usize] Head<H> { bias: [i32; OUTPUTS], weights: [[Pair; OUTPUTS]; H] } }
