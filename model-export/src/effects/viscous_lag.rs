//! The flexure follows its force late.

use super::memory::{beyond, low_pass};
use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "viscous_lag",
    stage: Stage::Flexure,
    physics: "A damper beside the flexure, be it a rubber foot, grease or an air film, gives way only with \
              time. The deflection then follows the force like a first-order low pass, some milliseconds \
              late. In the residual this is proportional to how fast the force changes. It belongs to one \
              flexure, whereas a skewed clock shifts all forces of the gripper by one time.",
    equation: "w' tau + w = F / k",
    regressors: "dB/dF times -dF/dt, each flexure",
    needs: &[],
    shows_against: &["fx_rate_n_per_s", "fz_rate_n_per_s"],
    parameters: &[
        Parameter::coefficient("lag_x", "ms", 10.0),
        Parameter::coefficient("lag_z", "ms", 10.0),
    ],
    size: Size {
        words: "retardation time",
        unit: "ms",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 10.0,
        plausible: (0.0, 100.0),
        possible: (0.0, 2000.0),
    },
    record: "Load to the same peak at two speeds a factor of three apart, one flexure at a time.",
    confused_with: &[
        ("clock_skew", "where all flexures lag alike"),
        ("hysteresis", "at a single frequency"),
        ("reference_filter", "with the opposite sign"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    for (axis, &lag_ms) in values.iter().enumerate().take(2) {
        let lag_s = 1e-3 * lag_ms;
        if lag_s > 0.0 {
            let late = beyond(track, axis, |time_s, force, _| {
                low_pass(time_s, force, lag_s)
            });
            series.add_force(axis, |row| late[row]);
        } else if lag_s < 0.0 {
            // Nothing physical runs ahead; the fit must be able to say so.
            series.add_force(axis, |row| -lag_s * track.rate_n_per_s[row][axis]);
        }
    }
}
