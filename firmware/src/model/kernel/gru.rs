//! One step of a recurrent network: two layers of gated recurrent units and a linear head, in integers.
//!
//! The equation is PyTorch's, with the reset after the product:
//!
//! ```text
//! r = sigmoid(W_r x + b_r + U_r h)
//! z = sigmoid(W_z x + b_z + U_z h)
//! n = tanh(W_n x + b_n + r (U_n h + c_n))
//! h' = n + z (h - n)
//! ```
//!
//! **State.** 32 bits, of which the products use the upper half. A state of 16 bits would stall at slow gates, where
//! (1 - z) times the difference rounds to zero. A candidate stays within ±(2^30 - 2^16), and a state within two units of
//! the last place of that: it is a mean of itself and the candidate with 32-bit weights, rounded once. So their
//! difference never overflows, and rounding errors decay with the state itself.

#[cfg(target_os = "none")]
use core::arch::naked_asm;

use crate::model::formats::{GruState, Head, OUTPUTS, Pair, UnitPair, Weights};
#[cfg(target_os = "none")]
use crate::model::kernel::activation;
#[cfg(target_os = "none")]
use crate::model::kernel::activation::MIDDLE;
use crate::model::kernel::activation::{sigmoid, tanh};

/// One step on the inputs in `state`: updates the states and the outputs there.
#[inline(always)]
pub fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    #[cfg(target_os = "none")]
    assembly(weights, state);
    #[cfg(not(target_os = "none"))]
    portable(weights, state);
}

/// Definition of [`step`]. A change requires the same change of the assembly.
///
/// Sums wrap at 32 bits; the exporter proves for every row that they do not, for any input and state.
pub fn portable<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    let [first_full, second_full] = &mut state.full;
    let [first_upper, second_upper] = &mut state.upper;
    layer(&weights.first, &state.input, first_upper, first_full);
    layer(&weights.second, first_upper, second_upper, second_full);
    for (outputs, head) in state.outputs.iter_mut().zip(&weights.heads) {
        *outputs = linear(head, second_upper);
    }
}

/// One layer: every unit uses the layer's previous state.
fn layer<const INPUTS: usize, const HIDDEN: usize>(
    units: &[UnitPair<INPUTS, HIDDEN>; HIDDEN],
    input: &[Pair; INPUTS],
    upper: &mut [Pair; HIDDEN],
    full: &mut [[i32; 2]; HIDDEN],
) {
    let before = *upper;
    for ((units, upper), full) in units.iter().zip(upper).zip(full) {
        *full = pair(units, input, &before, *full);
        // Rounded down; the biases compensate the mean of half a bit.
        *upper = full.map(|state| (state >> 16) as i16);
    }
}

fn pair<const INPUTS: usize, const HIDDEN: usize>(
    units: &UnitPair<INPUTS, HIDDEN>,
    input: &[Pair; INPUTS],
    upper: &[Pair; HIDDEN],
    full: [i32; 2],
) -> [i32; 2] {
    let mut sums = units.bias;
    let mut recurrent = units.state_bias;
    for (products, &input) in units.input.iter().zip(input) {
        for (sums, gates) in sums.iter_mut().zip(products) {
            for (sum, &weights) in sums.iter_mut().zip(gates) {
                *sum = dual_product(*sum, weights, input);
            }
        }
    }
    for (products, &upper) in units.state.iter().zip(upper) {
        for ((sums, recurrent), gates) in sums.iter_mut().zip(&mut recurrent).zip(products) {
            let [reset, update, _] = sums;
            let &[to_reset, to_update, to_candidate] = gates;
            *reset = dual_product(*reset, to_reset, upper);
            *update = dual_product(*update, to_update, upper);
            *recurrent = dual_product(*recurrent, to_candidate, upper);
        }
    }
    let mut next = full;
    for ((next, sums), recurrent) in next.iter_mut().zip(sums).zip(recurrent) {
        *next = unit(sums, recurrent, *next);
    }
    next
}

