//! Low-pass filter of the reference.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, Signature,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "reference_filter",
    stage: EffectStage::Reference,
    physics: "Force sensors with an amplifier often low-pass their output: the reported force is delayed by some \
              milliseconds, and fast peaks are rounded. The reference lags behind the gripper, the \
              opposite of a lagging flexure.",
    equation: "F = F_reference + tau dF_reference/dt",
    regressors: "dB/dFx dFx/dt + dB/dFz dFz/dt",
    needs: &[],
    plot_against: &["fx_rate_n_per_s", "fz_rate_n_per_s"],
    parameters: &[EffectParameter::coefficient("time", "ms", 4.0).shared()],
    size: MagnitudeSpec {
        description: "time constant",
        unit: "ms",
        typical: 4.0,
        plausible: (0.0, 30.0),
        possible: (0.0, 2000.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load with sharp edges (impacts): a filter rounds them, a clock skew only shifts them.",
    confused_with: &[
        ("clock_skew", "with the opposite sign, except at sharp edges"),
        ("viscous_lag", "with the opposite sign"),
    ],
    similar_outside: "",
    signatures: &[Signature::LoadHistory],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 13,
        range: (0.0, 200.0),
        meaning: "time constant of the reference's own filter",
        shared: true,
    }),
    device: DeviceForm::Bench {
        error: "the reference's own filter delays it by",
        remedy: "correct the reference sensor",
    },
    is_transient: false,
    has_memory: false,
    time: TimeDependence::Rows,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[time_ms] = values else { return };
    for axis in 0..2 {
        series.add_force(axis, |row| 1e-3 * time_ms * excitation.rate_n_per_s[row][axis]);
    }
}
