//! Time offset between the clocks of board and reference.

use crate::effects::operators::delayed;
use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, Signature,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "clock_skew",
    stage: EffectStage::Reference,
    physics: "Two computers write two files, and their clocks differ by milliseconds because of buffering or \
              time stamps at packet arrival. Force and field of a row then belong to different instants, \
              which matters while the force changes fast. The effect equals a common lag of all flexures. \
              Half a millisecond is detectable on a good test bench.",
    equation: "F(t) = F_reference(t - tau)",
    regressors: "-(dB/dFx dFx/dt + dB/dFz dFz/dt)",
    needs: &[],
    plot_against: &["fx_rate_n_per_s", "fz_rate_n_per_s"],
    parameters: &[EffectParameter::coefficient("skew", "ms", 5.0).shared()],
    size: MagnitudeSpec {
        description: "field after force",
        unit: "ms",
        typical: 5.0,
        plausible: (-50.0, 50.0),
        possible: (-2000.0, 2000.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load fast and slowly, and tap the finger once: the impact is visible in both files.",
    confused_with: &[
        ("viscous_lag", "where all flexures have the same lag"),
        ("reference_filter", "with the opposite sign"),
        ("hysteresis", "at a single frequency"),
    ],
    similar_outside: "a filter in the sensors",
    signatures: &[Signature::LoadHistory],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 12,
        range: (-100.0, 100.0),
        meaning: "the field is recorded later than the reference says",
        shared: true,
    }),
    device: DeviceForm::Bench {
        error: "the reference's clock differs from the board's by",
        remedy: "set --delay-ms or correct the clocks",
    },
    is_transient: false,
    has_memory: true,
    time: TimeDependence::Rows,
    reads: &[EffectStage::Reference],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[skew_ms] = values else { return };
    for axis in 0..2 {
        series.apply_operator(excitation, axis, |time_s, force, rate| {
            delayed(time_s, force, rate, 1e-3 * skew_ms)
        });
    }
}
