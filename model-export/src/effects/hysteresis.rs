//! Friction beside the flexure holds it back, on the way there and on the way back.

use super::memory::stops;
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
    equation: "F' = F - f (w1 s1 + w2 s2 + s3) / (w1 + w2 + 1), si = stop operator of F with reach i, from -1 to 1",
    regressors: "dB/dF times the stop operators of F",
    needs: &[],
    shows_against: &["loading_x", "loading_z"],
    parameters: &[
        Parameter::coefficient("friction_x", "N", 2.5),
        Parameter::coefficient("friction_z", "N", 2.5),
        Parameter::shape("reach1_x", "N", &[2.0, 4.0, 8.0, 16.0, 32.0]).within_swing(),
        Parameter::shape("reach2_x", "N", &[4.0, 8.0, 16.0, 32.0, 64.0]).within_swing(),
        Parameter::shape("reach3_x", "N", &[8.0, 16.0, 32.0, 64.0, 128.0]).within_swing(),
        Parameter::shape("weight1_x", "", &[0.1, 0.3, 1.0, 3.0]),
        Parameter::shape("weight2_x", "", &[0.1, 0.3, 1.0, 3.0]),
        Parameter::shape("reach1_z", "N", &[2.0, 4.0, 8.0, 16.0, 32.0]).within_swing(),
        Parameter::shape("reach2_z", "N", &[4.0, 8.0, 16.0, 32.0, 64.0]).within_swing(),
        Parameter::shape("reach3_z", "N", &[8.0, 16.0, 32.0, 64.0, 128.0]).within_swing(),
        Parameter::shape("weight1_z", "", &[0.1, 0.3, 1.0, 3.0]),
        Parameter::shape("weight2_z", "", &[0.1, 0.3, 1.0, 3.0]),
        Parameter::beginning("begin_x", "", 0.5),
        Parameter::beginning("begin_z", "", 0.5),
    ],
    size: Size {
        words: "friction force (half the width of the loop)",
        unit: "N",
        first: 2,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
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

/// Shapes of one axis.
const SHAPES: usize = 5;

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let Some((frictions, rest)) = values.split_at_checked(2) else {
        return;
    };
    let Some((shapes, beginnings)) = rest.split_at_checked(2 * SHAPES) else {
        return;
    };
    let recordings = beginnings.len() / 2;
    for (axis, (&friction, shapes)) in frictions
        .iter()
        .zip(shapes.chunks_exact(SHAPES))
        .enumerate()
    {
        if friction == 0.0 {
            continue;
        }
        let begin = beginnings
            .get(axis * recordings + track.recording)
            .copied()
            .unwrap_or(0.0);
        let force: Vec<f64> = track.smooth_n.iter().map(|force| force[axis]).collect();
        let held = stops(&force, sliders(shapes), begin);
        series.add_force(axis, |row| -friction * held[row]);
    }
}

/// Friction in newtons of one axis (0 lateral, 1 longitudinal), and its sliders; `values` in the order
/// of the parameters.
pub fn sliders_of(values: &[f64], axis: usize) -> (f64, [(f64, f64); 3]) {
    let shapes = values.get(2 + axis * SHAPES..2 + (axis + 1) * SHAPES);
    let friction = values.get(axis).copied().unwrap_or(0.0);
    (friction, sliders(shapes.unwrap_or(&[])))
}

/// Share of the friction and reach in newtons of each slider, from the shapes of one axis. Friction
/// is never one contact that lets go at once: three sliders in series with springs of their own
/// (the Maxwell-slip model) end at the noise floor of the recordings in `tests/data/friction`, where
/// one alone leaves some three times that.
fn sliders(shapes: &[f64]) -> [(f64, f64); 3] {
    let [reach1, reach2, reach3, weight1, weight2] =
        std::array::from_fn(|i| shapes.get(i).copied().unwrap_or(1.0));
    let all = weight1 + weight2 + 1.0;
    [
        (weight1 / all, reach1),
        (weight2 / all, reach2),
        (1.0 / all, reach3),
    ]
}
