//! Covariates of an error: the columns of a recording, and quantities derived from them.

use model_export::effects::ExcitationSeries;
use model_export::recordings::Recording;
use model_export::recordings::columns::{Axis, STATOR_CURRENTS, force_column_name};
use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

/// How a covariate is binned and cross-validated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CovariateKind {
    /// A physical quantity, whose effect generalises between recordings.
    Quantity,
    /// A constant of each channel.
    Constant,
    /// Time in a recording. It is confounded with everything slow, so it is selected only if it explains much
    /// more than any quantity.
    Time,
    /// Time in the campaign, or the recording's number: cross-validated within recordings.
    TimeOfCampaign,
}

/// A covariate of the residual.
#[derive(Clone, Debug)]
pub struct Covariate {
    /// Column name, or name of a derived quantity.
    pub name: Cow<'static, str>,
    /// Label in text.
    pub words: Cow<'static, str>,
    /// Unit; empty for a dimensionless number.
    pub unit: &'static str,
    /// How it is binned and cross-validated.
    pub kind: CovariateKind,
}

const fn quantity(name: &'static str, words: &'static str, unit: &'static str) -> Covariate {
    covariate(name, words, unit, CovariateKind::Quantity)
}

const fn covariate(
    name: &'static str,
    words: &'static str,
    unit: &'static str,
    kind: CovariateKind,
) -> Covariate {
    Covariate { name: Cow::Borrowed(name), words: Cow::Borrowed(words), unit, kind }
}

/// Covariates that any gripper may have.
static STANDARD: [Covariate; 24] = [
    quantity("fx_n", "lateral force", "N"),
    quantity("fz_n", "longitudinal force", "N"),
    quantity("force_n", "size of the force", "N"),
    quantity("fx_rate_n_per_s", "rate of the lateral force", "N/s"),
    quantity("fz_rate_n_per_s", "rate of the longitudinal force", "N/s"),
    quantity("loading_x", "direction of lateral loading", ""),
    quantity("loading_z", "direction of longitudinal loading", ""),
    quantity("opening_mm", "opening", "mm"),
    quantity("temp_c", "temperature", "°C"),
    quantity("temp_rate_c_per_min", "rate of the temperature", "°C/min"),
    quantity("motor_iq_a", "motor current", "A"),
    quantity("motor_angle_rad", "rotor angle", "rad"),
    quantity(STATOR_CURRENTS[0], "stator current along alpha", "A"),
    quantity(STATOR_CURRENTS[1], "stator current along beta", "A"),
    quantity("roll_rad", "roll", "rad"),
    quantity("pitch_rad", "pitch", "rad"),
    quantity("yaw_rad", "yaw", "rad"),
    quantity("accel_x_mps2", "acceleration along x", "m/s²"),
    quantity("accel_y_mps2", "acceleration along y", "m/s²"),
    quantity("accel_z_mps2", "acceleration along z", "m/s²"),
    covariate("time_s", "time in the recording", "s", CovariateKind::Time),
    covariate("session_s", "time in the session", "s", CovariateKind::TimeOfCampaign),
    covariate("recording", "recording", "", CovariateKind::TimeOfCampaign),
    covariate("constant", "a constant of each channel", "", CovariateKind::Constant),
];

/// Rates below this fraction of their RMS have no direction of loading.
const DEADBAND: f64 = 0.1;

/// Window of the temperature rate in seconds: longer than the quantisation steps, shorter than the changes.
const TEMPERATURE_RATE_S: f64 = 4.0;

/// Covariates that any gripper may have.
pub fn standard_covariates() -> &'static [Covariate] {
    &STANDARD
}

/// The standard covariates, those that the recording declares, and the forces on other sensors.
pub fn all_covariates(recording: &Recording) -> Vec<Covariate> {
    let is_standard = |name: &str| STANDARD.iter().any(|covariate| covariate.name == name);
    let declared = recording.covariates.keys().filter(|name| !is_standard(name));
    let own = declared.map(|name| Covariate {
        name: Cow::Owned(name.clone()),
        words: Cow::Owned(name.clone()),
        unit: "",
        kind: CovariateKind::Quantity,
    });
    let forces = recording.forces_on_several().map(|(sensor, axis)| {
        let along = if axis == Axis::X { "lateral" } else { "longitudinal" };
        Covariate {
            name: Cow::Owned(force_column_name((sensor, axis))),
            words: Cow::Owned(format!("{along} force on sensor {sensor}")),
            unit: "N",
            kind: CovariateKind::Quantity,
        }
    });
    STANDARD.iter().cloned().chain(own).chain(forces).collect()
}

/// Between the columns of a product.
const PRODUCT: char = '*';

