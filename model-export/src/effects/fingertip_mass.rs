//! The fingertip itself pushes on its flexures: its weight and its inertia.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "fingertip_mass",
    stage: Stage::Load,
    physics: "The flexure carries the fingertip, and the reference does not see what that mass does. Held \
              sideways it pulls with its weight; accelerated it pushes back. Both are the same thing: mass \
              times specific force, which is what an accelerometer reads, gravity included. A tenth of a \
              kilogram is 1 N of weight and 1.5 N at 15 m/s^2.",
    equation: "F' = F + m a, a specific force along x and z",
    regressors: "dB/dFx times accel_x plus dB/dFz times accel_z",
    needs: &["accel_x_mps2", "accel_z_mps2"],
    shows_against: &["accel_x_mps2", "accel_z_mps2"],
    parameters: &[Parameter::coefficient("mass", "kg", 0.1)],
    size: Size {
        words: "mass",
        unit: "kg",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.1,
        plausible: (0.0, 1.0),
        possible: (0.0, 20.0),
    },
    record: "Turn the unloaded gripper slowly through all orientations, then shake it along x and z.",
    confused_with: &[
        (
            "earth_field",
            "both follow the orientation: Earth is a field in any axis, weight enters through dB/dF",
        ),
        ("cross_coupling", "where the load comes from moving the arm"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[mass_kg] = values else { return };
    for (axis, column) in [(0, "accel_x_mps2"), (1, "accel_z_mps2")] {
        if let Some(acceleration) = track.covariates.get(column) {
            series.add_force(axis, |row| mass_kg * acceleration[row]);
        }
    }
}
