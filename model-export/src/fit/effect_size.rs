//! Magnitude of an effect over all sensors, with its standard error.

use std::borrow::Cow;

use nalgebra::DVector;

use crate::effects::{Aggregation, EffectTerm, MagnitudeSpec};
use crate::fit::block_bootstrap::jackknife;
use crate::fit::joint::{JointFit, SensorFit};

/// Threshold of significance in standard errors.
const SIGNIFICANT: f64 = 4.0;

/// Minimum number of folds for a jackknife.
const MIN_FOLDS: usize = 3;

/// A single sensor is reported where its value exceeds the mean of all by this factor.
const OUTLIER_RATIO: f64 = 3.0;

/// Magnitude of an effect.
#[derive(Clone, Debug)]
pub struct EffectSize {
    /// In `unit`.
    pub value: f64,
    /// Standard error.
    pub std_error: f64,
    /// The part of it that shows whether the effect is there: without what its prior takes from every sensor, and without the scatter
    /// over shapes.
    pub data_error: f64,
    /// Least and largest value of a sensor with their standard errors, in `unit`, where the sensors differ so much that the magnitude
    /// describes none of them.
    pub extremes: Option<[(f64, f64); 2]>,
    /// Unit of the magnitude.
    pub unit: Cow<'static, str>,
    /// Name of the coefficient where there are several.
    pub component: Option<String>,
    /// Definition, with typical and plausible values.
    pub size: MagnitudeSpec,
    /// The largest absolute value of a sensor where the magnitude is a mean that may cancel, else that of the magnitude.
    pub largest: f64,
    /// Chi-squared of all coefficients of all sensors against zero, above its expectation, in its standard deviations: coefficients that
    /// only a prior separates from each other or from the model's parameters are not determined one by one.
    pub significance: f64,
}

impl EffectSize {
    /// Whether it is within the plausible range.
    pub fn is_plausible(&self) -> bool {
        self.is_within(self.size.plausible)
    }

    /// Whether the magnitude is larger than two of its standard errors, or the coefficients together are significant. Without an error
    /// it is.
    pub fn is_determined(&self) -> bool {
        self.std_error.is_nan()
            || self.value.abs() >= 2.0 * self.data_error
            || self.significance >= SIGNIFICANT
    }

    /// Whether it is within the physically possible range.
    pub fn is_possible(&self) -> bool {
        self.is_within(self.size.possible)
    }

    /// Least and largest value of a sensor where the magnitude describes none of them.
    pub fn differs(&self) -> Option<[f64; 2]> {
        self.extremes.map(|extremes| extremes.map(|(value, _)| value))
    }

    /// The mean of sensors that differ can be possible where that of a sensor is not.
    fn is_within(&self, range: (f64, f64)) -> bool {
        let own = self.extremes.iter().flatten().copied();
        own.chain([(self.value, self.data_error)]).all(|value| within(value, range))
    }

    /// Whether a single coefficient is physically possible; the components of a norm have any sign.
    pub fn allows_coefficient(&self, value: f64, std_error: f64, unit: &str) -> bool {
        let is_magnitude =
            matches!(self.size.aggregation, Aggregation::Largest) && unit == self.size.unit;
        !is_magnitude || within((value, std_error), self.size.possible)
    }
}

/// Whether a value with its standard error is in a range, with a tolerance of two standard errors.
fn within((value, std_error): (f64, f64), (low, high): (f64, f64)) -> bool {
    value + 2.0 * std_error >= low && value - 2.0 * std_error <= high
}

/// Magnitudes of `effects`, in the given order; `fit` has them in the order of their stages.
///
/// The standard error is the larger of that by blocks of time and, of three folds and more, that of the jackknife over the folds: the
/// first is linear at the solution and misses what differs between recordings, such as the rate of a clock. The scatter over shapes
/// that the recordings do not exclude is added where the fit has their profiles. An event has no standard error: it is within one block.
pub fn effect_sizes(fit: &JointFit, effects: &[EffectTerm], recordings: usize) -> Vec<EffectSize> {
    let folds: Vec<JointFit> = (0..fit.fold_count()).map(|fold| fit.without(fold)).collect();
    let of = |effect: &EffectTerm| {
        let mut size = effect_size(fit, effects, effect, recordings);
        if effect.is_event() {
            // Draws of blocks without the event do not determine it.
            (size.std_error, size.data_error) = (f64::NAN, 0.0);
            return size;
        }
        let others = folds.iter().map(|fold| effect_size(fold, effects, effect, recordings));
        let same = others.filter(|other| other.component == size.component);
        let values: Vec<f64> = same.map(|other| other.value).collect();
        if values.len() == folds.len() && folds.len() >= MIN_FOLDS {
            let between = jackknife(&values);
            size.std_error = size.std_error.max(between);
            size.data_error = size.data_error.max(between);
        }
        let variance = fit.profiles.iter().map(|profile| {
            profile.variance(|values| {
                let other = fit.with_values(values.iter().cloned().map(Some));
                let other = effect_size(&other, effects, effect, recordings);
                (other.unit == size.unit).then_some(other.value)
            })
        });
        size.std_error = size.std_error.hypot(variance.sum::<f64>().sqrt());
        size
    };
    effects.iter().map(of).collect()
}

