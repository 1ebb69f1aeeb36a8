//! Expression effects as lookup tables over the covariates of the board.

use firmware::compensation::lookup_table::{Covariate, LookupAxis, LookupTable};
use firmware::compensation::thermal;
use firmware::config::constants;
use firmware::fixed_point::Force;
use nalgebra::Vector3;

use crate::effects::{EffectStage, Expression, REFERENCE_C};
use crate::inverse::compensation::{Converter, NotCompensable};

/// Knots of a curve, and along each side of a surface.
const KNOTS: [u16; 2] = [257, 33];
/// Lookup table of no effect.
const EMPTY_MAP: OwnedMap = OwnedMap { sides: [None; 2], values: Vec::new() };

/// Owned lookup table.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedMap {
    sides: [Option<LookupAxis>; 2],
    values: Vec<i32>,
}

impl OwnedMap {
    /// The device's view.
    pub fn view(&self) -> LookupTable<'_> {
        LookupTable { sides: self.sides, values: &self.values }
    }
}

/// Tables of an expression, by the quantity that it changes.
pub(super) enum Maps {
    /// Field, each sensor axis.
    Field([OwnedMap; 3]),
    /// Forces, or displacements converted to forces.
    Force([OwnedMap; 2]),
}

/// Device format of a covariate: range and unit.
struct CovariateFormat {
    covariate: Covariate,
    from: f64,
    to: f64,
    /// Device units per unit of the expression, and the value at the device's zero.
    per_unit: f64,
    zero: f64,
}

impl Converter<'_> {
    pub(super) fn map(&self, formula: &Expression, values: &[f64]) -> Result<Maps, NotCompensable> {
        if formula.changes_sensor() {
            return Err(self.error(
                "the device's tables hold forces, displacements and fields, not gains, rotations or tilts; write it as a field (bx_g, by_g, bz_g)",
            ));
        }
        if formula.has_memory() {
            return Err(
                self.error("the device's tables are functions of the present, without lags and rates of the opening")
            );
        }
        let known: Vec<CovariateFormat> = formula
            .covariates
            .iter()
            .map(|column| {
                known(column).ok_or_else(|| self.error(format!("the board does not know {column}")))
            })
            .collect::<Result<_, _>>()?;
        self.check_turns(formula, values)?;
        let table = |scale: f64| self.table(formula, values, &known, scale);
        let (_, axis) = formula.value(values, &vec![0.0; known.len()]);
        let per_force = Force::PER_NEWTON;
        Ok(match (formula.stage(), axis) {
            (EffectStage::Load, 0) => Maps::Force([table(per_force)?, EMPTY_MAP]),
            (EffectStage::Load, _) => Maps::Force([EMPTY_MAP, table(per_force)?]),
            // A displacement is equivalent to the force of the flexure.
            (EffectStage::Displacement, 0) => {
                Maps::Force([table(1e-3 * self.stiffness(0) * per_force)?, EMPTY_MAP])
            }
            (EffectStage::Displacement, 2) => {
                Maps::Force([EMPTY_MAP, table(1e-3 * self.stiffness(1) * per_force)?])
            }
            (EffectStage::Displacement, _) => {
                // Linearised at rest: displacements are small, and the derivative varies by a fifth over the
                // box.
                let derivative = self.model.per_mm([0.0; 2]).column(1) * (1e-3 * self.units);
                Maps::Field([table(derivative.x)?, table(derivative.y)?, table(derivative.z)?])
            }
            (_, axis) => {
                let mut along = Vector3::zeros();
                along[axis] = self.units;
                let seen = self.model.element() * along;
                Maps::Field([table(seen.x)?, table(seen.y)?, table(seen.z)?])
            }
        })
    }

    fn stiffness(&self, axis: usize) -> f64 {
        self.model.stiffness_n_per_mm()[axis]
    }

    /// The board measures the rotor angle modulo one turn: the expression must be periodic.
    fn check_turns(&self, formula: &Expression, values: &[f64]) -> Result<(), NotCompensable> {
        let Some(i) = formula.covariates.iter().position(|column| column == "motor_angle_rad")
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
        if [0.3, 1.7, 4.1].into_iter().any(differs) {
            Err(self.error("the board measures motor_angle_rad modulo one turn, and the formula is not periodic"))
        } else {
            Ok(())
        }
    }

    fn table(
        &self,
        formula: &Expression,
        values: &[f64],
        known: &[CovariateFormat],
        scale: f64,
    ) -> Result<OwnedMap, NotCompensable> {
        let [line, surface] = KNOTS;
        let (knots, rows) =
            match known.len() {
                1 => (line, 1),
                2 => (surface, surface),
                0 => {
                    return Err(self.error("a constant is part of the base: refit without it"));
                }
                _ => return Err(self.error(
                    "it depends on more than two covariates, and the device holds tables of two",
                )),
            };
        let mut sides = [None; 2];
        for (side, known) in sides.iter_mut().zip(known) {
            let step = ((known.to - known.from) * known.per_unit / f64::from(knots - 1)).round();
            *side = Some(LookupAxis {
                covariate: known.covariate,
                from: ((known.from - known.zero) * known.per_unit).round() as i32,
                step: step as i32,
                knots,
            });
        }
        let at = |known: &CovariateFormat, i: u16| {
            known.from + (known.to - known.from) * f64::from(i) / f64::from(knots - 1)
        };
        let mut table = Vec::new();
        for row in 0..rows {
            for column in 0..knots {
                let covariates: Vec<f64> =
                    known.iter().zip([column, row]).map(|(known, i)| at(known, i)).collect();
                let value = formula.value(values, &covariates).0 * scale;
                let value = if value.is_finite() { value } else { 0.0 };
                table.push(self.integer(value, 0)?);
            }
        }
        Ok(OwnedMap { sides, values: table })
    }
}

/// Device format of a column, over the range of its table.
fn known(column: &str) -> Option<CovariateFormat> {
    let plain = |covariate, from, to, per_unit| {
        Some(CovariateFormat { covariate, from, to, per_unit, zero: 0.0 })
    };
    match column {
        "opening_mm" => plain(Covariate::Opening, 0.0, 64.0, 1e3),
        "motor_iq_a" => plain(Covariate::MotorIq, -32.0, 32.0, 1e3),
        "motor_angle_rad" => plain(Covariate::MotorAngle, 0.0, std::f64::consts::TAU, 1e6),
        "accel_x_mps2" => plain(Covariate::Acceleration(0), -40.0, 40.0, 1e3),
        "accel_y_mps2" => plain(Covariate::Acceleration(1), -40.0, 40.0, 1e3),
        "accel_z_mps2" => plain(Covariate::Acceleration(2), -40.0, 40.0, 1e3),
        "temp_c" => Some(CovariateFormat {
            covariate: Covariate::Temperature,
            from: -10.0,
            to: 90.0,
            per_unit: constants::TEMPERATURE_SCALE.value
                * f64::from(1 << thermal::TEMPERATURE_BITS),
            zero: REFERENCE_C,
        }),
        _ => None,
    }
}
