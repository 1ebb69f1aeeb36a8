//! The motor's currents make a field of their own.

use nalgebra::Vector3;

use crate::recordings::columns::STATOR_CURRENTS;

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The currents, in the order of the parameters.
const COLUMNS: [&str; 3] = [STATOR_CURRENTS[0], STATOR_CURRENTS[1], "motor_iq_a"];

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "motor_leakage",
    stage: Stage::Outside,
    physics: "The motor sits centimetres from the sensors. Its phase currents make a field that turns with \
              the rotor, pole pair by pole pair, and the wires that feed it make one that stands still and \
              grows with the current. Both are proportional to the current: 10 A at 20 mm give about a \
              gauss.",
    equation: "B + K [i_alpha, i_beta] + k iq",
    regressors: "i_alpha, i_beta and iq in each axis",
    needs: &["motor_iq_a", "motor_angle_rad"],
    shows_against: &COLUMNS,
    parameters: &[
        Parameter::coefficient("alpha_x", "G/A", 0.05),
        Parameter::coefficient("alpha_y", "G/A", 0.05),
        Parameter::coefficient("alpha_z", "G/A", 0.05),
        Parameter::coefficient("beta_x", "G/A", 0.05),
        Parameter::coefficient("beta_y", "G/A", 0.05),
        Parameter::coefficient("beta_z", "G/A", 0.05),
        Parameter::coefficient("iq_x", "G/A", 0.05),
        Parameter::coefficient("iq_y", "G/A", 0.05),
        Parameter::coefficient("iq_z", "G/A", 0.05),
    ],
    size: Size {
        words: "field at 10 A",
        unit: "G",
        first: 9,
        of: SizeOf::Norm,
        factor: 10.0,
        resolution: 0.0,
        typical: 1.0,
        plausible: (0.0, 20.0),
        possible: (0.0, 2000.0),
    },
    record: "With the gripper unloaded and at a fixed opening, press against a stop with 0, half and full \
              current; then turn the motor slowly through several revolutions.",
    confused_with: &[("neighbour_magnet", "closing needs current")],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    for (column, field) in COLUMNS.iter().zip(values.chunks_exact(3)) {
        let (Some(current), &[x, y, z]) = (track.covariates.get(*column), field) else {
            continue;
        };
        for (state, amperes) in series.states.iter_mut().zip(current) {
            state.outside_g += Vector3::new(x, y, z) * *amperes;
        }
    }
}