impl Covariate {
    /// The product of several recorded or built-in columns.
    pub fn product(columns: &[String]) -> Self {
        Self {
            name: Cow::Owned(columns.join("*")),
            words: Cow::Owned(columns.join(" times ")),
            unit: "",
            kind: CovariateKind::Quantity,
        }
    }

    /// Whether it is computed from other columns.
    pub fn is_derived(&self) -> bool {
        self.name == "temp_rate_c_per_min" || STATOR_CURRENTS.contains(&self.name.as_ref())
    }

    /// Values over a recording; `None` where it was not recorded. `place` is the recording's number from 1.
    pub fn values(&self, track: &ExcitationSeries, place: usize) -> Option<Vec<f64>> {
        let of_force = |f: &dyn Fn(&[f64; 2]) -> f64| Some(track.force_n.iter().map(f).collect());
        match self.name.as_ref() {
            "force_n" => of_force(&|[x, z]| x.hypot(*z)),
            "fx_rate_n_per_s" => Some(rates(track, 0)),
            "fz_rate_n_per_s" => Some(rates(track, 1)),
            "loading_x" => Some(directions(&rates(track, 0))),
            "loading_z" => Some(directions(&rates(track, 1))),
            "temp_rate_c_per_min" => (!track.temperature_c.is_empty())
                .then(|| slope_per_min(&track.time_s, &track.temperature_c)),
            "motor_angle_rad" => {
                let turns = track.covariate(&self.name)?;
                Some(turns.iter().map(|angle| wrapped(*angle)).collect())
            }
            "recording" => Some(vec![place as f64; track.len()]),
            "constant" => Some(vec![0.0; track.len()]),
            name if name.contains(PRODUCT) => {
                let factors: Option<Vec<Vec<f64>>> =
                    name.split(PRODUCT).map(|factor| track.covariate(factor)).collect();
                factors?.into_iter().reduce(|mut product, factor| {
                    product.iter_mut().zip(factor).for_each(|(product, value)| *product *= value);
                    product
                })
            }
            name => track.covariate(name),
        }
    }
}

/// An angle from -pi to pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

fn rates(track: &ExcitationSeries, axis: usize) -> Vec<f64> {
    track.rate_n_per_s.iter().map(|rate| rate[axis]).collect()
}

/// Direction of loading by row: -1, 0 or 1.
fn directions(rates: &[f64]) -> Vec<f64> {
    let squares = rates.iter().map(|rate| rate * rate).sum::<f64>();
    let threshold = DEADBAND * (squares / rates.len().max(1) as f64).sqrt();
    let direction = |rate: &f64| {
        if rate.abs() > threshold { rate.signum() } else { 0.0 }
    };
    rates.iter().map(direction).collect()
}

/// Slope of a straight line through the window around each row, per minute.
fn slope_per_min(time_s: &[f64], values: &[f64]) -> Vec<f64> {
    let (mut first, mut end) = (0, 0);
    // Sums over the window of 1, t, v, t t, t v; time since the first row.
    let mut sums = [0.0; 5];
    let origin = time_s.first().copied().unwrap_or(0.0);
    let terms = |row: usize| {
        let (t, v) = (time_s[row] - origin, values[row]);
        [1.0, t, v, t * t, t * v]
    };
    let mut slopes = Vec::with_capacity(time_s.len());
    for time in time_s {
        while end < time_s.len() && time_s[end] <= time + TEMPERATURE_RATE_S / 2.0 {
            sums.iter_mut().zip(terms(end)).for_each(|(s, t)| *s += t);
            end += 1;
        }
        while time_s[first] < time - TEMPERATURE_RATE_S / 2.0 {
            sums.iter_mut().zip(terms(first)).for_each(|(s, t)| *s -= t);
            first += 1;
        }
        let [n, t, v, tt, tv] = sums;
        let determinant = n * tt - t * t;
        slopes.push(if determinant > 0.0 { 60.0 * (n * tv - t * v) / determinant } else { 0.0 });
    }
    slopes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_warming_has_a_constant_rate() {
        let time_s: Vec<f64> = (0..1000).map(|i| 100.0 + 0.01 * f64::from(i)).collect();
        let warm: Vec<f64> = time_s.iter().map(|t| 20.0 + 0.05 * t).collect();
        let slopes = slope_per_min(&time_s, &warm);
        assert!(slopes.iter().all(|slope| (slope - 3.0).abs() < 1e-6));
    }

    #[test]
    fn small_rates_have_no_direction() {
        let rates = [100.0, -100.0, 1.0, -1.0];
        assert_eq!(directions(&rates), [1.0, -1.0, 0.0, 0.0]);
    }

    #[test]
    fn rotor_angle_wraps_to_one_turn() {
        assert!((wrapped(0.5 + 7.0 * TAU) - 0.5).abs() < 1e-12);
        assert!((wrapped(3.0 * PI - 0.1) - (PI - 0.1)).abs() < 1e-12);
    }
}
