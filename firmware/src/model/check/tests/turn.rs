//! Turns single bits of tables.

use crate::compensate::map::{self, Side};
use crate::compensate::{
    Compensation, OnField, OnForce, creep, earth_field, fingertip_mass, hard_stop, hysteresis,
    magnet_temperature, motor_leakage, sensor_temperature, thermal_gap, viscous_lag,
};
use crate::model::network::{Guard, Head, Input, Network, UnitPair, Weights};
use crate::model::parity::Parity;
use crate::model::table::{AxisScale, CentrePair, Linear, SensorTable};
use crate::units::{Field, Force};

/// What has bits to turn, struct by struct and no other way than the fields' own.
pub trait Turn {
    /// How many bits there are.
    fn bits(&self) -> usize;
    /// Turns one of them.
    fn turn(&mut self, bit: usize);
}

macro_rules! turn_numbers {
    ($($type:ty),*) => {$(
        impl Turn for $type {
            fn bits(&self) -> usize {
                <$type>::BITS as usize
            }

            fn turn(&mut self, bit: usize) {
                *self ^= 1 << bit;
            }
        }
    )*};
}
turn_numbers!(u8, u16, u32, i16, i32);

fn turn_in<'t>(parts: impl IntoIterator<Item = &'t mut (dyn Turn + 't)>, mut bit: usize) {
    for part in parts {
        if bit < part.bits() {
            return part.turn(bit);
        }
        bit -= part.bits();
    }
}

impl<T: Turn, const N: usize> Turn for [T; N] {
    fn bits(&self) -> usize {
        self.iter().map(Turn::bits).sum()
    }

    fn turn(&mut self, bit: usize) {
        turn_in(self.iter_mut().map(|part| part as &mut dyn Turn), bit);
    }
}

impl<T: Turn> Turn for Option<T> {
    fn bits(&self) -> usize {
        self.as_ref().map_or(0, Turn::bits)
    }

    fn turn(&mut self, bit: usize) {
        self.as_mut().unwrap().turn(bit);
    }
}

macro_rules! turn_fields {
    ($([$($generic:tt)*] $type:ty: $($field:ident),* $(; without $($left:ident),*)?;)*) => {$(
        impl<$($generic)*> Turn for $type {
            fn bits(&self) -> usize {
                let Self { $($field,)* $($($left: _,)*)? } = self;
                0 $(+ $field.bits())*
            }

            fn turn(&mut self, bit: usize) {
                let Self { $($field,)* $($($left: _,)*)? } = self;
                turn_in([$($field as &mut dyn Turn),*], bit);
            }
        }
    )*};
}
turn_fields! {
    [] SensorTable: number, scale, limit_counts, linear, pairs, used_pairs, shift, parity;
    [] AxisScale: offset, gain;
    [] Linear: bias, slope;
    [] CentrePair: xy, z, weight;
    [] Parity: axis, terms, spread;
    ['a] Compensation<'a>: number, field, force;
    [] sensor_temperature::Table: offset, gain;
    [] motor_leakage::Table: per_ma;
    [] earth_field::Table: world, element;
    [] magnet_temperature::Table: without, per_count;
    [] thermal_gap::Table: at, rest, bend;
    [] viscous_lag::Table: lead, rate;
    [] creep::Table: share, rate;
    [] hard_stop::Table: knee, beyond;
    [] hysteresis::Table: sliders;
    [] hysteresis::Slider: reach, share;
    [] fingertip_mass::Table: mass;
    ['a] map::Table<'a>: sides; without values;
    [] Side: from, step, knots; without covariate;
    [] Network<2, 4, 1>: sensors, inputs, force, warm_up, guards, weights; without target, check;
    [] Input: offset, gain; without source;
    [] Guard: departure, force, split;
    [] Weights<2, 4, 1>: first, second, heads;
    [const I: usize] UnitPair<I, 4>: bias, input, state_bias, state;
    [] Head<4>: bias, weights;
}

macro_rules! turn_kinds {
    ($type:ty: $($kind:ident),*; without $($left:ident),*) => {
        impl Turn for $type {
            fn bits(&self) -> usize {
                match self {
                    $(Self::$kind(inside) => inside.bits(),)*
                    $(Self::$left(_) => 0,)*
                }
            }

            fn turn(&mut self, bit: usize) {
                match self {
                    $(Self::$kind(inside) => inside.turn(bit),)*
                    $(Self::$left(_) => {})*
                }
            }
        }
    };
}
turn_kinds! {
    OnField<'_>: SensorTemperature, MotorLeakage, EarthField, Map, MagnetTemperature, ThermalGap;
    without NeighbourMagnet
}
turn_kinds! {
    OnForce<'_>: ViscousLag, Creep, HardStop, Hysteresis, FingertipMass, Map; without
}

impl Turn for Field {
    fn bits(&self) -> usize {
        self.0.bits()
    }

    fn turn(&mut self, bit: usize) {
        self.0.turn(bit);
    }
}

impl Turn for Force {
    fn bits(&self) -> usize {
        self.0.bits()
    }

    fn turn(&mut self, bit: usize) {
        self.0.turn(bit);
    }
}

/// Turns every bit of a value, one at a time; each must be noticed. Says how many there are.
pub fn every_turn_is_noticed<T: Turn>(
    value: &mut T,
    mut is_sound: impl FnMut(&T) -> bool,
) -> usize {
    assert!(is_sound(value));
    for bit in 0..value.bits() {
        value.turn(bit);
        assert!(!is_sound(value), "bit {bit} may turn");
        value.turn(bit);
    }
    assert!(is_sound(value));
    value.bits()
}
