//! The sensor's gain falls in strong fields.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "sensor_compression",
    stage: Stage::Sensor,
    physics: "Hall elements and their amplifiers are not quite linear: near the end of the range the gain \
              falls. With 1272 G at rest along the gap the sensor always works there, and every load that \
              moves the magnet closer meets less gain.",
    equation: "b (1 - c (b / 1300 G)^2), each axis b of B",
    regressors: "the cube of each axis' field",
    needs: &[],
    shows_against: &["fx_n", "fz_n"],
    parameters: &[Parameter::coefficient("loss", "%", 1.0)],
    size: Size {
        words: "gain lost at 1300 G",
        unit: "%",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 1.0,
        plausible: (-1.0, 10.0),
        possible: (-20.0, 60.0),
    },
    record: "Load over the whole range with two gaps that differ by some tenths of a millimetre.",
    confused_with: &[
        ("tip_slope", "both are even in the load"),
        (
            "geometric_stiffening",
            "where the field along the gap grows with the load",
        ),
    ],
    undone: Undone::Tables,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], _: &Track, series: &mut Series) {
    let &[percent] = values else { return };
    for state in &mut series.states {
        state.compression += 0.01 * percent;
    }
}