/// Index of the first parameter of `effect` in a fit with `effects`.
pub fn first_parameter(
    base_count: usize,
    effects: &[EffectTerm],
    effect: &EffectTerm,
    recordings: usize,
) -> usize {
    let mut sorted: Vec<&EffectTerm> = effects.iter().collect();
    sorted.sort_by_key(|effect| effect.stage());
    let before = sorted.into_iter().take_while(|other| *other != effect);
    base_count + before.map(|other| other.parameters(recordings).len()).sum::<usize>()
}

fn effect_size(
    fit: &JointFit,
    effects: &[EffectTerm],
    effect: &EffectTerm,
    recordings: usize,
) -> EffectSize {
    let size = effect.size();
    let parameters = effect.parameters(recordings);
    let coefficients = parameters.iter().filter(|parameter| parameter.is_coefficient()).count();
    let count = if size.first == 0 { coefficients } else { size.first.min(coefficients) };
    let indices = |sensor: &SensorFit| {
        let first = first_parameter(sensor.base_count, effects, effect, recordings);
        first..first + count
    };
    let excess = fit.sensors.iter().map(|sensor| {
        let first = indices(sensor).start;
        chi_squared(sensor, first..first + coefficients) - coefficients as f64
    });
    let degrees = (coefficients * fit.sensors.len()).max(1) as f64;
    let significance = excess.sum::<f64>() / (2.0 * degrees).sqrt();
    // Steps between recordings precede the slope, which has another unit.
    let is_formula = effect.effect().is_none();
    let one_unit =
        is_formula || parameters.iter().take(count).all(|p| p.unit == parameters[0].unit);
    let count = if one_unit { count } else { count.saturating_sub(1) };
    let single_with = |i: usize, prior: f64| {
        mean(fit.sensors.iter().map(|sensor| {
            let index = indices(sensor).start + i;
            (sensor.values[index], sensor.std_error(index), prior * sensor.prior_errors[index])
        }))
    };
    // Whether a coefficient is there: the errors of the sensors are independent.
    let single = |i: usize| single_with(i, 0.0);
    let mut with_prior = None;
    let mut of_sensors: Vec<(f64, f64)> = Vec::new();
    let (value, std_error, component) = match size.aggregation {
        Aggregation::Largest => {
            let all: Vec<(f64, f64)> = (0..count).map(single).collect();
            let significance = |i: usize| all[i].0.abs() / all[i].1.max(f64::MIN_POSITIVE);
            let significant = |i: &usize| significance(*i) >= SIGNIFICANT;
            let largest = (0..count)
                .filter(significant)
                .max_by(|&a, &b| all[a].0.abs().total_cmp(&all[b].0.abs()));
            let most_significant =
                || (0..count).max_by(|&a, &b| significance(a).total_cmp(&significance(b)));
            let chosen = largest.or_else(most_significant).unwrap_or(0);
            let (value, std_error) = all.get(chosen).copied().unwrap_or((f64::NAN, f64::NAN));
            with_prior = (chosen < count).then(|| single_with(chosen, 1.0).1);
            let own = (0..count).flat_map(|i| {
                fit.sensors.iter().map(move |sensor| {
                    let index = indices(sensor).start + i;
                    (i, sensor, sensor.values[index], sensor.std_error(index))
                })
            });
            let one = own
                .filter(|(.., value, error)| value.abs() >= SIGNIFICANT * error)
                .max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
            match one {
                // A defect of a single flexure or channel would vanish in the mean over all.
                Some((i, sensor, single, error)) if single.abs() > OUTLIER_RATIO * value.abs() => {
                    let name = &parameters[i].name;
                    with_prior = None;
                    let component = format!("{name} of sensor {}", sensor.sensor);
                    (single, error, Some(component))
                }
                _ => {
                    let name = || parameters[chosen].name.to_string();
                    let values = fit.sensors.iter().map(|sensor| {
                        let index = indices(sensor).start + chosen;
                        (sensor.values[index], sensor.std_error(index))
                    });
                    of_sensors = values.collect();
                    (value, std_error, (count > 1).then(name))
                }
            }
        }
        Aggregation::Max(of) | Aggregation::Mean(of) => {
            let all = fit.sensors.iter().map(|sensor| {
                let first = indices(sensor).start;
                propagate(sensor, first..first + parameters.len(), of)
            });
            of_sensors = all.collect();
            let (value, std_error) = if matches!(size.aggregation, Aggregation::Mean(_)) {
                unweighted_mean(&of_sensors)
            } else {
                let max = of_sensors.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
                max.unwrap_or((f64::NAN, f64::NAN))
            };
            (value, std_error, None)
        }
        Aggregation::Norm => {
            of_sensors = fit.sensors.iter().map(|s| norm(s, indices(s))).collect();
            let (value, error) = unweighted_mean(&of_sensors);
            let shared = parameters.first().is_some_and(|parameter| parameter.shared);
            let of_one = of_sensors.first().map_or(error, |norm| norm.1);
            (value, if shared { of_one } else { error }, None)
        }
    };
    // Where its usual measure is not determined, the effect may act through another coefficient: the gain of a sensor's drift
    // instead of the offset.
    if value.is_nan() || value.abs() < 2.0 * std_error {
        let others = count..coefficients;
        let ratio = |i: &usize| single(*i).0.abs() / single(*i).1.max(f64::MIN_POSITIVE);
        let best = others.max_by(|a, b| ratio(a).total_cmp(&ratio(b)));
        if let Some(i) = best.filter(|i| ratio(i) >= SIGNIFICANT)
            && let Cow::Borrowed(unit) = parameters[i].unit
        {
            let (value, std_error) = single(i);
            let size = MagnitudeSpec {
                description: size.description,
                unit,
                typical: parameters[i].typical,
                ..MagnitudeSpec::DEFAULT
            };
            let component = Some(format!("here {}", parameters[i].name));
            return EffectSize {
                value,
                std_error,
                data_error: std_error,
                extremes: None,
                unit: Cow::Borrowed(unit),
                component,
                size,
                largest: value.abs(),
                significance,
            };
        }
    }
    let own = fit.sensors.iter().flat_map(|sensor| {
        let first = indices(sensor).start;
        sensor.values[first..first + count].iter().map(|value| value.abs())
    });
    let largest = match size.aggregation {
        Aggregation::Largest => own.fold(value.abs(), f64::max),
        _ => value.abs(),
    };
    EffectSize {
        value: value * size.factor,
        std_error: with_prior.unwrap_or(std_error) * size.factor.abs(),
        data_error: std_error * size.factor.abs(),
        extremes: extremes(&of_sensors).map(|extremes| {
            extremes.map(|(value, error)| (value * size.factor, error * size.factor.abs()))
        }),
        unit: effect.size_unit(),
        component,
        size,
        largest: largest * size.factor.abs(),
        significance,
    }
}

