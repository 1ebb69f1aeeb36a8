//! Run-in: the flexure softens over its first load cycles.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec, Signature,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "softening",
    stage: EffectStage::Flexure,
    physics: "New polymer flexures and glued joints run in: over the first tens of load cycles the material and \
              its surfaces settle, and the compliance increases permanently. Metals do not soften. A \
              printed TPU lattice lost 6.5 % of its stiffness.",
    equation: "F' = F (1 + c (1 - exp(-n / N))), n load cycles since the start of the campaign",
    regressors: "dB/dF times F times (1 - exp(-n / N))",
    needs: &[],
    plot_against: &["session_s"],
    parameters: &[
        EffectParameter::coefficient("softening_x", "%", 3.0),
        EffectParameter::coefficient("softening_z", "%", 3.0),
        EffectParameter::shape("cycles", "", &[2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0]),
    ],
    size: MagnitudeSpec {
        description: "final increase of the compliance",
        unit: "%",
        first: 2,
        typical: 3.0,
        plausible: (-10.0, 20.0),
        possible: (-90.0, 500.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Cycle a new flexure at least fifty times with the same load, recording from the very first.",
    confused_with: &[
        ("creep", "both increase under load"),
        ("demagnetisation", "both scale the response, recording by recording"),
        ("magnet_temperature", "where the temperature rises at the same time"),
    ],
    similar_outside: "a span of the reference that drifts",
    signatures: &[Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 11,
        range: (-20.0, 50.0),
        meaning: "growth of the compliance over many load cycles",
        shared: false,
    }),
    device: DeviceForm::Settled,
    is_transient: true,
    has_memory: false,
    // Load cycles are counted in the order of the rows.
    time: TimeDependence::Rows,
    reads: EffectStage::FORCES,
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[softening_x, softening_z, cycles] = values else {
        return;
    };
    for (axis, softening) in [(0, softening_x), (1, softening_z)] {
        let run_in = |row: usize| 1.0 - libm::exp(-excitation.cycles[row][axis] / cycles);
        for (row, force) in series.force_n.iter_mut().enumerate() {
            force[axis] *= 1.0 + 0.01 * softening * run_in(row);
        }
    }
}
