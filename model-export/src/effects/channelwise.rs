//! Flexure effects for a base without geometry: each channel has its own response.
//!
//! With magnet and flexures, a force increment changes the three field axes of a sensor along dB/dF. A polynomial
//! has no such constraint: the field of a creeping lattice of magnets may differ from that under additional
//! force. The effect therefore provides only the force increment over time, and the response of each channel is a
//! free coefficient.

use std::borrow::Cow;

use nalgebra::Vector3;

use crate::effects::parameter::{EffectParameter, MagnitudeSpec, ParameterKind, ParameterScope};
use crate::effects::{Effect, ExcitationSeries, StateSeries};

/// Suffixes of the three responses of a coefficient.
const CHANNELS: [&str; 3] = ["x", "y", "z"];

/// A flexure effect with an independent response of each channel.
#[derive(Clone, Copy, Debug)]
pub struct Channelwise {
    effect: &'static Effect,
    /// Whether a lateral and a longitudinal force were recorded.
    axes: [bool; 2],
}

/// Force axis of a parameter: 0 lateral, 1 longitudinal, `None` for both.
fn axis(parameter: &EffectParameter) -> Option<usize> {
    ["_x", "_z"].iter().position(|end| parameter.name.ends_with(end))
}

impl Channelwise {
    /// `axes`: whether a lateral and a longitudinal force were recorded.
    pub fn new(effect: &'static Effect, axes: [bool; 2]) -> Self {
        Self { effect, axes }
    }

    /// The underlying effect.
    pub fn effect(&self) -> &'static Effect {
        self.effect
    }

    /// Whether the force axis of a parameter was recorded.
    fn has_force(&self, parameter: &EffectParameter) -> bool {
        axis(parameter).is_none_or(|axis| self.axes[axis])
    }

    /// Parameters whose force axis was recorded.
    fn active_parameters(&self) -> impl Iterator<Item = &'static EffectParameter> {
        let all = self.effect.parameters.iter();
        all.filter(|parameter| self.has_force(parameter))
    }

    /// Three responses in place of each coefficient; other parameters unchanged.
    pub fn parameters(&self, recordings: usize) -> Vec<EffectParameter> {
        let of = |parameter: &EffectParameter| match parameter.kind {
            ParameterKind::Coefficient => {
                CHANNELS.map(|channel| response(parameter, channel)).to_vec()
            }
            _ => parameter.repeated(recordings),
        };
        self.active_parameters().flat_map(of).collect()
    }

    /// Euclidean norm of the responses.
    pub fn size(&self) -> MagnitudeSpec {
        let unit = self.effect.parameters.first().map_or("", |p| &p.unit);
        let description = match unit {
            "N" => "response to 1 N, norm over the channels",
            "%" => "response to 1 %, norm over the channels",
            _ => "response to 1 ms, norm over the channels",
        };
        MagnitudeSpec::norm_without_prior(description, "G")
    }

    /// Adds the response of each channel to the force increment; `values` in the order of
    /// [`Channelwise::parameters`].
    pub fn apply(&self, values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
        let coefficients = self.active_parameters().filter(|p| p.is_coefficient()).count();
        let Some((responses, rest)) = values.split_at_checked(3 * coefficients) else {
            return;
        };
        let coefficients = self.active_parameters().filter(|p| p.is_coefficient());
        for (coefficient, response) in coefficients.zip(responses.chunks_exact(3)) {
            let response = Vector3::from_column_slice(response);
            if response == Vector3::zeros() {
                continue;
            }
            let increment_n = self.unit_increment(coefficient, rest, excitation, series);
            for (state, increment_n) in series.states.iter_mut().zip(increment_n) {
                state.offset_g += response * increment_n;
            }
        }
    }

    /// Force increment in newtons, row by row, with one coefficient at one unit and the others at zero.
    fn unit_increment(
        &self,
        coefficient: &EffectParameter,
        rest: &[f64],
        excitation: &ExcitationSeries,
        series: &StateSeries,
    ) -> Vec<f64> {
        let mut changed = StateSeries {
            force_n: series.force_n.clone(),
            opening_mm: Vec::new(),
            states: Vec::new(),
        };
        let values = self.effect_values(coefficient, rest);
        (self.effect.apply)(&values, excitation, &mut changed);
        let rows = changed.force_n.iter().zip(&series.force_n);
        rows.map(|(after, before)| after[0] - before[0] + after[1] - before[1]).collect()
    }

    /// Values of all parameters of the effect: one coefficient at one unit, the others from `rest`. Shapes of a
    /// missing force axis have no influence; they are set to the middle of the grid.
    fn effect_values(&self, coefficient: &EffectParameter, rest: &[f64]) -> Vec<f64> {
        let mut rest = rest.iter().copied();
        let count = |condition: fn(&EffectParameter) -> bool| {
            let active = self.active_parameters().filter(|parameter| !parameter.is_coefficient());
            active.filter(|parameter| condition(parameter)).count()
        };
        let (once, each) = (
            count(|p| p.scope == ParameterScope::Campaign),
            count(|p| p.scope != ParameterScope::Campaign),
        );
        let recordings = rest.len().saturating_sub(once) / each.max(1);
        let mut values = Vec::new();
        for parameter in self.effect.parameters {
            let count = match parameter.scope {
                ParameterScope::Campaign => 1,
                _ => recordings,
            };
            let default = match &parameter.kind {
                ParameterKind::Coefficient => {
                    f64::from(u8::from(parameter.name == coefficient.name))
                }
                ParameterKind::Shape { grid } => grid[grid.len() / 2],
                ParameterKind::InitialState | ParameterKind::Instant => 0.0,
            };
            for _ in 0..count {
                let is_default = parameter.is_coefficient() || !self.has_force(parameter);
                let given = if is_default { None } else { rest.next() };
                values.push(given.unwrap_or(default));
            }
        }
        values
    }
}

