//! Thermal expansion of the structure between magnet and sensor.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, FieldForm, MagnitudeSpec,
    REFERENCE_C, Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "thermal_gap",
    stage: EffectStage::Displacement,
    physics: "Ten millimetres of aluminium expand by 0.23 um per kelvin. As the structure between magnet and \
              sensor they widen the gap, along which the field changes by 1170 G per millimetre: a quarter \
              of a gauss per kelvin. The in-plane sensitivity to the forces changes slightly.",
    equation: "dy = g (T - 25 C)",
    regressors: "dB/dy times T",
    needs: &["temp_c"],
    plot_against: &["temp_c"],
    parameters: &[EffectParameter::coefficient("growth", "um/K", 0.5)],
    size: MagnitudeSpec {
        description: "growth of the gap",
        unit: "um/K",
        typical: 0.5,
        plausible: (-3.0, 3.0),
        possible: (-50.0, 50.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Warm and cool the gripper with a constant load in the plane: the gap axis changes most.",
    confused_with: &[
        ("magnet_temperature", "both change the gap axis with the temperature"),
        ("sensor_temperature", "equal to an offset drift along the gap"),
    ],
    similar_outside: "",
    signatures: &[Signature::Temperature],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 7,
        range: (-10.0, 10.0),
        meaning: "growth of the gap from 25 C",
        shared: false,
    }),
    device: DeviceForm::Field(FieldForm::ThermalGap),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[um_per_k] = values else { return };
    for (state, temperature_c) in series.states.iter_mut().zip(&excitation.temperature_c) {
        state.displacement_mm.y += 1e-3 * um_per_k * (temperature_c - REFERENCE_C);
    }
}
