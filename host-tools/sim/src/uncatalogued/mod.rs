//! Physics of the effects that no effect of the catalogue represents: products of covariates, periods and thresholds to be found,
//! lags.
//!
//! Each acts at one point of the chain from force to counts, see [`Contribution`], and depends only on what the recordings
//! contain, except [`UNLOGGED`]. Directions and phases vary from sensor to sensor; a period or a time constant is one of the
//! gripper. [`SCREW_RIPPLE`] is a part of [`crate::finger`].
//!
//! [`UNLOGGED`]: crate::effects::uncatalogued_kinds::UNLOGGED
//! [`SCREW_RIPPLE`]: crate::effects::uncatalogued_kinds::SCREW_RIPPLE

mod law;
#[cfg(test)]
mod tests;

pub use law::{Law, RANGES};

use crate::effects::Effects;
use nalgebra::Vector3;

/// Recorded quantities at one sensor and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariates {
    /// Number of the recording, from 1.
    pub recording: u32,
    /// Time since the start of the campaign in seconds.
    pub session_s: f64,
    /// Lateral and longitudinal load in newtons.
    pub load_n: [f64; 2],
    /// Opening in mm.
    pub opening_mm: f64,
    /// Quadrature current of the motor in A.
    pub current_a: f64,
    /// Temperature of the sensor above the reference, in kelvin.
    pub warm_k: f64,
    /// Specific force in m/s^2, body axes.
    pub specific_force: Vector3<f64>,
    /// Roll in rad.
    pub roll_rad: f64,
}

/// What effects add to one sensor, at each point of the chain from force to counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contribution {
    /// Lateral and longitudinal force on the flexures in newtons.
    pub force_n: [f64; 2],
    /// Displacement of the magnet, gripper axes, in mm.
    pub displacement_mm: Vector3<f64>,
    /// External field in gauss, gripper axes.
    pub field_g: Vector3<f64>,
    /// Rotation vector of the element against the gripper, in rad.
    pub rotation_rad: Vector3<f64>,
    /// Relative change of the gain of each axis of the element.
    pub gain: Vector3<f64>,
}

/// Covariates, and what follows from their history in a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Present values.
    pub now: Covariates,
    /// Interval since the previous sample of the recording in seconds; 0 at its first sample.
    pub since_s: f64,
    /// Rate of the lateral load in N/s.
    pub lateral_n_per_s: f64,
    /// Speed of the opening in mm/s.
    pub opening_mm_per_s: f64,
}

impl Conditions {
    /// Rates are differences to the previous sample, and zero at the first sample of a recording.
    fn new(now: Covariates, before: Option<Covariates>) -> Self {
        let same = before.filter(|before| before.recording == now.recording);
        let since_s = same.map_or(0.0, |before| now.session_s - before.session_s);
        let rate = |of: fn(&Covariates) -> f64| match same {
            Some(before) if since_s > 0.0 => (of(&now) - of(&before)) / since_s,
            _ => 0.0,
        };
        Self {
            now,
            since_s,
            lateral_n_per_s: rate(|at| at.load_n[0]),
            opening_mm_per_s: rate(|at| at.opening_mm),
        }
    }
}

/// Effects outside the catalogue of one sensor, with their state.
#[derive(Clone, Debug)]
pub struct UncataloguedEffects {
    laws: Vec<Law>,
    before: Option<Covariates>,
}

impl UncataloguedEffects {
    /// Draws directions, phases, thresholds, periods and time constants of a sensor.
    pub fn draw(effects: &Effects, seed: u64, sensor: u32) -> Self {
        let law = |kind| Law::draw(kind, effects.each(kind.id, sensor), seed, sensor);
        let laws = effects.chosen.iter().filter_map(|chosen| law(chosen.effect.kind)).collect();
        Self { laws, before: None }
    }

    /// The drawn values of an effect; none where it is absent or is a part of the finger.
    pub fn law(&self, kind: &str) -> Option<&Law> {
        self.laws.iter().find(|law| law.kind().id == kind)
    }

    /// Advances to a sample; returns the sum of all effects.
    pub fn advance(&mut self, now: Covariates) -> Contribution {
        let conditions = Conditions::new(now, self.before);
        self.before = Some(now);
        let mut sum = Contribution::default();
        for law in &mut self.laws {
            law.add(&conditions, &mut sum);
        }
        sum
    }
}
