//! Whether the device compensates an effect, and if not, why: known before a model is exported.

use std::fmt;
use std::path::Path;

use serde::Serialize;

use crate::effects::{DeviceForm, EffectTerm};
use crate::inverse::build::{BuildError, ModelVariant, effect_values, static_model};
use crate::inverse::compensation::{OwnedCompensation, board_conditions, lookup_table};
use crate::model_file::ModelFile;

/// Whether the device compensates an effect.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceSupport {
    /// Name of the effect.
    pub effect: String,
    /// Whether the device compensates it; `None` where it does not need to.
    pub runs: Option<bool>,
    /// When the device compensates it, or why it does not; may be empty.
    pub detail: String,
}

impl fmt::Display for DeviceSupport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.runs, self.detail.as_str()) {
            (Some(true), "") => f.write_str("yes"),
            (Some(true), detail) => write!(f, "yes, {detail}"),
            (Some(false), reason) => write!(f, "no, because {reason}"),
            (None, reason) => write!(f, "not needed, {reason}"),
        }
    }
}

impl DeviceSupport {
    /// Of an effect, as far as it does not depend on the values of its parameters.
    pub fn of(effect: &EffectTerm) -> Self {
        let support = |runs: Option<bool>, detail: String| Self {
            effect: effect.name().to_owned(),
            runs,
            detail,
        };
        let conditions = board_conditions(&effect.needs()).join("; ");
        if effect.is_function_of_force() {
            return support(Some(true), "by the tables of the ideal model".to_owned());
        }
        match effect {
            EffectTerm::Catalogue(known) => match known.device {
                DeviceForm::Tables | DeviceForm::Field(_) | DeviceForm::Force(_) => {
                    support(Some(true), conditions)
                }
                DeviceForm::Settled => {
                    support(Some(true), "in its state at the end of the recordings".to_owned())
                }
                DeviceForm::Bench { .. } => support(None, "an error of the test bench".to_owned()),
                DeviceForm::Never(why) => support(Some(false), why.to_owned()),
            },
            EffectTerm::Expression(formula) => match lookup_table::unsupported(formula) {
                Some(why) => support(Some(false), why),
                None => support(Some(true), conditions),
            },
        }
    }
}

/// Of all effects of a model, with the values of their parameters at every sensor, each together with those before it.
pub fn device_support(model: &ModelFile, effects: &[EffectTerm]) -> Vec<DeviceSupport> {
    let recordings = model.provenance.recordings.len();
    let mut supported: Vec<EffectTerm> = Vec::new();
    let of = |effect: &EffectTerm| {
        let support = DeviceSupport::of(effect);
        if support.runs != Some(true) {
            return support;
        }
        let refused = |reason: &str| DeviceSupport {
            runs: Some(false),
            detail: reason.to_owned(),
            ..support.clone()
        };
        let refusal = model.sensors.iter().find_map(|sensor| {
            let number = sensor.number;
            let place = Path::new("");
            let all = match effect_values(model, effects, number, recordings, place) {
                Ok(all) => all,
                Err(error) => return Some(error.to_string()),
            };
            let rest = match static_model(model, &all, number, ModelVariant::Fitted, place) {
                Ok(rest) => rest,
                Err(BuildError::NotInvertible { why, .. }) => return Some(why.to_string()),
                Err(error) => return Some(error.to_string()),
            };
            let is_built = |own: &EffectTerm| own == effect || supported.contains(own);
            let own: Vec<_> = all.iter().filter(|(own, _)| is_built(own)).cloned().collect();
            let gauss_per_lsb = model.sensor_scale.gauss_per_lsb;
            let built = OwnedCompensation::build(number, &rest, &own, gauss_per_lsb);
            built.err().map(|error| format!("{} (sensor {number})", error.why))
        });
        if let Some(reason) = refusal {
            return refused(&reason);
        }
        supported.push(effect.clone());
        support
    };
    effects.iter().map(of).collect()
}
