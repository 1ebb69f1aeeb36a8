//! The structure between magnet and sensor grows with temperature.

use super::{less, temperature};
use crate::fixed::share_of;
use crate::units::Field;

/// Fractional bits of [`Table::rest`] and [`Table::bend`].
pub const BITS: u32 = 24;

/// The field's answer to a count of temperature by way of the gap: a linear function of the field
/// itself, fitted over the design box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// The field at rest, in field units.
    pub at: [i32; 3],
    /// The answer there, in field units for each count.
    pub rest: [i32; 3],
    /// How it changes with each axis of the field: for each count and unit.
    pub bend: [[i32; 3]; 3],
}

impl Table {
    /// The field with the gap of the reference temperature.
    pub fn undo(&self, field: [Field; 3], warmer: i32) -> [Field; 3] {
        let [bx, by, bz] = field;
        let [ax, ay, az] = self.at;
        let away = [
            bx.0.saturating_sub(ax),
            by.0.saturating_sub(ay),
            bz.0.saturating_sub(az),
        ];
        let [sx, sy, sz] = self.bend.map(|row| {
            row.iter().zip(away).fold(0_i32, |sum, (slope, away)| {
                sum.saturating_add(share_of(*slope, away, 0))
            })
        });
        let [rx, ry, rz] = self.rest;
        [(bx, rx, sx), (by, ry, sy), (bz, rz, sz)].map(|(field, rest, bent)| {
            less(
                field,
                share_of(rest.saturating_add(bent), warmer, temperature::BITS + BITS),
            )
        })
    }
}
