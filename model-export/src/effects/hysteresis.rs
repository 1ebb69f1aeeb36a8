//! Friction beside the flexure holds it back, on the way there and on the way back.

use super::memory::stop;
use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "hysteresis",
    stage: Stage::Flexure,
    physics: "Where the finger rubs on a guide, a cable drags or a screw joint creeps, a friction force \
              acts beside the flexure. It opposes every movement until it slips, so the flexure lags \
              behind on the way up and on the way down, and at one and the same force the field has two \
              values: a loop, as wide as twice the friction force, however slowly the load moves. Just \
              after a turning point the friction first reverses (elastically, within its reach) before the \
              flexure follows fully again.",
    equation: "F' = F - f s, s = stop operator of F with the reach, from -1 to 1",
    regressors: "dB/dF times the stop operator of F",
    needs: &[],
    parameters: &[
        Parameter::coefficient("friction_x", "N", 2.5),
        Parameter::coefficient("friction_z", "N", 2.5),
        Parameter::shape("reach_x", "N", &[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0]),
        Parameter::shape("reach_z", "N", &[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0]),
    ],
    size: Size {
        words: "friction force (half the width of the loop)",
        unit: "N",
        first: 2,
        of: SizeOf::MostSignificant,
        factor: 1.0,
        typical: 2.5,
        plausible: (0.0, 25.0),
        possible: (0.0, 250.0),
    },
    record: "Load to the same peak at two speeds a factor of three apart, and dwell at the turning \
              points: hysteresis stays, lag and skew change with the speed.",
    confused_with: &[
        ("viscous_lag", "at a single frequency: the same ellipse"),
        ("clock_skew", "at a single frequency: the same ellipse"),
        ("creep", "where the load always returns at the same pace"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[friction_x, friction_z, reach_x, reach_z] = values else {
        return;
    };
    for (axis, friction, reach) in [(0, friction_x, reach_x), (1, friction_z, reach_z)] {
        if friction != 0.0 {
            let force: Vec<f64> = track.smooth_n.iter().map(|force| force[axis]).collect();
            let slider = stop(&force, reach, track.starts_unloaded);
            series.add_force(axis, |row| -friction * slider[row]);
        }
    }
}
