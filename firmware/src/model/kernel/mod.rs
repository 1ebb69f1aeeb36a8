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

#[cfg(target_os = "none")]
use core::arch::naked_asm;

/// Copies the kernels from flash to the core-coupled memory. Called first by the reset handler, in assembly because
/// statics are not initialised yet.
///
/// # Safety
/// Only for the reset handler. The linker script states the three addresses, in whole words.
#[cfg(target_os = "none")]
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __pre_init() {
    naked_asm!(
        "ldr r0, =__sccm",
        "ldr r1, =__eccm",
        "ldr r2, =__siccm",
        "2:",
        "cmp r0, r1",
        "beq 3f",
        "ldmia r2!, {{r3}}",
        "stmia r0!, {{r3}}",
        "b 2b",
        "3:",
        // Completes the writes before the code is executed.
        "dsb",
        "isb",
        "bx lr",
        ".ltorg",
    )
}
