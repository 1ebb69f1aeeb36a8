//! Sum of Gaussian radial basis functions in integers.

#[cfg(target_os = "none")]
use core::arch::naked_asm;

use crate::model::formats::{CentrePair, EXP_ENTRIES};

/// Right shift of a squared distance to the argument of the table.
const DISTANCE_SHIFT: u32 = 5;
/// Maximum argument: the table's last entry, zero for any useful width.
const DISTANCE_LIMIT: u32 = (1 << 24) - 1;
/// Bits of the argument between two entries.
pub const ENTRY_BITS: u32 = 15;
/// Squared distance between two entries of the table.
pub const ENTRY_STEP: u32 = 1 << (ENTRY_BITS + DISTANCE_SHIFT);

/// Sum over the centres of weight times exp(-gamma d^2), for both forces.
///
/// The exponential has 15 bits, a weight 16. Sums wrap; the exporter proves that they do not overflow for any input.
#[inline(always)]
pub fn sum(exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
    #[cfg(target_os = "none")]
    return assembly(exp, pairs, at);
    #[cfg(not(target_os = "none"))]
    portable(exp, pairs, at)
}

/// Definition of [`sum`]. Differences wrap at 16 bits, which does not occur within
/// [`crate::model::formats::COORDINATE_LIMIT`].
pub fn portable(exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
    let [x, y, z] = at;
    let (mut fx, mut fz) = (0_i32, 0_i32);
    for pair in pairs {
        let [first, second] = pair.xy;
        let basis = |[cx, cy]: [i16; 2], cz: i16| {
            let difference = |at: i16, centre: i16| i32::from(at.wrapping_sub(centre));
            let (dx, dy, dz) = (difference(x, cx), difference(y, cy), difference(z, cz));
            let squares = dx.wrapping_mul(dx).wrapping_add(dy.wrapping_mul(dy));
            exponential(exp, squares.wrapping_add(dz.wrapping_mul(dz)))
        };
        let [z1, z2] = pair.z;
        let (a, b) = (basis(first, z1), basis(second, z2));
        let [[wa, wb], [va, vb]] = pair.weight;
        fx = fx.wrapping_add(a * i32::from(wa)).wrapping_add(b * i32::from(wb));
        fz = fz.wrapping_add(a * i32::from(va)).wrapping_add(b * i32::from(vb));
    }
    [fx, fz]
}

/// exp(-gamma d^2) with 15 fractional bits, by linear interpolation.
///
/// An entry has its value in the upper and its slope in the lower half. The lower half of the argument is used as a
/// signed number, so that odd entries refer to their end and the fraction needs no mask.
fn exponential(table: &[u32; EXP_ENTRIES], distance: i32) -> i32 {
    let argument = (distance >> DISTANCE_SHIFT).clamp(0, DISTANCE_LIMIT as i32);
    let index = (argument >> ENTRY_BITS) as usize;
    let entry = table.get(index).copied().unwrap_or(0);
    let slope = i32::from(entry as u16 as i16);
    let fraction = i32::from(argument as u16 as i16);
    (entry as i32).wrapping_add(slope.wrapping_mul(fraction)) >> 16
}

/// [`portable`] in assembly: two centres at a time, the loop unrolled twice.
#[cfg(target_os = "none")]
#[inline(always)]
pub fn assembly(exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
    // Word by word: optimised for size, a map over the array would be a function call.
    let [x, y, z] = at;
    let (x, y, z) = (x as u16 as u32, y as u16 as u32, z as u16 as u32);
    let end = pairs.as_ptr_range().end;
    // SAFETY: the loop ends where the pairs end, and an index of the table is saturated to 9 bits.
    let both = unsafe { kernel(pairs.as_ptr(), end, exp, x | y << 16, z | z << 16) };
    [both as i32, (both >> 32) as i32]
}

/// Two centres: five words from r0 on, accumulated in r4 and r5.
#[cfg(target_os = "none")]
macro_rules! pair {
    () => {
        concat!(
            "ldmia r0!, {{r7-r11}}\n",
            // Differences, then squared distances in r7 and r8.
            "ssub16 r7, r3, r7\n",
            "ssub16 r8, r3, r8\n",
            "ssub16 r9, r6, r9\n",
            "smuad r7, r7, r7\n",
            "smuad r8, r8, r8\n",
            "smlabb r7, r9, r9, r7\n",
            "smlatt r8, r9, r9, r8\n",
            // The exponential.
            "usat r7, #24, r7, asr #5\n",
            "usat r8, #24, r8, asr #5\n",
            "lsr r9, r7, #15\n",
            "lsr r12, r8, #15\n",
            "ldr r9, [r2, r9, lsl #2]\n",
            "ldr r12, [r2, r12, lsl #2]\n",
            "smlabb r9, r9, r7, r9\n",
            "smlabb r12, r12, r8, r12\n",
            "pkhtb r9, r12, r9, asr #16\n",
            "smlad r4, r9, r10, r4\n",
            "smlad r5, r9, r11, r5",
        )
    };
}

/// # Safety
/// The first two are the start and the end of a slice, the third points to a table of the exponential.
#[cfg(target_os = "none")]
#[unsafe(naked)]
#[unsafe(link_section = ".ccm.grbf")]
unsafe extern "C" fn kernel(
    _pairs: *const CentrePair,
    _end: *const CentrePair,
    _exp: *const [u32; EXP_ENTRIES],
    _xy: u32,
    _zz: u32,
) -> u64 {
    naked_asm!(
        "push {{r4-r11, lr}}",
        "ldr r6, [sp, #36]",
        "mov r4, #0",
        "mov r5, #0",
        // An odd number of pairs starts with a single one. A pair has 20 bytes, so bit 2 of the length is set for an odd
        // number.
        "sub r7, r1, r0",
        "tst r7, #4",
        "beq 3f",
        pair!(),
        "3:",
        "cmp r0, r1",
        "beq 4f",
        "2:",
        pair!(),
        pair!(),
        "cmp r0, r1",
        "bne 2b",
        "4:",
        "mov r0, r4",
        "mov r1, r5",
        "pop {{r4-r11, pc}}",
    )
}
