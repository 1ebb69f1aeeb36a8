//! Orientation of a Hall sensor by right angles.

use core::ops::Neg;

/// Which axis of a sensor measures each axis of the gripper: one octal digit for each, x in the lowest; 0 to 2 for the sensor's x
/// to z, plus 4 where it points the other way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisMap(pub u16);

impl AxisMap {
    /// The sensor's axes are those of the gripper.
    pub const NOMINAL: Self = Self(0o210);

    /// Axis of the sensor along each axis of the gripper, and whether it points the other way.
    pub fn axes(self) -> [(u8, bool); 3] {
        [0, 3, 6].map(|shift| {
            let digit = self.0 >> shift;
            ((digit & 3) as u8, digit & 4 != 0)
        })
    }

    /// Whether this is one of the 24 rotations by right angles.
    pub fn is_rotation(self) -> bool {
        let order = self.0 & !0o444;
        let is_odd = (self.0 ^ (self.0 >> 3) ^ (self.0 >> 6)) & 4 != 0;
        if is_odd {
            matches!(order, 0o012 | 0o120 | 0o201)
        } else {
            matches!(order, 0o021 | 0o102 | 0o210)
        }
    }

    /// A vector in the sensor's axes, in those of the gripper.
    pub fn apply<T: Copy + Neg<Output = T>>(self, [x, y, z]: [T; 3]) -> [T; 3] {
        self.axes().map(|(axis, is_negated)| {
            let value = match axis {
                0 => x,
                1 => y,
                _ => z,
            };
            if is_negated { -value } else { value }
        })
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    #[test]
    fn rotations_are_the_24_maps_that_keep_handedness() {
        let rotations: Vec<AxisMap> =
            (0..=u16::MAX).map(AxisMap).filter(|map| map.is_rotation()).collect();
        assert_eq!(rotations.len(), 24);
        for map in rotations {
            // The images of the unit vectors: their triple product is the determinant.
            let [a, b, c] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|unit: [i32; 3]| map.apply(unit));
            let cross =
                [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            assert_eq!(a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2], 1, "{map:?}");
        }
        assert_eq!(AxisMap::NOMINAL.apply([1, 2, 3]), [1, 2, 3]);
        // The gripper's x is the sensor's -y.
        assert_eq!(AxisMap(0o205).apply([1, 2, 3]), [-2, 1, 3]);
    }
}
