//! An effect in a model: of the catalogue, or a formula of the user.

use std::borrow::Cow;
use std::sync::Arc;

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ErrorOrigin, ExcitationSeries, Expression,
    MagnitudeSpec, ParameterKind, ParameterScope, Signature, StateSeries, TimeDependence,
};

/// An effect in a model: of the catalogue, or user-defined.
#[derive(Clone, Debug)]
pub enum EffectTerm {
    /// Of the catalogue.
    Catalogue(&'static Effect),
    /// User-defined.
    Expression(Arc<Expression>),
}

impl PartialEq for EffectTerm {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Catalogue(one), Self::Catalogue(other)) => one.id == other.id,
            // Formulas of one name differ while a parameter is a number in one of them.
            (Self::Expression(one), Self::Expression(other)) => {
                one.text == other.text && one.ranges == other.ranges
            }
            _ => false,
        }
    }
}

impl EffectTerm {
    /// Name in commands and files.
    pub fn name(&self) -> &str {
        match self {
            Self::Catalogue(effect) => effect.id,
            Self::Expression(expression) => &expression.name,
        }
    }

    /// Position in the chain from force to field.
    pub fn stage(&self) -> EffectStage {
        match self {
            Self::Catalogue(effect) => effect.stage,
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
            Self::Expression(expression) => expression.parameters(),
        }
    }

    /// Whether it has a state at the start of each recording.
    pub(crate) fn has_initial_state(&self) -> bool {
        self.parameters(1).iter().any(|parameter| parameter.kind == ParameterKind::InitialState)
    }

    /// Definition of its magnitude.
    pub fn size(&self) -> MagnitudeSpec {
        match self {
            Self::Catalogue(effect) => effect.size,
            Self::Expression(expression) => expression.size(),
        }
    }

    /// Unit of its magnitude.
    pub fn size_unit(&self) -> Cow<'static, str> {
        match self {
            Self::Catalogue(effect) => Cow::Borrowed(effect.size.unit),
            Self::Expression(expression) => Cow::Owned(expression.size_unit()),
        }
    }

    /// Whether its magnitude is a magnetic field, absolute or per unit of a covariate.
    pub fn is_of_field(&self) -> bool {
        self.effect().is_some_and(|effect| effect.size.unit.split('/').next() == Some("G"))
    }

    /// Required columns besides force and field.
    pub fn needs(&self) -> Vec<String> {
        match (self, self.effect()) {
            (Self::Expression(expression), _) => expression.recorded_columns(),
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

    /// Whether it depends on the times between the recordings, besides their order.
    pub fn depends_on_start(&self) -> bool {
        match self {
            Self::Catalogue(effect) => effect.time == TimeDependence::Starts,
            Self::Expression(expression) => {
                expression.covariates.iter().any(|name| name == "session_s")
            }
        }
    }

    /// Whether it depends on the times of the rows: by a rate, a time constant or a drift.
    pub fn depends_on_time(&self) -> bool {
        match self {
            Self::Catalogue(effect) => effect.time != TimeDependence::None,
            Self::Expression(expression) => expression.depends_on_time(),
        }
    }

    /// True where a held-out recording carries no information on the effect.
    pub fn is_transient(&self) -> bool {
        self.effect().is_some_and(|effect| effect.is_transient)
    }

    /// True for a single event, at an instant of the campaign that is searched: no parameter is of a recording.
    pub fn is_event(&self) -> bool {
        let parameters = self.effect().map_or(&[][..], |effect| effect.parameters);
        let is_by_recording =
            |one: &EffectParameter| one.scope == ParameterScope::EachLaterRecording;
        parameters.iter().any(|parameter| parameter.kind == ParameterKind::Instant)
            && !parameters.iter().any(is_by_recording)
    }

    /// True where it depends on the order of the rows: on time, on a rate, or on the past.
    pub fn depends_on_order(&self) -> bool {
        match self {
            Self::Catalogue(effect) => effect.has_memory || effect.time != TimeDependence::None,
            Self::Expression(formula) => {
                let is_of_order = |name: &String| {
                    matches!(name.as_str(), "time_s" | "session_s") || name.contains("_rate_")
                };
                formula.has_memory() || formula.covariates.iter().any(is_of_order)
            }
        }
    }

    /// True where its action on a row depends on that row alone: it has no memory, and no later effect
    /// reads what it changes.
    pub(crate) fn is_pointwise(&self) -> bool {
        let on_force_or_opening =
            self.stage() <= EffectStage::Flexure || self.stage() == EffectStage::Opening;
        let has_memory = match self {
            Self::Catalogue(effect) => effect.has_memory,
            Self::Expression(formula) => formula.has_memory(),
        };
        !has_memory && !on_force_or_opening
    }

    /// Whether it reads or scales what `earlier`, an effect before it in the chain, changes. A formula depends on covariates alone.
    pub(crate) fn depends_on(&self, earlier: &Self) -> bool {
        self.effect().is_some_and(|effect| effect.reads.contains(&earlier.stage()))
    }

    /// True where the field depends on it through the present forces alone.
    pub fn is_function_of_force(&self) -> bool {
        match self {
            Self::Catalogue(effect) => matches!(effect.device, DeviceForm::Tables),
            Self::Expression(formula) => formula.depends_on_forces_alone(),
        }
    }

    /// Origin of the error that it causes.
    pub fn error_origin(&self) -> ErrorOrigin {
        match self.effect().map(|effect| effect.device) {
            Some(DeviceForm::Settled) => ErrorOrigin::History,
            Some(DeviceForm::Bench { .. }) => ErrorOrigin::Reference,
            Some(DeviceForm::Never(_)) if self.is_transient() => ErrorOrigin::Event,
            Some(DeviceForm::Never(_)) => ErrorOrigin::Uncompensated,
            _ => ErrorOrigin::Compensated,
        }
    }

    /// The underlying effect of the catalogue; `None` for a user-defined one.
    pub fn effect(&self) -> Option<&'static Effect> {
        match self {
            Self::Catalogue(effect) => Some(effect),
            Self::Expression(_) => None,
        }
    }

    /// True where it models the ambient field; the remaining offset is then the sensor's alone.
    pub(crate) fn includes_ambient_field(&self) -> bool {
        matches!(self, Self::Catalogue(effect) if effect.signatures.contains(&Signature::AmbientField))
    }

    /// Applies the effect with `values` in the order of [`EffectTerm::parameters`].
    pub fn apply(&self, values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
        match self {
            Self::Catalogue(effect) => (effect.apply)(values, excitation, series),
            Self::Expression(expression) => expression.apply(values, excitation, series),
        }
    }
}
