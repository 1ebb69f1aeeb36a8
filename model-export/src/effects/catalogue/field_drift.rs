//! Slow drift of the field over the session, independent in each channel.

use nalgebra::Vector3;

use crate::effects::{
    Aggregation, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "field_drift",
    stage: EffectStage::Sensor,
    physics: "Adhesive settles, a printed lattice relaxes, electronics warm up: over minutes to hours each \
              channel approaches a new rest value exponentially. A part may restart with each recording, \
              with the current that is switched on. The drift is independent of the load. It is an \
              empirical description; a logged temperature may explain the drift better.",
    equation: "B + A (1 - exp(-t / tau)) + C (1 - exp(-s / tau)), t since the start of the campaign, s since that of the recording",
    regressors: "1 - exp(-t / tau) and 1 - exp(-s / tau) in each axis",
    needs: &[],
    plot_against: &["session_s"],
    parameters: &[
        EffectParameter::coefficient("shift_x", "G", 0.7),
        EffectParameter::coefficient("shift_y", "G", 0.7),
        EffectParameter::coefficient("shift_z", "G", 0.7),
        EffectParameter::coefficient("again_x", "G", 0.7),
        EffectParameter::coefficient("again_y", "G", 0.7),
        EffectParameter::coefficient("again_z", "G", 0.7),
        EffectParameter::shape("time", "s", &[15.0, 30.0, 60.0, 150.0, 400.0, 1000.0, 3000.0])
            .shared()
            .cross_validated(),
    ],
    size: MagnitudeSpec {
        description: "final shift",
        unit: "G",
        first: 3,
        aggregation: Aggregation::Norm,
        typical: 0.7,
        plausible: (0.0, 10.0),
        possible: (0.0, 500.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Record the unloaded gripper for a minute at the start and at the end of the session; log the \
              temperature.",
    confused_with: &[
        ("creep", "both are slow"),
        ("magnet_temperature", "where every recording has the same warm-up"),
        ("sensor_temperature", "where every recording has the same warm-up"),
        ("reference_drift", "both are slow; a drifting reference acts along dB/dF only"),
        ("demagnetisation", "both change from recording to recording"),
    ],
    similar_outside: "",
    signatures: &[Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 21,
        range: (0.0, 20.0),
        meaning: "norm of the final shift of the field",
        shared: false,
    }),
    device: DeviceForm::Settled,
    is_transient: false,
    has_memory: false,
    time: TimeDependence::Starts,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[x, y, z, restart_x, restart_y, restart_z, tau_s] = values else {
        return;
    };
    let (campaign, recording) =
        (Vector3::new(x, y, z), Vector3::new(restart_x, restart_y, restart_z));
    let settled = |time_s: f64| 1.0 - libm::exp(-time_s.max(0.0) / tau_s);
    for (state, time_s) in series.states.iter_mut().zip(&excitation.time_s) {
        state.offset_g +=
            campaign * settled(excitation.start_s + time_s) + recording * settled(*time_s);
    }
}
