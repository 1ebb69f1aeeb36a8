//! Viscous lag of a flexure.

use crate::effects::operators::low_pass_with_rates;
use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, ForceForm, MagnitudeSpec,
    Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "viscous_lag",
    stage: EffectStage::Flexure,
    physics: "A damper parallel to the flexure (a rubber foot, grease, an air film) delays its deflection like a \
              first-order low pass by some milliseconds. The residual is proportional to the rate of the \
              force. Each flexure has its own lag, whereas a clock skew shifts all forces of the gripper \
              by the same time.",
    equation: "w' tau + w = F / k",
    regressors: "dB/dF times -dF/dt, each flexure",
    needs: &[],
    plot_against: &["fx_rate_n_per_s", "fz_rate_n_per_s"],
    parameters: &[
        EffectParameter::coefficient("lag_x", "ms", 10.0),
        EffectParameter::coefficient("lag_z", "ms", 10.0),
    ],
    size: MagnitudeSpec {
        description: "retardation time",
        unit: "ms",
        typical: 10.0,
        plausible: (0.0, 100.0),
        possible: (0.0, 2000.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load to the same peak at two speeds that differ by a factor of three, one flexure at a time.",
    confused_with: &[
        ("clock_skew", "where all flexures have the same lag"),
        ("hysteresis", "at a single frequency"),
        ("reference_filter", "with the opposite sign"),
    ],
    similar_outside: "a sensor that is read later than the others",
    signatures: &[Signature::LoadHistory],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 9,
        range: (0.0, 200.0),
        meaning: "retardation time, lateral; half of it longitudinally",
        shared: false,
    }),
    device: DeviceForm::Force(ForceForm::ViscousLag),
    is_transient: false,
    has_memory: true,
    time: TimeDependence::Rows,
    reads: EffectStage::FORCES,
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    for (axis, &lag_ms) in values.iter().enumerate().take(2) {
        let lag_s = 1e-3 * lag_ms;
        if lag_s > 0.0 {
            series.apply_operator(excitation, axis, |time_s, force, rates| {
                low_pass_with_rates(time_s, force, rates, lag_s)
            });
        } else if lag_s < 0.0 {
            // Unphysical, but the estimate must not be biased by a bound at zero.
            let (_, rates) = series.history(excitation, axis);
            series.add_force(axis, |row| -lag_s * rates[row]);
        }
    }
}
