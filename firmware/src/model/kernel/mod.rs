//! The two sums that dominate the computing time. Each has a portable definition of every bit, which hosts use, and
//! an equivalent in assembly for the chip; the self-test compares both on an emulated core.
//!
//! The assembly is the only unsafe code of the models. Its pointers are from references to structs of fixed layout
//! (`repr(C)`, words and pairs of half words, no padding) whose sizes are the constants of the loops: no access outside
//! of them. The code is in `.ccm`, core-coupled memory without wait states.
#![allow(unsafe_code)]

pub mod activation;
pub mod grbf;
pub mod gru;

/// Copies the kernels and the motor's interrupts from flash to the core-coupled memory, where they run. Called before
/// the first use of either, and after the clocks are set: with the clock after a reset it takes ten times as long. False if the
/// copy differs.
///
/// Not inlined: the check of the image looks for this function.
#[cfg(target_os = "none")]
#[inline(never)]
pub fn copy_to_ccm() -> bool {
    unsafe extern "C" {
        static mut __sccm: u32;
        static __eccm: u32;
        static __siccm: u32;
    }
    let is_equal;
    // SAFETY: the addresses are those of the linker script, aligned to words. No reference to this memory exists, and copying
    // the same code again would change nothing.
    unsafe {
        let to = &raw mut __sccm;
        let words = (&raw const __eccm).addr().saturating_sub(to.addr()) / size_of::<u32>();
        to.copy_from_nonoverlapping(&raw const __siccm, words);
        let word = |start: *const u32, word| start.add(word).read_volatile();
        is_equal = (0..words).all(|place| word(to, place) == word(&raw const __siccm, place));
    }
    // Completes the writes before the code is executed.
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    is_equal
}
