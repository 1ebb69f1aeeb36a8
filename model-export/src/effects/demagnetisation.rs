//! The magnet has lost strength for good.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "demagnetisation",
    stage: Stage::Magnet,
    physics: "Heat, a stronger magnet or a blow take away some of a magnet's strength, and unlike the \
              change with temperature it does not come back. It shows as a step from one recording to the \
              next, or as a slow loss within one. Stabilised magnets lose less than a percent.",
    equation: "B_magnet (1 - d_r - e t), one d for each recording but the first",
    regressors: "the magnet's own field in each recording, and times t",
    needs: &[],
    shows_against: &["session_s"],
    parameters: &[
        Parameter::coefficient("step", "%", 0.5).each_later_recording(),
        Parameter::coefficient("slope", "%/min", 0.1),
    ],
    size: Size {
        words: "loss since the first recording",
        unit: "%",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.5,
        plausible: (0.0, 5.0),
        possible: (-1.0, 100.0),
    },
    record: "Repeat the first recording's load at the first recording's temperature after each heating.",
    confused_with: &[
        (
            "magnet_temperature",
            "where each recording has its own temperature",
        ),
        ("field_drift", "both change from recording to recording"),
        (
            "softening",
            "the field weakens against stiffness, recording by recording",
        ),
    ],
    undone: Undone::Settled,
    lives_in_one_recording: true,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let Some((slope, steps)) = values.split_last() else {
        return;
    };
    let step = match track.recording.checked_sub(1) {
        Some(later) => steps.get(later).copied().unwrap_or(0.0),
        None => 0.0,
    };
    for (state, time_s) in series.states.iter_mut().zip(&track.time_s) {
        state.strength *= 1.0 - 0.01 * (step + slope * time_s / 60.0);
    }
}
