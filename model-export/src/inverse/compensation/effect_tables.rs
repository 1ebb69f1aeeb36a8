//! Tables of each device form of the catalogue in the formats of the firmware's compensation.

use firmware::compensation::{FieldEffect, ForceEffect, crosstalk, flexure, hysteresis, thermal};
use firmware::config::constants;
use firmware::fixed_point::Force;
use nalgebra::{Matrix3, Vector3};

use crate::effects::{CreepParts, FieldForm, ForceForm, FrictionSliders};
use crate::inverse::compensation::{Converter, NotCompensable, OwnedOnField, OwnedOnForce};

/// Minimum reach in newtons of an inverse slider: a shorter one would follow noise.
const MIN_REACH_N: f64 = 0.8;
/// Minimum slope of an invertible deflection.
const MIN_SLOPE: f64 = 0.05;
/// Time constant in milliseconds of each of the two low passes of the force rate. Short ones pass noise, long
/// ones trail the load. In simulation (10 ms of lag, loads of 200 N at 0.2 to 1.2 Hz) the error was 1.23, 1.15,
/// 1.12 and 1.13 times that without a lag, at 5, 7, 9 and 12 ms.
pub(super) const RATE_FILTER_MS: f64 = 10.0;

/// Temperature rise in kelvin per count of the Hall sensor.
const PER_COUNT: f64 = 1.0 / constants::TEMPERATURE_SCALE.value;

/// A linear function of the field: value at the unloaded field `at_g`, and change per gauss of difference from it.
pub(super) struct LinearInField {
    pub(super) at_g: Vector3<f64>,
    pub(super) rest_g: Vector3<f64>,
    pub(super) bend: Matrix3<f64>,
}

