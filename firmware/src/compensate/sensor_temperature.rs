//! The Hall element's offset and gain change with its temperature.

use super::{less, temperature};
use crate::fixed::share_of;
use crate::units::Field;

/// Fractional bits of [`Table::offset`] and [`Table::gain`].
pub const BITS: u32 = 24;

/// Drift for each count of temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Of each axis' offset, in field units.
    pub offset: [i32; 3],
    /// Of the gain.
    pub gain: i32,
}

impl Table {
    /// The field that the sensor would have read at the reference temperature.
    pub fn undo(&self, field: [Field; 3], warmer: i32) -> [Field; 3] {
        let gain = share_of(self.gain, warmer, temperature::BITS);
        let [x, y, z] = self.offset;
        let [bx, by, bz] = field;
        [(bx, x), (by, y), (bz, z)].map(|(field, offset)| {
            let centred = less(field, share_of(offset, warmer, temperature::BITS + BITS));
            less(centred, share_of(centred.0, gain, BITS))
        })
    }
}
