//! Each effect in the device's formats.

use firmware::compensate::{
    OnField, OnForce, creep, earth_field, fingertip_mass, hard_stop, hysteresis,
    magnet_temperature, motor_leakage, neighbour_magnet, sensor_temperature, thermal_gap,
    viscous_lag,
};
use firmware::params;
use firmware::units::Force;
use nalgebra::{Matrix3, Vector3};

use super::{NotUndone, Sensor};
use crate::effects::{creep_parts, hysteresis_sliders, neighbour_field};
use crate::inverse::design_box::lattice;

/// A slider's inverse with less reach than this, in newtons, would follow the noise of a reading.
const LEAST_REACH_N: f64 = 0.8;
/// Least slope of a deflection that is inverted: what stands still altogether tells nothing.
const LEAST_SLOPE: f64 = 0.05;
/// Time constant of each of the two low passes behind a rate, in milliseconds. Short ones let noise
/// through, long ones trail the load. On the simulated bench (10 ms of lag, loads of 200 N at 0.2 to
/// 1.2 Hz) the error was 1.23, 1.15, 1.12 and 1.13 times that without a lag, at 5, 7, 9 and 12 ms.
const RATE_FILTER_MS: f64 = 10.0;

impl Sensor<'_> {
    pub(super) fn sensor_temperature(
        &self,
        values: &[f64],
        per_count: f64,
    ) -> Result<OnField<'static>, NotUndone> {
        let id = "sensor_temperature";
        let [x, y, z, gain] = self.values(id, values)?;
        let offset = Vector3::new(x, y, z) * (self.units * per_count);
        Ok(OnField::SensorTemperature(sensor_temperature::Table {
            offset: self.three(id, offset, sensor_temperature::BITS)?,
            gain: self.integer(id, 0.01 * gain * per_count, sensor_temperature::BITS)?,
        }))
    }

    pub(super) fn motor_leakage(&self, values: &[f64]) -> Result<OnField<'static>, NotUndone> {
        let id = "motor_leakage";
        let values: [f64; 9] = self.values(id, values)?;
        // Columns: the field of each current; the device wants them in the sensor's axes, per mA.
        let per_a = self.turn() * Matrix3::from_column_slice(&values);
        let per_ma = per_a * (1e-3 * self.units);
        Ok(OnField::MotorLeakage(motor_leakage::Table {
            per_ma: self.matrix(id, per_ma, motor_leakage::BITS)?,
        }))
    }

    pub(super) fn earth_field(&self, values: &[f64]) -> Result<OnField<'static>, NotUndone> {
        let id = "earth_field";
        let [x, y, z] = self.values(id, values)?;
        Ok(OnField::EarthField(earth_field::Table {
            world: self.three(id, Vector3::new(x, y, z) * self.units, earth_field::BITS)?,
            element: self.matrix(id, self.turn(), earth_field::BITS)?,
        }))
    }

    pub(super) fn neighbour_magnet(
        &self,
        values: &[f64],
    ) -> Result<Box<[[i16; 3]; neighbour_magnet::KNOTS]>, NotUndone> {
        let at =
            |opening_um: f64| self.turn() * neighbour_field(values, 1e-3 * opening_um) * self.units;
        let step = f64::from(neighbour_magnet::STEP_UM);
        let mut knots = Box::new([[0; 3]; neighbour_magnet::KNOTS]);
        for (i, knot) in knots.iter_mut().enumerate() {
            let opening = step * i as f64;
            let field = at(opening);
            // A straight line between knots lies beside the curve: half of that is taken off both.
            let bow = 0.5 * (at(opening + 0.5 * step) - 0.5 * (field + at(opening + step)));
            let shifted = (field + bow).map(f64::round);
            if shifted.amax() > f64::from(i16::MAX) {
                return Err(self.refuse(
                    "neighbour_magnet",
                    "its field at this opening is beyond what the device can hold",
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
    ) -> Result<OnField<'static>, NotUndone> {
        let id = "magnet_temperature";
        let [percent_per_k] = self.values(id, values)?;
        Ok(OnField::MagnetTemperature(magnet_temperature::Table {
            without: self.three(id, self.at_rest.model.bias_g * self.units, 0)?,
            per_count: self.integer(
                id,
                0.01 * percent_per_k * per_count,
                magnet_temperature::BITS,
            )?,
        }))
    }

    /// The answer to the gap, fitted as a linear function of the field over the design box.
    pub(super) fn thermal_gap(
        &self,
        values: &[f64],
        per_count: f64,
    ) -> Result<OnField<'static>, NotUndone> {
        let id = "thermal_gap";
        let [um_per_k] = self.values(id, values)?;
        let mm_per_count = 1e-3 * um_per_k * per_count;
        let at = self.at_rest.field([0.0; 2]) * self.units;
        let mut normal = nalgebra::Matrix4::<f64>::zeros();
        let mut right = nalgebra::Matrix4x3::<f64>::zeros();
        for force in lattice([self.at_rest.model.force_range_n; 2], 15) {
            let away = self.at_rest.field(force) * self.units - at;
            let regressor = nalgebra::Vector4::new(1.0, away.x, away.y, away.z);
            let answer = self.at_rest.per_mm(force).column(1) * (mm_per_count * self.units);
            normal += regressor * regressor.transpose();
            right += regressor * answer.transpose();
        }
        let fitted = normal.cholesky().map(|factor| factor.solve(&right));
        let fitted = fitted
            .ok_or_else(|| self.refuse(id, "the field hardly moves over the box of forces"))?;
        let bend = fitted.fixed_rows::<3>(1).transpose();
        Ok(OnField::ThermalGap(thermal_gap::Table {
            at: self.three(id, at, 0)?,
            rest: self.three(id, fitted.row(0).transpose(), thermal_gap::BITS)?,
            bend: self.matrix(id, bend, thermal_gap::BITS)?,
        }))
    }

    pub(super) fn viscous_lag(&self, values: &[f64]) -> Result<OnForce<'static>, NotUndone> {
        let id = "viscous_lag";
        let lags: [f64; 2] = self.values(id, values)?;
        let tick_ms = 1e3 / params::SENSE_RATE.value;
        let rate = -libm::expm1(-tick_ms / RATE_FILTER_MS);
        // On a ramp the second filter trails the first by this many milliseconds of it.
        let trail_ms = tick_ms * (1.0 - rate) / rate;
        let lead = |lag: f64| self.integer(id, lag.max(0.0) / trail_ms, viscous_lag::BITS);
        Ok(OnForce::ViscousLag(viscous_lag::Table {
            lead: [lead(lags[0])?, lead(lags[1])?],
            rate: self.integer(id, rate, viscous_lag::BITS)?,
        }))
    }

    pub(super) fn creep(&self, values: &[f64]) -> Result<OnForce<'static>, NotUndone> {
        let id = "creep";
        let _: [f64; 5] = self.values(id, values)?;
        let share = |percent: f64| self.integer(id, 0.01 * percent, creep::BITS);
        let shares = |axis: usize| {
            let [(fast, _), (slow, _)] = creep_parts(values, axis);
            Ok([share(fast)?, share(slow)?])
        };
        let tick_s = 1.0 / params::SENSE_RATE.value;
        let rate = |time_s: f64| self.integer(id, -libm::expm1(-tick_s / time_s), creep::BITS);
        let [(_, fast_s), (_, slow_s)] = creep_parts(values, 0);
        Ok(OnForce::Creep(creep::Table {
            share: [shares(0)?, shares(1)?],
            rate: [rate(fast_s)?, rate(slow_s)?],
        }))
    }

    pub(super) fn hard_stop(&self, values: &[f64]) -> Result<OnForce<'static>, NotUndone> {
        let id = "hard_stop";
        let [x, z, back_x, back_z, knee_x, knee_z] = self.values(id, values)?;
        // All of it lost would leave nothing to measure beyond the knee.
        let beyond = |lost: f64| 1.0 / (1.0 - 0.01 * lost).max(LEAST_SLOPE) - 1.0;
        let integers = |one: f64, other: f64, bits: u32| {
            Ok([self.integer(id, one, bits)?, self.integer(id, other, bits)?])
        };
        Ok(OnForce::HardStop(hard_stop::Table {
            knee: integers(knee_x, knee_z, Force::BITS)?,
            beyond: [
                integers(beyond(x), beyond(back_x), hard_stop::BITS)?,
                integers(beyond(z), beyond(back_z), hard_stop::BITS)?,
            ],
        }))
    }

    pub(super) fn hysteresis(&self, values: &[f64]) -> Result<OnForce<'static>, NotUndone> {
        let axis = |axis: usize| -> Result<[hysteresis::Slider; hysteresis::SLIDERS], NotUndone> {
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
        Ok(OnForce::Hysteresis(hysteresis::Table {
            sliders: [axis(0)?, axis(1)?],
        }))
    }

    pub(super) fn fingertip_mass(&self, values: &[f64]) -> Result<OnForce<'static>, NotUndone> {
        let id = "fingertip_mass";
        let [mass_kg] = self.values(id, values)?;
        let mass = self.integer(id, 1e-3 * mass_kg * Force::PER_NEWTON, fingertip_mass::BITS)?;
        Ok(OnForce::FingertipMass(fingertip_mass::Table { mass }))
    }
}

