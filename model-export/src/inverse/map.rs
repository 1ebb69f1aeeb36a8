//! A user's own effect as a table over the covariates that the board knows.

use firmware::compensate::map::{Covariate, Side, Table};
use firmware::compensate::temperature;
use firmware::params;
use firmware::units::Force;
use nalgebra::Vector3;

use super::compensation::{NotUndone, Sensor};
use crate::effects::{Expression, REFERENCE_C, Stage};

/// Knots of a line, and along each side of a surface.
const KNOTS: [u16; 2] = [257, 33];
/// Bytes of flash that are spent on a table of no effect.
const NOTHING: OwnedMap = OwnedMap {
    sides: [None; 2],
    values: Vec::new(),
};

/// A table, owned.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedMap {
    sides: [Option<Side>; 2],
    values: Vec<i32>,
}

impl OwnedMap {
    /// As the device sees it.
    pub fn view(&self) -> Table<'_> {
        Table {
            sides: self.sides,
            values: &self.values,
        }
    }
}

/// What a formula changes.
pub(super) enum Maps {
    /// The field, each axis of the sensor.
    Field([OwnedMap; 3]),
    /// The forces, or displacements as forces.
    Force([OwnedMap; 2]),
}

/// A covariate of a formula on the device: its range there, and its unit.
struct Known {
    covariate: Covariate,
    from: f64,
    to: f64,
    /// Device's units in one of the formula's, and the formula's value at the device's zero.
    per_unit: f64,
    zero: f64,
}

impl Sensor<'_> {
    pub(super) fn map(&self, formula: &Expression, values: &[f64]) -> Result<Maps, NotUndone> {
        let name = formula.name.as_str();
        let known: Vec<Known> = formula
            .covariates
            .iter()
            .map(|column| {
                known(column)
                    .ok_or_else(|| self.refuse(name, format!("the board does not know {column}")))
            })
            .collect::<Result<_, _>>()?;
        self.check_turns(formula, values)?;
        let table = |scale: f64| self.table(formula, values, &known, scale);
        let (_, axis) = formula.value(values, &vec![0.0; known.len()]);
        let per_force = Force::PER_NEWTON;
        Ok(match (formula.stage(), axis) {
            (Stage::Load, 0) => Maps::Force([table(per_force)?, NOTHING]),
            (Stage::Load, _) => Maps::Force([NOTHING, table(per_force)?]),
            // The flexure would need a force to be where the effect puts it.
            (Stage::Displacement, 0) => {
                Maps::Force([table(1e-3 * self.stiffness(0) * per_force)?, NOTHING])
            }
            (Stage::Displacement, 2) => {
                Maps::Force([NOTHING, table(1e-3 * self.stiffness(1) * per_force)?])
            }
            (Stage::Displacement, _) => {
                // With the answer at rest: small displacements, and it varies by a fifth over the box.
                let answer = self.at_rest.per_mm([0.0; 2]).column(1) * (1e-3 * self.units);
                Maps::Field([table(answer.x)?, table(answer.y)?, table(answer.z)?])
            }
            (_, axis) => {
                let mut along = Vector3::zeros();
                along[axis] = self.units;
                let seen = self.at_rest.model.frames().element * along;
                Maps::Field([table(seen.x)?, table(seen.y)?, table(seen.z)?])
            }
        })
    }

    fn stiffness(&self, axis: usize) -> f64 {
        self.at_rest.model.stiffness_n_per_mm[axis]
    }

    /// The board knows the rotor within a turn: a formula must not tell one turn from the next.
    fn check_turns(&self, formula: &Expression, values: &[f64]) -> Result<(), NotUndone> {
        let Some(i) = formula
            .covariates
            .iter()
            .position(|column| column == "motor_angle_rad")
        else {
            return Ok(());
        };
        let at = |angle: f64| {
            let mut covariates = vec![1.0; formula.covariates.len()];
            covariates[i] = angle;
            formula.value(values, &covariates).0
        };
        let differs = |angle: f64| {
            let (one, next) = (at(angle), at(angle + std::f64::consts::TAU));
            (one - next).abs() > 1e-6 * one.abs().max(1e-9)
        };
        match [0.3, 1.7, 4.1].into_iter().any(differs) {
            true => Err(self.refuse(&formula.name, "the board knows motor_angle_rad within a turn only, and the formula tells turns apart")),
            false => Ok(()),
        }
    }

    fn table(
        &self,
        formula: &Expression,
        values: &[f64],
        known: &[Known],
        scale: f64,
    ) -> Result<OwnedMap, NotUndone> {
        let [line, surface] = KNOTS;
        let (knots, rows) =
            match known.len() {
                1 => (line, 1),
                2 => (surface, surface),
                0 => {
                    return Err(self.refuse(
                        &formula.name,
                        "a constant is part of the base: refit without it",
                    ));
                }
                _ => return Err(self.refuse(
                    &formula.name,
                    "it depends on more than two covariates, and the device holds tables of two",
                )),
            };
        let mut sides = [None; 2];
        for (side, known) in sides.iter_mut().zip(known) {
            let step = ((known.to - known.from) * known.per_unit / f64::from(knots - 1)).round();
            *side = Some(Side {
                covariate: known.covariate,
                from: ((known.from - known.zero) * known.per_unit).round() as i32,
                step: step as i32,
                knots,
            });
        }
        let at = |known: &Known, i: u16| {
            known.from + (known.to - known.from) * f64::from(i) / f64::from(knots - 1)
        };
        let mut table = Vec::new();
        for row in 0..rows {
            for column in 0..knots {
                let covariates: Vec<f64> = known
                    .iter()
                    .zip([column, row])
                    .map(|(known, i)| at(known, i))
                    .collect();
                let value = formula.value(values, &covariates).0 * scale;
                let value = if value.is_finite() { value } else { 0.0 };
                table.push(self.integer(&formula.name, value, 0)?);
            }
        }
        Ok(OwnedMap {
            sides,
            values: table,
        })
    }
}

/// What the device knows of a column, over the range that its table covers.
fn known(column: &str) -> Option<Known> {
    let plain = |covariate, from, to, per_unit| {
        Some(Known {
            covariate,
            from,
            to,
            per_unit,
            zero: 0.0,
        })
    };
    match column {
        "opening_mm" => plain(Covariate::Opening, 0.0, 64.0, 1e3),
        "motor_iq_a" => plain(Covariate::MotorIq, -32.0, 32.0, 1e3),
        "motor_angle_rad" => plain(Covariate::MotorAngle, 0.0, std::f64::consts::TAU, 1e6),
        "accel_x_mps2" => plain(Covariate::Acceleration(0), -40.0, 40.0, 1e3),
        "accel_y_mps2" => plain(Covariate::Acceleration(1), -40.0, 40.0, 1e3),
        "accel_z_mps2" => plain(Covariate::Acceleration(2), -40.0, 40.0, 1e3),
        "temp_c" => Some(Known {
            covariate: Covariate::Temperature,
            from: -10.0,
            to: 90.0,
            per_unit: params::TEMPERATURE_SCALE.value * f64::from(1 << temperature::BITS),
            zero: REFERENCE_C,
        }),
        _ => None,
    }
}
