//! Brings the kernels from flash to the memory beside the core.

use core::arch::naked_asm;

/// Runs before anything else, called by the reset handler. In assembly: no memory of Rust's is ready.
///
/// # Safety
/// Only for the reset handler. The linker script states the three addresses, in whole words.
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
        // What was written is now what is executed.
        "dsb",
        "isb",
        "bx lr",
        ".ltorg",
    )
}