/// Least and largest of the sensors' values with their standard errors, where their difference is significant and larger than half of
/// the largest magnitude: smaller ones are manufacturing tolerances.
fn extremes(values: &[(f64, f64)]) -> Option<[(f64, f64); 2]> {
    let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.0.total_cmp(&b.0);
    let (least, largest) = (*values.iter().min_by(by_value)?, *values.iter().max_by(by_value)?);
    let difference = largest.0 - least.0;
    let is_significant = difference >= SIGNIFICANT * largest.1.hypot(least.1);
    let is_large = difference > 0.5 * largest.0.abs().max(least.0.abs());
    (is_significant && is_large).then_some([least, largest])
}

/// Squares of some parameters in their standard errors, with their correlations.
fn chi_squared(sensor: &SensorFit, parameters: std::ops::Range<usize>) -> f64 {
    let count = parameters.len();
    let values = DVector::from_column_slice(&sensor.values[parameters.clone()]);
    let covariance =
        sensor.covariance.view((parameters.start, parameters.start), (count, count)).into_owned();
    let eigen = covariance.symmetric_eigen();
    let least = 1e-12 * eigen.eigenvalues.max();
    // Directions without a variance are not fitted.
    let fitted = eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues);
    let squares = fitted.filter(|(_, variance)| **variance > least);
    squares.map(|(axis, variance)| axis.dot(&values).powi(2) / variance).sum()
}

