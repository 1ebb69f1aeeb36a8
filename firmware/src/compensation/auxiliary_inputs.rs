//! Auxiliary inputs of the compensation: everything measured besides the Hall sensors. Each is optional; an effect
//! that needs a missing input is skipped and the estimate flagged.

use core::f32::consts::TAU;

use crate::fixed_point::saturate;
use crate::math::{Direction, TURN_UNITS};

/// Auxiliary inputs of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AuxiliaryInputs {
    /// Distance of the fingertips in micrometres.
    pub opening_um: Option<i32>,
    /// Current and rotor of the motor.
    pub motor: Option<MotorInputs>,
    /// Specific force (gravity included) in mm/s^2, gripper axes.
    pub acceleration: Option<[i32; 3]>,
    /// Orientation of the gripper.
    pub attitude: Option<Attitude>,
}

/// Current and rotor of the motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorInputs {
    /// Quadrature current in milliamperes.
    pub iq_ma: i32,
    /// Mechanical angle of the rotor sensor in microradians, 0 to 2 pi.
    pub angle_urad: i32,
    /// Sine and cosine of the electrical angle, with 15 fractional bits.
    pub electrical: [i32; 2],
}

impl MotorInputs {
    /// Of a quadrature current and a mechanical angle of the rotor sensor in 2^-32 turns.
    ///
    /// The electrical angle of the compensation is the pole pairs times this angle, in fit, recording and device. The
    /// commissioned offset between rotor sensor and winding is not part of it: it rotates the fitted coefficients, and
    /// a new commissioning does not change them.
    pub fn new(iq_ma: i32, turn: u32, pole_pairs: u8) -> Self {
        const TURN_URAD: u64 = 6_283_185;
        const ONE: f32 = 32_768.0;
        let Direction { sin, cos } = Direction::of(turn.wrapping_mul(pole_pairs.into()));
        Self {
            iq_ma,
            angle_urad: ((u64::from(turn) * TURN_URAD) >> 32) as i32,
            electrical: [(sin * ONE) as i32, (cos * ONE) as i32],
        }
    }

    /// Alpha, beta and quadrature current in milliamperes, assuming no direct current.
    pub fn currents(&self) -> [i32; 3] {
        let [sin, cos] = self.electrical.map(i64::from);
        let iq = i64::from(self.iq_ma);
        let project = |factor: i64| saturate((iq * factor) >> 15);
        [project(-sin), project(cos), self.iq_ma]
    }
}

/// Rotation from gripper to world axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attitude {
    /// Rotation matrix by rows, with 14 fractional bits.
    pub to_world: [[i32; 3]; 3],
}

impl Attitude {
    /// Fractional bits of the matrix.
    pub const BITS: u32 = 14;

    /// Of roll, pitch and yaw in radians: rotations about x, then y, then z. Each entry has an error of at most 0.004,
    /// three times that of the sine.
    pub fn from_euler([roll, pitch, yaw]: [f32; 3]) -> Self {
        const TURN_PER_RAD: f32 = TURN_UNITS / TAU;
        let [r, p, y] = [roll, pitch, yaw].map(|angle| {
            // Through i64: the cast to u32 alone would saturate negative angles.
            Direction::of((angle * TURN_PER_RAD) as i64 as u32)
        });
        let matrix = [
            [
                y.cos * p.cos,
                y.cos * p.sin * r.sin - y.sin * r.cos,
                y.cos * p.sin * r.cos + y.sin * r.sin,
            ],
            [
                y.sin * p.cos,
                y.sin * p.sin * r.sin + y.cos * r.cos,
                y.sin * p.sin * r.cos - y.cos * r.sin,
            ],
            [-p.sin, p.cos * r.sin, p.cos * r.cos],
        ];
        const ONE: f32 = (1 << Attitude::BITS) as f32;
        Self { to_world: matrix.map(|row| row.map(|entry| (entry * ONE) as i32)) }
    }

    /// Transforms a vector from world to gripper axes.
    pub fn to_body(&self, world: [i32; 3]) -> [i32; 3] {
        let [x, y, z] = self.to_world;
        let [wx, wy, wz] = world.map(i64::from);
        let sum = |a: i32, b: i32, c: i32| {
            saturate((i64::from(a) * wx + i64::from(b) * wy + i64::from(c) * wz) >> Self::BITS)
        };
        [sum(x[0], y[0], z[0]), sum(x[1], y[1], z[1]), sum(x[2], y[2], z[2])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_puts_the_current_on_minus_alpha() {
        let motor = MotorInputs { iq_ma: 4000, electrical: [1 << 15, 0], angle_urad: 0 };
        assert_eq!(motor.currents(), [-4000, 0, 4000]);
    }

    #[test]
    fn a_roll_of_90_degrees_maps_world_z_to_body_y() {
        let one = 1 << Attitude::BITS;
        let attitude = Attitude { to_world: [[one, 0, 0], [0, 0, -one], [0, one, 0]] };
        assert_eq!(attitude.to_body([0, 0, 100]), [0, 100, 0]);
    }
}
