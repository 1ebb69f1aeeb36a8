//! Irreversible loss of the magnet's strength.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, Signature,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "demagnetisation",
    stage: EffectStage::Magnet,
    physics: "Heat, a stronger magnet or an impact reduce the strength of a magnet irreversibly, in contrast \
              to the reversible temperature dependence. The loss is a step between recordings, a slow \
              decrease within one, or a step at an impact. Stabilised magnets lose less than a percent.",
    equation: "B_magnet (1 - d_r - e t - s step(t - t0)), one d for each recording but the first",
    regressors: "the magnet's field in each recording, times t, and after one instant",
    needs: &[],
    plot_against: &["session_s"],
    parameters: &[
        EffectParameter::coefficient("step", "%", 0.5).each_later_recording(),
        EffectParameter::coefficient("impact", "%", 0.5),
        EffectParameter::coefficient("slope", "%/min", 0.1),
        EffectParameter::instant("at", "s"),
    ],
    size: MagnitudeSpec {
        description: "loss since the first recording",
        unit: "%",
        typical: 0.5,
        plausible: (0.0, 5.0),
        possible: (-1.0, 100.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Repeat the first recording's load at the first recording's temperature after each heating.",
    confused_with: &[
        ("magnet_temperature", "where the temperature differs between recordings only"),
        ("field_drift", "both change from recording to recording"),
        ("softening", "both scale the response, recording by recording"),
    ],
    similar_outside: "a gain of all axes that changed",
    signatures: &[Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 18,
        range: (-10.0, 10.0),
        meaning: "loss of remanence from the first recording to the second",
        shared: false,
    }),
    device: DeviceForm::Settled,
    is_transient: true,
    has_memory: false,
    // The loss is between recordings, whose order their starts give.
    time: TimeDependence::Starts,
    reads: &[EffectStage::Magnet],
    apply,
};

/// Duration in seconds of an impact's step: a few rows of the reference, so that a fit can move its instant.
const IMPACT_S: f64 = 0.02;

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let [steps @ .., impact, slope, at_s] = values else {
        return;
    };
    let step = match excitation.recording.checked_sub(1) {
        Some(later) => steps.get(later).copied().unwrap_or(0.0),
        None => 0.0,
    };
    // Within one recording: later ones have steps of their own.
    let end_s = excitation.time_s.last().copied().unwrap_or(0.0);
    let own_s = at_s - excitation.before_s;
    let is_own = (0.0..=end_s).contains(&own_s);
    for (state, time_s) in series.states.iter_mut().zip(&excitation.time_s) {
        let after = 0.5 + 0.5 * libm::tanh((time_s - own_s) / IMPACT_S);
        let lost = if is_own { impact * after } else { 0.0 };
        state.strength *= 1.0 - 0.01 * (step + slope * time_s / 60.0 + lost);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Strength of the magnet over 20 s of the second recording, which begins 30 s after the first.
    fn strength(values: &[f64]) -> Vec<f64> {
        let time_s: Vec<f64> = (0..=200).map(|i| 0.1 * f64::from(i)).collect();
        let excitation = ExcitationSeries {
            force_n: vec![[0.0; 2]; time_s.len()],
            recording: 1,
            before_s: 30.0,
            time_s,
            ..ExcitationSeries::default()
        };
        let mut series = StateSeries::of(&excitation, [1.0; 2], &[]);
        apply(values, &excitation, &mut series);
        series.states.iter().map(|state| state.strength).collect()
    }

    #[test]
    fn impact_acts_in_its_own_recording_after_its_instant() {
        // Since the first recording 1 %, and 2 % after 12 s of this one.
        let own = strength(&[1.0, 5.0, 2.0, 0.0, 42.0]);
        assert!((own[119] - 0.99).abs() < 1e-5 && (own[121] - 0.97).abs() < 1e-5, "{own:?}");
        // In the first recording, and after this one.
        for at_s in [12.0, 51.0] {
            assert!(strength(&[1.0, 5.0, 2.0, 0.0, at_s]).iter().all(|s| (s - 0.99).abs() < 1e-12));
        }
        // 0.6 % in a minute: 0.2 % in 20 s.
        let slow = strength(&[0.0, 0.0, 0.0, 0.6, 0.0]);
        assert!((slow[0] - 1.0).abs() < 1e-12 && (slow[200] - 0.998).abs() < 1e-12);
    }
}
