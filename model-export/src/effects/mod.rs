//! Physical effects beyond the base model: catalogue, parameters, application to a sensor's state.
//!
//! - [`catalogue`]: all effects, one file each.
//! - [`parameter`]: parameters of an effect and the definition of its magnitude.
//! - [`excitation`]: forces and covariates of one sensor over a recording.
//! - [`history`]: permanent changes of a gripper over a campaign.
//! - [`operators`]: stop operator, low pass, delay, smoothing.
//! - [`state_series`]: from forces to states, effect by effect.
//! - [`expression`]: user-defined effects, written as formulas.
//!
//! An effect is defined once, by its action on the state ([`Effect::apply`]). Its regressors in the field
//! are the derivatives of that action with respect to its coefficients, so the two cannot disagree.

pub mod catalogue;
pub mod excitation;
pub mod expression;
pub mod history;
pub mod operators;
pub mod parameter;
pub mod state_series;

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::Vector3;

pub use catalogue::{CATALOGUE, UnknownEffect, find};
pub use excitation::ExcitationSeries;
pub use expression::Expression;
pub use history::{FinalState, GripperState};
pub use parameter::{Aggregation, EffectParameter, MagnitudeSpec, ParameterKind, ParameterScope};
pub use state_series::{EffectChain, EffectStage, MovedSeries, StateSeries};

/// Temperature in degrees Celsius at which remanence, offsets and gaps are stated.
pub const REFERENCE_C: f64 = 25.0;

/// How the device compensates an effect.
#[derive(Clone, Copy, Debug)]
pub enum DeviceForm {
    /// On the field, before the ideal model.
    Field(FieldForm),
    /// On the forces, after the ideal model.
    Force(ForceForm),
    /// By the tables of the ideal model: the effect depends only on the present forces.
    Tables,
    /// A permanent change: the tables describe the gripper in its state at the end of the campaign.
    Settled,
    /// Not needed on the device: an error of the reference.
    Bench {
        /// The error, before its magnitude: "the reference drifts by".
        error: &'static str,
        /// The remedy.
        remedy: &'static str,
    },
    /// Impossible on the device, with the reason: the forces keep the effect's error.
    Never(&'static str),
}

impl DeviceForm {
    /// One word for tables of effects.
    pub fn label(self) -> &'static str {
        match self {
            Self::Field(_) | Self::Force(_) => "device",
            Self::Tables => "tables",
            Self::Settled => "settled",
            Self::Bench { .. } => "bench",
            Self::Never(_) => "no",
        }
    }
}

/// Origin of the error that an effect causes in the forces of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorOrigin {
    /// The gripper, in a way that the device compensates.
    Compensated,
    /// A permanent change of the gripper: the tables hold the state of one time ([`FinalState`]).
    History,
    /// The reference sensor or its clock, not the device.
    Reference,
    /// A single event, which the device can detect but not compensate.
    Event,
    /// The gripper, in a way that no model of the device compensates.
    Uncompensated,
}

impl ErrorOrigin {
    /// True where no model of the device could remove the error.
    pub fn is_irreducible(self) -> bool {
        matches!(self, Self::Event | Self::Uncompensated)
    }
}

/// Compensation of the field, by the firmware's `FieldEffect` of the same name. Without a function, the values are
/// the effect's parameters, in the stated order and unit.
#[derive(Clone, Copy, Debug)]
pub enum FieldForm {
    /// Per kelvin: offset along x, y and z in gauss, gain in percent.
    SensorTemperature,
    /// Field in gauss per ampere: x, y and z each for the alpha, beta and quadrature current.
    MotorLeakage,
    /// Field along the world's x, y and z in gauss.
    EarthField,
    /// Field in gauss, gripper's axes, by values and opening in mm.
    NeighbourMagnet(fn(&[f64], f64) -> Vector3<f64>),
    /// Change of the remanence in percent per kelvin.
    MagnetTemperature,
    /// Growth of the gap in micrometres per kelvin.
    ThermalGap,
}

