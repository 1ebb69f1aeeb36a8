//! Attitude as foreign recordings have it: a quaternion from the body to the world.

use nalgebra::{Quaternion, UnitQuaternion};
use serde::Deserialize;

use super::problem::Fault;

/// Columns that an attitude becomes: turns about x, y and z, body to world, in the order z, y, x.
pub const ANGLES: [&str; 3] = ["roll_rad", "pitch_rad", "yaw_rad"];

/// A quaternion shorter than this is none.
const LEAST_NORM: f64 = 1e-6;

/// Columns of the source that hold the parts of the quaternion.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attitude {
    /// Scalar part.
    pub w: String,
    /// Along x.
    pub x: String,
    /// Along y.
    pub y: String,
    /// Along z.
    pub z: String,
}

impl Attitude {
    /// Names of the columns, the scalar part first.
    pub fn columns(&self) -> [&str; 4] {
        [&self.w, &self.x, &self.y, &self.z]
    }
}

/// Roll, pitch and yaw in rad of a quaternion of any length (scalar part first). Roll and yaw go on
/// from `last` instead of jumping by a turn at half a turn: rows are averaged later.
pub fn angles([w, x, y, z]: [f64; 4], last: Option<[f64; 3]>) -> Result<[f64; 3], Fault> {
    let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), LEAST_NORM);
    let Some(turn) = turn else {
        let found = "the quaternion 0, 0, 0, 0".to_owned();
        let advice = "it is no attitude: remove the rows before the attitude was known".to_owned();
        return Err(Fault::BadValue { found, advice });
    };
    let (roll, pitch, yaw) = turn.euler_angles();
    let [last_roll, _, last_yaw] = last.unwrap_or([roll, pitch, yaw]);
    Ok([onwards(roll, last_roll), pitch, onwards(yaw, last_yaw)])
}

/// The angle, whole turns added, that is nearest to `last`.
fn onwards(angle: f64, last: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    angle + turn * ((last - angle) / turn).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn a_quaternion_of_any_length_turns_a_vector_as_its_angles_do() {
        let parts = [0.9546, 0.0415, 0.0482, -0.2910];
        let [roll, pitch, yaw] = angles(parts.map(|part| 3.0 * part), None).unwrap();
        let by_angles =
            Rotation3::from_euler_angles(roll, pitch, yaw) * Vector3::new(1.0, 2.0, 3.0);
        let [w, x, y, z] = parts;
        let quaternion = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        let turned = quaternion * Vector3::new(1.0, 2.0, 3.0);
        assert!((by_angles - turned).norm() < 1e-12);
    }

    #[test]
    fn a_quarter_turn_about_z_is_a_quarter_of_yaw() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let [roll, pitch, yaw] = angles([half, 0.0, 0.0, half], None).unwrap();
        assert!(roll.abs() < 1e-12 && pitch.abs() < 1e-12);
        assert!((yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn yaw_goes_on_beyond_half_a_turn() {
        let at = |yaw: f64| [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()];
        let before = angles(at(3.1), None).unwrap();
        let after = angles(at(3.2), Some(before)).unwrap();
        assert!((after[2] - 3.2).abs() < 1e-9, "{}", after[2]);
    }

    #[test]
    fn no_quaternion_is_refused() {
        assert!(angles([0.0; 4], None).is_err());
    }
}
