//! The Earth's field turns through the gripper's axes as the gripper turns.

use nalgebra::{Rotation3, Vector3};

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "earth_field",
    stage: Stage::Outside,
    physics: "The Earth's field is 25 to 65 uT, 0.25 to 0.65 G (not 0.5 uT, as the paper has it): five \
              steps of the sensor, or half a newton. It stands still in the room, so it turns in the \
              gripper's axes whenever the gripper turns. In a gripper that never turns it cannot be told \
              from the sensor's offset.",
    equation: "B + R' b, R from roll, pitch, yaw (ZYX, body to world)",
    regressors: "the rows of the rotation",
    needs: &["roll_rad", "pitch_rad", "yaw_rad"],
    shows_against: &["roll_rad", "pitch_rad", "yaw_rad"],
    parameters: &[
        Parameter::coefficient("world_x", "G", 0.3).shared(),
        Parameter::coefficient("world_y", "G", 0.3).shared(),
        Parameter::coefficient("world_z", "G", 0.3).shared(),
    ],
    size: Size {
        words: "field",
        unit: "G",
        first: 0,
        of: SizeOf::Norm,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.48,
        plausible: (0.2, 0.7),
        possible: (0.0, 5.0),
    },
    record: "Turn the unloaded gripper through all orientations, at least 90 degrees about two axes.",
    confused_with: &[
        (
            "fingertip_mass",
            "both follow the orientation: Earth is a field in any axis, weight enters through dB/dF",
        ),
        ("sensor_temperature", "where it warms while it turns"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[x, y, z] = values else { return };
    let columns = ["roll_rad", "pitch_rad", "yaw_rad"].map(|name| track.covariates.get(name));
    let [Some(roll), Some(pitch), Some(yaw)] = columns else {
        return;
    };
    for (row, state) in series.states.iter_mut().enumerate() {
        let to_world = Rotation3::from_euler_angles(roll[row], pitch[row], yaw[row]);
        state.outside_g += to_world.inverse() * Vector3::new(x, y, z);
    }
}
