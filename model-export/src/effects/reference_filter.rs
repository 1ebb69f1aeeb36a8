//! The reference filters its own signal.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "reference_filter",
    stage: Stage::Reference,
    physics: "Force sensors with an amplifier often low-pass their output. What they report is then the \
              force of some milliseconds ago, and fast peaks are rounded. The gripper is right and the \
              bench is late: the opposite of a flexure that lags.",
    equation: "F = F_reference + tau dF_reference/dt",
    regressors: "dB/dFx dFx/dt + dB/dFz dFz/dt",
    needs: &[],
    shows_against: &["fx_rate_n_per_s", "fz_rate_n_per_s"],
    parameters: &[Parameter::coefficient("time", "ms", 4.0).shared()],
    size: Size {
        words: "time constant",
        unit: "ms",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.05,
        typical: 4.0,
        plausible: (0.0, 30.0),
        possible: (0.0, 2000.0),
    },
    record: "Load with sharp edges (knocks): a filter rounds them, a skewed clock only shifts them.",
    confused_with: &[
        (
            "clock_skew",
            "with the opposite sign, except at sharp edges",
        ),
        ("viscous_lag", "with the opposite sign"),
    ],
    undone: Undone::Never("it belongs to the bench, not to the gripper"),
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[time_ms] = values else { return };
    for axis in 0..2 {
        series.add_force(axis, |row| 1e-3 * time_ms * track.rate_n_per_s[row][axis]);
    }
}
