//! The effects that the device undoes by compensations of their own, in its formats. One function an
//! effect; each mirrors a file in the firmware's `compensate/`.

mod effects;

use firmware::compensate::{Compensation, MOST, OnField, OnForce, neighbour_magnet};
use firmware::params;
use firmware::units::{Field, Force};
use nalgebra::{Matrix3, Vector3};

use super::at_rest::AtRest;
use super::map::OwnedMap;
use crate::effects::{Addition, Undone};

/// An effect that cannot be undone as it stands.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{effect} of sensor {sensor} cannot be undone on the device: {why}")]
pub struct NotUndone {
    /// Its name.
    pub effect: String,
    /// The sensor.
    pub sensor: u32,
    /// Why, and what to do.
    pub why: String,
}

/// The compensation of one sensor, owned.
#[derive(Clone, Debug, Default)]
pub struct OwnedCompensation {
    number: u8,
    field: Vec<OwnedOnField>,
    force: Vec<OwnedOnForce>,
}

#[derive(Clone, Debug)]
enum OwnedOnField {
    Plain(OnField<'static>),
    Neighbour(Box<[[i16; 3]; neighbour_magnet::KNOTS]>),
    Map([OwnedMap; 3]),
}

#[derive(Clone, Debug)]
enum OwnedOnForce {
    Plain(OnForce<'static>),
    Map([OwnedMap; 2]),
}

/// One sensor while its effects are brought into the device's formats.
pub(super) struct Sensor<'a> {
    pub(super) number: u32,
    pub(super) at_rest: &'a AtRest,
    /// Field units in a gauss.
    pub(super) units: f64,
}

impl OwnedCompensation {
    /// What the device undoes at one sensor, and notes on what it does not. `None` where nothing is
    /// undone.
    pub fn build(
        number: u32,
        at_rest: &AtRest,
        effects: &[(Addition, Vec<f64>)],
        gauss_per_lsb: f64,
    ) -> Result<Option<Self>, NotUndone> {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let sensor = Sensor {
            number,
            at_rest,
            units,
        };
        let mut own = Self {
            number: number as u8,
            ..Self::default()
        };
        let mut sorted: Vec<&(Addition, Vec<f64>)> = effects.iter().collect();
        // Backwards through the chain: what came last is taken off first.
        sorted.sort_by_key(|(effect, _)| std::cmp::Reverse(effect.stage()));
        for (effect, values) in sorted {
            match effect {
                Addition::Catalogue(known) if known.undone == Undone::Compensation => {
                    sensor.add(&mut own, known.id, values)?;
                }
                // A polynomial, beside which alone effects act channel by channel, has no inverse.
                Addition::Catalogue(_) | Addition::Channelwise(_) => {}
                Addition::Expression(formula) => match sensor.map(formula, values)? {
                    super::map::Maps::Field(maps) => own.field.push(OwnedOnField::Map(maps)),
                    super::map::Maps::Force(maps) => own.force.push(OwnedOnForce::Map(maps)),
                },
            }
        }
        let most = own.field.len().max(own.force.len());
        if most > MOST {
            return Err(sensor.refuse(
                "the whole",
                format!("{most} effects, and the device has room for {MOST}: drop some"),
            ));
        }
        Ok((most > 0).then_some(own))
    }

    /// True where one of the effects needs the sensor's temperature.
    pub fn needs_temperature(&self) -> bool {
        self.field.iter().any(|effect| {
            matches!(
                effect,
                OwnedOnField::Plain(
                    OnField::SensorTemperature(_)
                        | OnField::MagnetTemperature(_)
                        | OnField::ThermalGap(_)
                )
            )
        })
    }

    /// Number of the sensor.
    pub fn number(&self) -> u32 {
        u32::from(self.number)
    }

    /// Friction beside the flexures, Fx and Fz in newtons: what may be held where nothing pushes.
    pub fn friction_n(&self) -> [f64; 2] {
        self.view().held().map(Force::newtons)
    }