/// `of` applied to the values of these parameters, with its standard error to first order.
fn propagate(
    sensor: &SensorFit,
    parameters: std::ops::Range<usize>,
    of: fn(&[f64]) -> f64,
) -> (f64, f64) {
    let values = &sensor.values[parameters.clone()];
    let value = of(values);
    let slope = |i: usize| {
        let step = 0.1 * sensor.std_error(parameters.start + i).max(1e-9);
        let mut moved = values.to_vec();
        moved[i] += step;
        (of(&moved) - value) / step
    };
    let slopes: Vec<f64> = (0..values.len()).map(slope).collect();
    let mut variance = 0.0;
    for (i, a) in parameters.clone().enumerate() {
        for (j, b) in parameters.clone().enumerate() {
            variance += slopes[i] * sensor.covariance[(a, b)] * slopes[j];
        }
    }
    (value, variance.max(0.0).sqrt())
}

/// Norm and its standard error. The expected square of noise is subtracted. Where the recordings determine a coefficient at all, those
/// that they do not determine (of the force on this sensor, in a formula of those on the others) are no part of it.
fn norm(sensor: &SensorFit, parameters: std::ops::Range<usize>) -> (f64, f64) {
    let is_determined = |index: &usize| sensor.identifiable[*index];
    let is_any = parameters.clone().any(|index| is_determined(&index));
    let parameters = parameters.filter(move |index| !is_any || is_determined(index));
    let values: Vec<f64> = parameters.clone().map(|index| sensor.values[index]).collect();
    let noise: f64 = parameters.clone().map(|index| sensor.std_error(index).powi(2)).sum();
    let square: f64 = values.iter().map(|v| v * v).sum();
    let norm = square.sqrt().max(f64::MIN_POSITIVE);
    let mut variance = 0.0;
    for (i, a) in parameters.clone().enumerate() {
        for (j, b) in parameters.clone().enumerate() {
            variance += values[i] / norm * sensor.covariance[(a, b)] * values[j] / norm;
        }
    }
    ((square - noise).max(0.0).sqrt(), variance.max(0.0).sqrt())
}

/// Unweighted mean, for quantities that differ between sensors.
fn unweighted_mean(values: &[(f64, f64)]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let sum: f64 = values.iter().map(|(value, _)| value).sum();
    let squares: f64 = values.iter().map(|(_, error)| error * error).sum();
    (sum / n, squares.sqrt() / n)
}

/// Inverse-variance weighted mean of values with their standard errors, of which a part is by the prior; scatter between sensors
/// widens its error (Birge). The prior of an effect is zero for every sensor, and what it takes from one it takes from all: these
/// parts add up.
fn mean(values: impl Iterator<Item = (f64, f64, f64)> + Clone) -> (f64, f64) {
    let weight = |error: f64| 1.0 / error.max(1e-12).powi(2);
    let total: f64 = values.clone().map(|(_, error, _)| weight(error)).sum();
    let weighted = |of: &dyn Fn(f64, f64) -> f64| {
        values
            .clone()
            .map(|(value, error, by_prior)| of(value, by_prior) * weight(error))
            .sum::<f64>()
    };
    let mean = weighted(&|value, _| value) / total;
    let scatter = weighted(&|value, _| (value - mean).powi(2));
    let freedom = values.clone().count().saturating_sub(1);
    let birge = if freedom > 0 { (scatter / freedom as f64).max(1.0) } else { 1.0 };
    // Of independent errors the variance already holds this.
    let independent: f64 =
        values.clone().map(|(_, error, by_prior)| (by_prior * weight(error) / total).powi(2)).sum();
    let common = (weighted(&|_, by_prior| by_prior) / total).powi(2) - independent;
    (mean, (birge / total + common.max(0.0)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four sensors with an error of 0.2, of which 0.12 is by the prior: 0.2^2/4 + 0.12^2 (1 - 1/4).
    #[test]
    fn what_the_prior_takes_does_not_average_out() {
        let of = |by_prior: f64| mean(std::iter::repeat_n((1.0, 0.2, by_prior), 4));
        assert!((of(0.0).1 - 0.1).abs() < 1e-12);
        assert!((of(0.12).1 - 0.0208_f64.sqrt()).abs() < 1e-12);
        assert_eq!(of(0.12).0, 1.0);
    }
}
