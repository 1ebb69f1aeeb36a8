//! Definition of the recurrent network's step. A change requires the same change of the assembly.
//!
//! Sums wrap at 32 bits; the exporter proves for every row that they do not, for any input and state.

use crate::model::formats::{GATES, GruState, Head, OUTPUTS, Pair, Products, UnitPair, Weights};
use crate::model::kernel::activation::{sigmoid, tanh};

/// The part of a step that needs no input: computes [`GruState::recurrent`] from the states.
pub fn prepare<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    let [first_upper, second_upper] = &state.upper;
    let [first, second] = &mut state.recurrent;
    prepare_layer(&weights.first, first_upper, first);
    prepare_layer(&weights.second, second_upper, second);
}

/// The rest of a step, once after each [`prepare`]: updates the states and the outputs by the inputs in `state`.
pub fn finish<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    let [first_full, second_full] = &mut state.full;
    let [first_upper, second_upper] = &mut state.upper;
    let [first, second] = &state.recurrent;
    finish_layer(&weights.first, &state.input, first, first_upper, first_full);
    finish_layer(&weights.second, first_upper, second, second_upper, second_full);
    for (outputs, head) in state.outputs.iter_mut().zip(&weights.heads) {
        *outputs = linear(head, second_upper);
    }
}

/// One step by the portable definition, also on the chip.
pub fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    prepare(weights, state);
    finish(weights, state);
}

fn prepare_layer<const INPUTS: usize, const HIDDEN: usize>(
    units: &[UnitPair<INPUTS, HIDDEN>; HIDDEN],
    upper: &[Pair; HIDDEN],
    recurrent: &mut [[[i32; GATES]; 2]; HIDDEN],
) {
    for (units, recurrent) in units.iter().zip(recurrent) {
        *recurrent = units.bias;
        for (sums, state_bias) in recurrent.iter_mut().zip(units.state_bias) {
            let [_, _, candidate] = sums;
            *candidate = state_bias;
        }
        add_products(recurrent, &units.state, upper);
    }
}

fn finish_layer<const INPUTS: usize, const HIDDEN: usize>(
    units: &[UnitPair<INPUTS, HIDDEN>; HIDDEN],
    input: &[Pair; INPUTS],
    recurrent: &[[[i32; GATES]; 2]; HIDDEN],
    upper: &mut [Pair; HIDDEN],
    full: &mut [[i32; 2]; HIDDEN],
) {
    let states = upper.iter_mut().zip(full);
    for ((units, recurrent), (upper, full)) in units.iter().zip(recurrent).zip(states) {
        let mut sums = *recurrent;
        for (sums, bias) in sums.iter_mut().zip(units.bias) {
            let ([_, _, candidate], [_, _, candidate_bias]) = (sums, bias);
            *candidate = candidate_bias;
        }
        add_products(&mut sums, &units.input, input);
        for ((full, sums), [_, _, recurrent]) in full.iter_mut().zip(sums).zip(recurrent) {
            *full = unit(sums, *recurrent, *full);
        }
        // Rounded down; the biases compensate the mean of half a bit.
        *upper = full.map(|state| (state >> 16) as i16);
    }
}

/// Adds the products of two units' weights with pairs of factors to the accumulators of their gates.
///
/// On the chip one function for all sizes: the self-test, which alone uses it there, would not fit into the flash otherwise.
#[cfg_attr(target_os = "none", inline(never))]
fn add_products(sums: &mut [[i32; GATES]; 2], weights: &[Products], factors: &[Pair]) {
    for (weights, &factors) in weights.iter().zip(factors) {
        for (sums, gates) in sums.iter_mut().zip(weights) {
            for (sum, &weights) in sums.iter_mut().zip(gates) {
                *sum = dual_product(*sum, weights, factors);
            }
        }
    }
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
