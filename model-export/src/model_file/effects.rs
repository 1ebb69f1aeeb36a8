//! Effects of a model: definition, magnitude, and the parameters of each sensor.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::effects::expression::ParameterRange;
use crate::effects::{EffectTerm, Expression, ParameterScope, find};
use crate::fit::effect_size::{effect_sizes, first_parameter};
use crate::fit::joint::JointFit;
use crate::model_file::sensor::{FittedValue, digits};

/// A fitted effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectModel {
    /// Id in the catalogue, or name of a user-defined effect.
    pub name: String,
    /// Formula of a user-defined effect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression: Option<String>,
    /// Nonlinear parameters of a user-defined effect.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ranges: Vec<ParameterRange>,
    /// Description of `value`.
    #[serde(rename = "means")]
    pub quantity: String,
    /// Magnitude over all sensors.
    pub value: f64,
    /// Standard error of `value`.
    pub std_error: f64,
    /// Unit of `value` and `std_error`.
    pub unit: String,
    /// Parameters of each sensor.
    #[serde(rename = "sensor")]
    pub sensors: Vec<SensorEffect>,
}

/// Parameters of an effect at one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorEffect {
    /// Index of the sensor.
    pub number: u32,
    /// Parameters by name.
    pub parameters: BTreeMap<String, FittedValue>,
}

impl EffectModel {
    /// The effects of a fit of `recordings` recordings.
    pub fn all_of(fit: &JointFit, effects: &[EffectTerm], recordings: usize) -> Vec<Self> {
        let sizes = effect_sizes(fit, effects, recordings);
        let pairs = effects.iter().zip(sizes);
        pairs
            .map(|(effect, size)| {
                let (expression, ranges) = match effect {
                    EffectTerm::Expression(expression) => {
                        (Some(expression.text.clone()), expression.ranges.clone())
                    }
                    _ => (None, Vec::new()),
                };
                Self {
                    name: effect.name().to_owned(),
                    expression,
                    ranges,
                    quantity: match size.component {
                        Some(component) => format!("{} ({component})", size.size.description),
                        None => size.size.description.to_owned(),
                    },
                    value: digits(size.value),
                    std_error: digits(size.std_error),
                    unit: size.unit.into_owned(),
                    sensors: sensor_effects(fit, effects, effect, recordings),
                }
            })
            .collect()
    }

    /// The effect. The covariates of a formula were validated when it was added.
    ///
    /// # Errors
    /// There is no such effect, or a sensor does not have all its parameters: the file is of another version.
    pub fn term(&self) -> Result<EffectTerm, String> {
        let term = match &self.expression {
            None => EffectTerm::Catalogue(find(&self.name).map_err(|error| error.to_string())?),
            Some(text) => {
                let covariates = Expression::covariate_names(text);
                let expression = Expression::parse(text, &self.ranges, &covariates);
                EffectTerm::Expression(Arc::new(expression.map_err(|error| error.to_string())?))
            }
        };
        let parameters = term.parameters(1);
        let needed = parameters.iter().filter(|one| one.scope == ParameterScope::Campaign);
        for (sensor, parameter) in
            self.sensors.iter().flat_map(|sensor| needed.clone().map(move |one| (sensor, one)))
        {
            if !sensor.parameters.contains_key(parameter.name.as_ref()) {
                let (number, name) = (sensor.number, &parameter.name);
                return Err(format!(
                    "its parameter {name} of sensor {number} is missing: repeat the fit"
                ));
            }
        }
        Ok(term)
    }

    /// Values at one sensor in the order of the parameters of `term`; `None` if one is missing.
    pub fn values(&self, term: &EffectTerm, number: u32, recordings: usize) -> Option<Vec<f64>> {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let parameters = term.parameters(recordings);
        let value = |name: &str| Some(sensor.parameters.get(name)?.value);
        parameters.iter().map(|parameter| value(&parameter.name)).collect()
    }
}

fn sensor_effects(
    fit: &JointFit,
    effects: &[EffectTerm],
    effect: &EffectTerm,
    recordings: usize,
) -> Vec<SensorEffect> {
    let parameters = effect.parameters(recordings);
    let sensors = fit.sensors.iter();
    sensors
        .map(|sensor| {
            let first = first_parameter(sensor.base_count, effects, effect, recordings);
            let value = |i: usize| FittedValue {
                value: digits(sensor.values[first + i]),
                std_error: digits(sensor.std_error(first + i)),
                unit: parameters[i].unit.to_string(),
                identifiable: sensor.identifiable[first + i],
                prior_width: Some(digits(sensor.prior_width(first + i))),
            };
            SensorEffect {
                number: sensor.sensor,
                parameters: (0..parameters.len())
                    .map(|i| (parameters[i].name.to_string(), value(i)))
                    .collect(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_parameter_of_an_effect_is_named() {
        let value = FittedValue {
            value: 0.1,
            std_error: 0.01,
            unit: "%".to_owned(),
            identifiable: true,
            prior_width: None,
        };
        let mut model = EffectModel {
            name: "demagnetisation".to_owned(),
            expression: None,
            ranges: Vec::new(),
            quantity: String::new(),
            value: 0.1,
            std_error: 0.01,
            unit: "%".to_owned(),
            sensors: vec![SensorEffect {
                number: 2,
                parameters: ["impact", "slope"].map(|name| (name.to_owned(), value.clone())).into(),
            }],
        };
        let error = model.term().unwrap_err();
        assert_eq!(error, "its parameter at of sensor 2 is missing: repeat the fit");
        model.sensors[0].parameters.insert("at".to_owned(), value);
        assert_eq!(model.term().unwrap().name(), "demagnetisation");
    }
}
