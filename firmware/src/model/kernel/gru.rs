//! One step of a recurrent network: both layers and the heads in one function.
//!
//! Two units at a time, six accumulators in r4 to r9 (reset, update, candidate of the first, then of
//! the second). Inputs and old states wait in s0 to s31, a pair each; weights stream through r0 to r3,
//! r10 and r11, six words at a time: eight instructions for twelve products. While a unit's gates are
//! computed its pointers come from the stack in one load:
//!
//! ```text
//! sp + 0   the two candidates' accumulators, put aside during the recurrent products
//! sp + 8   middle of the table of the sigmoid; how far it is above tanh's
//! sp + 16  the layer's states: its last pair, then the pair before the next
//! ```
//!
//! Straight code and loops that count: the same instructions for any number.

use core::arch::naked_asm;

use super::super::activation::{self, MIDDLE};
use super::super::network::{State, Weights};

/// Pairs of units to an iteration of the loop: two where the code stays short.
const fn unrolled(hidden: usize) -> usize {
    if hidden <= 8 { 2 } else { 1 }
}

/// One step over the inputs in `state`.
#[inline(always)]
pub fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut State<INPUTS, HIDDEN, SENSORS>,
) {
    const {
        assert!(HIDDEN >= 4 && HIDDEN <= 16 && HIDDEN.is_multiple_of(4));
        assert!(INPUTS >= 1 && INPUTS + HIDDEN <= 32);
        assert!(SENSORS >= 1 && SENSORS <= 8);
    }
    // SAFETY: both are as large as the loops count, the assertions above are what the registers and
    // the offsets allow, and an index of the table is saturated to 9 bits around its middle.
    unsafe {
        let sigmoid = activation::TABLE.as_ptr().add(MIDDLE);
        kernel::<INPUTS, HIDDEN, SENSORS>(weights, state, sigmoid, activation::TANH_ONE);
    }
}

/// Products of the pairs in registers s`$from` to s`$to` - 1 with six words of weights each.
macro_rules! products {
    ($from:literal, $to:literal) => {
        concat!(
            ".irp i,0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30,31\n",
            ".if (\\i >= ", $from, ") && (\\i < ", $to, ")\n",
            "vmov r12, s\\i\n",
            "ldmia lr!, {{r0-r3, r10, r11}}\n",
            "smlad r4, r0, r12, r4\n",
            "smlad r5, r1, r12, r5\n",
            "smlad r6, r2, r12, r6\n",
            "smlad r7, r3, r12, r7\n",
            "smlad r8, r10, r12, r8\n",
            "smlad r9, r11, r12, r9\n",
            ".endif\n",
            ".endr",
        )
    };
}

/// A layer over `$inputs` pairs of inputs, `$all` together with its own states, which are in s0 and
/// up. r12 and the stack hold where its states are; r12 ends at its last pair.
macro_rules! layer {
    ($inputs:literal, $all:literal) => {
        concat!(
            "2:\n",
            ".irp k,1,2\n",
            ".if \\k <= {unrolled}\n",
            "ldmia lr!, {{r4-r9}}\n", // biases
            products!("0", $inputs),
            "\n",
            "strd r6, r9, [sp]\n",
            "ldmia lr!, {{r6, r9}}\n", // the candidates' recurrent biases
            products!($inputs, $all),
            "\n",
            "ldmia sp, {{r0-r3, r11, r12}}\n",
            // Reset gates, and what they let through to the candidates.
            "ssat r4, #24, r4, asr #7\n",
            "ssat r7, #24, r7, asr #7\n",
            "asr r10, r4, #15\n",
            "ldr r10, [r2, r10, lsl #2]\n",
            "smlabb r4, r10, r4, r10\n",
            "asr r10, r7, #15\n",
            "ldr r10, [r2, r10, lsl #2]\n",
            "smlabb r7, r10, r7, r10\n",
            "smlawt r6, r6, r4, r0\n",
            "smlawt r9, r9, r7, r1\n",
            // Update gates in r5 and r8, candidates in r6 and r9.
            "ssat r5, #24, r5, asr #7\n",
            "ssat r8, #24, r8, asr #7\n",
            "ssat r6, #24, r6, asr #6\n",
            "ssat r9, #24, r9, asr #6\n",
            "asr r0, r5, #15\n",
            "asr r1, r8, #15\n",
            "asr r4, r6, #15\n",
            "asr r7, r9, #15\n",
            "ldr r0, [r2, r0, lsl #2]\n",
            "ldr r1, [r2, r1, lsl #2]\n",
            "ldr r4, [r2, r4, lsl #2]\n",
            "ldr r7, [r2, r7, lsl #2]\n",
            "smlabb r5, r0, r5, r0\n",
            "smlabb r8, r1, r8, r1\n",
            "smlabb r6, r4, r6, r4\n",
            "smlabb r9, r7, r9, r7\n",
            "sub r6, r6, r3\n",
            "sub r9, r9, r3\n",
            "ldrd r2, r3, [r12, #8*\\k]\n", // old states
            // candidate + update * (old - candidate)
            "sub r2, r2, r6\n",
            "sub r3, r3, r9\n",
            "smmulr r2, r2, r5\n",
            "smmulr r3, r3, r8\n",
            "add r6, r6, r2, lsl #1\n",
            "add r9, r9, r3, lsl #1\n",
            ".if \\k == {unrolled}\n",
            "strd r6, r9, [r12, #8*\\k]!\n",
            ".else\n",
            "strd r6, r9, [r12, #8*\\k]\n",
            ".endif\n",
            ".endif\n",
            ".endr\n",
            "str r12, [sp, #20]\n",
            "cmp r12, r11\n",
            "bne 2b",
        )
    };
}

