//! The effects of a model: what they are, their size, and every parameter of every sensor.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Value, digits};
use crate::effects::expression::Range;
use crate::effects::{Addition, Expression, find};
use crate::fit::joint::JointFit;
use crate::fit::size::{first_slot, sizes};

/// An effect with its values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EffectModel {
    /// Id in the catalogue, or the name of the user's own.
    pub name: String,
    /// A user's own: the formula.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expression: Option<String>,
    /// A user's own: the nonlinear parameters.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ranges: Vec<Range>,
    /// What `value` is.
    pub means: String,
    /// How large it is over all sensors.
    pub value: f64,
    /// One standard deviation.
    pub std_error: f64,
    /// Unit of both.
    pub unit: String,
    /// The parameters of each sensor.
    #[serde(rename = "sensor")]
    pub sensors: Vec<EffectOfSensor>,
}

/// The parameters of an effect at one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EffectOfSensor {
    /// Number of the sensor.
    pub number: u32,
    /// By name.
    pub parameters: BTreeMap<String, Value>,
}

impl EffectModel {
    /// Every effect of a fit of this many recordings.
    pub fn all_of(fit: &JointFit, effects: &[Addition], recordings: usize) -> Vec<Self> {
        let sizes = sizes(fit, effects, recordings);
        let pairs = effects.iter().zip(sizes);
        pairs
            .map(|(effect, size)| {
                let (expression, ranges) = match effect {
                    Addition::Expression(own) => (Some(own.text.clone()), own.ranges.clone()),
                    _ => (None, Vec::new()),
                };
                Self {
                    name: effect.name().to_owned(),
                    expression,
                    ranges,
                    means: match size.component {
                        Some(component) => format!("{} ({component})", size.size.words),
                        None => size.size.words.to_owned(),
                    },
                    value: digits(size.value),
                    std_error: digits(size.std_error),
                    unit: size.size.unit.to_owned(),
                    sensors: of_sensors(fit, effects, effect, recordings),
                }
            })
            .collect()
    }

    /// The effect itself, beside a polynomial of forces along `axes` (lateral, longitudinal) or, with
    /// `None`, beside the cylinder; what a formula names was checked when it was added.
    pub fn addition(&self, axes: Option<[bool; 2]>) -> Result<Addition, String> {
        let Some(text) = &self.expression else {
            let effect = Addition::Catalogue(find(&self.name).map_err(|error| error.to_string())?);
            return Ok(match axes {
                Some(axes) => effect.beside_polynomial(axes),
                None => effect,
            });
        };
        let any = Expression::names(text);
        let own = Expression::parse(text, &self.ranges, &any).map_err(|error| error.to_string())?;
        Ok(Addition::Expression(Arc::new(own)))
    }

    /// Values at one sensor, in the order of the parameters of `addition`; `None` where one is missing.
    pub fn values(&self, addition: &Addition, number: u32, recordings: usize) -> Option<Vec<f64>> {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let parameters = addition.parameters(recordings);
        let value = |name: &str| Some(sensor.parameters.get(name)?.value);
        parameters
            .iter()
            .map(|parameter| value(&parameter.name))
            .collect()
    }
}

fn of_sensors(
    fit: &JointFit,
    effects: &[Addition],
    effect: &Addition,
    recordings: usize,
) -> Vec<EffectOfSensor> {
    let parameters = effect.parameters(recordings);
    let sensors = fit.sensors.iter();
    sensors
        .map(|sensor| {
            let first = first_slot(sensor.base_count, effects, effect, recordings);
            let value = |i: usize| Value {
                value: digits(sensor.values[first + i]),
                std_error: digits(sensor.std_error(first + i)),
                unit: parameters[i].unit.to_string(),
                identifiable: sensor.identifiable[first + i],
            };
            EffectOfSensor {
                number: sensor.sensor,
                parameters: (0..parameters.len())
                    .map(|i| (parameters[i].name.to_string(), value(i)))
                    .collect(),
            }
        })
        .collect()
}