/// A unit's next state from its accumulators: reset, update and candidate in Q26, the candidate's
/// recurrent one in Q27; the state in Q30.
fn unit([reset, update, candidate]: [i32; 3], recurrent: i32, state: i32) -> i32 {
    let reset = sigmoid(reset);
    let update = sigmoid(update);
    // Q27 times the upper half of Q31, rounded down to Q26.
    let gated = (i64::from(recurrent) * i64::from(reset >> 16)) >> 16;
    let candidate = tanh(candidate.wrapping_add(gated as i32));
    // Q30 times Q31, rounded to the nearest in Q29.
    let difference = i64::from(state.wrapping_sub(candidate));
    let blend = (difference * i64::from(update) + (1 << 31)) >> 32;
    candidate.wrapping_add((blend as i32).wrapping_mul(2))
}

fn linear<const HIDDEN: usize>(head: &Head<HIDDEN>, upper: &[Pair; HIDDEN]) -> [i32; OUTPUTS] {
    let mut outputs = head.bias;
    for (weights, &upper) in head.weights.iter().zip(upper) {
        for (output, &weights) in outputs.iter_mut().zip(weights) {
            *output = dual_product(*output, weights, upper);
        }
    }
    outputs
}

/// Adds two products to a sum.
fn dual_product(sum: i32, [a, b]: Pair, [x, y]: Pair) -> i32 {
    sum.wrapping_add(i32::from(a) * i32::from(x)).wrapping_add(i32::from(b) * i32::from(y))
}

/// Pairs of units per iteration of the loop: two where the code stays short.
#[cfg(target_os = "none")]
const fn unrolled(hidden: usize) -> usize {
    if hidden <= 8 { 2 } else { 1 }
}

/// [`portable`] in assembly: both layers and the heads in one function.
///
/// Two units at a time, six accumulators in r4 to r9 (reset, update, candidate of the first, then of
/// the second). Inputs and previous states are in s0 to s31, a pair each; weights are streamed through r0 to r3,
/// r10 and r11, six words at a time: eight instructions for twelve products. While a unit's gates are
/// computed its pointers are loaded from the stack:
///
/// ```text
/// sp + 0   the two candidates' accumulators, saved during the recurrent products
/// sp + 8   middle of the table of the sigmoid; its offset from tanh's
/// sp + 16  the layer's states: its last pair, then the pair before the next
/// ```
///
/// No data-dependent branches: the number of instructions is constant.
#[cfg(target_os = "none")]
#[inline(always)]
pub fn assembly<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
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
#[cfg(target_os = "none")]
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
/// up. r12 and the stack point to its states; r12 ends at its last pair.
#[cfg(target_os = "none")]
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
            // Reset gates and the gated recurrent terms of the candidates.
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
#[cfg(target_os = "none")]
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
#[cfg(target_os = "none")]
#[unsafe(naked)]
#[unsafe(link_section = ".ccm.gru")]
unsafe extern "C" fn kernel<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    _weights: *const Weights<INPUTS, HIDDEN, SENSORS>,
    _state: *mut GruState<INPUTS, HIDDEN, SENSORS>,
    _sigmoid: *const u32,
    _above_tanh: i32,
) {
    naked_asm!(
        ".fpu fpv4-sp-d16", // The unit of the target, which the assembler does not always assume.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_state_stays_within_two_bits_of_the_candidate_s_range() {
        const END: i32 = (1 << 30) - (1 << 16);
        for candidate in [i32::MIN, -1 << 29, -3, 0, 3, 1 << 29, i32::MAX] {
            for update in (-32..32).map(|update| update << 26) {
                for excess in -6..=2 {
                    for state in [END + excess, -END - excess] {
                        let next = unit([0, update, candidate], 0, state);
                        assert!(next.abs() <= END + 2, "{candidate} {update} {state} {next}");
                    }
                }
            }
        }
    }

    #[test]
    fn minimum_factors_give_exact_products_and_wrapping_sums() {
        let min = [i16::MIN; 2];
        assert_eq!(dual_product(0, [i16::MIN, 0], min), 1 << 30);
        assert_eq!(dual_product(-1, min, min), i32::MAX);
        assert_eq!(dual_product(0, min, min), i32::MIN);
    }
}
