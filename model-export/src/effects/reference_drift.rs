//! The reference's zero wanders.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "reference_drift",
    stage: Stage::Reference,
    physics: "Force/torque sensors drift, by temperature above all: the paper's own data hold up to 15 N \
              of bias. A wandering zero looks like a force that is not there, so the residual moves \
              exactly along dB/dF. A constant part cannot be told from a magnet that was mounted aside and \
              is left to the fit of the base.",
    equation: "F = F_reference - c t, t since the campaign began",
    regressors: "dB/dF times t, each axis",
    needs: &[],
    shows_against: &["time_s"],
    parameters: &[
        Parameter::coefficient("drift_x", "N/min", 0.5),
        Parameter::coefficient("drift_z", "N/min", 0.5),
    ],
    size: Size {
        words: "drift",
        unit: "N/min",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.5,
        plausible: (-10.0, 10.0),
        possible: (-1000.0, 1000.0),
    },
    record: "Unload completely before and after every recording and compare the two zeros.",
    confused_with: &[
        (
            "field_drift",
            "both are slow; this one only moves along dB/dF",
        ),
        ("creep", "both are slow"),
    ],
    undone: Undone::Never("it belongs to the bench, not to the gripper"),
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    for (axis, &n_per_min) in values.iter().enumerate().take(2) {
        let minutes = |row: usize| (track.start_s + track.time_s[row]) / 60.0;
        series.add_force(axis, |row| -n_per_min * minutes(row));
    }
}