impl Converter<'_> {
    /// Compensation of the field.
    pub(super) fn field(
        &self,
        form: FieldForm,
        values: &[f64],
    ) -> Result<OwnedOnField, NotCompensable> {
        Ok(OwnedOnField::Scalar(match form {
            FieldForm::SensorTemperature => self.sensor_temperature(values)?,
            FieldForm::MotorLeakage => self.motor_leakage(values)?,
            FieldForm::EarthField => self.earth_field(values)?,
            FieldForm::NeighbourMagnet(field) => {
                let knots = self.neighbour_magnet(|opening_mm| field(values, opening_mm))?;
                return Ok(OwnedOnField::Neighbour(knots));
            }
            FieldForm::MagnetTemperature => self.magnet_temperature(values)?,
            FieldForm::ThermalGap => self.thermal_gap(values)?,
        }))
    }

    /// Compensation of the forces.
    pub(super) fn force(
        &self,
        form: ForceForm,
        values: &[f64],
    ) -> Result<OwnedOnForce, NotCompensable> {
        Ok(OwnedOnForce::Scalar(match form {
            ForceForm::ViscousLag => self.viscous_lag(values)?,
            ForceForm::Creep(parts) => self.creep([0, 1].map(|axis| parts(values, axis)))?,
            ForceForm::HardStop => self.hard_stop(values)?,
            ForceForm::Hysteresis(sliders) => {
                self.hysteresis([0, 1].map(|axis| sliders(values, axis)))?
            }
            ForceForm::FingertipMass => self.fingertip_mass(values)?,
        }))
    }

    fn sensor_temperature(&self, values: &[f64]) -> Result<FieldEffect<'static>, NotCompensable> {
        let [x, y, z, gain] = self.values(values)?;
        let offset = Vector3::new(x, y, z) * (self.units * PER_COUNT);
        Ok(FieldEffect::SensorTemperature(thermal::SensorTemperatureTable {
            offset: self.three(offset, thermal::DRIFT_BITS)?,
            gain: self.integer(0.01 * gain * PER_COUNT, thermal::DRIFT_BITS)?,
        }))
    }

    fn motor_leakage(&self, values: &[f64]) -> Result<FieldEffect<'static>, NotCompensable> {
        let values: [f64; 9] = self.values(values)?;
        // Columns: field per current; the device needs sensor axes, per mA.
        let per_a = self.turn() * Matrix3::from_column_slice(&values);
        let per_ma = per_a * (1e-3 * self.units);
        Ok(FieldEffect::MotorLeakage(crosstalk::MotorLeakageTable {
            per_ma: self.matrix(per_ma, crosstalk::LEAKAGE_BITS)?,
        }))
    }

    fn earth_field(&self, values: &[f64]) -> Result<FieldEffect<'static>, NotCompensable> {
        let [x, y, z] = self.values(values)?;
        Ok(FieldEffect::EarthField(crosstalk::EarthFieldTable {
            world: self.three(Vector3::new(x, y, z) * self.units, crosstalk::EARTH_FIELD_BITS)?,
            element: self.matrix(self.turn(), crosstalk::EARTH_FIELD_BITS)?,
        }))
    }

    fn neighbour_magnet(
        &self,
        field: impl Fn(f64) -> Vector3<f64>,
    ) -> Result<Box<[[i32; 3]; crosstalk::KNOTS]>, NotCompensable> {
        let at = |opening_um: f64| self.turn() * field(1e-3 * opening_um) * self.units;
        let step = f64::from(crosstalk::STEP_UM);
        let mut knots = Box::new([[0; 3]; crosstalk::KNOTS]);
        for (i, knot) in knots.iter_mut().enumerate() {
            let opening = step * i as f64;
            let field = at(opening);
            // Half of the error of linear interpolation is added to both knots.
            let bow = 0.5 * (at(opening + 0.5 * step) - 0.5 * (field + at(opening + step)));
            *knot = self.three(field + bow, 0)?;
        }
        Ok(knots)
    }

    fn magnet_temperature(&self, values: &[f64]) -> Result<FieldEffect<'static>, NotCompensable> {
        let [percent_per_k] = self.values(values)?;
        Ok(FieldEffect::MagnetTemperature(thermal::MagnetTemperatureTable {
            without: self.three(self.model.bias_g() * self.units, 0)?,
            per_count: self.integer(0.01 * percent_per_k * PER_COUNT, thermal::REMANENCE_BITS)?,
        }))
    }

    /// A function of the forces in gauss, fitted as a linear function of the field over the design box.
    pub(super) fn linear_in_field(
        &self,
        function_g: &dyn Fn([f64; 2]) -> Vector3<f64>,
    ) -> Result<LinearInField, NotCompensable> {
        let at_g = self.model.field([0.0; 2]);
        let mut normal = nalgebra::Matrix4::<f64>::zeros();
        let mut right = nalgebra::Matrix4x3::<f64>::zeros();
        for force in self.model.region().lattice(15) {
            let away = (self.model.field(force) - at_g) * self.units;
            let regressor = nalgebra::Vector4::new(1.0, away.x, away.y, away.z);
            normal += regressor * regressor.transpose();
            right += regressor * (function_g(force) * self.units).transpose();
        }
        let fitted = normal.cholesky().map(|factor| factor.solve(&right));
        let fitted =
            fitted.ok_or_else(|| self.error("the field hardly changes over the force range"))?;
        Ok(LinearInField {
            at_g,
            rest_g: fitted.row(0).transpose() / self.units,
            bend: fitted.fixed_rows::<3>(1).transpose(),
        })
    }

    /// The derivative to the gap.
    fn thermal_gap(&self, values: &[f64]) -> Result<FieldEffect<'static>, NotCompensable> {
        let [um_per_k] = self.values(values)?;
        let mm_per_count = 1e-3 * um_per_k * PER_COUNT;
        let derivative = self.linear_in_field(&|force_n| {
            self.model.response(force_n).per_mm.column(1) * mm_per_count
        })?;
        Ok(FieldEffect::ThermalGap(thermal::ThermalGapTable {
            at: self.three(derivative.at_g * self.units, 0)?,
            rest: self.three(derivative.rest_g * self.units, thermal::GAP_BITS)?,
            bend: self.matrix(derivative.bend, thermal::GAP_BITS)?,
        }))
    }

    fn viscous_lag(&self, values: &[f64]) -> Result<ForceEffect<'static>, NotCompensable> {
        let lags: [f64; 2] = self.values(values)?;
        let tick_ms = 1e3 / constants::SENSE_RATE.value;
        let rate = -libm::expm1(-tick_ms / RATE_FILTER_MS);
        // On a ramp the second filter trails the first by this time.
        let trail_ms = tick_ms * (1.0 - rate) / rate;
        let lead = |lag: f64| self.integer(lag.max(0.0) / trail_ms, flexure::LAG_BITS);
        Ok(ForceEffect::ViscousLag(flexure::ViscousLagTable {
            lead: [lead(lags[0])?, lead(lags[1])?],
            rate: self.integer(rate, flexure::LAG_BITS)?,
        }))
    }

    fn creep(&self, parts: [CreepParts; 2]) -> Result<ForceEffect<'static>, NotCompensable> {
        let share = |percent: f64| self.integer(0.01 * percent, flexure::CREEP_BITS);
        let shares = |[(fast, _), (slow, _)]: CreepParts| Ok([share(fast)?, share(slow)?]);
        let tick_s = 1.0 / constants::SENSE_RATE.value;
        let rate = |time_s: f64| self.integer(-libm::expm1(-tick_s / time_s), flexure::CREEP_BITS);
        let [(_, fast_s), (_, slow_s)] = parts[0];
        Ok(ForceEffect::Creep(flexure::CreepTable {
            share: [shares(parts[0])?, shares(parts[1])?],
            rate: [rate(fast_s)?, rate(slow_s)?],
        }))
    }

    fn hard_stop(&self, values: &[f64]) -> Result<ForceEffect<'static>, NotCompensable> {
        let [x, z, back_x, back_z, knee_x, knee_z] = self.values(values)?;
        // A total loss would leave no signal beyond the knee.
        let beyond = |lost: f64| 1.0 / (1.0 - 0.01 * lost).max(MIN_SLOPE) - 1.0;
        let integers = |one: f64, other: f64, bits: u32| {
            Ok([self.integer(one, bits)?, self.integer(other, bits)?])
        };
        Ok(ForceEffect::HardStop(flexure::HardStopTable {
            knee: integers(knee_x, knee_z, Force::BITS)?,
            beyond: [
                integers(beyond(x), beyond(back_x), flexure::HARD_STOP_BITS)?,
                integers(beyond(z), beyond(back_z), flexure::HARD_STOP_BITS)?,
            ],
        }))
    }

    fn hysteresis(
        &self,
        axes: [FrictionSliders; 2],
    ) -> Result<ForceEffect<'static>, NotCompensable> {
        let slider = |(reach_n, force_n): (f64, f64)| {
            Ok(hysteresis::Slider {
                reach: self.integer(reach_n, Force::BITS)?,
                share: self.integer(force_n / reach_n, hysteresis::BITS)?,
            })
        };
        let axis = |(friction_n, sliders): FrictionSliders| {
            let [a, b, c] = inverse_sliders(friction_n, sliders);
            Ok([slider(a)?, slider(b)?, slider(c)?])
        };
        let sliders = [axis(axes[0])?, axis(axes[1])?];
        Ok(ForceEffect::Hysteresis(hysteresis::HysteresisTable { sliders }))
    }

    fn fingertip_mass(&self, values: &[f64]) -> Result<ForceEffect<'static>, NotCompensable> {
        let [mass_kg] = self.values(values)?;
        let mass = self.integer(1e-3 * mass_kg * Force::PER_NEWTON, flexure::MASS_BITS)?;
        Ok(ForceEffect::FingertipMass(flexure::FingertipMassTable { mass }))
    }
}