/// Compensation of the forces, by the firmware's `ForceEffect` of the same name. Without a function, the values are
/// the effect's parameters, in the stated order and unit. Axis 0 is lateral, axis 1 longitudinal.
#[derive(Clone, Copy, Debug)]
pub enum ForceForm {
    /// Retardation time of each axis in milliseconds.
    ViscousLag,
    /// Parts by values and axis. Both axes have the same time constants.
    Creep(fn(&[f64], usize) -> CreepParts),
    /// Compliance lost in percent: each axis under positive, then under negative force; knee of each axis in newtons.
    HardStop,
    /// Sliders by values and axis.
    Hysteresis(fn(&[f64], usize) -> FrictionSliders),
    /// Mass in kilograms.
    FingertipMass,
}

/// Percentage of the deflection and time constant in seconds of the fast and the slow part of creep along one axis.
pub type CreepParts = [(f64, f64); 2];

/// Friction force in newtons, and weight and reach in newtons of each slider, along one axis.
pub type FrictionSliders = (f64, [(f64, f64); 3]);

/// Dependence on the excitation that an effect has in common with others: recordings with a special excitation (a single sine, the
/// same warm-up) do not distinguish them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signature {
    /// History or rate of the load: one elliptic response to a single sine.
    LoadHistory,
    /// Time, or the number of the recording.
    Time,
    /// Temperature.
    Temperature,
    /// A uniform field that is constant in the world; without it, the sensor's offset contains that field.
    AmbientField,
}

/// How the simulator generates an effect.
#[derive(Clone, Copy, Debug)]
pub enum Simulation {
    /// By physics of its own, independent of [`Effect::apply`], with this magnitude.
    Magnitude(SimulatedMagnitude),
    /// Not at all, with the reason.
    Never(&'static str),
}

/// Magnitude of a simulated effect; typical value and unit are those of [`Effect::size`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedMagnitude {
    /// Number of the random stream, and position in lists of simulated effects. Unique and never changed, so that a
    /// seed continues to give the same gripper.
    pub random_stream: u32,
    /// Valid range.
    pub range: (f64, f64),
    /// Definition.
    pub meaning: &'static str,
    /// Property of a material or of the whole gripper: equal in every sensor.
    pub shared: bool,
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
    /// Ids of confusable effects, each with the condition. A pair may be stated at one of the two only.
    pub confused_with: &'static [(&'static str, &'static str)],
    /// A cause outside the catalogue that can leave nearly the same; empty where none is known.
    pub similar_outside: &'static str,
    /// What it has in common with other effects.
    pub signatures: &'static [Signature],
    /// How it is simulated.
    pub simulation: Simulation,
    /// How the device compensates it.
    pub device: DeviceForm,
    /// True for events within single recordings: a held-out recording carries no information on them.
    pub is_transient: bool,
    /// Stages of the effects before it whose results it reads or scales: its contribution depends on them.
    pub reads: &'static [EffectStage],
    /// Applies the effect. Arguments: values in the order of [`Effect::parameters`] (those of each
    /// recording repeated), the excitation, the series so far.
    pub apply: fn(&[f64], &ExcitationSeries, &mut StateSeries),
}

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
    pub fn has_initial_state(&self) -> bool {
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
            Self::Catalogue(effect) => {
                matches!(effect.id, "field_drift" | "reference_drift" | "demagnetisation")
            }
            Self::Expression(expression) => {
                expression.covariates.iter().any(|name| name == "session_s")
            }
        }
    }

    /// Whether it depends on the times of the rows: by a rate, a time constant or a drift.
    pub fn depends_on_time(&self) -> bool {
        match self {
            Self::Catalogue(effect) => {
                self.depends_on_start()
                    || effect.signatures.contains(&Signature::Time)
                    || matches!(
                        effect.id,
                        "viscous_lag" | "creep" | "clock_skew" | "reference_filter"
                    )
            }
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
            Self::Catalogue(effect) => {
                let is_of_order =
                    |one: &Signature| matches!(one, Signature::LoadHistory | Signature::Time);
                effect.signatures.iter().any(is_of_order)
            }
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
    pub fn is_pointwise(&self) -> bool {
        let on_force_or_opening =
            self.stage() <= EffectStage::Flexure || self.stage() == EffectStage::Opening;
        let has_memory = match self {
            Self::Catalogue(_) => false,
            Self::Expression(formula) => formula.has_memory(),
        };
        !has_memory && !on_force_or_opening
    }

    /// Whether it reads or scales what `earlier`, an effect before it in the chain, changes. A formula depends on covariates alone.
    pub fn depends_on(&self, earlier: &Self) -> bool {
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
    pub fn includes_ambient_field(&self) -> bool {
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
