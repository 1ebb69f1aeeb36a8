//! The definition of a step, bit by bit. Nothing here may be changed without the kernel.
//!
//! Sums wrap at 32 bits: the exporter has proved of every row that they do not, for any input and any
//! state.

use super::super::activation::{sigmoid, tanh};
use super::super::network::{Head, OUTPUTS, Pair, State, UnitPair, Weights};

/// One step over the inputs in `state`.
pub fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut State<INPUTS, HIDDEN, SENSORS>,
) {
    let [first_full, second_full] = &mut state.full;
    let [first_upper, second_upper] = &mut state.upper;
    layer(&weights.first, &state.input, first_upper, first_full);
    layer(&weights.second, first_upper, second_upper, second_full);
    for (outputs, head) in state.outputs.iter_mut().zip(&weights.heads) {
        *outputs = linear(head, second_upper);
    }
}

/// One layer: every unit sees the layer's state as it was before.
fn layer<const INPUTS: usize, const HIDDEN: usize>(
    units: &[UnitPair<INPUTS, HIDDEN>; HIDDEN],
    input: &[Pair; INPUTS],
    upper: &mut [Pair; HIDDEN],
    full: &mut [[i32; 2]; HIDDEN],
) {
    let before = *upper;
    for ((units, upper), full) in units.iter().zip(upper).zip(full) {
        *full = pair(units, input, &before, *full);
        // Rounded down; the biases make up for half a bit of it.
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
                *sum = multiplied(*sum, weights, input);
            }
        }
    }
    for (products, &upper) in units.state.iter().zip(upper) {
        for ((sums, recurrent), gates) in sums.iter_mut().zip(&mut recurrent).zip(products) {
            let [reset, update, _] = sums;
            let &[to_reset, to_update, to_candidate] = gates;
            *reset = multiplied(*reset, to_reset, upper);
            *update = multiplied(*update, to_update, upper);
            *recurrent = multiplied(*recurrent, to_candidate, upper);
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
    let kept = (difference * i64::from(update) + (1 << 31)) >> 32;
    candidate.wrapping_add((kept as i32).wrapping_mul(2))
}

fn linear<const HIDDEN: usize>(head: &Head<HIDDEN>, upper: &[Pair; HIDDEN]) -> [i32; OUTPUTS] {
    let mut outputs = head.bias;
    for (weights, &upper) in head.weights.iter().zip(upper) {
        for (output, &weights) in outputs.iter_mut().zip(weights) {
            *output = multiplied(*output, weights, upper);
        }
    }
    outputs
}

/// Two products added to a sum.
fn multiplied(sum: i32, [a, b]: Pair, [x, y]: Pair) -> i32 {
    sum.wrapping_add(i32::from(a) * i32::from(x))
        .wrapping_add(i32::from(b) * i32::from(y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_stays_within_two_bits_of_the_greatest_candidate() {
        const END: i32 = (1 << 30) - (1 << 16);
        for candidate in [i32::MIN, -1 << 29, -3, 0, 3, 1 << 29, i32::MAX] {
            for update in (-32..32).map(|update| update << 26) {
                for beyond in -6..=2 {
                    for state in [END + beyond, -END - beyond] {
                        let next = unit([0, update, candidate], 0, state);
                        assert!(next.abs() <= END + 2, "{candidate} {update} {state} {next}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_product_of_the_least_numbers_is_exact_and_a_sum_wraps() {
        let least = [i16::MIN; 2];
        assert_eq!(multiplied(0, [i16::MIN, 0], least), 1 << 30);
        assert_eq!(multiplied(-1, least, least), i32::MAX);
        assert_eq!(multiplied(0, least, least), i32::MIN);
    }
}
