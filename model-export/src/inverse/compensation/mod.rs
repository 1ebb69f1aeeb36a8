//! Effects that the device compensates outside of the inverse, in its formats.

mod effect_tables;
mod lookup_table;

use firmware::config::constants;
use firmware::estimator::compensation::{
    Compensation, FieldEffect, ForceEffect, MAX_EFFECTS, crosstalk,
};
use firmware::fixed_point::{Field, Force};
use nalgebra::{Matrix3, Vector3};

use crate::effects::{Compensated, EffectTerm};
use crate::inverse::compensation::lookup_table::OwnedMap;
use crate::inverse::static_model::StaticModel;

/// An effect that the device cannot compensate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{effect} of sensor {sensor} cannot be compensated on the device: {why}")]
pub struct NotCompensable {
    /// Name of the effect.
    pub effect: String,
    /// The sensor.
    pub sensor: u32,
    /// Reason and remedy.
    pub why: String,
}

/// Owned compensation of one sensor.
#[derive(Clone, Debug, Default)]
pub struct OwnedCompensation {
    number: u8,
    field: Vec<OwnedOnField>,
    force: Vec<OwnedOnForce>,
}

#[derive(Clone, Debug)]
enum OwnedOnField {
    Scalar(FieldEffect<'static>),
    Neighbour(Box<[[i16; 3]; crosstalk::KNOTS]>),
    Map([OwnedMap; 3]),
}

#[derive(Clone, Debug)]
enum OwnedOnForce {
    Scalar(ForceEffect<'static>),
    Map([OwnedMap; 2]),
}

/// Converts the effects of one sensor into the device's formats.
pub(super) struct Converter<'a> {
    pub(super) number: u32,
    pub(super) model: &'a StaticModel,
    /// Field units per gauss.
    pub(super) units: f64,
}

impl OwnedCompensation {
    /// Builds the compensation of one sensor; `None` without compensated effects.
    pub fn build(
        number: u32,
        model: &StaticModel,
        effects: &[(EffectTerm, Vec<f64>)],
        gauss_per_lsb: f64,
    ) -> Result<Option<Self>, NotCompensable> {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let sensor = Converter { number, model, units };
        let mut own = Self { number: number as u8, ..Self::default() };
        let mut sorted: Vec<&(EffectTerm, Vec<f64>)> = effects.iter().collect();
        // In reverse order of the measuring chain.
        sorted.sort_by_key(|(effect, _)| std::cmp::Reverse(effect.stage()));
        for (effect, values) in sorted {
            match effect {
                EffectTerm::Catalogue(known) if known.compensated == Compensated::Compensation => {
                    sensor.add(&mut own, known.id, values)?;
                }
                // A polynomial, the only base with channel-wise effects, has no inverse.
                EffectTerm::Catalogue(_) | EffectTerm::Channelwise(_) => {}
                EffectTerm::Expression(formula) => match sensor.map(formula, values)? {
                    lookup_table::Maps::Field(maps) => own.field.push(OwnedOnField::Map(maps)),
                    lookup_table::Maps::Force(maps) => own.force.push(OwnedOnForce::Map(maps)),
                },
            }
        }
        let count = own.field.len().max(own.force.len());
        if count > MAX_EFFECTS {
            return Err(sensor.error(
                "the whole",
                format!("{count} effects, and the device supports {MAX_EFFECTS}: remove some"),
            ));
        }
        Ok((count > 0).then_some(own))
    }

    /// Whether one of the effects needs the sensor's temperature.
    pub fn needs_temperature(&self) -> bool {
        self.field.iter().any(|effect| {
            matches!(
                effect,
                OwnedOnField::Scalar(
                    FieldEffect::SensorTemperature(_)
                        | FieldEffect::MagnetTemperature(_)
                        | FieldEffect::ThermalGap(_)
                )
            )
        })
    }

    /// Number of the sensor.
    pub fn number(&self) -> u32 {
        u32::from(self.number)
    }

    /// Friction parallel to the flexures, Fx and Fz in newtons: the deadband without load.
    pub fn friction_n(&self) -> [f64; 2] {
        self.view().friction_deadband().map(Force::newtons)
    }