/// Reach and force in newtons of each slider of the inverse: the deflection of a loop's first branch
/// is piecewise straight in the force, and the inverse follows its mirror image (Krejci and Kuhnen
/// 2001).
fn inverse_sliders(friction_n: f64, mut sliders: [(f64, f64); 3]) -> [(f64, f64); 3] {
    sliders.sort_by(|a, b| a.1.total_cmp(&b.1));
    let slope = |first: usize| {
        let taken: f64 = sliders[first..]
            .iter()
            .map(|(share, reach)| friction_n * share / reach)
            .sum();
        (1.0 - taken).max(LEAST_SLOPE)
    };
    let (mut shown, mut from) = (0.0, 0.0);
    [0, 1, 2].map(|i| {
        let reach = sliders[i].1;
        shown += slope(i) * (reach - from);
        from = reach;
        let after = if i < 2 { slope(i + 1) } else { 1.0 };
        let force = (1.0 / slope(i) - 1.0 / after) * shown;
        (shown.max(LEAST_REACH_N), force)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_of_a_loop_adds_what_the_loop_took() {
        let sliders = [(0.3, 12.0), (0.4, 40.0), (0.3, 70.0)];
        let inverse = inverse_sliders(8.0, sliders);
        for force in [5.0, 12.0, 30.0, 55.0, 90.0, 200.0] {
            let taken: f64 = sliders
                .iter()
                .map(|(share, reach)| 8.0 * share * (force / reach).min(1.0))
                .sum();
            let shown = force - taken;
            let added: f64 = inverse
                .iter()
                .map(|(reach, n)| n * (shown / reach).min(1.0))
                .sum();
            assert!(
                (shown + added - force).abs() < 1e-9,
                "{force}: {}",
                shown + added
            );
        }
    }
}
