//! Beyond a knee the flexure meets a stop.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "hard_stop",
    stage: Stage::Flexure,
    physics: "Many flexures carry a stop against overload: beyond some deflection the finger touches a \
              wall and the force goes on without much more movement. In the field the answer to the force \
              has a knee. Up to it nothing at all is seen, which tells a stop from a stiffening flexure. A \
              finger that sits off the middle may meet one on one side only.",
    equation: "F' = F - c (|F| - F_knee) sign(F) beyond the knee, one c for each side",
    regressors: "dB/dF times the force beyond the knee",
    needs: &[],
    shows_against: &["fx_n", "fz_n"],
    parameters: &[
        Parameter::coefficient("lost_x", "%", 60.0),
        Parameter::coefficient("lost_z", "%", 60.0),
        Parameter::coefficient("lost_back_x", "%", 60.0),
        Parameter::coefficient("lost_back_z", "%", 60.0),
        Parameter::shape(
            "knee_x",
            "N",
            &[
                20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0, 210.0,
            ],
        ),
        Parameter::shape(
            "knee_z",
            "N",
            &[
                20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0, 210.0,
            ],
        ),
    ],
    size: Size {
        words: "compliance lost beyond the knee",
        unit: "%",
        first: 4,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 60.0,
        plausible: (5.0, 100.0),
        possible: (0.0, 105.0),
    },
    record: "Go slowly 10 % past the suspected stop, both signs, and look at the raw counts for clipping.",
    confused_with: &[
        (
            "geometric_stiffening",
            "where the load hardly goes beyond the knee",
        ),
        (
            "sensor_compression",
            "where the field along the gap grows with the load",
        ),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], _: &Track, series: &mut Series) {
    let &[x, z, back_x, back_z, knee_x, knee_z] = values else {
        return;
    };
    for force in &mut series.force_n {
        let stopped = |n: f64, [lost, back]: [f64; 2], knee: f64| {
            let lost = if n < 0.0 { back } else { lost };
            n - 0.01 * lost * (n.abs() - knee).max(0.0) * n.signum()
        };
        *force = [
            stopped(force[0], [x, back_x], knee_x),
            stopped(force[1], [z, back_z], knee_z),
        ];
    }
}
