//! How large an effect is over all sensors, as one number with its error bar.

use super::joint::{JointFit, SensorFit};
use crate::effects::{Addition, Size, SizeOf};

/// A component stands out where it is this many error bars from zero.
const STANDS_OUT: f64 = 4.0;

/// A sensor by itself is meant where it shows this many times the mean over all.
const ALONE: f64 = 3.0;

/// The size of an effect.
#[derive(Clone, Debug)]
pub struct EffectSize {
    /// In the unit of `size`.
    pub value: f64,
    /// One standard deviation.
    pub std_error: f64,
    /// The coefficient that it is, where it is one of several.
    pub component: Option<String>,
    /// What the number means, and what is typical.
    pub size: Size,
}

impl EffectSize {
    /// True where no one would wonder at it.
    pub fn is_plausible(&self) -> bool {
        self.within(self.size.plausible)
    }

    /// True where physics allows it.
    pub fn is_possible(&self) -> bool {
        self.within(self.size.possible)
    }

    /// Two error bars of benefit of the doubt.
    fn within(&self, (low, high): (f64, f64)) -> bool {
        let slack = 2.0 * self.std_error;
        self.value + slack >= low && self.value - slack <= high
    }
}

/// The sizes of `effects`, which `fit` holds in the order of their stages; returned in the given
/// order.
pub fn sizes(fit: &JointFit, effects: &[Addition], recordings: usize) -> Vec<EffectSize> {
    effects
        .iter()
        .map(|effect| size_of(fit, effects, effect, recordings))
        .collect()
}

/// Where `effect` has its parameters in a fit with `effects`.
pub fn first_slot(
    base_count: usize,
    effects: &[Addition],
    effect: &Addition,
    recordings: usize,
) -> usize {
    let mut sorted: Vec<&Addition> = effects.iter().collect();
    sorted.sort_by_key(|effect| effect.stage());
    let before = sorted.into_iter().take_while(|other| *other != effect);
    base_count
        + before
            .map(|other| other.parameters(recordings).len())
            .sum::<usize>()
}

fn size_of(
    fit: &JointFit,
    effects: &[Addition],
    effect: &Addition,
    recordings: usize,
) -> EffectSize {
    let size = effect.size();
    let parameters = effect.parameters(recordings);
    let coefficients = parameters
        .iter()
        .filter(|parameter| parameter.is_coefficient())
        .count();
    let count = if size.first == 0 {
        coefficients
    } else {
        size.first.min(coefficients)
    };
    let slots = |sensor: &SensorFit| {
        let first = first_slot(sensor.base_count, effects, effect, recordings);
        first..first + count
    };
    // Steps of recordings come before the slope, which is another unit.
    let count = match parameters
        .iter()
        .take(count)
        .all(|p| p.unit == parameters[0].unit)
    {
        true => count,
        false => count.saturating_sub(1),
    };
    let single = |i: usize| {
        mean(fit.sensors.iter().map(|sensor| {
            let slot = slots(sensor).start + i;
            (sensor.values[slot], sensor.std_error(slot))
        }))
    };
    let (value, std_error, component) = match size.of {
        SizeOf::Largest => {
            let all: Vec<(f64, f64)> = (0..count).map(single).collect();
            let significance = |i: usize| all[i].0.abs() / all[i].1.max(f64::MIN_POSITIVE);
            let stands_out = |i: &usize| significance(*i) >= STANDS_OUT;
            let largest = (0..count)
                .filter(stands_out)
                .max_by(|&a, &b| all[a].0.abs().total_cmp(&all[b].0.abs()));
            let most = || (0..count).max_by(|&a, &b| significance(a).total_cmp(&significance(b)));
            let chosen = largest.or_else(most).unwrap_or(0);
            let (value, std_error) = all.get(chosen).copied().unwrap_or((f64::NAN, f64::NAN));
            let own = (0..count).flat_map(|i| {
                fit.sensors.iter().map(move |sensor| {
                    let slot = slots(sensor).start + i;
                    (i, sensor, sensor.values[slot], sensor.std_error(slot))
                })
            });
            let one = own
                .filter(|(.., value, error)| value.abs() >= STANDS_OUT * error)
                .max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
            match one {
                // A flexure or a channel by itself: a mean over all would hide it.
                Some((i, sensor, single, error)) if single.abs() > ALONE * value.abs() => {
                    let name = &parameters[i].name;
                    let component = format!("{name} of sensor {}", sensor.sensor);
                    (single, error, Some(component))
                }
                _ => {
                    let name = || parameters[chosen].name.to_string();
                    (value, std_error, (count > 1).then(name))
                }
            }
        }
        SizeOf::Greatest(of) | SizeOf::Mean(of) => {
            let all = fit.sensors.iter().map(|sensor| {
                let first = slots(sensor).start;
                made(sensor, first..first + parameters.len(), of)
            });
            let all: Vec<(f64, f64)> = all.collect();
            match size.of {
                SizeOf::Mean(_) => {
                    let (value, std_error) = plain_mean(&all);
                    (value, std_error, None)
                }
                _ => {
                    let greatest = all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
                    let (value, std_error) = greatest.unwrap_or((f64::NAN, f64::NAN));
                    (value, std_error, None)
                }
            }
        }
        SizeOf::Norm => {
            let norms: Vec<(f64, f64)> = fit.sensors.iter().map(|s| norm(s, slots(s))).collect();
            let (value, error) = plain_mean(&norms);
            let shared = parameters.first().is_some_and(|parameter| parameter.shared);
            let of_one = norms.first().map_or(error, |norm| norm.1);
            (value, if shared { of_one } else { error }, None)
        }
    };
    EffectSize {
        value: value * size.factor,
        std_error: (std_error * size.factor).hypot(size.resolution),
        component,
        size,
    }
}

