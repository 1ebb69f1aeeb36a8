//! What the board knows beside the fields: whatever a compensation may need. Each is absent where
//! nothing measures it; then what needs it is off, and the estimate says so.

use crate::fixed::clamped;

/// One millisecond of everything that is not a Hall sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Surroundings {
    /// Between the fingertips in micrometres.
    pub opening_um: Option<i32>,
    /// The motor's current and rotor.
    pub motor: Option<Motor>,
    /// Specific force (gravity included) in mm/s^2, gripper's axes.
    pub acceleration: Option<[i32; 3]>,
    /// Orientation of the gripper.
    pub attitude: Option<Attitude>,
}

/// The motor at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Motor {
    /// Quadrature current in milliamperes.
    pub iq_ma: i32,
    /// Sine and cosine of the electrical angle, with 15 fractional bits.
    pub electrical: [i32; 2],
    /// Mechanical angle in microradians, within a turn.
    pub angle_urad: i32,
}

impl Motor {
    /// Alpha, beta and quadrature current in milliamperes, all current being quadrature current.
    pub fn currents(&self) -> [i32; 3] {
        let [sin, cos] = self.electrical.map(i64::from);
        let iq = i64::from(self.iq_ma);
        let turned = |share: i64| clamped((iq * share) >> 15);
        [turned(-sin), turned(cos), self.iq_ma]
    }
}

/// Orientation as a rotation from the body's axes to the world's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attitude {
    /// The matrix row by row, with 14 fractional bits.
    pub to_world: [[i32; 3]; 3],
}

impl Attitude {
    /// Fractional bits of the matrix.
    pub const BITS: u32 = 14;

    /// A vector of the world in the body's axes.
    pub fn to_body(&self, world: [i32; 3]) -> [i32; 3] {
        let [x, y, z] = self.to_world;
        let [wx, wy, wz] = world.map(i64::from);
        let sum = |a: i32, b: i32, c: i32| {
            clamped((i64::from(a) * wx + i64::from(b) * wy + i64::from(c) * wz) >> Self::BITS)
        };
        [
            sum(x[0], y[0], z[0]),
            sum(x[1], y[1], z[1]),
            sum(x[2], y[2], z[2]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotor_a_quarter_turn_on_has_its_current_along_minus_alpha() {
        let motor = Motor {
            iq_ma: 4000,
            electrical: [1 << 15, 0],
            angle_urad: 0,
        };
        assert_eq!(motor.currents(), [-4000, 0, 4000]);
    }

    #[test]
    fn a_gripper_rolled_by_a_quarter_turn_sees_the_world_s_down_along_its_y() {
        // Roll by 90 degrees about x: body y points to the world's z.
        let one = 1 << Attitude::BITS;
        let attitude = Attitude {
            to_world: [[one, 0, 0], [0, 0, -one], [0, one, 0]],
        };
        assert_eq!(attitude.to_body([0, 0, 100]), [0, 100, 0]);
    }
}
