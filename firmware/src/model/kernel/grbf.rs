//! The sum of Gaussian radial basis functions: two centres at a time, the loop twice unrolled.

use core::arch::naked_asm;

use super::super::table::{CentrePair, EXP_ENTRIES};

/// Sum over the centres of weight times exp(-gamma d^2), for both forces.
#[inline(always)]
pub fn sum(exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
    // Word by word: built for size, a map over the array is a call of its own.
    let [x, y, z] = at;
    let (x, y, z) = (x as u16 as u32, y as u16 as u32, z as u16 as u32);
    let end = pairs.as_ptr_range().end;
    // SAFETY: the loop ends where the pairs end, and an index of the table is saturated to 9 bits.
    let both = unsafe { kernel(pairs.as_ptr(), end, exp, x | y << 16, z | z << 16) };
    [both as i32, (both >> 32) as i32]
}

/// Two centres: their five words from r0 on, what they add in r4 and r5.
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
        // An odd number of pairs begins with one alone. A pair has 20 bytes, so the bit of four is set
        // in the length of an odd number of them.
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