/// What `of` makes of the values of these slots, and its error bar to first order.
fn made(sensor: &SensorFit, slots: std::ops::Range<usize>, of: fn(&[f64]) -> f64) -> (f64, f64) {
    let values = &sensor.values[slots.clone()];
    let value = of(values);
    let slope = |i: usize| {
        let step = 0.1 * sensor.std_error(slots.start + i).max(1e-9);
        let mut moved = values.to_vec();
        moved[i] += step;
        (of(&moved) - value) / step
    };
    let slopes: Vec<f64> = (0..values.len()).map(slope).collect();
    let mut variance = 0.0;
    for (i, a) in slots.clone().enumerate() {
        for (j, b) in slots.clone().enumerate() {
            variance += slopes[i] * sensor.covariance[(a, b)] * slopes[j];
        }
    }
    (value, variance.max(0.0).sqrt())
}

/// Root of the sum of squares and its error bar. Noise alone has a norm as well: its expected square
/// is taken off.
fn norm(sensor: &SensorFit, slots: std::ops::Range<usize>) -> (f64, f64) {
    let values: Vec<f64> = slots.clone().map(|slot| sensor.values[slot]).collect();
    let noise: f64 = slots
        .clone()
        .map(|slot| sensor.std_error(slot).powi(2))
        .sum();
    let square: f64 = values.iter().map(|v| v * v).sum();
    let norm = square.sqrt().max(f64::MIN_POSITIVE);
    let mut variance = 0.0;
    for (i, a) in slots.clone().enumerate() {
        for (j, b) in slots.clone().enumerate() {
            variance += values[i] / norm * sensor.covariance[(a, b)] * values[j] / norm;
        }
    }
    ((square - noise).max(0.0).sqrt(), variance.max(0.0).sqrt())
}

/// Sensors differ in where they stand: their plain mean is the gripper's.
fn plain_mean(values: &[(f64, f64)]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let sum: f64 = values.iter().map(|(value, _)| value).sum();
    let squares: f64 = values.iter().map(|(_, error)| error * error).sum();
    (sum / n, squares.sqrt() / n)
}

/// Mean with the weights of the error bars; sensors that disagree widen it.
fn mean(values: impl Iterator<Item = (f64, f64)> + Clone) -> (f64, f64) {
    let weight = |error: f64| 1.0 / error.max(1e-12).powi(2);
    let total: f64 = values.clone().map(|(_, error)| weight(error)).sum();
    let mean = values
        .clone()
        .map(|(value, error)| value * weight(error))
        .sum::<f64>()
        / total;
    let spread: f64 = values
        .clone()
        .map(|(value, error)| (value - mean).powi(2) * weight(error))
        .sum();
    let freedom = values.count().saturating_sub(1);
    let birge = if freedom > 0 {
        (spread / freedom as f64).max(1.0)
    } else {
        1.0
    };
    (mean, (birge / total).sqrt())
}
