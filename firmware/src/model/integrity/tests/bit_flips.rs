//! Flips every bit of the tables, one at a time.

use super::*;

/// Number of bits, and access to each, through the fields of the structs: independent of the checksum's traversal.
pub trait BitFlip {
    fn bits(&self) -> usize;
    fn flip(&mut self, bit: usize);
}

macro_rules! flip_integers {
    ($($type:ty),*) => {$(
        impl BitFlip for $type {
            fn bits(&self) -> usize {
                <$type>::BITS as usize
            }

            fn flip(&mut self, bit: usize) {
                *self ^= 1 << bit;
            }
        }
    )*};
}
flip_integers!(u8, u16, u32, i16, i32);

fn flip_in<'t>(parts: impl IntoIterator<Item = &'t mut (dyn BitFlip + 't)>, mut bit: usize) {
    for part in parts {
        if bit < part.bits() {
            return part.flip(bit);
        }
        bit -= part.bits();
    }
}

impl<T: BitFlip, const N: usize> BitFlip for [T; N] {
    fn bits(&self) -> usize {
        self.iter().map(BitFlip::bits).sum()
    }

    fn flip(&mut self, bit: usize) {
        flip_in(self.iter_mut().map(|part| part as &mut dyn BitFlip), bit);
    }
}

impl<T: BitFlip> BitFlip for Option<T> {
    fn bits(&self) -> usize {
        self.as_ref().map_or(0, BitFlip::bits)
    }

    fn flip(&mut self, bit: usize) {
        self.as_mut().unwrap().flip(bit);
    }
}

// The patterns name all fields: a new one is a compile error here.
macro_rules! flip_fields {
    ($([$($generic:tt)*] $type:ty: $($field:ident),* $(; without $($left:ident),*)?;)*) => {$(
        impl<$($generic)*> BitFlip for $type {
            fn bits(&self) -> usize {
                let Self { $($field,)* $($($left: _,)*)? } = self;
                0 $(+ $field.bits())*
            }

            fn flip(&mut self, bit: usize) {
                let Self { $($field,)* $($($left: _,)*)? } = self;
                flip_in([$($field as &mut dyn BitFlip),*], bit);
            }
        }
    )*};
}
flip_fields! {
    [] SensorTable: number, axes, scale, limit_counts, linear, pairs, used_pairs, shift, parity;
    [] AxisScale: offset, gain;
    [] Linear: bias, slope;
    [] CentrePair: xy, z, weight;
    [] Parity: axis, terms, sigma;
    ['a] Compensation<'a>: number, filters, field, force;
    [] SensorTemperatureTable: offset, gain;
    [] MotorLeakageTable: per_ma;
    [] EarthFieldTable: world, element;
    [] MagnetTemperatureTable: without, per_count;
    [] ThermalGapTable: at, rest, bend;
    [] ViscousLagTable: lead, rate;
    [] CreepTable: share, rate;
    [] HardStopTable: knee, beyond;
    [] HysteresisTable: sliders;
    [] Slider: reach, share;
    [] FingertipMassTable: mass;
    [] CovariateFilter: gain; without covariate;
    ['a] FieldMap<'a>: table, along, matrix;
    ['a] ForceMap<'a>: table, along;
    ['a] LookupTable<'a>: sides; without values;
    [] LookupAxis: from, step, knots; without covariate;
    [] Network<2, 4, 1>: sensors, inputs, force, warm_up, guards, weights; without target, check;
    [] Input: offset, gain; without source;
    [] Guard: residual, force, deviation;
    [] Weights<2, 4, 1>: first, second, heads;
    [const I: usize] UnitPair<I, 4>: bias, input, state_bias, state;
    [] Head<4>: bias, weights;
}

macro_rules! flip_variants {
    ($type:ty: $($kind:ident),*; without $($left:ident),*) => {
        impl BitFlip for $type {
            fn bits(&self) -> usize {
                match self {
                    $(Self::$kind(table) => table.bits(),)*
                    $(Self::$left(_) => 0,)*
                }
            }

            fn flip(&mut self, bit: usize) {
                match self {
                    $(Self::$kind(table) => table.flip(bit),)*
                    $(Self::$left(_) => {})*
                }
            }
        }
    };
}
flip_variants! {
    FieldEffect<'_>: SensorTemperature, MotorLeakage, EarthField, Map, MagnetTemperature, ThermalGap;
    without NeighbourMagnet
}
flip_variants! {
    ForceEffect<'_>: ViscousLag, Creep, HardStop, Hysteresis, FingertipMass, Map; without
}

macro_rules! flip_wrapped {
    ($($type:ty),*) => {$(
        impl BitFlip for $type {
            fn bits(&self) -> usize {
                self.0.bits()
            }

            fn flip(&mut self, bit: usize) {
                self.0.flip(bit);
            }
        }
    )*};
}
flip_wrapped!(AxisMap, Field, Force);

/// Flips every bit, asserts that each flip is detected, and returns the number of bits.
pub fn assert_flips_detected<T: BitFlip>(
    value: &mut T,
    mut is_intact: impl FnMut(&T) -> bool,
) -> usize {
    assert!(is_intact(value));
    for bit in 0..value.bits() {
        value.flip(bit);
        assert!(!is_intact(value), "bit {bit}");
        value.flip(bit);
    }
    assert!(is_intact(value));
    value.bits()
}
