//! The catalogue of physical effects: one file an effect, with its physics, its equation, its
//! parameters, and what it does to the state of a sensor.
//!
//! - [`parameter`]: a number of an effect, its typical size and its range.
//! - [`track`]: what a sensor met over a recording.
//! - [`memory`]: play, low pass, smoothing.
//! - [`series`]: from forces to states, effect by effect.
//! - [`channelwise`]: an effect of the flexures where no geometry is known.
//! - [`expression`]: a user's own effect, written as a formula.
//! - [`CATALOGUE`]: all effects; each file below holds one.
//!
//! An effect is stated once, as what it does to the state ([`Effect::apply`]). Its regressors in the
//! field are the derivative of that to its coefficients, so they cannot disagree with it.

pub mod channelwise;
pub mod expression;
pub mod memory;
pub mod parameter;
pub mod series;
pub mod track;

mod clock_skew;
mod creep;
mod cross_coupling;
mod demagnetisation;
mod earth_field;
mod external_magnet;
mod field_drift;
mod fingertip_mass;
mod geometric_stiffening;
mod hard_stop;
mod hysteresis;
mod magnet_temperature;
mod motor_leakage;
mod neighbour_magnet;
mod reference_drift;
mod reference_filter;
mod screw_backlash;
mod sensor_compression;
mod sensor_temperature;
mod softening;
mod thermal_gap;
mod tip_slope;
mod viscous_lag;

use std::borrow::Cow;
use std::sync::Arc;

use crate::recordings::problem::closest;

pub use channelwise::Channelwise;
pub use creep::parts_of as creep_parts;
pub use expression::Expression;
pub use hysteresis::sliders_of as hysteresis_sliders;
pub use neighbour_magnet::field as neighbour_field;
pub use parameter::{Kind, Of, Parameter, Size, SizeOf};
pub use series::{Series, Stage};
pub use track::Track;

/// Remanence, offsets and gaps are those at this temperature in degrees Celsius.
pub const REFERENCE_C: f64 = 25.0;

/// Where an effect can be undone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Undone {
    /// On the device, by a compensation of its own.
    Compensation,
    /// On the device, by the tables of the ideal model: it only depends on the present forces.
    Tables,
    /// It changes the gripper for good: the tables are those of the gripper as it is in the end.
    Settled,
    /// Nowhere: it belongs to the bench, or happened once.
    Never(&'static str),
}

/// One physical effect.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Name in commands and files.
    pub id: &'static str,
    /// Where it acts.
    pub stage: Stage,
    /// A paragraph for a student.
    pub physics: &'static str,
    /// The equation.
    pub equation: &'static str,
    /// What its regressors in the field are.
    pub regressors: &'static str,
    /// Columns without which it cannot be judged, beside force and field.
    pub needs: &'static [&'static str],
    /// What to draw its field over: one of these, whichever it follows most.
    pub shows_against: &'static [&'static str],
    /// Its parameters; coefficients first.
    pub parameters: &'static [Parameter],
    /// The one number that says how large it is.
    pub size: Size,
    /// What to record to judge it.
    pub record: &'static str,
    /// Ids of effects that it is confused with, and when.
    pub confused_with: &'static [(&'static str, &'static str)],
    /// Where it can be undone.
    pub undone: Undone,
    /// True where it happens within single recordings: a recording left out says nothing of it.
    pub lives_in_one_recording: bool,
    /// What it does: the parameters' values, in the order of [`Effect::parameters`] (those marked
    /// for each recording repeated), the track, and the series so far.
    pub apply: fn(&[f64], &Track, &mut Series),
}

/// Every effect, in the order in which a person would suspect them.
pub const CATALOGUE: [&Effect; 23] = [
    &geometric_stiffening::EFFECT,
    &tip_slope::EFFECT,
    &cross_coupling::EFFECT,
    &hard_stop::EFFECT,
    &hysteresis::EFFECT,
    &viscous_lag::EFFECT,
    &creep::EFFECT,
    &softening::EFFECT,
    &fingertip_mass::EFFECT,
    &neighbour_magnet::EFFECT,
    &screw_backlash::EFFECT,
    &motor_leakage::EFFECT,
    &earth_field::EFFECT,
    &external_magnet::EFFECT,
    &magnet_temperature::EFFECT,
    &sensor_temperature::EFFECT,
    &thermal_gap::EFFECT,
    &demagnetisation::EFFECT,
    &field_drift::EFFECT,
    &sensor_compression::EFFECT,
    &clock_skew::EFFECT,
    &reference_filter::EFFECT,
    &reference_drift::EFFECT,
];

/// No effect of that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no effect {name:?}; {advice}")]
pub struct UnknownEffect {
    name: String,
    advice: String,
}

/// The effect of that name.
pub fn find(name: &str) -> Result<&'static Effect, UnknownEffect> {
    let known = CATALOGUE.iter().find(|effect| effect.id == name);
    known.copied().ok_or_else(|| UnknownEffect {
        name: name.to_owned(),
        advice: match closest(name, CATALOGUE.iter().map(|effect| effect.id)) {
            Some(id) => format!("did you mean {id}?"),
            None => "`magpie effects` lists them".to_owned(),
        },
    })
}

