//! First access to the memories, and memory copy routines of the ARM run-time ABI (IHI0043, "Memory copying"), which the compiler calls to move structures.
//!
//! The compiler's own are weak symbols, word loops at 1.3 instructions per byte, and the sensing tasks move some 6 KB in a
//! millisecond. These take 0.4 instructions per byte and a tenth of the flash.
#![allow(unsafe_code)] // Assembly under symbols of the ABI.

use core::arch::naked_asm;

/// Copies `length` bytes between word-aligned addresses.
///
/// # Safety
/// As [`core::ptr::copy_nonoverlapping`] of bytes; called by compiler-generated code.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memcpy4(_to: *mut u8, _from: *const u8, _length: usize) {
    naked_asm!(
        "push {{r4, r5, lr}}",
        "subs r2, #16",
        "blo 3f",
        "2:",
        "ldmia r1!, {{r3, r4, r5, r12}}",
        "stmia r0!, {{r3, r4, r5, r12}}",
        "subs r2, #16",
        "bhs 2b",
        // The lower four bits of the length are the remainder.
        "3:",
        "lsls r3, r2, #29",
        "itt cs",
        "ldmiacs r1!, {{r4, r5}}",
        "stmiacs r0!, {{r4, r5}}",
        "itt mi",
        "ldrmi r4, [r1], #4",
        "strmi r4, [r0], #4",
        "lsls r3, r2, #31",
        "itt cs",
        "ldrhcs r4, [r1], #2",
        "strhcs r4, [r0], #2",
        "itt mi",
        "ldrbmi r4, [r1]",
        "strbmi r4, [r0]",
        "pop {{r4, r5, pc}}",
    )
}

/// Copies `length` bytes between addresses aligned to double words.
///
/// # Safety
/// As [`__aeabi_memcpy4`].
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memcpy8(_to: *mut u8, _from: *const u8, _length: usize) {
    naked_asm!("b.w {words}", words = sym __aeabi_memcpy4)
}

/// Copies `length` bytes between unaligned addresses: the core supports single unaligned word accesses.
///
/// # Safety
/// As [`__aeabi_memcpy4`].
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memcpy(_to: *mut u8, _from: *const u8, _length: usize) {
    naked_asm!(
        "orr r3, r0, r1",
        "lsls r3, r3, #30",
        "beq.w {words}",
        "subs r2, #4",
        "blo 3f",
        "2:",
        "ldr r3, [r1], #4",
        "str r3, [r0], #4",
        "subs r2, #4",
        "bhs 2b",
        "3:",
        "lsls r2, r2, #31",
        "itt cs",
        "ldrhcs r3, [r1], #2",
        "strhcs r3, [r0], #2",
        "itt mi",
        "ldrbmi r3, [r1]",
        "strbmi r3, [r0]",
        "bx lr",
        words = sym __aeabi_memcpy4,
    )
}

/// Reads a word of each cut of SRAM before anything is written there: the first write to a cut after a reset may be lost (ES0430
/// 2.2.7). Core-coupled memory is read on the system bus. Called by the start of cortex-m-rt, before it uses the stack.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __pre_init() {
    naked_asm!(
        "ldr r0, =0x20000000",
        "ldr r0, [r0]",
        "ldr r0, =0x20014000",
        "ldr r0, [r0]",
        "ldr r0, =0x20018000",
        "ldr r0, [r0]",
        "bx lr",
        ".ltorg",
    )
}
