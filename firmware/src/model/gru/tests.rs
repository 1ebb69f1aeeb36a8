//! Steps whose result is known by hand, and what must hold for every network.

use super::*;
use crate::model::network::{Guard, Head, Input, Pair, Source, Target, UnitPair, Weights};

const ONE: i32 = 1 << 30;

fn step(network: &Network<1, 4, 1>, state: &mut State<1, 4, 1>, input: [Pair; 1]) {
    state.input = input;
    super::step(&network.weights, state);
}

/// Two inputs, eight units, one sensor; all weights zero.
fn nothing() -> Network<1, 4, 1> {
    let pair = UnitPair {
        bias: [[0; 3]; 2],
        input: [[[[0; 2]; 3]; 2]; 1],
        state_bias: [0; 2],
        state: [[[[0; 2]; 3]; 2]; 4],
    };
    let second = UnitPair {
        bias: [[0; 3]; 2],
        input: [[[[0; 2]; 3]; 2]; 4],
        state_bias: [0; 2],
        state: [[[[0; 2]; 3]; 2]; 4],
    };
    let head = Head {
        bias: [0; 4],
        weights: [[[0; 2]; 4]; 4],
    };
    let input = Input {
        source: Source::None,
        offset: 0,
        gain: 0,
    };
    Network {
        sensors: [0],
        target: Target::Force,
        inputs: [[input; 2]],
        force: [1 << 18; 2],
        warm_up: 2,
        guards: [Guard::NONE; 1],
        weights: Weights {
            first: [const { 0 }; 4].map(|_| pair.clone()),
            second: [const { 0 }; 4].map(|_| second.clone()),
            heads: [head],
        },
        check: 0,
    }
}

#[test]
fn without_weights_the_state_stays_at_zero() {
    let (network, mut state) = (nothing(), State::RESET);
    for _ in 0..1000 {
        step(&network, &mut state, [[16_384, -16_384]]);
    }
    let greatest = state.full.iter().flatten().flatten().map(|h| h.abs()).max();
    assert!(greatest < Some(1 << 17), "{greatest:?}");
    assert_eq!(state.outputs, [[0; 4]]);
}

#[test]
fn an_open_gate_takes_the_candidate_and_a_closed_one_keeps_the_state() {
    let mut network = nothing();
    // Update gates at -16 and +16; candidates at +1 in the first unit of both.
    network.weights.first[0].bias = [[0, -ONE, 1 << 26], [0, ONE, 1 << 26]];
    let mut state = State::RESET;
    state.full[0][0][1] = -ONE / 2;
    step(&network, &mut state, [[0; 2]]);
    let [open, closed] = state.full[0][0];
    let tanh_1 = (f64::from(ONE) * 0.761_594_155_955_764_9) as i32;
    assert!((open - tanh_1).abs() < 1 << 17, "{open}");
    assert!((closed + ONE / 2).abs() < 1 << 17, "{closed}");
    assert_eq!(
        state.upper[0][0],
        [(open >> 16) as i16, (closed >> 16) as i16]
    );
}

#[test]
fn the_recurrent_bias_of_a_candidate_stands_inside_the_reset_product() {
    let mut network = nothing();
    // 1 in Q27 behind a reset gate of one half; update gate open.
    network.weights.first[0].state_bias = [1 << 27, 0];
    network.weights.first[0].bias[0][1] = -ONE;
    let mut state = State::RESET;
    step(&network, &mut state, [[0; 2]]);
    let tanh_half = f64::from(ONE) * 0.462_117_157_260_009_76;
    let [h, _] = state.full[0][0];
    assert!((f64::from(h) - tanh_half).abs() < f64::from(1 << 17), "{h}");
}

#[test]
fn every_unit_sees_the_layer_as_it_was_before_the_step() {
    let mut network = nothing();
    for pair in &mut network.weights.first {
        pair.bias = [[0, -ONE, 0]; 2];
        // Each candidate sees the first unit alone, with a weight of 1 behind an open reset gate.
        pair.bias[0][0] = ONE;
        pair.bias[1][0] = ONE;
        pair.state[0] = [[[0; 2], [0; 2], [8192, 0]]; 2];
    }
    let mut state = State::RESET;
    // The last unit stands where the first does: a closed update gate keeps 3e-5 of it.
    for (pair, unit) in [(0, 0), (3, 1)] {
        state.full[0][pair][unit] = ONE / 2;
        state.upper[0][pair][unit] = 8192;
    }
    step(&network, &mut state, [[0; 2]]);
    let [first, last] = [state.full[0][0][0], state.full[0][3][1]];
    assert_eq!(first, last, "the first unit's new state was seen");
}

#[test]
fn the_state_never_reaches_one_whatever_drives_it() {
    let mut network = nothing();
    for pair in &mut network.weights.first {
        // Candidates at their ends by turns of the input, gates almost closed.
        pair.bias = [[0, 8 << 26, 0]; 2];
        pair.input[0] = [[[0; 2], [0; 2], [i16::MAX, 0]]; 2];
    }
    let mut state = State::RESET;
    let mut greatest = 0;
    for count in 0..400_000 {
        let input = if count % 100_000 < 50_000 {
            i16::MAX
        } else {
            i16::MIN
        };
        step(&network, &mut state, [[input, 0]]);
        greatest = greatest.max(state.full[0][0][0].abs());
    }
    // Close to the candidate's end, and not one bit beyond what the format's proof says.
    assert!(
        greatest > ONE - ONE / 8 && greatest < ONE - (1 << 15),
        "{greatest}"
    );
}

#[test]
fn outputs_are_the_head_over_the_second_layer() {
    let mut network = nothing();
    network.weights.second[1].bias = [[0, -ONE, 0], [0, -ONE, 4 << 26]];
    network.weights.heads[0].bias = [5, 0, 0, 0];
    network.weights.heads[0].weights[1][2] = [0, 4096];
    let mut state = State::RESET;
    step(&network, &mut state, [[0; 2]]);
    let tanh_4 = (0.999_329_299_739_067 * 16_384.0) as i32;
    let [[bias, _, weighted, _]] = state.outputs;
    // The second unit's state, a weight of one.
    assert_eq!(bias, 5);
    assert!((weighted - tanh_4 * 4096).abs() <= 4 * 4096, "{weighted}");
}

#[test]
fn an_estimate_counts_only_after_the_warm_up() {
    let network = nothing();
    let mut run = Run::RESET;
    let told: [bool; 4] = core::array::from_fn(|_| run.step(&network, |_| Some(0)).is_some());
    assert_eq!(told, [false, false, true, true]);
    run = Run::RESET;
    assert_eq!(run.step(&network, |_| Some(0)), None);
}
