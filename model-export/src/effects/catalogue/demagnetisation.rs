//! Irreversible loss of the magnet's strength.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, Signature,
    SimulatedMagnitude, Simulation, StateSeries,
};

pub const EFFECT: Effect = Effect {
    id: "demagnetisation",
    stage: EffectStage::Magnet,
    physics: "Heat, a stronger magnet or an impact reduce the strength of a magnet irreversibly, in contrast \
              to the reversible temperature dependence. The loss is a step between recordings or a slow \
              decrease within one. Stabilised magnets lose less than a percent.",
    equation: "B_magnet (1 - d_r - e t), one d for each recording but the first",
    regressors: "the magnet's field in each recording, and times t",
    needs: &[],
    plot_against: &["session_s"],
    parameters: &[
        EffectParameter::coefficient("step", "%", 0.5).each_later_recording(),
        EffectParameter::coefficient("slope", "%/min", 0.1),
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
    signatures: &[Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 18,
        range: (-10.0, 10.0),
        meaning: "loss of remanence from the first recording to the second",
        shared: false,
    }),
    device: DeviceForm::Settled,
    is_transient: true,
    reads: &[EffectStage::Magnet],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let Some((slope, steps)) = values.split_last() else {
        return;
    };
    let step = match excitation.recording.checked_sub(1) {
        Some(later) => steps.get(later).copied().unwrap_or(0.0),
        None => 0.0,
    };
    for (state, time_s) in series.states.iter_mut().zip(&excitation.time_s) {
        state.strength *= 1.0 - 0.01 * (step + slope * time_s / 60.0);
    }
}
