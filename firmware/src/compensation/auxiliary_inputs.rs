//! Auxiliary inputs of the compensation: everything measured besides the Hall sensors. Each is optional; an effect
//! that needs a missing input is skipped and the estimate flagged.

use crate::fixed_point::saturate;

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
    /// Sine and cosine of the electrical angle, with 15 fractional bits.
    pub electrical: [i32; 2],
    /// Mechanical angle in microradians, within a turn.
    pub angle_urad: i32,
}

impl MotorInputs {
    /// Alpha, beta and quadrature current in milliamperes, assuming no direct current.
    pub fn currents(&self) -> [i32; 3] {
        let [sin, cos] = self.electrical.map(i64::from);
        let iq = i64::from(self.iq_ma);
        let project = |factor: i64| saturate((iq * factor) >> 15);
        [project(-sin), project(cos), self.iq_ma]
    }
}

/// Rotation from body to world axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attitude {
    /// Rotation matrix by rows, with 14 fractional bits.
    pub to_world: [[i32; 3]; 3],
}

impl Attitude {
    /// Fractional bits of the matrix.
    pub const BITS: u32 = 14;

    /// Transforms a vector from world to body axes.
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
