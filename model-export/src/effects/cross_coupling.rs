//! A force along one axis also moves the magnet along the other.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "cross_coupling",
    stage: Stage::Load,
    physics: "No flexure is soft in one direction only. A force along the fingertip also twists or bends \
              the lateral flexure a little, and the magnet moves sideways by some percent of what a \
              lateral force of that size would do. A sensor that is mounted with a small turn shows nearly \
              the same, and only what the turn cannot explain is told apart.",
    equation: "Fx' = Fx + c_x Fz, Fz' = Fz + c_z Fx",
    regressors: "dB/dFx times Fz, dB/dFz times Fx",
    needs: &[],
    shows_against: &["fx_n", "fz_n"],
    parameters: &[
        Parameter::coefficient("onto_x", "%", 1.5),
        Parameter::coefficient("onto_z", "%", 1.5),
    ],
    size: Size {
        words: "share of the other force",
        unit: "%",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 1.5,
        plausible: (-10.0, 10.0),
        possible: (-100.0, 100.0),
    },
    record: "Load one axis at a time, then both with different rhythms.",
    confused_with: &[("fingertip_mass", "where the load comes from moving the arm")],
    undone: Undone::Tables,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], _: &Track, series: &mut Series) {
    let &[onto_x, onto_z] = values else { return };
    for force in &mut series.force_n {
        let [x, z] = *force;
        *force = [x + 0.01 * onto_x * z, z + 0.01 * onto_z * x];
    }
}
