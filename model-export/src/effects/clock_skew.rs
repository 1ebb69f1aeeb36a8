//! The clocks of board and reference disagree.

use super::memory::{beyond, delayed};
use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "clock_skew",
    stage: Stage::Reference,
    physics: "Two computers write two files, and their clocks differ by milliseconds: a driver that \
              buffers, a stamp that is set when a packet arrives. While the force changes fast, force and \
              field are then of two different instants. It looks like a lag of all flexures at once. Half \
              a millisecond is already seen on a good bench.",
    equation: "F(t) = F_reference(t - tau)",
    regressors: "-(dB/dFx dFx/dt + dB/dFz dFz/dt)",
    needs: &[],
    shows_against: &["fx_rate_n_per_s", "fz_rate_n_per_s"],
    parameters: &[Parameter::coefficient("skew", "ms", 5.0).shared()],
    size: Size {
        words: "field after force",
        unit: "ms",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.05,
        typical: 5.0,
        plausible: (-50.0, 50.0),
        possible: (-2000.0, 2000.0),
    },
    record: "Load fast and slowly, and knock on the finger once: the knock shows in both files.",
    confused_with: &[
        ("viscous_lag", "where all flexures lag alike"),
        ("reference_filter", "with the opposite sign"),
        ("hysteresis", "at a single frequency"),
    ],
    undone: Undone::Never("it belongs to the bench: give --delay-ms, or mend the clocks"),
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[skew_ms] = values else { return };
    for axis in 0..2 {
        let shifted = beyond(track, axis, |time_s, force, rate| {
            delayed(time_s, force, rate, 1e-3 * skew_ms)
        });
        series.add_force(axis, |row| shifted[row]);
    }
}
