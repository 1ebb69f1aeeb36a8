//! Under a steady load the flexure gives way a little more, and comes back slowly.

use super::memory::low_pass;
use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "creep",
    stage: Stage::Flexure,
    physics: "A polymer, and to a much smaller degree a metal, does not stop moving when the load stands \
              still. Part of the deflection comes with a delay of seconds to minutes, and goes with the \
              same delay after unloading. Metals creep by 0.02 to 0.1 %, printed polymers by 1 to 10 %.",
    equation: "F' = F + c y, tau y' + y = F",
    regressors: "dB/dF times the low-passed F",
    needs: &[],
    shows_against: &["loading_x", "loading_z", "fx_n", "fz_n"],
    parameters: &[
        Parameter::coefficient("creep_x", "%", 2.0),
        Parameter::coefficient("creep_z", "%", 2.0),
        Parameter::shape("time", "s", &[0.7, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0]),
    ],
    size: Size {
        words: "delayed share of the deflection",
        unit: "%",
        first: 2,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 2.0,
        plausible: (0.0, 15.0),
        possible: (0.0, 300.0),
    },
    record: "Hold a high load for 60 s, then no load for 60 s, twice: creep relaxes back, a drift goes \
              on.",
    confused_with: &[
        ("field_drift", "both are slow"),
        (
            "hysteresis",
            "where the load always returns at the same pace",
        ),
        ("softening", "both grow under load"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[creep_x, creep_z, time_s] = values else {
        return;
    };
    for (axis, creep) in [(0, creep_x), (1, creep_z)] {
        if creep != 0.0 {
            let force: Vec<f64> = track.smooth_n.iter().map(|force| force[axis]).collect();
            let delayed = low_pass(&track.time_s, &force, time_s);
            series.add_force(axis, |row| 0.01 * creep * delayed[row]);
        }
    }
}
