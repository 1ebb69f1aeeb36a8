//! An effect of the flexures where no geometry is known: each channel answers on its own.
//!
//! With magnet and flexures known, a shift of the force moves all three axes of a sensor along dB/dF.
//! A polynomial knows neither: what a lattice of many magnets shows while it creeps need not be what it
//! shows under more force. So the effect only says when it acts (its shift of the force over time), and
//! how far each channel answers is a coefficient of its own.

use std::borrow::Cow;

use nalgebra::Vector3;

use super::parameter::{Kind, Of, Parameter, Size};
use super::{Effect, Series, Track, repeated};

/// Names of a coefficient's three answers end in these.
const CHANNELS: [&str; 3] = ["x", "y", "z"];

/// An effect of the flexures that the channels of a sensor follow each by its own measure.
#[derive(Clone, Copy, Debug)]
pub struct Channelwise {
    effect: &'static Effect,
    /// Whether a lateral and a longitudinal force were recorded.
    axes: [bool; 2],
}

/// Along which force a parameter of an effect acts: 0 lateral, 1 longitudinal, `None` for both.
fn axis(parameter: &Parameter) -> Option<usize> {
    ["_x", "_z"]
        .iter()
        .position(|end| parameter.name.ends_with(end))
}

impl Channelwise {
    /// The effect along the forces that were recorded.
    pub fn new(effect: &'static Effect, axes: [bool; 2]) -> Self {
        Self { effect, axes }
    }

    /// The effect itself.
    pub fn effect(&self) -> &'static Effect {
        self.effect
    }

    /// Whether a parameter of the effect has a force to act along.
    fn has_force(&self, parameter: &Parameter) -> bool {
        axis(parameter).is_none_or(|axis| self.axes[axis])
    }

    /// The parameters of the effect that have a force to act along.
    fn kept(&self) -> impl Iterator<Item = &'static Parameter> {
        let all = self.effect.parameters.iter();
        all.filter(|parameter| self.has_force(parameter))
    }

    /// Three answers in place of each coefficient; shapes and beginnings as they are.
    pub fn parameters(&self, recordings: usize) -> Vec<Parameter> {
        let of = |parameter: &Parameter| match parameter.kind {
            Kind::Coefficient => CHANNELS.map(|channel| answer(parameter, channel)).to_vec(),
            _ => repeated(parameter, recordings),
        };
        self.kept().flat_map(of).collect()
    }

    /// The channels' answers together.
    pub fn size(&self) -> Size {
        let unit = self.effect.parameters.first().map_or("", |p| &p.unit);
        let words = match unit {
            "N" => "answer to 1 N of it, root of the sum of squares of the channels",
            "%" => "answer to 1 % of it, root of the sum of squares of the channels",
            _ => "answer to 1 ms of it, root of the sum of squares of the channels",
        };
        Size::unexpected(words, "G")
    }

    /// Adds to the reading what each channel makes of the shift of the force. `values` are in the order
    /// of [`Channelwise::parameters`].
    pub fn apply(&self, values: &[f64], track: &Track, series: &mut Series) {
        let coefficients = self.kept().filter(|p| p.is_coefficient()).count();
        let Some((answers, rest)) = values.split_at_checked(3 * coefficients) else {
            return;
        };
        let coefficients = self.kept().filter(|p| p.is_coefficient());
        for (coefficient, answer) in coefficients.zip(answers.chunks_exact(3)) {
            let answer = Vector3::from_column_slice(answer);
            if answer == Vector3::zeros() {
                continue;
            }
            let shift_n = self.unit_shift(coefficient, rest, track, series);
            for (state, shift_n) in series.states.iter_mut().zip(shift_n) {
                state.offset_g += answer * shift_n;
            }
        }
    }

    /// The shift of the force in newtons, row by row, that the effect makes with one coefficient at one
    /// unit and the others at zero.
    fn unit_shift(
        &self,
        coefficient: &Parameter,
        rest: &[f64],
        track: &Track,
        series: &Series,
    ) -> Vec<f64> {
        let mut shifted = Series {
            force_n: series.force_n.clone(),
            opening_mm: Vec::new(),
            states: Vec::new(),
        };
        let values = self.whole(coefficient, rest);
        (self.effect.apply)(&values, track, &mut shifted);
        let rows = shifted.force_n.iter().zip(&series.force_n);
        rows.map(|(after, before)| after[0] - before[0] + after[1] - before[1])
            .collect()
    }

    /// Values of the whole effect: one coefficient at one unit, shapes and beginnings from `rest`. A
    /// shape without a force is never used; it stands at the middle of its grid.
    fn whole(&self, coefficient: &Parameter, rest: &[f64]) -> Vec<f64> {
        let mut rest = rest.iter().copied();
        let counted = |of: fn(&Parameter) -> bool| {
            let kept = self.kept().filter(|parameter| !parameter.is_coefficient());
            kept.filter(|parameter| of(parameter)).count()
        };
        let (once, each) = (
            counted(|p| p.of == Of::Campaign),
            counted(|p| p.of != Of::Campaign),
        );
        let recordings = rest.len().saturating_sub(once) / each.max(1);
        let mut values = Vec::new();
        for parameter in self.effect.parameters {
            let count = match parameter.of {
                Of::Campaign => 1,
                _ => recordings,
            };
            let without = match &parameter.kind {
                Kind::Coefficient => f64::from(u8::from(parameter.name == coefficient.name)),
                Kind::Shape { grid } => grid[grid.len() / 2],
                Kind::Beginning | Kind::Instant => 0.0,
            };
            for _ in 0..count {
                let given = match parameter.is_coefficient() || !self.has_force(parameter) {
                    true => None,
                    false => rest.next(),
                };
                values.push(given.unwrap_or(without));
            }
        }
        values
    }
}

