use super::*;
use crate::estimator::parity::ParityResidual;
use crate::fixed_point::Field;
use crate::model::formats::{Head, Input, Pair, UnitPair, Weights};

const ONE: i32 = 1 << 30;

type Net = Network<1, 4, 1>;
type State = GruState<1, 4, 1>;

fn step(network: &Net, state: &mut State, input: [Pair; 1]) {
    state.input = input;
    gru::step(&network.weights, state);
}

fn zero_units<const INPUTS: usize>() -> [UnitPair<INPUTS, 4>; 4] {
    [(); 4].map(|()| UnitPair {
        bias: [[0; 3]; 2],
        input: [[[[0; 2]; 3]; 2]; INPUTS],
        state_bias: [0; 2],
        state: [[[[0; 2]; 3]; 2]; 4],
    })
}

/// Two inputs, eight units, sensor 1; all weights zero.
fn zero_network() -> Net {
    let input = Input { source: InputSource::None, offset: 0, gain: 0 };
    Network {
        sensors: [1],
        target: Target::Force,
        inputs: [[input; 2]],
        force: [1 << 18; 2],
        warm_up: 2,
        guards: [Guard::NONE],
        weights: Weights {
            first: zero_units(),
            second: zero_units(),
            heads: [Head { bias: [0; 4], weights: [[[0; 2]; 4]; 4] }],
        },
        check: 0,
    }
}

#[test]
fn zero_weights_keep_the_state_at_zero() {
    let (network, mut state) = (zero_network(), State::RESET);
    for _ in 0..1000 {
        step(&network, &mut state, [[16_384, -16_384]]);
    }
    let max = state.full.iter().flatten().flatten().map(|h| h.abs()).max();
    assert!(max < Some(1 << 17), "{max:?}");
    assert_eq!(state.outputs, [[0; 4]]);
}

#[test]
fn the_update_gate_selects_candidate_or_state() {
    let mut network = zero_network();
    // Update gates at -16 and +16; candidates at +1.
    network.weights.first[0].bias = [[0, -ONE, 1 << 26], [0, ONE, 1 << 26]];
    let mut state = State::RESET;
    state.full[0][0][1] = -ONE / 2;
    step(&network, &mut state, [[0; 2]]);
    let [candidate, kept] = state.full[0][0];
    let tanh_1 = (f64::from(ONE) * 0.761_594_155_955_764_9) as i32;
    assert!((candidate - tanh_1).abs() < 1 << 17, "{candidate}");
    assert!((kept + ONE / 2).abs() < 1 << 17, "{kept}");
    let upper = [candidate, kept].map(|state| (state >> 16) as i16);
    assert_eq!(state.upper[0][0], upper);
}

#[test]
fn the_reset_gate_scales_the_candidate_s_recurrent_bias() {
    let mut network = zero_network();
    // 1 in Q27 times a reset gate of one half; update gate open.
    network.weights.first[0].state_bias = [1 << 27, 0];
    network.weights.first[0].bias[0][1] = -ONE;
    let mut state = State::RESET;
    step(&network, &mut state, [[0; 2]]);
    let tanh_half = f64::from(ONE) * 0.462_117_157_260_009_76;
    let [h, _] = state.full[0][0];
    assert!((f64::from(h) - tanh_half).abs() < f64::from(1 << 17), "{h}");
}

#[test]
fn all_units_use_the_layer_s_previous_state() {
    let mut network = zero_network();
    for pair in &mut network.weights.first {
        pair.bias = [[0, -ONE, 0]; 2];
        // Each candidate has the first unit as input, with a weight of 1 and an open reset gate.
        pair.bias[0][0] = ONE;
        pair.bias[1][0] = ONE;
        pair.state[0] = [[[0; 2], [0; 2], [8192, 0]]; 2];
    }
    let mut state = State::RESET;
    // The first and the last unit start equal.
    for (pair, unit) in [(0, 0), (3, 1)] {
        state.full[0][pair][unit] = ONE / 2;
        state.upper[0][pair][unit] = 8192;
    }
    step(&network, &mut state, [[0; 2]]);
    assert_eq!(state.full[0][0][0], state.full[0][3][1]);
}

#[test]
fn the_state_stays_below_one_for_extreme_inputs() {
    let mut network = zero_network();
    for pair in &mut network.weights.first {
        // Saturated candidates, gates almost closed.
        pair.bias = [[0, 8 << 26, 0]; 2];
        pair.input[0] = [[[0; 2], [0; 2], [i16::MAX, 0]]; 2];
    }
    let mut state = State::RESET;
    let mut max = 0;
    for count in 0..400_000 {
        let is_high = count % 100_000 < 50_000;
        let input = if is_high { i16::MAX } else { i16::MIN };
        step(&network, &mut state, [[input, 0]]);
        max = max.max(state.full[0][0][0].abs());
    }
    // Close to the candidate's bound, and within the proven one.
    assert!(max > ONE - ONE / 8 && max < ONE - (1 << 15), "{max}");
}

