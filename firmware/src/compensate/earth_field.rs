//! The Earth's field turns through the gripper's axes as the gripper turns.

use super::less;
use crate::fixed::share_of;
use crate::surroundings::Surroundings;
use crate::units::Field;

/// Fractional bits of [`Table::world`] and of [`Table::element`].
pub const BITS: u32 = 14;

/// The field of the world, and how the Hall element is turned against the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// In field units, world's axes.
    pub world: [i32; 3],
    /// Rotation from the gripper's to the sensor's axes, row by row.
    pub element: [[i32; 3]; 3],
}

impl Table {
    /// The field without the Earth's; `None` where the orientation is not known.
    pub fn undo(&self, field: [Field; 3], around: &Surroundings) -> Option<[Field; 3]> {
        let body = around.attitude?.to_body(self.world);
        let [x, y, z] = self.element;
        let [bx, by, bz] = field;
        Some([(bx, x), (by, y), (bz, z)].map(|(field, row)| {
            let seen = row.iter().zip(body).fold(0_i32, |sum, (share, b)| {
                // Both have fractional bits: they leave in two steps, so that nothing overflows.
                sum.saturating_add(share_of(*share, b, BITS))
            });
            less(field, share_of(seen, 1, BITS))
        }))
    }
}