/// A parameter as often as recordings need it, numbered from 1 where there are several.
fn repeated(parameter: &Parameter, recordings: usize) -> Vec<Parameter> {
    let first = match parameter.of {
        Of::Campaign => return vec![parameter.clone()],
        Of::EachRecording => 1,
        Of::EachLaterRecording => 2,
    };
    let numbered = |n: usize| Parameter {
        name: Cow::Owned(format!("{}_{n}", parameter.name)),
        ..parameter.clone()
    };
    (first..=recordings).map(numbered).collect()
}

/// What can be added to a model: an effect of the catalogue, or a user's own.
#[derive(Clone, Debug)]
pub enum Addition {
    /// Of the catalogue.
    Catalogue(&'static Effect),
    /// An effect of the flexures beside a base that knows no geometry.
    Channelwise(Channelwise),
    /// A user's own.
    Expression(Arc<Expression>),
}

impl PartialEq for Addition {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Addition {
    /// Name in commands and files.
    pub fn name(&self) -> &str {
        match self {
            Self::Catalogue(effect) => effect.id,
            Self::Channelwise(own) => own.effect().id,
            Self::Expression(expression) => &expression.name,
        }
    }

    /// Where it acts.
    pub fn stage(&self) -> Stage {
        match self {
            Self::Catalogue(effect) => effect.stage,
            // It no longer moves the flexures: its answers are added to what the sensor reads.
            Self::Channelwise(_) => Stage::Sensor,
            Self::Expression(expression) => expression.stage(),
        }
    }

    /// Every parameter in a campaign of this many recordings.
    pub fn parameters(&self, recordings: usize) -> Vec<Parameter> {
        match self {
            Self::Catalogue(effect) => effect
                .parameters
                .iter()
                .flat_map(|parameter| repeated(parameter, recordings))
                .collect(),
            Self::Channelwise(own) => own.parameters(recordings),
            Self::Expression(expression) => expression.parameters(),
        }
    }

    /// How large it is, as one number.
    pub fn size(&self) -> Size {
        match self {
            Self::Catalogue(effect) => effect.size,
            Self::Channelwise(own) => own.size(),
            Self::Expression(expression) => expression.size(),
        }
    }

    /// Columns that it cannot do without.
    pub fn needs(&self) -> Vec<String> {
        let named = |effect: &Effect| effect.needs.iter().map(|&name| name.to_owned()).collect();
        match self {
            Self::Catalogue(effect) => named(effect),
            Self::Channelwise(own) => named(own.effect()),
            Self::Expression(expression) => expression.covariates.clone(),
        }
    }

    /// What to draw its field over: a formula's own first covariate, or the force.
    pub fn shows_against(&self) -> Vec<String> {
        if let Some(effect) = self.effect() {
            return effect.shows_against.iter().map(|&n| n.to_owned()).collect();
        }
        let first = self.needs().into_iter().next();
        vec![first.unwrap_or_else(|| "force_n".to_owned())]
    }

    /// True where a recording left out says nothing of it.
    pub fn lives_in_one_recording(&self) -> bool {
        self.effect()
            .is_some_and(|effect| effect.lives_in_one_recording)
    }

    /// True where what it does to a row's state depends on nothing but that row: no memory, and no
    /// later effect reads what it changes.
    pub fn is_pointwise(&self) -> bool {
        let flexures_and_screw = self.stage() <= Stage::Flexure || self.stage() == Stage::Opening;
        matches!(self, Self::Catalogue(_)) && !flexures_and_screw
    }

    /// The effect of the catalogue that it is; `None` for a user's own.
    pub fn effect(&self) -> Option<&'static Effect> {
        match self {
            Self::Catalogue(effect) => Some(effect),
            Self::Channelwise(own) => Some(own.effect()),
            Self::Expression(_) => None,
        }
    }

    /// The same beside a base that knows no geometry, where a lateral and a longitudinal force were
    /// recorded or not: effects of the flexures become channelwise.
    pub fn beside_polynomial(self, axes: [bool; 2]) -> Self {
        match self {
            Self::Catalogue(effect) if effect.stage == Stage::Flexure => {
                Self::Channelwise(Channelwise::new(effect, axes))
            }
            other => other,
        }
    }

    /// True where it brings the field that stands in the room: an offset is then the sensor's own alone.
    pub fn brings_standing_field(&self) -> bool {
        matches!(self, Self::Catalogue(effect) if effect.id == earth_field::EFFECT.id)
    }

    /// Changes the series.
    pub fn apply(&self, values: &[f64], track: &Track, series: &mut Series) {
        match self {
            Self::Catalogue(effect) => (effect.apply)(values, track, series),
            Self::Channelwise(own) => own.apply(values, track, series),
            Self::Expression(expression) => expression.apply(values, track, series),
        }
    }
}
