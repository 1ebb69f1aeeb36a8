//! The motor's currents make a field of their own.

use super::less;
use crate::fixed::share_of;
use crate::surroundings::Surroundings;
use crate::units::Field;

/// Fractional bits of [`Table::per_ma`].
pub const BITS: u32 = 20;

/// Field for each milliampere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// For each axis of the sensor: field units for a milliampere of alpha, beta, quadrature current.
    pub per_ma: [[i32; 3]; 3],
}

impl Table {
    /// The field without the motor; `None` where the motor is not known.
    pub fn undo(&self, field: [Field; 3], around: &Surroundings) -> Option<[Field; 3]> {
        let currents = around.motor?.currents();
        let [x, y, z] = self.per_ma;
        let [bx, by, bz] = field;
        Some([(bx, x), (by, y), (bz, z)].map(|(field, row)| {
            let own = row.iter().zip(currents);
            own.fold(field, |field, (share, ma)| {
                less(field, share_of(*share, ma, BITS))
            })
        }))
    }
}