    /// The device's view.
    pub fn view(&self) -> Compensation<'_> {
        let mut view = Compensation {
            number: self.number,
            field: [None; MAX_EFFECTS],
            force: [None; MAX_EFFECTS],
        };
        for (slot, effect) in view.field.iter_mut().zip(&self.field) {
            *slot = Some(match effect {
                OwnedOnField::Scalar(scalar) => *scalar,
                OwnedOnField::Neighbour(knots) => {
                    FieldEffect::NeighbourMagnet(crosstalk::NeighbourMagnetTable { knots })
                }
                OwnedOnField::Map(maps) => FieldEffect::Map(maps.each_ref().map(OwnedMap::view)),
            });
        }
        for (slot, effect) in view.force.iter_mut().zip(&self.force) {
            *slot = Some(match effect {
                OwnedOnForce::Scalar(scalar) => *scalar,
                OwnedOnForce::Map(maps) => ForceEffect::Map(maps.each_ref().map(OwnedMap::view)),
            });
        }
        view
    }
}

impl Converter<'_> {
    pub(super) fn error(&self, effect: &str, why: impl Into<String>) -> NotCompensable {
        NotCompensable { effect: effect.to_owned(), sensor: self.number, why: why.into() }
    }

    /// Rounds a value to an integer with `bits` fractional bits.
    pub(super) fn integer(
        &self,
        effect: &str,
        value: f64,
        bits: u32,
    ) -> Result<i32, NotCompensable> {
        let scaled = (value * 2.0_f64.powi(bits as i32)).round();
        if scaled.abs() <= f64::from(i32::MAX) {
            Ok(scaled as i32)
        } else {
            Err(self.error(effect, format!("{value:.3e} does not fit the device's format")))
        }
    }

    fn add(
        &self,
        own: &mut OwnedCompensation,
        id: &str,
        values: &[f64],
    ) -> Result<(), NotCompensable> {
        let per_count = 1.0 / constants::TEMPERATURE_SCALE.value;
        let mut field = |effect| own.field.push(OwnedOnField::Scalar(effect));
        let mut force = |effect| own.force.push(OwnedOnForce::Scalar(effect));
        match id {
            "sensor_temperature" => field(self.sensor_temperature(values, per_count)?),
            "motor_leakage" => field(self.motor_leakage(values)?),
            "earth_field" => field(self.earth_field(values)?),
            "magnet_temperature" => field(self.magnet_temperature(values, per_count)?),
            "thermal_gap" => field(self.thermal_gap(values, per_count)?),
            "viscous_lag" => force(self.viscous_lag(values)?),
            "creep" => force(self.creep(values)?),
            "hard_stop" => force(self.hard_stop(values)?),
            "hysteresis" => force(self.hysteresis(values)?),
            "fingertip_mass" => force(self.fingertip_mass(values)?),
            "neighbour_magnet" => {
                let knots = self.neighbour_magnet(values)?;
                own.field.push(OwnedOnField::Neighbour(knots));
            }
            other => {
                return Err(self.error(other, "the device has no compensation for this effect"));
            }
        }
        Ok(())
    }

    fn turn(&self) -> Matrix3<f64> {
        *self.model.model.frames().element.matrix()
    }

    fn three(&self, id: &str, values: Vector3<f64>, bits: u32) -> Result<[i32; 3], NotCompensable> {
        Ok([
            self.integer(id, values.x, bits)?,
            self.integer(id, values.y, bits)?,
            self.integer(id, values.z, bits)?,
        ])
    }

    fn matrix(
        &self,
        id: &str,
        matrix: Matrix3<f64>,
        bits: u32,
    ) -> Result<[[i32; 3]; 3], NotCompensable> {
        let row = |i: usize| self.three(id, matrix.row(i).transpose(), bits);
        Ok([row(0)?, row(1)?, row(2)?])
    }

    pub(super) fn values<const N: usize>(
        &self,
        id: &str,
        values: &[f64],
    ) -> Result<[f64; N], NotCompensable> {
        let found: Option<[f64; N]> = values.try_into().ok();
        found.ok_or_else(|| {
            self.error(id, format!("it has {} parameters and needs {N}", values.len()))
        })
    }
}