/// Upper halves of the `{hidden}` pairs of states from r10 on to r11 on.
macro_rules! upper_halves {
    () => {
        concat!(
            ".rept {hidden}/4\n",
            "ldmia r10!, {{r0-r7}}\n",
            "pkhtb r0, r1, r0, asr #16\n",
            "pkhtb r1, r3, r2, asr #16\n",
            "pkhtb r2, r5, r4, asr #16\n",
            "pkhtb r3, r7, r6, asr #16\n",
            "stmia r11!, {{r0-r3}}\n",
            ".endr",
        )
    };
}

/// # Safety
/// The first two point to a network's weights and state of these sizes, the third to the middle of the table
/// of [`activation`]; the last is [`activation::TANH_ONE`].
#[unsafe(naked)]
#[unsafe(link_section = ".ccm.gru")]
unsafe extern "C" fn kernel<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    _weights: *const Weights<INPUTS, HIDDEN, SENSORS>,
    _state: *mut State<INPUTS, HIDDEN, SENSORS>,
    _sigmoid: *const u32,
    _above_tanh: i32,
) {
    naked_asm!(
        ".fpu fpv4-sp-d16", // What the target has; the assembler is not always told.
        "push {{r4-r11, lr}}",
        ".if {registers} > 16",
        "vpush {{s16-s31}}",
        ".endif",
        "mov lr, r0",
        "vldmia r1!, {{s0-s{last_first}}}", // inputs and the first layer's states
        "add r12, r1, #4*{hidden}-8",
        "add r11, r12, #8*{hidden}",
        "push {{r0-r3, r11, r12}}",
        layer!("{inputs}", "{inputs}+{hidden}"),
        "sub r10, r12, #8*{hidden}-8",
        "sub r11, r12, #16*{hidden}-8",
        upper_halves!(),
        "sub r1, r11, #4*{hidden}",
        "vldmia r1, {{s0-s{last_second}}}", // the first layer's states and the second's
        "add r0, r12, #8*{hidden}",
        "str r0, [sp, #16]",
        layer!("{hidden}", "2*{hidden}"),
        "sub r10, r12, #8*{hidden}-8",
        "sub r11, r12, #20*{hidden}-8",
        upper_halves!(),
        // The heads: accumulators in r4 to r7, four pairs of states in r8 to r11. The outputs stand
        // behind all states; a single sensor's need no counting.
        "sub r12, r11, #4*{hidden}",
        ".if {sensors} > 1",
        "add r0, r11, #16*{hidden}",
        "add r1, r0, #16*{sensors}",
        "strd r0, r1, [sp]",
        ".endif",
        "3:",
        "ldmia lr!, {{r4-r7}}",
        ".rept {hidden}/4",
        "ldmia r12!, {{r8-r11}}",
        ".irp pair,r8,r9,r10,r11",
        "ldmia lr!, {{r0-r3}}",
        "smlad r4, r0, \\pair, r4",
        "smlad r5, r1, \\pair, r5",
        "smlad r6, r2, \\pair, r6",
        "smlad r7, r3, \\pair, r7",
        ".endr",
        ".endr",
        ".if {sensors} > 1",
        "ldrd r0, r1, [sp]",
        "stmia r0!, {{r4-r7}}",
        "str r0, [sp]",
        "sub r12, r12, #4*{hidden}",
        "cmp r0, r1",
        "bne 3b",
        ".else",
        "add r0, r12, #16*{hidden}",
        "stmia r0!, {{r4-r7}}",
        ".endif",
        "add sp, sp, #24",
        ".if {registers} > 16",
        "vpop {{s16-s31}}",
        ".endif",
        "pop {{r4-r11, pc}}",
        inputs = const INPUTS,
        hidden = const HIDDEN,
        sensors = const SENSORS,
        unrolled = const unrolled(HIDDEN),
        last_first = const INPUTS + HIDDEN - 1,
        last_second = const 2 * HIDDEN - 1,
        registers = const if INPUTS > HIDDEN { INPUTS + HIDDEN } else { 2 * HIDDEN },
    )
}