#[test]
fn the_head_is_linear_in_the_second_layer() {
    let mut network = zero_network();
    network.weights.second[1].bias = [[0, -ONE, 0], [0, -ONE, 4 << 26]];
    network.weights.heads[0].bias = [5, 0, 0, 0];
    network.weights.heads[0].weights[1][2] = [0, 4096];
    let mut state = State::RESET;
    step(&network, &mut state, [[0; 2]]);
    let tanh_4 = (0.999_329_299_739_067 * 16_384.0) as i32;
    let [[bias, _, weighted, _]] = state.outputs;
    // The second unit's state times a weight of one.
    assert_eq!(bias, 5);
    assert!((weighted - tanh_4 * 4096).abs() <= 4 * 4096, "{weighted}");
}

#[test]
fn predictions_start_after_the_warm_up() {
    let network = zero_network();
    let mut run = GruInference::RESET;
    let predicts = [(); 4].map(|()| run.step(&network, |_| Some(0)).is_some());
    assert_eq!(predicts, [false, false, true, true]);
    run = GruInference::RESET;
    assert_eq!(run.step(&network, |_| Some(0)), None);
}

/// Predicts 1 N and 2 N with a sigma of 1 N for any field of sensor 1, after three steps.
fn constant_network(target: Target) -> [Net; 1] {
    let mut network = zero_network();
    network.target = target;
    network.inputs[0][0] =
        Input { source: InputSource::Field { sensor: 1, axis: 2 }, offset: 0, gain: 1 << 20 };
    network.warm_up = 3;
    network.weights.heads[0].bias = [1 << 26, 2 << 26, 0, 0];
    [network]
}

fn estimates() -> [Estimate; SENSORS] {
    [Estimate {
        force: [Force(100), Force(200)],
        validity: Validity::Valid,
        field: [Field(5); 3],
        ..Estimate::MISSING
    }; SENSORS]
}

/// Estimates of the last frame.
fn run_frames(
    frames: u32,
    target: Target,
    runs: &mut [GruInference<1, 4, 1>; 1],
) -> [Estimate; SENSORS] {
    let mut last = estimates();
    for _ in 0..frames {
        last = estimates();
        apply(&constant_network(target), runs, &mut [None], &mut last);
    }
    last
}

#[test]
fn a_network_replaces_its_sensor_s_force_after_the_warm_up() {
    let mut runs = [GruInference::RESET];
    assert_eq!(run_frames(3, Target::Force, &mut runs), estimates());
    let [other, predicted, ..] = run_frames(1, Target::Force, &mut runs);
    assert_eq!(predicted.force, [Force(1024), Force(2048)]);
    let [sigma, _] = predicted.sigma.unwrap();
    assert!((sigma.0 - 1024).abs() <= 1);
    assert_eq!((other.force, other.sigma), ([Force(100), Force(200)], None));
}

#[test]
fn a_residual_network_is_added_to_the_ideal_model() {
    let [_, predicted, ..] = run_frames(4, Target::Rest, &mut [GruInference::RESET]);
    assert_eq!(predicted.force, [Force(1124), Force(2248)]);
}

#[test]
fn sigma_grows_outside_the_training_range() {
    let guard = Guard {
        residual: [Field(-10), Field(20)],
        force: [2 << FORCE_BITS, 3 << FORCE_BITS],
        deviation: [Force(50), Force(i32::MAX)],
    };
    for (guard, residual, deviation, expected) in [
        (guard, 20, [50, 9999], [0, 0]),
        (guard, 25, [0, 0], [10, 15]),
        (guard, -14, [57, 0], [8 + 7, 12]),
        (Guard::NONE, i32::MIN, [i32::MAX; 2], [0, 0]),
    ] {
        let estimate = Estimate {
            parity: ParityResidual { residual: Field(residual), sigma: 1 },
            ..Estimate::MISSING
        };
        assert_eq!(extrapolation(&guard, &estimate, deviation), expected);
    }
}

#[test]
fn a_missing_input_resets_the_network() {
    let mut runs = [GruInference::RESET];
    run_frames(9, Target::Force, &mut runs);
    let mut missing = estimates();
    missing[1] = Estimate::MISSING;
    apply(&constant_network(Target::Force), &mut runs, &mut [None], &mut missing);
    assert_eq!((missing[1], runs[0].steps), (Estimate::MISSING, 0));
    assert_eq!(run_frames(3, Target::Force, &mut runs), estimates());
}