/// How one channel answers, in gauss for each newton by which one unit of the coefficient shifts the
/// force. Nobody knows beforehand how much that is.
fn answer(coefficient: &Parameter, channel: &str) -> Parameter {
    Parameter {
        name: Cow::Owned(format!("{}_{channel}", coefficient.name)),
        unit: Cow::Borrowed("G"),
        typical: f64::NAN,
        ..coefficient.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Addition, Stage, find};

    fn track() -> Track {
        let time_s: Vec<f64> = (0..400).map(|i| f64::from(i) * 0.05).collect();
        let force = |t: &f64| [0.0, 20.0 + 15.0 * (0.7 * t).sin()];
        Track {
            force_n: time_s.iter().map(force).collect(),
            smooth_n: time_s.iter().map(force).collect(),
            rate_n_per_s: vec![[0.0; 2]; time_s.len()],
            cycles: vec![[0.0; 2]; time_s.len()],
            time_s,
            ..Track::default()
        }
    }

    fn longitudinal(name: &str) -> Addition {
        Addition::Catalogue(find(name).unwrap()).beside_polynomial([false, true])
    }

    #[test]
    fn an_axis_without_a_force_has_no_parameters_and_every_channel_has_its_own() {
        let names = |name: &str| -> Vec<String> {
            let parameters = longitudinal(name).parameters(2);
            parameters.iter().map(|p| p.name.to_string()).collect()
        };
        assert_eq!(
            names("creep"),
            [
                "creep_z_x",
                "creep_z_y",
                "creep_z_z",
                "time1",
                "time2",
                "weight"
            ]
        );
        let hysteresis = names("hysteresis");
        assert_eq!(
            hysteresis[..3],
            ["friction_z_x", "friction_z_y", "friction_z_z"]
        );
        assert_eq!(
            hysteresis[hysteresis.len() - 2..],
            ["begin_z_1", "begin_z_2"]
        );
        assert_eq!(hysteresis.len(), 3 + 5 + 2);
    }

    #[test]
    fn channels_answer_to_the_shift_that_one_unit_makes() {
        let track = track();
        let shapes = [3.0, 6.0, 20.0, 0.5, 2.0];
        let whole: Vec<f64> = [0.0, 1.0]
            .into_iter()
            .chain(shapes)
            .chain(shapes)
            .chain([0.0, 0.3])
            .collect();
        let plain = Addition::Catalogue(find("hysteresis").unwrap());
        let shifted = Series::of(&track, [1.0; 2], &[(&plain, &whole)]);
        let values: Vec<f64> = [0.5, -2.0, 0.0]
            .into_iter()
            .chain(shapes)
            .chain([0.3])
            .collect();
        let own = longitudinal("hysteresis");
        let series = Series::of(&track, [1.0; 2], &[(&own, &values)]);
        for (row, state) in series.states.iter().enumerate() {
            let shift_n = shifted.force_n[row][1] - track.force_n[row][1];
            assert_eq!(series.force_n[row], track.force_n[row]);
            let expected = Vector3::new(0.5, -2.0, 0.0) * shift_n;
            assert!((state.offset_g - expected).norm() < 1e-12);
        }
        assert!(
            series
                .states
                .iter()
                .any(|state| state.offset_g.x.abs() > 0.4)
        );
    }

    #[test]
    fn only_effects_of_the_flexures_become_channelwise() {
        assert!(matches!(longitudinal("creep"), Addition::Channelwise(_)));
        assert_eq!(longitudinal("creep").stage(), Stage::Sensor);
        assert!(matches!(
            longitudinal("field_drift"),
            Addition::Catalogue(_)
        ));
    }
}
