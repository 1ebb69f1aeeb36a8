//! Gaussian radial basis functions in integers. [`portable`] is the definition of every bit; the chip
//! runs a kernel in assembly that gives the same.

use super::table::{CentrePair, EXP_ENTRIES};

/// Squared distances are shifted right by this before the table is read.
const DISTANCE_SHIFT: u32 = 5;
/// Greatest shifted distance: the table's last entry, and zero beyond for any useful width.
const DISTANCE_LIMIT: u32 = (1 << 24) - 1;
/// Shifted distances between two entries.
pub const ENTRY_BITS: u32 = 15;
/// Squared distance between two entries of the table.
pub const ENTRY_STEP: u32 = 1 << (ENTRY_BITS + DISTANCE_SHIFT);

/// Sum over the centres of weight times exp(-gamma d^2), for both forces.
///
/// The exponential has 15 bits, a weight 16. Sums wrap: the exporter has proved that they do not
/// overflow for any input.
#[inline(always)]
pub fn sum(exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
    #[cfg(target_os = "none")]
    return super::kernel::grbf::sum(exp, pairs, at);
    #[cfg(not(target_os = "none"))]
    portable(exp, pairs, at)
}

/// The definition of [`sum`]. Differences wrap at 16 bits: coordinates and centres stay within
/// [`super::table::COORDINATE_LIMIT`], where they do not.
pub fn portable(exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
    let [x, y, z] = at;
    let (mut fx, mut fz) = (0_i32, 0_i32);
    for pair in pairs {
        let [first, second] = pair.xy;
        let near = |[cx, cy]: [i16; 2], cz: i16| {
            let apart = |at: i16, centre: i16| i32::from(at.wrapping_sub(centre));
            let (dx, dy, dz) = (apart(x, cx), apart(y, cy), apart(z, cz));
            let squares = dx.wrapping_mul(dx).wrapping_add(dy.wrapping_mul(dy));
            exponential(exp, squares.wrapping_add(dz.wrapping_mul(dz)))
        };
        let [z1, z2] = pair.z;
        let (a, b) = (near(first, z1), near(second, z2));
        let [[wa, wb], [va, vb]] = pair.weight;
        fx = fx
            .wrapping_add(a * i32::from(wa))
            .wrapping_add(b * i32::from(wb));
        fz = fz
            .wrapping_add(a * i32::from(va))
            .wrapping_add(b * i32::from(vb));
    }
    [fx, fz]
}

/// exp(-gamma d^2) with 15 fractional bits, by linear interpolation.
///
/// An entry holds its value in the upper and its slope in the lower half. The lower half of the
/// argument is read as a signed number, so that odd entries refer to their end: the fraction needs
/// no masking.
fn exponential(table: &[u32; EXP_ENTRIES], distance: i32) -> i32 {
    let argument = (distance >> DISTANCE_SHIFT).clamp(0, DISTANCE_LIMIT as i32);
    let index = (argument >> ENTRY_BITS) as usize;
    let entry = table.get(index).copied().unwrap_or(0);
    let slope = i32::from(entry as u16 as i16);
    let fraction = i32::from(argument as u16 as i16);
    (entry as i32).wrapping_add(slope.wrapping_mul(fraction)) >> 16
}
