//! Tables of each catalogue effect in the device's formats; each mirrors a file of the firmware's compensation.

use firmware::config::constants;
use firmware::estimator::compensation::{
    FieldEffect, ForceEffect, crosstalk, flexure, hysteresis, thermal,
};
use firmware::fixed_point::Force;
use nalgebra::{Matrix3, Vector3};

use crate::effects::{creep_parts, hysteresis_sliders, neighbour_field};
use crate::inverse::compensation::{Converter, NotCompensable};
use crate::inverse::static_model::lattice;

/// Minimum reach in newtons of an inverse slider: a shorter one would follow noise.
const MIN_REACH_N: f64 = 0.8;
/// Minimum slope of an invertible deflection.
const MIN_SLOPE: f64 = 0.05;
/// Time constant in milliseconds of each of the two low passes of the force rate. Short ones pass noise, long
/// ones trail the load. In simulation (10 ms of lag, loads of 200 N at 0.2 to 1.2 Hz) the error was 1.23, 1.15,
/// 1.12 and 1.13 times that without a lag, at 5, 7, 9 and 12 ms.
const RATE_FILTER_MS: f64 = 10.0;

impl Converter<'_> {
    pub(super) fn sensor_temperature(
        &self,
        values: &[f64],
        per_count: f64,
    ) -> Result<FieldEffect<'static>, NotCompensable> {
        let id = "sensor_temperature";
        let [x, y, z, gain] = self.values(id, values)?;
        let offset = Vector3::new(x, y, z) * (self.units * per_count);
        Ok(FieldEffect::SensorTemperature(thermal::SensorTemperatureTable {
            offset: self.three(id, offset, thermal::DRIFT_BITS)?,
            gain: self.integer(id, 0.01 * gain * per_count, thermal::DRIFT_BITS)?,
        }))
    }

    pub(super) fn motor_leakage(
        &self,
        values: &[f64],
    ) -> Result<FieldEffect<'static>, NotCompensable> {
        let id = "motor_leakage";
        let values: [f64; 9] = self.values(id, values)?;
        // Columns: field per current; the device needs sensor axes, per mA.
        let per_a = self.turn() * Matrix3::from_column_slice(&values);
        let per_ma = per_a * (1e-3 * self.units);
        Ok(FieldEffect::MotorLeakage(crosstalk::MotorLeakageTable {
            per_ma: self.matrix(id, per_ma, crosstalk::LEAKAGE_BITS)?,
        }))
    }

    pub(super) fn earth_field(
        &self,
        values: &[f64],
    ) -> Result<FieldEffect<'static>, NotCompensable> {
        let id = "earth_field";
        let [x, y, z] = self.values(id, values)?;
        Ok(FieldEffect::EarthField(crosstalk::EarthFieldTable {
            world: self.three(
                id,
                Vector3::new(x, y, z) * self.units,
                crosstalk::EARTH_FIELD_BITS,
            )?,
            element: self.matrix(id, self.turn(), crosstalk::EARTH_FIELD_BITS)?,
        }))
    }

    pub(super) fn neighbour_magnet(
        &self,
        values: &[f64],
    ) -> Result<Box<[[i16; 3]; crosstalk::KNOTS]>, NotCompensable> {
        let at =
            |opening_um: f64| self.turn() * neighbour_field(values, 1e-3 * opening_um) * self.units;
        let step = f64::from(crosstalk::STEP_UM);
        let mut knots = Box::new([[0; 3]; crosstalk::KNOTS]);
        for (i, knot) in knots.iter_mut().enumerate() {
            let opening = step * i as f64;
            let field = at(opening);
            // Half of the error of linear interpolation is added to both knots.
            let bow = 0.5 * (at(opening + 0.5 * step) - 0.5 * (field + at(opening + step)));
            let shifted = (field + bow).map(f64::round);
            if shifted.amax() > f64::from(i16::MAX) {
                return Err(self.error(
                    "neighbour_magnet",
                    "its field at this opening exceeds the range of the device",
                ));
            }
            *knot = [shifted.x as i16, shifted.y as i16, shifted.z as i16];
        }
        Ok(knots)
    }

    pub(super) fn magnet_temperature(
        &self,
        values: &[f64],
        per_count: f64,
    ) -> Result<FieldEffect<'static>, NotCompensable> {
        let id = "magnet_temperature";
        let [percent_per_k] = self.values(id, values)?;
        Ok(FieldEffect::MagnetTemperature(thermal::MagnetTemperatureTable {
            without: self.three(id, self.model.model.bias_g * self.units, 0)?,
            per_count: self.integer(
                id,
                0.01 * percent_per_k * per_count,
                thermal::REMANENCE_BITS,
            )?,
        }))
    }

    /// Derivative to the gap, fitted as a linear function of the field over the design box.
    pub(super) fn thermal_gap(
        &self,
        values: &[f64],
        per_count: f64,
    ) -> Result<FieldEffect<'static>, NotCompensable> {
        let id = "thermal_gap";
        let [um_per_k] = self.values(id, values)?;
        let mm_per_count = 1e-3 * um_per_k * per_count;
        let at = self.model.field([0.0; 2]) * self.units;
        let mut normal = nalgebra::Matrix4::<f64>::zeros();
        let mut right = nalgebra::Matrix4x3::<f64>::zeros();
        for force in lattice([self.model.model.force_range_n; 2], 15) {
            let away = self.model.field(force) * self.units - at;
            let regressor = nalgebra::Vector4::new(1.0, away.x, away.y, away.z);
            let derivative = self.model.per_mm(force).column(1) * (mm_per_count * self.units);
            normal += regressor * regressor.transpose();
            right += regressor * derivative.transpose();
        }
        let fitted = normal.cholesky().map(|factor| factor.solve(&right));
        let fitted = fitted
            .ok_or_else(|| self.error(id, "the field hardly changes over the force range"))?;
        let bend = fitted.fixed_rows::<3>(1).transpose();
        Ok(FieldEffect::ThermalGap(thermal::ThermalGapTable {
            at: self.three(id, at, 0)?,
            rest: self.three(id, fitted.row(0).transpose(), thermal::GAP_BITS)?,
            bend: self.matrix(id, bend, thermal::GAP_BITS)?,
        }))
    }

    pub(super) fn viscous_lag(
        &self,
        values: &[f64],
    ) -> Result<ForceEffect<'static>, NotCompensable> {
        let id = "viscous_lag";
        let lags: [f64; 2] = self.values(id, values)?;
        let tick_ms = 1e3 / constants::SENSE_RATE.value;
        let rate = -libm::expm1(-tick_ms / RATE_FILTER_MS);
        // On a ramp the second filter trails the first by this time.
        let trail_ms = tick_ms * (1.0 - rate) / rate;
        let lead = |lag: f64| self.integer(id, lag.max(0.0) / trail_ms, flexure::LAG_BITS);
        Ok(ForceEffect::ViscousLag(flexure::ViscousLagTable {
            lead: [lead(lags[0])?, lead(lags[1])?],
            rate: self.integer(id, rate, flexure::LAG_BITS)?,
        }))
    }

    pub(super) fn creep(&self, values: &[f64]) -> Result<ForceEffect<'static>, NotCompensable> {
        let id = "creep";
        let _: [f64; 5] = self.values(id, values)?;
        let share = |percent: f64| self.integer(id, 0.01 * percent, flexure::CREEP_BITS);
        let shares = |axis: usize| {
            let [(fast, _), (slow, _)] = creep_parts(values, axis);
            Ok([share(fast)?, share(slow)?])
        };
        let tick_s = 1.0 / constants::SENSE_RATE.value;
        let rate =
            |time_s: f64| self.integer(id, -libm::expm1(-tick_s / time_s), flexure::CREEP_BITS);
        let [(_, fast_s), (_, slow_s)] = creep_parts(values, 0);
        Ok(ForceEffect::Creep(flexure::CreepTable {
            share: [shares(0)?, shares(1)?],
            rate: [rate(fast_s)?, rate(slow_s)?],
        }))
    }

    pub(super) fn hard_stop(&self, values: &[f64]) -> Result<ForceEffect<'static>, NotCompensable> {
        let id = "hard_stop";
        let [x, z, back_x, back_z, knee_x, knee_z] = self.values(id, values)?;
        // A total loss would leave no signal beyond the knee.
        let beyond = |lost: f64| 1.0 / (1.0 - 0.01 * lost).max(MIN_SLOPE) - 1.0;
        let integers = |one: f64, other: f64, bits: u32| {
            Ok([self.integer(id, one, bits)?, self.integer(id, other, bits)?])
        };
        Ok(ForceEffect::HardStop(flexure::HardStopTable {
            knee: integers(knee_x, knee_z, Force::BITS)?,
            beyond: [
                integers(beyond(x), beyond(back_x), flexure::HARD_STOP_BITS)?,
                integers(beyond(z), beyond(back_z), flexure::HARD_STOP_BITS)?,
            ],
        }))
    }

    pub(super) fn hysteresis(
        &self,
        values: &[f64],
    ) -> Result<ForceEffect<'static>, NotCompensable> {
        let axis =
            |axis: usize| -> Result<[hysteresis::Slider; hysteresis::SLIDERS], NotCompensable> {
                let (friction, sliders) = hysteresis_sliders(values, axis);
                let [a, b, c] = inverse_sliders(friction, sliders);
                let slider = |(reach_n, force_n): (f64, f64)| {
                    Ok(hysteresis::Slider {
                        reach: self.integer("hysteresis", reach_n, Force::BITS)?,
                        share: self.integer("hysteresis", force_n / reach_n, hysteresis::BITS)?,
                    })
                };
                Ok([slider(a)?, slider(b)?, slider(c)?])
            };
        Ok(ForceEffect::Hysteresis(hysteresis::HysteresisTable { sliders: [axis(0)?, axis(1)?] }))
    }

    pub(super) fn fingertip_mass(
        &self,
        values: &[f64],
    ) -> Result<ForceEffect<'static>, NotCompensable> {
        let id = "fingertip_mass";
        let [mass_kg] = self.values(id, values)?;
        let mass = self.integer(id, 1e-3 * mass_kg * Force::PER_NEWTON, flexure::MASS_BITS)?;
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
