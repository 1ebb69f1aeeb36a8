//! Zero drift of the reference.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, Signature,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "reference_drift",
    stage: EffectStage::Reference,
    physics: "Force/torque sensors drift, mainly with temperature: the data of the paper contain up to 15 N of \
              bias. A zero drift equals an apparent force, so the residual is exactly along dB/dF. A \
              constant bias is confounded with a misplaced magnet and absorbed by the fit of the base.",
    equation: "F = F_reference - c t, t since the start of the campaign",
    regressors: "dB/dF times t, each axis",
    needs: &[],
    plot_against: &["time_s"],
    parameters: &[
        EffectParameter::coefficient("drift_x", "N/min", 0.5),
        EffectParameter::coefficient("drift_z", "N/min", 0.5),
    ],
    size: MagnitudeSpec {
        description: "drift",
        unit: "N/min",
        typical: 0.5,
        plausible: (-10.0, 10.0),
        possible: (-1000.0, 1000.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Unload completely before and after every recording and compare the two zeros.",
    confused_with: &[
        ("field_drift", "both are slow; this one acts along dB/dF only"),
        ("creep", "both are slow"),
    ],
    similar_outside: "",
    signatures: &[Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 20,
        range: (-5.0, 5.0),
        meaning: "steady wander of the reference's lateral zero",
        shared: true,
    }),
    device: DeviceForm::Bench {
        error: "the reference drifts by",
        remedy: "correct the reference sensor",
    },
    is_transient: false,
    has_memory: false,
    time: TimeDependence::Starts,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    for (axis, &n_per_min) in values.iter().enumerate().take(2) {
        let minutes = |row: usize| (excitation.start_s + excitation.time_s[row]) / 60.0;
        series.add_force(axis, |row| -n_per_min * minutes(row));
    }
}