/// Response of one channel in gauss per newton of the force increment by one unit of the coefficient; no prior
/// magnitude.
fn response(coefficient: &EffectParameter, channel: &str) -> EffectParameter {
    EffectParameter {
        name: Cow::Owned(format!("{}_{channel}", coefficient.name)),
        unit: Cow::Borrowed("G"),
        typical: f64::NAN,
        ..coefficient.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{EffectStage, EffectTerm, find};

    fn excitation() -> ExcitationSeries {
        let time_s: Vec<f64> = (0..400).map(|i| f64::from(i) * 0.05).collect();
        let force = |t: &f64| [0.0, 20.0 + 15.0 * (0.7 * t).sin()];
        ExcitationSeries {
            force_n: time_s.iter().map(force).collect(),
            smooth_n: time_s.iter().map(force).collect(),
            rate_n_per_s: vec![[0.0; 2]; time_s.len()],
            cycles: vec![[0.0; 2]; time_s.len()],
            time_s,
            ..ExcitationSeries::default()
        }
    }

    fn longitudinal(name: &str) -> EffectTerm {
        EffectTerm::Catalogue(find(name).unwrap()).for_polynomial([false, true])
    }

    #[test]
    fn each_channel_has_parameters_for_recorded_axes_only() {
        let names = |name: &str| -> Vec<String> {
            let parameters = longitudinal(name).parameters(2);
            parameters.iter().map(|p| p.name.to_string()).collect()
        };
        assert_eq!(
            names("creep"),
            ["creep_z_x", "creep_z_y", "creep_z_z", "time1", "time2", "weight"]
        );
        let hysteresis = names("hysteresis");
        assert_eq!(hysteresis[..3], ["friction_z_x", "friction_z_y", "friction_z_z"]);
        assert_eq!(hysteresis[hysteresis.len() - 2..], ["begin_z_1", "begin_z_2"]);
        assert_eq!(hysteresis.len(), 3 + 5 + 2);
    }

    #[test]
    fn channels_respond_to_the_unit_increment() {
        let excitation = excitation();
        let shapes = [3.0, 6.0, 20.0, 0.5, 2.0];
        let all_values: Vec<f64> =
            [0.0, 1.0].into_iter().chain(shapes).chain(shapes).chain([0.0, 0.3]).collect();
        let effect = EffectTerm::Catalogue(find("hysteresis").unwrap());
        let shifted = StateSeries::of(&excitation, [1.0; 2], &[(&effect, &all_values)]);
        let values: Vec<f64> = [0.5, -2.0, 0.0].into_iter().chain(shapes).chain([0.3]).collect();
        let channelwise = longitudinal("hysteresis");
        let series = StateSeries::of(&excitation, [1.0; 2], &[(&channelwise, &values)]);
        for (row, state) in series.states.iter().enumerate() {
            let shift_n = shifted.force_n[row][1] - excitation.force_n[row][1];
            assert_eq!(series.force_n[row], excitation.force_n[row]);
            let expected = Vector3::new(0.5, -2.0, 0.0) * shift_n;
            assert!((state.offset_g - expected).norm() < 1e-12);
        }
        assert!(series.states.iter().any(|state| state.offset_g.x.abs() > 0.4));
    }

    #[test]
    fn only_flexure_effects_become_channelwise() {
        assert!(matches!(longitudinal("creep"), EffectTerm::Channelwise(_)));
        assert_eq!(longitudinal("creep").stage(), EffectStage::Sensor);
        assert!(matches!(longitudinal("field_drift"), EffectTerm::Catalogue(_)));
    }
}
