//! The structure between magnet and sensor grows with temperature.

use super::{Effect, Parameter, REFERENCE_C, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "thermal_gap",
    stage: Stage::Displacement,
    physics: "Ten millimetres of aluminium grow by 0.23 um for each kelvin. If they hold magnet and sensor \
              apart, the gap grows with them, and along the gap the field changes by 1170 G for each \
              millimetre: a quarter of a gauss for each kelvin. The in-plane answer to the forces changes \
              a little as well.",
    equation: "dy = g (T - 25 C)",
    regressors: "dB/dy times T",
    needs: &["temp_c"],
    shows_against: &["temp_c"],
    parameters: &[Parameter::coefficient("growth", "um/K", 0.5)],
    size: Size {
        words: "growth of the gap",
        unit: "um/K",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.5,
        plausible: (-3.0, 3.0),
        possible: (-50.0, 50.0),
    },
    record: "Warm and cool the gripper with a steady load in the plane: a gap changes the gap axis most.",
    confused_with: &[
        (
            "magnet_temperature",
            "both move the gap axis with the temperature",
        ),
        (
            "sensor_temperature",
            "an offset along the gap does the same",
        ),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[um_per_k] = values else { return };
    for (state, temperature_c) in series.states.iter_mut().zip(&track.temperature_c) {
        state.displacement_mm.y += 1e-3 * um_per_k * (temperature_c - REFERENCE_C);
    }
}
