//! How the gripper is held and moved: angles, and what an accelerometer feels.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, Vector3};

use super::draw::{Purpose, between, stream};
use super::programme::Programme;
use super::waves::Waves;

/// Gravity in m/s^2.
pub const GRAVITY: f64 = 9.81;

/// Greatest angles of roll and pitch, in rad; pitch stays away from the poles of the ZYX angles.
const ROLL_RAD: f64 = 2.2;
const PITCH_RAD: f64 = 1.2;

/// Yaw swings by this about a slow turn.
const YAW_RAD: f64 = 1.0;

/// Frequencies of turning and of moving.
const TURNING_HZ: [f64; 2] = [0.02, 0.12];
const MOVING_HZ: [f64; 2] = [0.4, 2.5];

/// Greatest acceleration along each axis of the body, such that the norm stays below 6 m/s^2.
const MOVING_MPS2: f64 = 3.4;

/// Orientation and motion during one recording.
#[derive(Clone, Debug)]
pub struct Attitude {
    /// Roll, pitch and yaw; absent where the gripper stays level.
    turning: Option<[Waves; 3]>,
    yaw: (f64, f64),
    moving: [Waves; 3],
}

/// How the gripper stands at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Roll, pitch, yaw in rad, body to world, ZYX; within a turn.
    pub angles_rad: [f64; 3],
    /// From the body's axes to the world's.
    pub to_world: Rotation3<f64>,
    /// What an accelerometer feels in m/s^2, body's axes: gravity's reaction and motion.
    pub specific_force: Vector3<f64>,
}

impl Attitude {
    /// Draws turning and motion for a recording.
    pub fn draw(programme: Programme, seed: u64, recording: u32) -> Self {
        let mut rng = stream(seed, Purpose::Attitude, recording);
        let turning =
            [ROLL_RAD, PITCH_RAD, YAW_RAD].map(|peak| Waves::draw(&mut rng, 3, TURNING_HZ, peak));
        Self {
            turning: (programme != Programme::Level).then_some(turning),
            yaw: (between(&mut rng, -PI, PI), between(&mut rng, -0.15, 0.15)),
            moving: [0, 1, 2].map(|_| Waves::draw(&mut rng, 4, MOVING_HZ, MOVING_MPS2)),
        }
    }

    /// How the gripper stands at a time in seconds.
    pub fn at(&self, time_s: f64) -> Standing {
        let angles_rad = match &self.turning {
            None => [0.0; 3],
            Some(turning) => {
                let [roll, pitch, yaw] = [0, 1, 2].map(|i| turning[i].at(time_s));
                let (start, speed) = self.yaw;
                [roll, pitch, wrapped(start + speed * time_s + yaw)]
            }
        };
        let [roll, pitch, yaw] = angles_rad;
        let to_world = Rotation3::from_euler_angles(roll, pitch, yaw);
        let moving = Vector3::from_fn(|i, _| self.moving[i].at(time_s));
        Standing {
            angles_rad,
            to_world,
            specific_force: to_world.inverse() * Vector3::new(0.0, 0.0, GRAVITY) + moving,
        }
    }
}

/// An angle between -pi and pi.
fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_gripper_feels_gravity_along_z_and_motion_below_6() {
        let attitude = Attitude::draw(Programme::Level, 1, 1);
        for step in 0..3000 {
            let standing = attitude.at(f64::from(step) * 0.01);
            let motion = standing.specific_force - Vector3::new(0.0, 0.0, 9.81);
            assert!(standing.angles_rad == [0.0; 3] && motion.norm() < 6.0);
        }
    }

    #[test]
    fn a_gripper_rolled_onto_its_side_feels_gravity_along_y() {
        let to_world = Rotation3::from_euler_angles(0.5 * PI, 0.0, 0.3);
        let felt = to_world.inverse() * Vector3::new(0.0, 0.0, GRAVITY);
        assert!((felt - Vector3::new(0.0, GRAVITY, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn on_the_bench_the_gripper_turns_through_large_angles() {
        let attitude = Attitude::draw(Programme::Bench, 1, 1);
        for axis in 0..3 {
            let angles = (0..300).map(|step| attitude.at(f64::from(step) * 0.1).angles_rad[axis]);
            let (least, most) = angles.fold((PI, -PI), |(l, m), a| (l.min(a), m.max(a)));
            assert!(most - least > 0.8, "{axis}: {least} to {most}");
        }
    }
}
