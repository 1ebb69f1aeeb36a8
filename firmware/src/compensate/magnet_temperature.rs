//! A warm magnet is weaker.

use super::temperature;
use crate::fixed::share_of;
use crate::units::Field;

/// Fractional bits of [`Table::per_count`].
pub const BITS: u32 = 28;
/// Fractional bits of the relative change while it is applied.
const CHANGE_BITS: u32 = 24;

/// The magnet's temperature coefficient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// What the sensor would read without the magnet, in field units.
    pub without: [i32; 3],
    /// Relative change of the remanence for each count of temperature.
    pub per_count: i32,
}

impl Table {
    /// The field at the reference temperature.
    pub fn undo(&self, field: [Field; 3], warmer: i32) -> [Field; 3] {
        // B = B0 (1 + c), so B0 = B - B c / (1 + c), and c / (1 + c) = c - c^2 but for c^3, which is
        // below a millionth for thirty kelvin.
        let change = share_of(
            self.per_count,
            warmer,
            temperature::BITS + BITS - CHANGE_BITS,
        );
        let taken = change.saturating_sub(share_of(change, change, CHANGE_BITS));
        let [x, y, z] = self.without;
        let [bx, by, bz] = field;
        [(bx, x), (by, y), (bz, z)].map(|(field, without)| {
            let own = field.0.saturating_sub(without);
            Field(field.0.saturating_sub(share_of(own, taken, CHANGE_BITS)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_kelvin_of_a_tenth_of_a_percent_are_given_back() {
        // 8 counts to a kelvin, -0.1 % to a kelvin: -1.25e-4 to a count.
        let table = Table {
            without: [0, 160, 0],
            per_count: -(1.25e-4 * f64::from(1 << BITS)) as i32,
        };
        let cold = [Field(10_000), Field(160_160), Field(-5_000)];
        let warm = [Field(9_900), Field(158_560), Field(-4_950)];
        for (found, cold) in table.undo(warm, 80 << temperature::BITS).iter().zip(cold) {
            assert!((found.0 - cold.0).abs() <= 1, "{found:?} {cold:?}");
        }
    }
}
