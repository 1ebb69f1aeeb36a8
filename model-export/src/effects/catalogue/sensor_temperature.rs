//! Temperature dependence of the sensor's offset and gain.

use nalgebra::Vector3;

use crate::effects::{
    Aggregation, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, FieldForm,
    MagnitudeSpec, REFERENCE_C, Signature, SimulatedMagnitude, Simulation, StateSeries,
    TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "sensor_temperature",
    stage: EffectStage::Sensor,
    physics: "The sensor compensates its temperature internally. The residual drift of the offset is 0.02 to \
              0.2 G/K in each axis, that of the gain hundredths of a percent per kelvin. The gain drift is \
              confounded with the temperature coefficient of the magnet; the offset drift is identifiable \
              where the field varies, or in axes without a field of the magnet.",
    equation: "B (1 + s (T - 25 C)) + o (T - 25 C)",
    regressors: "T in each axis, and T times B",
    needs: &["temp_c"],
    plot_against: &["temp_c"],
    parameters: &[
        EffectParameter::coefficient("offset_x", "G/K", 0.1),
        EffectParameter::coefficient("offset_y", "G/K", 0.1),
        EffectParameter::coefficient("offset_z", "G/K", 0.1),
        EffectParameter::coefficient("gain", "%/K", 0.02),
    ],
    size: MagnitudeSpec {
        description: "drift of the offset",
        unit: "G/K",
        first: 3,
        aggregation: Aggregation::Norm,
        typical: 0.1,
        plausible: (0.0, 0.5),
        possible: (0.0, 20.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Warm and cool the unloaded gripper, then the loaded one: an offset drift is equal in both, a gain \
              drift is not.",
    confused_with: &[
        ("magnet_temperature", "equal to a gain drift"),
        ("thermal_gap", "both change the gap axis with the temperature"),
        ("field_drift", "where there is one warm-up only"),
    ],
    similar_outside: "",
    signatures: &[Signature::Temperature],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 6,
        range: (0.0, 5.0),
        meaning: "norm of the drift of the offset from 25 C",
        shared: false,
    }),
    device: DeviceForm::Field(FieldForm::SensorTemperature),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[EffectStage::Sensor],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[x, y, z, gain] = values else { return };
    for (state, temperature_c) in series.states.iter_mut().zip(&excitation.temperature_c) {
        let delta_c = temperature_c - REFERENCE_C;
        state.offset_g += Vector3::new(x, y, z) * delta_c;
        state.gain *= 1.0 + 0.01 * gain * delta_c;
    }
}
