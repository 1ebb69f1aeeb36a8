//! Physical effects beyond the base model: catalogue, parameters, application to a sensor's state.
//!
//! - [`catalogue`]: all effects, one file each.
//! - [`parameter`]: parameters of an effect and the definition of its magnitude.
//! - [`excitation`]: forces and covariates of one sensor over a recording.
//! - [`operators`]: stop operator, low pass, delay, smoothing.
//! - [`state_series`]: from forces to states, effect by effect.
//! - [`channelwise`]: flexure effects for bases without geometry.
//! - [`expression`]: user-defined effects, written as formulas.
//!
//! An effect is defined once, by its action on the state ([`Effect::apply`]). Its regressors in the field
//! are the derivatives of that action with respect to its coefficients, so the two cannot disagree.

pub mod catalogue;
pub mod channelwise;
pub mod excitation;
pub mod expression;
pub mod operators;
pub mod parameter;
pub mod state_series;

use std::sync::Arc;

pub use catalogue::creep::parts_of as creep_parts;
pub use catalogue::hysteresis::sliders_of as hysteresis_sliders;
pub use catalogue::neighbour_magnet::field as neighbour_field;
pub use catalogue::{CATALOGUE, UnknownEffect, find};
pub use channelwise::Channelwise;
pub use excitation::ExcitationSeries;
pub use expression::Expression;
pub use parameter::{Aggregation, EffectParameter, MagnitudeSpec, ParameterKind, ParameterScope};
pub use state_series::{EffectStage, StateSeries};

/// Temperature in degrees Celsius at which remanence, offsets and gaps are stated.
pub const REFERENCE_C: f64 = 25.0;

/// Where an effect can be compensated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compensated {
    /// On the device, by a compensation of its own.
    Compensation,
    /// On the device, by the tables of the ideal model: the effect depends only on the present forces.
    Tables,
    /// A permanent change: the tables describe the gripper in its final state.
    Settled,
    /// Not on the device, with the reason.
    Never(&'static str),
}

/// A physical effect of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Effect {
    /// Name in commands and files.
    pub id: &'static str,
    /// Position in the chain from force to field.
    pub stage: EffectStage,
    /// Explanation, one paragraph.
    pub physics: &'static str,
    /// Governing equation.
    pub equation: &'static str,
    /// Regressors in the field.
    pub regressors: &'static str,
    /// Required columns besides force and field.
    pub needs: &'static [&'static str],
    /// Covariates for plots of the effect; the one with the strongest dependence is used.
    pub plot_against: &'static [&'static str],
    /// Parameters, coefficients first.
    pub parameters: &'static [EffectParameter],
    /// Definition of its magnitude.
    pub size: MagnitudeSpec,
    /// Recommended recording to identify it.
    pub record: &'static str,
    /// Ids of confusable effects, each with the condition.
    pub confused_with: &'static [(&'static str, &'static str)],
    /// Where it can be compensated.
    pub compensated: Compensated,
    /// True for events within single recordings: a held-out recording carries no information on them.
    pub is_transient: bool,
    /// Applies the effect. Arguments: values in the order of [`Effect::parameters`] (those of each
    /// recording repeated), the excitation, the series so far.
    pub apply: fn(&[f64], &ExcitationSeries, &mut StateSeries),
}

/// An effect in a model: of the catalogue, or user-defined.
#[derive(Clone, Debug)]
pub enum EffectTerm {
    /// Of the catalogue.
    Catalogue(&'static Effect),
    /// A flexure effect with a base that has no geometry.
    Channelwise(Channelwise),
    /// User-defined.
    Expression(Arc<Expression>),
}

impl PartialEq for EffectTerm {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl EffectTerm {
    /// Name in commands and files.
    pub fn name(&self) -> &str {
        match self {
            Self::Catalogue(effect) => effect.id,
            Self::Channelwise(channelwise) => channelwise.effect().id,
            Self::Expression(expression) => &expression.name,
        }
    }

    /// Position in the chain from force to field.
    pub fn stage(&self) -> EffectStage {
        match self {
            Self::Catalogue(effect) => effect.stage,
            // Its responses are added to the sensor's reading; the flexures are not moved.
            Self::Channelwise(_) => EffectStage::Sensor,
            Self::Expression(expression) => expression.stage(),
        }
    }

    /// All parameters in a campaign of `recordings` recordings.
    pub fn parameters(&self, recordings: usize) -> Vec<EffectParameter> {
        match self {
            Self::Catalogue(effect) => effect
                .parameters
                .iter()
                .flat_map(|parameter| parameter.repeated(recordings))
                .collect(),
            Self::Channelwise(channelwise) => channelwise.parameters(recordings),
            Self::Expression(expression) => expression.parameters(),
        }
    }

    /// Definition of its magnitude.
    pub fn size(&self) -> MagnitudeSpec {
        match self {
            Self::Catalogue(effect) => effect.size,
            Self::Channelwise(channelwise) => channelwise.size(),
            Self::Expression(expression) => expression.size(),
        }
    }

    /// Required columns besides force and field.
    pub fn needs(&self) -> Vec<String> {
        match (self, self.effect()) {
            (Self::Expression(expression), _) => expression.covariates.clone(),
            (_, Some(effect)) => effect.needs.iter().map(|&name| name.to_owned()).collect(),
            _ => Vec::new(),
        }
    }

    /// Covariates for plots: of a formula its first covariate, or the force.
    pub fn plot_against(&self) -> Vec<String> {
        if let Some(effect) = self.effect() {
            return effect.plot_against.iter().map(|&n| n.to_owned()).collect();
        }
        let first = self.needs().into_iter().next();
        vec![first.unwrap_or_else(|| "force_n".to_owned())]
    }

    /// True where a held-out recording carries no information on the effect.
    pub fn is_transient(&self) -> bool {
        self.effect().is_some_and(|effect| effect.is_transient)
    }

    /// True where its action on a row depends on that row alone: it has no memory, and no later effect
    /// reads what it changes.
    pub fn is_pointwise(&self) -> bool {
        let on_force_or_opening =
            self.stage() <= EffectStage::Flexure || self.stage() == EffectStage::Opening;
        matches!(self, Self::Catalogue(_)) && !on_force_or_opening
    }

    /// The underlying effect of the catalogue; `None` for a user-defined one.
    pub fn effect(&self) -> Option<&'static Effect> {
        match self {
            Self::Catalogue(effect) => Some(effect),
            Self::Channelwise(channelwise) => Some(channelwise.effect()),
            Self::Expression(_) => None,
        }
    }

    /// The form for a base without geometry: flexure effects become channelwise. `axes`: whether a lateral
    /// and a longitudinal force were recorded.
    pub fn for_polynomial(self, axes: [bool; 2]) -> Self {
        match self {
            Self::Catalogue(effect) if effect.stage == EffectStage::Flexure => {
                Self::Channelwise(Channelwise::new(effect, axes))
            }
            other => other,
        }
    }

    /// True where it models the ambient field; the remaining offset is then the sensor's alone.
    pub fn includes_ambient_field(&self) -> bool {
        matches!(self, Self::Catalogue(effect) if effect.id == catalogue::earth_field::EFFECT.id)
    }

    /// Applies the effect with `values` in the order of [`EffectTerm::parameters`].
    pub fn apply(&self, values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
        match self {
            Self::Catalogue(effect) => (effect.apply)(values, excitation, series),
            Self::Channelwise(channelwise) => channelwise.apply(values, excitation, series),
            Self::Expression(expression) => expression.apply(values, excitation, series),
        }
    }
}
