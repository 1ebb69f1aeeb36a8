//! Reversible temperature dependence of the remanence.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, FieldForm, MagnitudeSpec,
    REFERENCE_C, Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "magnet_temperature",
    stage: EffectStage::Magnet,
    physics: "The remanence of neodymium magnets decreases by 0.08 to 0.13 % per kelvin, reversibly. At rest the \
              field along the gap is 1272 G, so the change is 1.4 G per kelvin: by far the largest effect \
              of temperature. In the plane of motion it changes the scale of the forces.",
    equation: "B_magnet (1 + a (T - 25 C))",
    regressors: "T times the magnet's field",
    needs: &["temp_c"],
    plot_against: &["temp_c"],
    parameters: &[EffectParameter::coefficient("coefficient", "%/K", 0.11)],
    size: MagnitudeSpec {
        description: "change of the remanence",
        unit: "%/K",
        typical: -0.11,
        plausible: (-0.25, 0.0),
        possible: (-1.0, 0.2),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Warm the gripper by 10 K under continuous load cycles, cool it, and repeat.",
    confused_with: &[
        ("sensor_temperature", "equal to a gain drift of the sensor"),
        ("thermal_gap", "both change the gap axis with the temperature"),
        ("field_drift", "where there is one warm-up only"),
        ("demagnetisation", "where the temperature differs between recordings only"),
    ],
    similar_outside: "",
    signatures: &[Signature::Temperature],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 5,
        range: (-1.0, 1.0),
        meaning: "change of remanence from 25 C",
        shared: true,
    }),
    device: DeviceForm::Field(FieldForm::MagnetTemperature),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[EffectStage::Magnet],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[percent_per_k] = values else { return };
    for (state, temperature_c) in series.states.iter_mut().zip(&excitation.temperature_c) {
        state.strength *= 1.0 + 0.01 * percent_per_k * (temperature_c - REFERENCE_C);
    }
}
