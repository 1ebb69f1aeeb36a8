//! A warm magnet is weaker.

use super::{Effect, Parameter, REFERENCE_C, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "magnet_temperature",
    stage: Stage::Magnet,
    physics: "The remanence of neodymium magnets falls by 0.08 to 0.13 % for each kelvin, and comes back \
              on cooling. At rest the sensor sees 1272 G along the gap, so a kelvin is 1.4 G there: by far \
              the largest effect of temperature. In the plane of motion it changes the scale of the \
              forces.",
    equation: "B_magnet (1 + a (T - 25 C))",
    regressors: "T times the magnet's own field",
    needs: &["temp_c"],
    shows_against: &["temp_c"],
    parameters: &[Parameter::coefficient("coefficient", "%/K", 0.11)],
    size: Size {
        words: "change of the remanence",
        unit: "%/K",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: -0.11,
        plausible: (-0.25, 0.0),
        possible: (-1.0, 0.2),
    },
    record: "Let it warm by 10 K with loads going on all the time, cool it back, and repeat.",
    confused_with: &[
        ("sensor_temperature", "a sensor's gain does the same"),
        ("thermal_gap", "both move the gap axis with the temperature"),
        ("field_drift", "where there is one warm-up only"),
        (
            "demagnetisation",
            "where each recording has its own temperature",
        ),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[percent_per_k] = values else { return };
    for (state, temperature_c) in series.states.iter_mut().zip(&track.temperature_c) {
        state.strength *= 1.0 + 0.01 * percent_per_k * (temperature_c - REFERENCE_C);
    }
}
