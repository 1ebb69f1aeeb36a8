//! Mechanical stop of the flexure beyond a knee force.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, ForceForm, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "hard_stop",
    stage: EffectStage::Flexure,
    physics: "Many flexures have an overload stop: beyond some deflection the finger touches a wall, and the \
              force increases with little further displacement. The response of the field has a knee. \
              Below the knee there is no effect, in contrast to a stiffening flexure. A finger that is off \
              centre may reach the stop on one side only.",
    equation: "F' = F - c (|F| - F_knee) sign(F) beyond the knee, one c for each side",
    regressors: "dB/dF times the force beyond the knee",
    needs: &[],
    plot_against: &["fx_n", "fz_n"],
    parameters: &[
        EffectParameter::coefficient("lost_x", "%", 60.0),
        EffectParameter::coefficient("lost_z", "%", 60.0),
        EffectParameter::coefficient("lost_back_x", "%", 60.0),
        EffectParameter::coefficient("lost_back_z", "%", 60.0),
        EffectParameter::shape(
            "knee_x",
            "N",
            &[20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0, 210.0],
        ),
        EffectParameter::shape(
            "knee_z",
            "N",
            &[20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0, 210.0],
        ),
    ],
    size: MagnitudeSpec {
        description: "compliance lost beyond the knee",
        unit: "%",
        first: 4,
        typical: 60.0,
        plausible: (5.0, 100.0),
        possible: (0.0, 105.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load slowly to 10 % beyond the suspected stop, both signs; check the raw counts for clipping.",
    confused_with: &[
        ("geometric_stiffening", "where the load barely exceeds the knee"),
        ("sensor_compression", "where the field along the gap increases with the load"),
    ],
    similar_outside: "",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 15,
        range: (0.0, 95.0),
        meaning: "compliance lost beyond 60 % of the greatest load",
        shared: false,
    }),
    device: DeviceForm::Force(ForceForm::HardStop),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: EffectStage::FORCES,
    apply,
};

fn apply(values: &[f64], _: &ExcitationSeries, series: &mut StateSeries) {
    let &[x, z, back_x, back_z, knee_x, knee_z] = values else {
        return;
    };
    for force in &mut series.force_n {
        let limited = |n: f64, [lost, back]: [f64; 2], knee: f64| {
            let lost = if n < 0.0 { back } else { lost };
            n - 0.01 * lost * (n.abs() - knee).max(0.0) * n.signum()
        };
        *force = [limited(force[0], [x, back_x], knee_x), limited(force[1], [z, back_z], knee_z)];
    }
}
