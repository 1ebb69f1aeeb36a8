//! Permanent changes of a gripper over a campaign: run-in of a flexure, loss of remanence, drift of the field.
//!
//! The tables of a device hold the gripper in one state, that at the end of its campaign ([`FinalState`]). A recording that was made
//! before is compared with tables of its own time: [`GripperState`] converts its readings and forces.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::effects::{EffectTerm, ErrorOrigin, ExcitationSeries, StateSeries};

/// Load cycles and seconds after which transients have ended.
const ENDED: f64 = 1e9;

/// Time at the end of a campaign by the measures on which permanent changes depend, of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FinalState {
    /// Start of the last recording in seconds since the start of the campaign.
    pub start_s: f64,
    /// Duration of the last recording in seconds.
    pub duration_s: f64,
    /// Load cycles along x and z since the start of the campaign.
    pub load_cycles: [f64; 2],
}

impl FinalState {
    /// After all transients: the state of a model that does not contain the end of its campaign.
    pub const ENDED: Self = Self { start_s: ENDED, duration_s: 0.0, load_cycles: [ENDED; 2] };

    /// The end of an excitation; `None` without rows.
    pub fn of(last: &ExcitationSeries) -> Option<Self> {
        let (duration_s, load_cycles) = (*last.time_s.last()?, *last.cycles.last()?);
        Some(Self { start_s: last.start_s, duration_s, load_cycles })
    }

    /// One row at this time, in the last of this many recordings, under these forces in newtons.
    pub fn row(&self, force_n: [f64; 2], recordings: usize) -> ExcitationSeries {
        ExcitationSeries {
            time_s: vec![self.duration_s],
            force_n: vec![force_n],
            recording: recordings.saturating_sub(1),
            start_s: self.start_s,
            cycles: vec![self.load_cycles],
            ..ExcitationSeries::default()
        }
    }
}

/// Permanent state of one sensor, relative to its base model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperState {
    /// Compliance along x and z, relative.
    pub compliance: [f64; 2],
    /// Remanence, relative.
    pub strength: f64,
    /// Offset of the sensor in gauss, in addition to its bias.
    pub offset_g: Vector3<f64>,
}

impl GripperState {
    /// States over an excitation; `None` if no effect changes the gripper permanently.
    pub fn over(
        excitation: &ExcitationSeries,
        effects: &[(EffectTerm, Vec<f64>)],
    ) -> Option<Vec<Self>> {
        let lasting = effects.iter().filter(|of| of.0.error_origin() == ErrorOrigin::History);
        let lasting: Vec<(&EffectTerm, &[f64])> =
            lasting.map(|(effect, values)| (effect, values.as_slice())).collect();
        if lasting.is_empty() {
            return None;
        }
        // Under a unit force on flexures of unit stiffness the displacement is the compliance.
        let unit =
            ExcitationSeries { force_n: vec![[1.0; 2]; excitation.len()], ..excitation.clone() };
        let states = StateSeries::of(&unit, [1.0; 2], &lasting).states;
        let state = states.iter().map(|state| Self {
            compliance: [state.displacement_mm.x, state.displacement_mm.z],
            strength: state.strength,
            offset_g: state.offset_g,
        });
        Some(state.collect())
    }

    /// Gain and offset in gauss that convert a reading in this state to one in the state `to`, under the same force on the same
    /// flexures. `bias_g` is the reading without a magnet.
    pub fn conversion(&self, to: &Self, bias_g: Vector3<f64>) -> (f64, Vector3<f64>) {
        let gain = to.strength / self.strength;
        (gain, to.offset_g + bias_g - (bias_g + self.offset_g) * gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::find;

    /// A minute in one recording, with ten load cycles.
    fn minute() -> ExcitationSeries {
        let time_s: Vec<f64> = (0..=60).map(f64::from).collect();
        ExcitationSeries {
            force_n: vec![[0.0; 2]; time_s.len()],
            cycles: time_s.iter().map(|t| [t / 6.0; 2]).collect(),
            start_s: 600.0,
            time_s,
            ..ExcitationSeries::default()
        }
    }

    fn effect(name: &str, values: &[f64]) -> (EffectTerm, Vec<f64>) {
        (EffectTerm::Catalogue(find(name).unwrap()), values.to_vec())
    }

    #[test]
    fn reading_is_converted_by_strength_and_offset() {
        // A magnet that has lost 2 % (1 %/min over a minute, after a step in no later recording) and a shift of 3 G.
        let effects = [
            effect("demagnetisation", &[0.0, 1.0, 0.0]),
            effect("field_drift", &[0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 1e-3]),
        ];
        let states = GripperState::over(&minute(), &effects).unwrap();
        let (start, end) = (states[0], states[60]);
        assert!((start.strength - 1.0).abs() < 1e-12 && (end.strength - 0.99).abs() < 1e-12);
        let bias_g = Vector3::new(5.0, -7.0, 0.0);
        let field_g = Vector3::new(100.0, 1200.0, -50.0);
        let read = |state: &GripperState| bias_g + state.offset_g + field_g * state.strength;
        let (gain, offset_g) = start.conversion(&end, bias_g);
        assert!((read(&start) * gain + offset_g - read(&end)).amax() < 1e-9);
    }

    #[test]
    fn run_in_changes_the_compliance_and_clean_models_have_no_state() {
        let states = GripperState::over(&minute(), &[effect("softening", &[4.0, 2.0, 10.0])]);
        let end = states.unwrap()[60];
        // 1 - exp(-1) of it after ten cycles.
        assert!((end.compliance[0] - (1.0 + 0.04 * 0.632_120_6)).abs() < 1e-6);
        assert!((end.compliance[1] - (1.0 + 0.02 * 0.632_120_6)).abs() < 1e-6);
        assert_eq!(GripperState::over(&minute(), &[effect("hard_stop", &[0.0; 6])]), None);
    }

    #[test]
    fn final_state_is_that_of_the_last_row() {
        let last = FinalState::of(&minute()).unwrap();
        assert_eq!(last, FinalState { start_s: 600.0, duration_s: 60.0, load_cycles: [10.0; 2] });
        let effects = [effect("softening", &[4.0, 2.0, 10.0])];
        let of = |series: &ExcitationSeries| {
            *GripperState::over(series, &effects).unwrap().last().unwrap()
        };
        assert_eq!(of(&last.row([0.0; 2], 1)), of(&minute()));
    }
}
