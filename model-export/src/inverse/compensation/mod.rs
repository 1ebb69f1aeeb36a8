//! Effects that the device compensates outside of the inverse, in its formats.

mod effect_tables;
pub(super) mod lookup_table;

use firmware::compensation::lookup_table::{CovariateFilter, FILTERS};
use firmware::compensation::{Compensation, FieldEffect, ForceEffect, MAX_EFFECTS, crosstalk};
use firmware::fixed_point::{Field, Force};
use nalgebra::{Matrix2, Matrix3, Vector3};
use serde::Serialize;

use crate::effects::{DeviceForm, EffectTerm};
use crate::inverse::compensation::lookup_table::{OwnedFieldMap, OwnedForceMap, OwnedMap};
use crate::inverse::static_model::StaticModel;

/// An effect that the device cannot compensate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, thiserror::Error)]
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
    needs_temperature: bool,
    filters: Vec<CovariateFilter>,
    field: Vec<OwnedOnField>,
    force: Vec<OwnedOnForce>,
}

#[derive(Clone, Debug)]
enum OwnedOnField {
    Scalar(FieldEffect<'static>),
    Neighbour(Box<[[i32; 3]; crosstalk::KNOTS]>),
    Map(OwnedFieldMap),
}

#[derive(Clone, Debug)]
enum OwnedOnForce {
    Scalar(ForceEffect<'static>),
    Map(OwnedForceMap),
}

/// Converts the effects of one sensor into the device's formats.
pub(super) struct Converter<'a> {
    /// Name of the effect, for messages.
    pub(super) effect: &'a str,
    pub(super) number: u32,
    pub(super) model: &'a StaticModel,
    /// Field units per gauss.
    pub(super) units: f64,
}

/// When the board has a covariate of a recording; `None`: always.
pub(crate) fn board_condition(covariate: &str) -> Option<&'static str> {
    match covariate {
        "opening_mm" => Some("after homing"),
        "motor_iq_a" | "motor_angle_rad" => Some("while the rotor sensor works"),
        "accel_x_mps2" | "accel_y_mps2" | "accel_z_mps2" => {
            Some("with an inertial sensor, or while a host sends attitude and acceleration")
        }
        "roll_rad" | "pitch_rad" => Some("with an inertial sensor, or while a host sends them"),
        "yaw_rad" => Some("while a host sends the yaw"),
        _ => None,
    }
}

/// Conditions under which the board compensates an effect that needs these covariates, each once.
pub fn board_conditions<S: AsRef<str>>(covariates: &[S]) -> Vec<&'static str> {
    let mut conditions = Vec::new();
    for condition in covariates.iter().filter_map(|name| board_condition(name.as_ref())) {
        if !conditions.contains(&condition) {
            conditions.push(condition);
        }
    }
    conditions
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
        let mut own = Self { number: number as u8, ..Self::default() };
        let mut feedback = Matrix2::zeros();
        let mut sorted: Vec<&(EffectTerm, Vec<f64>)> = effects.iter().collect();
        // In reverse order of the measuring chain.
        sorted.sort_by_key(|(effect, _)| std::cmp::Reverse(effect.stage()));
        for (effect, values) in sorted {
            let converter = Converter { effect: effect.name(), number, model, units };
            let compensated = own.field.len() + own.force.len();
            match effect {
                EffectTerm::Catalogue(known) => match known.device {
                    DeviceForm::Field(form) => own.field.push(converter.field(form, values)?),
                    DeviceForm::Force(form) => own.force.push(converter.force(form, values)?),
                    DeviceForm::Tables
                    | DeviceForm::Settled
                    | DeviceForm::Bench { .. }
                    | DeviceForm::Never(_) => {}
                },
                // In the tables of the inverse model.
                EffectTerm::Expression(formula) if formula.depends_on_forces_alone() => {}
                EffectTerm::Expression(formula) => {
                    let converted = converter.formula(formula, values, &mut own.filters)?;
                    match converted.map {
                        OwnedMap::Field(map) => own.field.push(OwnedOnField::Map(map)),
                        OwnedMap::Force(map) => own.force.push(OwnedOnForce::Map(map)),
                    }
                    feedback += converted.feedback;
                    converter.check_feedback(&feedback)?;
                }
            }
            own.needs_temperature |= own.field.len() + own.force.len() > compensated
                && effect.needs().iter().any(|column| column == "temp_c");
        }
        let count = own.field.len().max(own.force.len());
        if count > MAX_EFFECTS {
            let converter = Converter { effect: "the whole", number, model, units };
            return Err(converter.error(format!(
                "{count} effects, and the device supports {MAX_EFFECTS}: remove some"
            )));
        }
        Ok((count > 0).then_some(own))
    }

    /// Whether one of the compensated effects reads the sensor's temperature, as it states by its columns.
    pub fn needs_temperature(&self) -> bool {
        self.needs_temperature
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
        let mut filters = [None; FILTERS];
        filters.iter_mut().zip(&self.filters).for_each(|(slot, filter)| *slot = Some(*filter));
        let mut view = Compensation {
            number: self.number,
            filters,
            field: [None; MAX_EFFECTS],
            force: [None; MAX_EFFECTS],
        };
        for (slot, effect) in view.field.iter_mut().zip(&self.field) {
            *slot = Some(match effect {
                OwnedOnField::Scalar(scalar) => *scalar,
                OwnedOnField::Neighbour(knots) => {
                    FieldEffect::NeighbourMagnet(crosstalk::NeighbourMagnetTable {
                        knots: &knots[..],
                    })
                }
                OwnedOnField::Map(map) => FieldEffect::Map(map.view()),
            });
        }
        for (slot, effect) in view.force.iter_mut().zip(&self.force) {
            *slot = Some(match effect {
                OwnedOnForce::Scalar(scalar) => *scalar,
                OwnedOnForce::Map(map) => ForceEffect::Map(map.view()),
            });
        }
        view
    }
}

impl Converter<'_> {
    pub(super) fn error(&self, why: impl Into<String>) -> NotCompensable {
        NotCompensable { effect: self.effect.to_owned(), sensor: self.number, why: why.into() }
    }

    /// Rounds a value to an integer with `bits` fractional bits.
    pub(super) fn integer(&self, value: f64, bits: u32) -> Result<i32, NotCompensable> {
        let scaled = (value * 2.0_f64.powi(bits as i32)).round();
        if scaled.abs() <= f64::from(i32::MAX) {
            Ok(scaled as i32)
        } else {
            Err(self.error(format!("{value:.3e} does not fit the device's format")))
        }
    }

    fn turn(&self) -> Matrix3<f64> {
        *self.model.element().matrix()
    }

    fn three(&self, values: Vector3<f64>, bits: u32) -> Result<[i32; 3], NotCompensable> {
        Ok([
            self.integer(values.x, bits)?,
            self.integer(values.y, bits)?,
            self.integer(values.z, bits)?,
        ])
    }

    fn matrix(&self, matrix: Matrix3<f64>, bits: u32) -> Result<[[i32; 3]; 3], NotCompensable> {
        let row = |i: usize| self.three(matrix.row(i).transpose(), bits);
        Ok([row(0)?, row(1)?, row(2)?])
    }

    fn values<const N: usize>(&self, values: &[f64]) -> Result<[f64; N], NotCompensable> {
        let found: Option<[f64; N]> = values.try_into().ok();
        found.ok_or_else(|| self.error(format!("it has {} parameters and needs {N}", values.len())))
    }
}
