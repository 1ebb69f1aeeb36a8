//! Mechanical crosstalk between the two axes.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "cross_coupling",
    stage: EffectStage::Load,
    physics: "No flexure is compliant in one direction only. A longitudinal force also twists or bends the \
              lateral flexure slightly and moves the magnet laterally by some percent of the displacement \
              under an equal lateral force. A small rotation of the sensor has nearly the same effect; only \
              the difference is identifiable.",
    equation: "Fx' = Fx + c_x Fz, Fz' = Fz + c_z Fx",
    regressors: "dB/dFx times Fz, dB/dFz times Fx",
    needs: &[],
    plot_against: &["fx_n", "fz_n"],
    parameters: &[
        EffectParameter::coefficient("onto_x", "%", 1.5),
        EffectParameter::coefficient("onto_z", "%", 1.5),
    ],
    size: MagnitudeSpec {
        description: "fraction of the other force",
        unit: "%",
        typical: 1.5,
        plausible: (-10.0, 10.0),
        possible: (-100.0, 100.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load one axis at a time, then both with different rhythms.",
    confused_with: &[("fingertip_mass", "where the load results from motion of the arm")],
    similar_outside: "crosstalk between the axes of the reference",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 14,
        range: (-20.0, 20.0),
        meaning: "share of Fz that acts as Fx, and -0.4 times as much back",
        shared: false,
    }),
    device: DeviceForm::Tables,
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: EffectStage::FORCES,
    apply,
};

fn apply(values: &[f64], _: &ExcitationSeries, series: &mut StateSeries) {
    let &[onto_x, onto_z] = values else { return };
    for force in &mut series.force_n {
        let [x, z] = *force;
        *force = [x + 0.01 * onto_x * z, z + 0.01 * onto_z * x];
    }
}
