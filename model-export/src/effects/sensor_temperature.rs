//! The Hall element's offset and gain change with its temperature.

use nalgebra::Vector3;

use super::{Effect, Parameter, REFERENCE_C, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "sensor_temperature",
    stage: Stage::Sensor,
    physics: "The sensor corrects itself for its temperature, and what is left is an offset that moves by \
              0.02 to 0.2 G for each kelvin in each axis, and a gain that changes by hundredths of a \
              percent. The gain cannot be told from a magnet that weakens; the offset can, where the field \
              itself varies or in the axes in which the magnet has none.",
    equation: "B (1 + s (T - 25 C)) + o (T - 25 C)",
    regressors: "T in each axis, and T times B",
    needs: &["temp_c"],
    shows_against: &["temp_c"],
    parameters: &[
        Parameter::coefficient("offset_x", "G/K", 0.1),
        Parameter::coefficient("offset_y", "G/K", 0.1),
        Parameter::coefficient("offset_z", "G/K", 0.1),
        Parameter::coefficient("gain", "%/K", 0.02),
    ],
    size: Size {
        words: "drift of the offset",
        unit: "G/K",
        first: 3,
        of: SizeOf::Norm,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.1,
        plausible: (0.0, 0.5),
        possible: (0.0, 20.0),
    },
    record: "Warm and cool the unloaded gripper, then the loaded one: an offset moves alike, a gain does \
              not.",
    confused_with: &[
        ("magnet_temperature", "its gain does the same"),
        ("thermal_gap", "both move the gap axis with the temperature"),
        ("field_drift", "where there is one warm-up only"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[x, y, z, gain] = values else { return };
    for (state, temperature_c) in series.states.iter_mut().zip(&track.temperature_c) {
        let warmer = temperature_c - REFERENCE_C;
        state.offset_g += Vector3::new(x, y, z) * warmer;
        state.gain *= 1.0 + 0.01 * gain * warmer;
    }
}
