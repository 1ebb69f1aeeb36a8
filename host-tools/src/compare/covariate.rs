//! What an error may depend on: the columns of a recording, and what follows from them.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use model_export::effects::Track;
use model_export::recordings::Recording;
use model_export::recordings::columns::STATOR_CURRENTS;

/// How a covariate is cut into bins and judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A quantity: what it does carries over from one recording to another.
    Quantity,
    /// Nothing that moves: a constant of each channel.
    Constant,
    /// Time, or a recording's number: it can stand in for anything that changes slowly, so that it
    /// comes last unless it explains far more than a quantity.
    Time,
    /// The same, and no recording tells it of another: it is judged within recordings.
    TimeOfCampaign,
}

/// A covariate.
#[derive(Clone, Debug)]
pub struct Covariate {
    /// Name as in the recordings, or of what is made from them.
    pub name: Cow<'static, str>,
    /// In words.
    pub words: Cow<'static, str>,
    /// Unit; empty for a number without one.
    pub unit: &'static str,
    /// How it is judged.
    pub kind: Kind,
}

const fn quantity(name: &'static str, words: &'static str, unit: &'static str) -> Covariate {
    covariate(name, words, unit, Kind::Quantity)
}

const fn covariate(
    name: &'static str,
    words: &'static str,
    unit: &'static str,
    kind: Kind,
) -> Covariate {
    Covariate {
        name: Cow::Borrowed(name),
        words: Cow::Borrowed(words),
        unit,
        kind,
    }
}

/// What every gripper may have.
static KNOWN: [Covariate; 24] = [
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
    covariate("time_s", "time in the recording", "s", Kind::Time),
    covariate(
        "session_s",
        "time in the session",
        "s",
        Kind::TimeOfCampaign,
    ),
    covariate("recording", "recording", "", Kind::TimeOfCampaign),
    covariate("constant", "a constant of each channel", "", Kind::Constant),
];

/// A rate below this share of its own root mean square is no direction of loading.
const DEADBAND: f64 = 0.1;

/// Seconds over which the rate of a temperature is taken: far above its steps, below its swings.
const TEMPERATURE_RATE_S: f64 = 4.0;

/// Those that any gripper may have.
pub fn known() -> &'static [Covariate] {
    &KNOWN
}

/// Every covariate that is looked at: those that any gripper may have, and those that the recording
/// declares.
pub fn all(recording: &Recording) -> Vec<Covariate> {
    let known = |name: &str| KNOWN.iter().any(|covariate| covariate.name == name);
    let declared = recording.covariates.keys().filter(|name| !known(name));
    let own = declared.map(|name| Covariate {
        name: Cow::Owned(name.clone()),
        words: Cow::Owned(name.clone()),
        unit: "",
        kind: Kind::Quantity,
    });
    KNOWN.iter().cloned().chain(own).collect()
}

impl Covariate {
    /// Its values over a track; `None` where it was not recorded. `place` is the recording's in the
    /// campaign, from 1.
    pub fn values(&self, track: &Track, place: usize) -> Option<Vec<f64>> {
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
            name => track.covariate(name),
        }
    }
}

/// An angle from -pi to pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

fn rates(track: &Track, axis: usize) -> Vec<f64> {
    track.rate_n_per_s.iter().map(|rate| rate[axis]).collect()
}

/// -1, 0 or 1: unloading, standing, loading (towards greater values).
fn directions(rates: &[f64]) -> Vec<f64> {
    let squares = rates.iter().map(|rate| rate * rate).sum::<f64>();
    let least = DEADBAND * (squares / rates.len().max(1) as f64).sqrt();
    let direction = |rate: &f64| match rate.abs() > least {
        true => rate.signum(),
        false => 0.0,
    };
    rates.iter().map(direction).collect()
}

/// Slope of the straight line through the rows around each row.
fn slope_per_min(time_s: &[f64], values: &[f64]) -> Vec<f64> {
    let (mut first, mut end) = (0, 0);
    // Sums over the window: rows, t, v, t t, t v; times from the first row on.
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
        let spread = n * tt - t * t;
        slopes.push(match spread > 0.0 {
            true => 60.0 * (n * tv - t * v) / spread,
            false => 0.0,
        });
    }
    slopes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_warming_has_its_slope_everywhere() {
        let time_s: Vec<f64> = (0..1000).map(|i| 100.0 + 0.01 * f64::from(i)).collect();
        let warm: Vec<f64> = time_s.iter().map(|t| 20.0 + 0.05 * t).collect();
        let slopes = slope_per_min(&time_s, &warm);
        assert!(slopes.iter().all(|slope| (slope - 3.0).abs() < 1e-6));
    }

    #[test]
    fn a_rate_far_below_the_usual_one_is_no_direction() {
        let rates = [100.0, -100.0, 1.0, -1.0];
        assert_eq!(directions(&rates), [1.0, -1.0, 0.0, 0.0]);
    }

    #[test]
    fn rotor_angles_of_different_turns_are_the_same() {
        assert!((wrapped(0.5 + 7.0 * TAU) - 0.5).abs() < 1e-12);
        assert!((wrapped(3.0 * PI - 0.1) - (PI - 0.1)).abs() < 1e-12);
    }
}
