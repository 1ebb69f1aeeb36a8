//! [`super::portable`] in assembly: the same bits, without data-dependent branches, so that the number of instructions is constant.
//!
//! Two units at a time, six accumulators in r4 to r9 (reset, update, candidate of the first, then of the second). The factors of a
//! layer, inputs or previous states, are in s0 to s15, a pair each; weights are streamed through r0 to r3, r10 and r11 from lr, six
//! words at a time: eight instructions for twelve products.

use core::arch::naked_asm;

use crate::model::formats::{GruState, Weights};
use crate::model::kernel::activation::{self, MIDDLE};

/// [`super::portable::prepare`].
#[inline(always)]
pub fn prepare<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    const { assert_sizes(INPUTS, HIDDEN, SENSORS) };
    // SAFETY: both are as large as the loops count; the assertions are what the registers and the offsets allow.
    unsafe { prepare_kernel::<INPUTS, HIDDEN, SENSORS>(weights, state) };
}

/// [`super::portable::finish`].
#[inline(always)]
pub fn finish<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    const { assert_sizes(INPUTS, HIDDEN, SENSORS) };
    // SAFETY: both are as large as the loops count, the assertions are what the registers and the offsets allow, and an index
    // of the table is saturated to 9 bits around its middle.
    unsafe {
        let sigmoid = activation::TABLE.as_ptr().add(MIDDLE);
        finish_kernel::<INPUTS, HIDDEN, SENSORS>(weights, state, sigmoid, activation::TANH_ONE);
    }
}

const fn assert_sizes(inputs: usize, hidden: usize, sensors: usize) {
    assert!(hidden >= 4 && hidden <= 16 && hidden.is_multiple_of(4));
    assert!(inputs >= 1 && inputs <= 16);
    assert!(sensors >= 1 && sensors <= 8);
}

/// Pairs of units per iteration of the loop: two where the code stays short.
const fn unrolled(hidden: usize) -> usize {
    if hidden <= 8 { 2 } else { 1 }
}