/// Reach and force in newtons of each slider of the inverse: the initial loading curve is piecewise linear in
/// the force, and the inverse is its mirror image (Krejci and Kuhnen 2001).
fn inverse_sliders(friction_n: f64, mut sliders: [(f64, f64); 3]) -> [(f64, f64); 3] {
    sliders.sort_by(|a, b| a.1.total_cmp(&b.1));
    let slope = |first: usize| {
        let taken: f64 =
            sliders[first..].iter().map(|(share, reach)| friction_n * share / reach).sum();
        (1.0 - taken).max(MIN_SLOPE)
    };
    let (mut deflected, mut from) = (0.0, 0.0);
    [0, 1, 2].map(|i| {
        let reach = sliders[i].1;
        deflected += slope(i) * (reach - from);
        from = reach;
        let after = if i < 2 { slope(i + 1) } else { 1.0 };
        let force = (1.0 / slope(i) - 1.0 / after) * deflected;
        (deflected.max(MIN_REACH_N), force)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_hysteresis_restores_the_force() {
        let sliders = [(0.3, 12.0), (0.4, 40.0), (0.3, 70.0)];
        let inverse = inverse_sliders(8.0, sliders);
        for force in [5.0, 12.0, 30.0, 55.0, 90.0, 200.0] {
            let taken: f64 =
                sliders.iter().map(|(share, reach)| 8.0 * share * (force / reach).min(1.0)).sum();
            let deflected = force - taken;
            let added: f64 =
                inverse.iter().map(|(reach, n)| n * (deflected / reach).min(1.0)).sum();
            assert!((deflected + added - force).abs() < 1e-9, "{force}: {}", deflected + added);
        }
    }
}
