//! Physical effects undone on the device, one file each, named like the host's.
//!
//! Effects on the field are taken off before the ideal model, in the order in which a signal meets
//! them on its way back from the sensor: the sensor, fields of other sources, the magnet, the gap.
//! Effects on the flexures are undone on the forces afterwards, with a memory of their own. Effects
//! that only depend on the present forces (stiffening, tip slope, cross coupling, the sensor's
//! compression) are part of the ideal model's tables.
//!
//! - [`temperature`]: the sensor's temperature without its noise.
//! - [`sensor_temperature`], [`motor_leakage`], [`earth_field`], [`neighbour_magnet`],
//!   [`magnet_temperature`], [`thermal_gap`]: on the field.
//! - [`viscous_lag`], [`creep`], [`hysteresis`], [`hard_stop`], [`fingertip_mass`]: on the forces.
//! - [`map`]: a user's own effect as a table of one or two covariates.

pub mod creep;
pub mod earth_field;
pub mod fingertip_mass;
pub mod hard_stop;
pub mod hysteresis;
pub mod magnet_temperature;
pub mod map;
pub mod motor_leakage;
pub mod neighbour_magnet;
pub mod sensor_temperature;
pub mod temperature;
pub mod thermal_gap;
pub mod viscous_lag;

use crate::surroundings::Surroundings;
use crate::units::{Field, Force};

/// What is undone at one sensor.
#[derive(Clone, Copy, Debug)]
pub struct Compensation<'a> {
    /// Number of the sensor.
    pub number: u8,
    /// On the field, in this order.
    pub field: [Option<OnField<'a>>; MOST],
    /// On the forces, in this order.
    pub force: [Option<OnForce<'a>>; MOST],
}

/// Most effects on the field, and most on the forces, at one sensor.
pub const MOST: usize = 8;

/// An effect on the field.
#[derive(Clone, Copy, Debug)]
pub enum OnField<'a> {
    /// Offset and gain of the Hall element.
    SensorTemperature(sensor_temperature::Table),
    /// Field of the motor.
    MotorLeakage(motor_leakage::Table),
    /// Field of the Earth.
    EarthField(earth_field::Table),
    /// Field of the other finger's magnet.
    NeighbourMagnet(neighbour_magnet::Table<'a>),
    /// A user's field, each axis.
    Map([map::Table<'a>; 3]),
    /// Remanence.
    MagnetTemperature(magnet_temperature::Table),
    /// Growth of the gap.
    ThermalGap(thermal_gap::Table),
}

/// An effect on the forces.
#[derive(Clone, Copy, Debug)]
pub enum OnForce<'a> {
    /// The flexures follow late.
    ViscousLag(viscous_lag::Table),
    /// The flexures give way slowly.
    Creep(creep::Table),
    /// The flexures meet their stops.
    HardStop(hard_stop::Table),
    /// Friction beside the flexures.
    Hysteresis(hysteresis::Table),
    /// The fingertip's own weight and inertia.
    FingertipMass(fingertip_mass::Table),
    /// A user's force, or displacement as a force, along x and z.
    Map([map::Table<'a>; 2]),
}

/// What the compensation of one sensor remembers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Memory {
    temperature: temperature::State,
    lag: viscous_lag::State,
    creep: creep::State,
    hysteresis: hysteresis::State,
}

/// Values after a compensation, and whether something that it needs was absent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Undone<T> {
    /// What is left.
    pub left: T,
    /// True where an effect could not be undone.
    pub lacking: bool,
}

impl Compensation<'_> {
    /// Forces that friction may hold at rest, either sign: lateral and longitudinal.
    pub fn held(&self) -> [Force; 2] {
        let mut held = [Force(0); 2];
        for effect in self.force.iter().flatten() {
            if let OnForce::Hysteresis(table) = effect {
                for (held, sliders) in held.iter_mut().zip(&table.sliders) {
                    let force = sliders.iter().map(hysteresis::Slider::force);
                    held.0 = force.fold(held.0, |sum, force| sum.saturating_add(force.0));
                }
            }
        }
        held
    }

    /// Whether the fingertip's own weight and inertia are among it.
    pub fn is_without_mass(&self) -> bool {
        let mut effects = self.force.iter().flatten();
        effects.any(|effect| matches!(effect, OnForce::FingertipMass(_)))
    }

    /// Takes the effects on the field off.
    pub fn field(
        &self,
        mut field: [Field; 3],
        temperature: i16,
        around: &Surroundings,
        memory: &mut Memory,
    ) -> Undone<[Field; 3]> {
        let warmer = memory.temperature.follow(temperature);
        let mut lacking = false;
        for effect in self.field.iter().flatten() {
            let found = match effect {
                OnField::SensorTemperature(table) => Some(table.undo(field, warmer)),
                OnField::MotorLeakage(table) => table.undo(field, around),
                OnField::EarthField(table) => table.undo(field, around),
                OnField::NeighbourMagnet(table) => table.undo(field, around),
                OnField::Map(tables) => map_field(tables, field, warmer, around),
                OnField::MagnetTemperature(table) => Some(table.undo(field, warmer)),
                OnField::ThermalGap(table) => Some(table.undo(field, warmer)),
            };
            match found {
                Some(left) => field = left,
                None => lacking = true,
            }
        }
        Undone {
            left: field,
            lacking,
        }
    }

    /// Takes the effects on the flexures off.
    pub fn force(
        &self,
        mut force: [Force; 2],
        around: &Surroundings,
        memory: &mut Memory,
    ) -> Undone<[Force; 2]> {
        let warmer = memory.temperature.warmer();
        let mut lacking = false;
        for effect in self.force.iter().flatten() {
            let found = match effect {
                OnForce::ViscousLag(table) => Some(table.undo(force, &mut memory.lag)),
                OnForce::Creep(table) => Some(table.undo(force, &mut memory.creep)),
                OnForce::HardStop(table) => Some(table.undo(force)),
                OnForce::Hysteresis(table) => Some(table.undo(force, &mut memory.hysteresis)),
                OnForce::FingertipMass(table) => table.undo(force, around),
                OnForce::Map(tables) => map_force(tables, force, warmer, around),
            };
            match found {
                Some(left) => force = left,
                None => lacking = true,
            }
        }
        Undone {
            left: force,
            lacking,
        }
    }
}

fn map_field(
    tables: &[map::Table; 3],
    field: [Field; 3],
    warmer: i32,
    around: &Surroundings,
) -> Option<[Field; 3]> {
    let [x, y, z] = tables;
    let [bx, by, bz] = field;
    let less = |table: &map::Table, from: Field| {
        Some(Field(from.0.saturating_sub(table.value(warmer, around)?)))
    };
    Some([less(x, bx)?, less(y, by)?, less(z, bz)?])
}

fn map_force(
    tables: &[map::Table; 2],
    force: [Force; 2],
    warmer: i32,
    around: &Surroundings,
) -> Option<[Force; 2]> {
    let [x, z] = tables;
    let [fx, fz] = force;
    let less = |table: &map::Table, from: Force| {
        Some(Force(from.0.saturating_sub(table.value(warmer, around)?)))
    };
    Some([less(x, fx)?, less(z, fz)?])
}

/// A component of the field, less `by`.
pub(crate) fn less(field: Field, by: i32) -> Field {
    Field(field.0.saturating_sub(by))
}