/// Products of the first `$count` pairs of factors with six words of weights each.
macro_rules! products {
    ($count:literal) => {
        concat!(
            ".irp i,0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15\n",
            ".if \\i < ",
            $count,
            "\n",
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

/// Recurrent products of a layer with `$inputs` pairs of inputs. The stack points to the place of the accumulators and to their end.
macro_rules! prepare_layer {
    ($inputs:literal) => {
        concat!(
            "2:\n",
            "ldmia lr!, {{r4-r9}}\n", // biases
            "add lr, lr, #24*",
            $inputs,
            "\n",
            "ldmia lr!, {{r6, r9}}\n", // the candidates' recurrent biases
            products!("{hidden}"),
            "\n",
            "ldrd r0, r1, [sp]\n",
            "stmia r0!, {{r4-r9}}\n",
            "str r0, [sp]\n",
            "cmp r0, r1\n",
            "bne 2b",
        )
    };
}

/// # Safety
/// Both point to a network's weights and state of these sizes.
#[unsafe(naked)]
#[unsafe(link_section = ".ccm.gru")]
unsafe extern "C" fn prepare_kernel<
    const INPUTS: usize,
    const HIDDEN: usize,
    const SENSORS: usize,
>(
    _weights: *const Weights<INPUTS, HIDDEN, SENSORS>,
    _state: *mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    naked_asm!(
        ".fpu fpv4-sp-d16", // The unit of the target, which the assembler does not always assume.
        "push {{r4-r11, lr}}",
        "mov lr, r0",
        "add r4, r1, #4*{inputs}",
        "vldmia r4!, {{s0-s{last}}}", // the first layer's states
        "add r2, r4, #20*{hidden}+16*{sensors}",
        "add r3, r2, #24*{hidden}",
        "push {{r2-r4}}",
        prepare_layer!("{inputs}"),
        "ldr r4, [sp, #8]",
        "vldmia r4, {{s0-s{last}}}", // the second layer's states
        "add r1, r1, #24*{hidden}",
        "str r1, [sp, #4]",
        prepare_layer!("{hidden}"),
        "add sp, sp, #12",
        "pop {{r4-r11, pc}}",
        inputs = const INPUTS,
        hidden = const HIDDEN,
        sensors = const SENSORS,
        last = const HIDDEN - 1,
    )
}

/// A layer over `$inputs` pairs of inputs in s0 and up. While a unit's gates are computed its pointers are loaded from the stack:
///
/// ```text
/// sp + 0   the two candidates' recurrent accumulators
/// sp + 8   middle of the table of the sigmoid; its offset from tanh's
/// sp + 16  the layer's states: its last pair, then the pair before the next
/// sp + 24  accumulators of the next two units after the recurrent products
/// ```
///
/// r12 ends at the last pair of states.
macro_rules! finish_layer {
    ($inputs:literal) => {
        concat!(
            "2:\n",
            ".irp k,1,2\n",
            ".if \\k <= {unrolled}\n",
            "ldr r12, [sp, #24]\n",
            "ldmia r12!, {{r4-r9}}\n",
            "str r12, [sp, #24]\n",
            "strd r6, r9, [sp]\n",
            "ldr r6, [lr, #8]\n", // the candidates' biases
            "ldr r9, [lr, #20]\n",
            "add lr, lr, #24\n",
            products!($inputs),
            "\n",
            "add lr, lr, #24*{hidden}+8\n", // behind the recurrent weights
            "ldmia sp, {{r0-r3, r11, r12}}\n",
            // Reset gates and the gated recurrent terms of the candidates.
            "ssat r4, #24, r4, asr #7\n",
            "ssat r7, #24, r7, asr #7\n",
            "asr r10, r4, #15\n",
            "ldr r10, [r2, r10, lsl #2]\n",
            "smlabb r4, r10, r4, r10\n",
            "asr r10, r7, #15\n",
            "ldr r10, [r2, r10, lsl #2]\n",
            "smlabb r7, r10, r7, r10\n",
            "smlawt r6, r0, r4, r6\n",
            "smlawt r9, r1, r7, r9\n",
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
unsafe extern "C" fn finish_kernel<
    const INPUTS: usize,
    const HIDDEN: usize,
    const SENSORS: usize,
>(
    _weights: *const Weights<INPUTS, HIDDEN, SENSORS>,
    _state: *mut GruState<INPUTS, HIDDEN, SENSORS>,
    _sigmoid: *const u32,
    _above_tanh: i32,
) {
    naked_asm!(
        ".fpu fpv4-sp-d16", // As above.
        "push {{r4-r11, lr}}",
        "mov lr, r0",
        "vldmia r1!, {{s0-s{last_input}}}",
        "add r12, r1, #8*{hidden}-8",
        "add r11, r12, #8*{hidden}",
        "add r4, r1, #24*{hidden}+16*{sensors}",
        "push {{r4}}",
        "push {{r0-r3, r11, r12}}",
        finish_layer!("{inputs}"),
        "sub r10, r12, #8*{hidden}-8",
        "sub r11, r12, #16*{hidden}-8",
        upper_halves!(),
        "sub r1, r11, #4*{hidden}",
        "vldmia r1, {{s0-s{last_state}}}", // the first layer's new states
        "add r0, r12, #8*{hidden}",
        "str r0, [sp, #16]",
        finish_layer!("{hidden}"),
        "sub r10, r12, #8*{hidden}-8",
        "sub r11, r12, #20*{hidden}-8",
        upper_halves!(),
        // The heads: accumulators in r4 to r7, four pairs of states in r8 to r11. The outputs
        // follow the states; a single sensor needs no loop.
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
        "add sp, sp, #28",
        "pop {{r4-r11, pc}}",
        inputs = const INPUTS,
        hidden = const HIDDEN,
        sensors = const SENSORS,
        unrolled = const unrolled(HIDDEN),
        last_input = const INPUTS - 1,
        last_state = const HIDDEN - 1,
    )
}