    /// As the device sees it.
    pub fn view(&self) -> Compensation<'_> {
        let mut view = Compensation {
            number: self.number,
            field: [None; MOST],
            force: [None; MOST],
        };
        for (slot, effect) in view.field.iter_mut().zip(&self.field) {
            *slot = Some(match effect {
                OwnedOnField::Plain(plain) => *plain,
                OwnedOnField::Neighbour(knots) => {
                    OnField::NeighbourMagnet(neighbour_magnet::Table { knots })
                }
                OwnedOnField::Map(maps) => OnField::Map(maps.each_ref().map(OwnedMap::view)),
            });
        }
        for (slot, effect) in view.force.iter_mut().zip(&self.force) {
            *slot = Some(match effect {
                OwnedOnForce::Plain(plain) => *plain,
                OwnedOnForce::Map(maps) => OnForce::Map(maps.each_ref().map(OwnedMap::view)),
            });
        }
        view
    }
}

impl Sensor<'_> {
    pub(super) fn refuse(&self, effect: &str, why: impl Into<String>) -> NotUndone {
        NotUndone {
            effect: effect.to_owned(),
            sensor: self.number,
            why: why.into(),
        }
    }

    /// A number in the device's format.
    pub(super) fn integer(&self, effect: &str, value: f64, bits: u32) -> Result<i32, NotUndone> {
        let scaled = (value * 2.0_f64.powi(bits as i32)).round();
        match scaled.abs() <= f64::from(i32::MAX) {
            true => Ok(scaled as i32),
            false => Err(self.refuse(
                effect,
                format!("{value:.3e} does not fit the device's format"),
            )),
        }
    }

    fn add(&self, own: &mut OwnedCompensation, id: &str, values: &[f64]) -> Result<(), NotUndone> {
        let per_count = 1.0 / params::TEMPERATURE_SCALE.value;
        match id {
            "sensor_temperature" => own.field.push(OwnedOnField::Plain(
                self.sensor_temperature(values, per_count)?,
            )),
            "motor_leakage" => own
                .field
                .push(OwnedOnField::Plain(self.motor_leakage(values)?)),
            "earth_field" => own
                .field
                .push(OwnedOnField::Plain(self.earth_field(values)?)),
            "neighbour_magnet" => own
                .field
                .push(OwnedOnField::Neighbour(self.neighbour_magnet(values)?)),
            "magnet_temperature" => own.field.push(OwnedOnField::Plain(
                self.magnet_temperature(values, per_count)?,
            )),
            "thermal_gap" => own
                .field
                .push(OwnedOnField::Plain(self.thermal_gap(values, per_count)?)),
            "viscous_lag" => own
                .force
                .push(OwnedOnForce::Plain(self.viscous_lag(values)?)),
            "creep" => own.force.push(OwnedOnForce::Plain(self.creep(values)?)),
            "hard_stop" => own.force.push(OwnedOnForce::Plain(self.hard_stop(values)?)),
            "hysteresis" => own
                .force
                .push(OwnedOnForce::Plain(self.hysteresis(values)?)),
            "fingertip_mass" => own
                .force
                .push(OwnedOnForce::Plain(self.fingertip_mass(values)?)),
            other => return Err(self.refuse(other, "the device has no compensation of this name")),
        }
        Ok(())
    }

    fn turn(&self) -> Matrix3<f64> {
        *self.at_rest.model.frames().element.matrix()
    }

    fn three(&self, id: &str, values: Vector3<f64>, bits: u32) -> Result<[i32; 3], NotUndone> {
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
    ) -> Result<[[i32; 3]; 3], NotUndone> {
        let row = |i: usize| self.three(id, matrix.row(i).transpose(), bits);
        Ok([row(0)?, row(1)?, row(2)?])
    }

    pub(super) fn values<const N: usize>(
        &self,
        id: &str,
        values: &[f64],
    ) -> Result<[f64; N], NotUndone> {
        let found: Option<[f64; N]> = values.try_into().ok();
        found.ok_or_else(|| {
            self.refuse(
                id,
                format!("it has {} parameters and needs {N}", values.len()),
            )
        })
    }
}
