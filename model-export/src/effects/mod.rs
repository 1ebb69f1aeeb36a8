//! Physical effects beyond the base model: catalogue, parameters, application to a sensor's state.
//!
//! - [`effect`]: what each effect of the catalogue states of itself.
//! - [`catalogue`]: all effects, one file each.
//! - [`term`]: an effect in a model: of the catalogue, or user-defined.
//! - [`parameter`]: parameters of an effect and the definition of its magnitude.
//! - [`excitation`]: forces and covariates of one sensor over a recording.
//! - [`history`]: permanent changes of a gripper over a campaign.
//! - [`operators`]: stop operator, low pass, delay.
//! - `state_series`: stages of the chain from force to field, and states row by row.
//! - `chain`: from forces to states, effect by effect ([`EffectChain`]).
//! - [`expression`]: user-defined effects, written as formulas.
//!
//! An effect is defined once, by its action on the state ([`Effect::apply`]). Its regressors in the field
//! are the derivatives of that action with respect to its coefficients, so the two cannot disagree.

pub mod catalogue;
mod chain;
pub mod effect;
pub mod excitation;
pub mod expression;
pub mod history;
pub mod operators;
pub mod parameter;
mod state_series;
pub mod term;
#[cfg(test)]
mod tests;

pub use catalogue::{CATALOGUE, UnknownEffect, find};
pub use chain::{EffectChain, MovedSeries};
pub use effect::{
    CreepParts, DeviceForm, Effect, ErrorOrigin, FieldForm, ForceForm, FrictionSliders, Signature,
    SimulatedMagnitude, Simulation, TimeDependence,
};
pub use excitation::ExcitationSeries;
pub use expression::Expression;
pub use history::{FinalState, GripperState};
pub use parameter::{Aggregation, EffectParameter, MagnitudeSpec, ParameterKind, ParameterScope};
pub use state_series::{EffectStage, StateSeries};
pub use term::EffectTerm;

/// Temperature in degrees Celsius at which remanence, offsets and gaps are stated.
pub const REFERENCE_C: f64 = 25.0;
