//! The magnet of the opposing finger comes close as the gripper closes.

use super::less;
use crate::surroundings::Surroundings;
use crate::units::Field;

/// Openings of the table: 0 to 64 mm in steps of half a millimetre.
pub const KNOTS: usize = 129;
/// Step in micrometres.
pub const STEP_UM: i32 = 500;

/// The neighbour's field over the opening, in field units, sensor's axes. Between the knots the
/// device goes along a straight line; beyond the ends it stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table<'a> {
    /// One for each opening.
    pub knots: &'a [[i16; 3]; KNOTS],
}

impl Table<'_> {
    /// The field without the neighbour's; `None` where the opening is not known.
    pub fn undo(&self, field: [Field; 3], around: &Surroundings) -> Option<[Field; 3]> {
        let last = (KNOTS as i32 - 1) * STEP_UM;
        let opening = around.opening_um?.clamp(0, last - 1);
        let index = (opening / STEP_UM) as usize;
        let share = opening % STEP_UM;
        let (before, after) = (self.knots.get(index)?, self.knots.get(index + 1)?);
        let [bx, by, bz] = field;
        let [x0, y0, z0] = *before;
        let [x1, y1, z1] = *after;
        Some(
            [(bx, x0, x1), (by, y0, y1), (bz, z0, z1)].map(|(field, from, to)| {
                let (from, to) = (i32::from(from), i32::from(to));
                less(field, from + (to - from) * share / STEP_UM)
            }),
        )
    }
}
