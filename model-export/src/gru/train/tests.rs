//! Training arithmetic versus the tensor library and versus plain equations.

use std::collections::HashMap;

use candle_core::{DType, Device, Tensor, Var};
use candle_nn::VarBuilder;
use candle_nn::optim::{AdamW, Optimizer, ParamsAdamW};
use candle_nn::rnn::{GRU, GRUConfig, RNN};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::network::{Input, Layer, Network, OUTPUTS, ScaledInput, Target};
use crate::gru::quantise::QuantisedNetwork;
use crate::gru::train::adam::{Adam, WEIGHT_DECAY, clip_gradients};
use crate::gru::train::dataset::{
    ScaledSequence, Scaling, SensorSequence, Sequence, Topology, zero_force_weight,
};
use crate::gru::train::forward::{LayerStates, WeightTensors, losses};
use crate::gru::train::parameters::{
    MAX_CANDIDATE_WEIGHT, MAX_WEIGHT, NetworkSize, ParameterTensor, TrainableParameters, index,
};

const SIZE: NetworkSize = NetworkSize { networks: 2, inputs: 3, hidden: 5, outputs: 4 };

/// Weights of all kinds, some of them large.
fn weights() -> TrainableParameters {
    let mut parameters = TrainableParameters::random(SIZE, 7, &[0, 1]);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for parameter in &mut parameters.all {
        for value in &mut parameter.values {
            *value += rng.random_range(-1.0..1.0_f32);
        }
    }
    parameters
}

fn noise(count: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// One layer's step in plain arithmetic, from the equation alone.
fn plain_step(layer: &Layer, x: &[f64], h: &[f64]) -> Vec<f64> {
    let dot = |weights: &[f32], row: usize, values: &[f64]| -> f64 {
        let row = &weights[row * values.len()..][..values.len()];
        row.iter().zip(values).map(|(w, v)| f64::from(*w) * v).sum()
    };
    let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
    let hidden = h.len();
    (0..hidden)
        .map(|i| {
            let inner =
                |row: usize| dot(&layer.input_weights, row, x) + f64::from(layer.input_bias[row]);
            let outer =
                |row: usize| dot(&layer.state_weights, row, h) + f64::from(layer.state_bias[row]);
            let r = sigmoid(inner(i) + outer(i));
            let z = sigmoid(inner(hidden + i) + outer(hidden + i));
            let n = (inner(2 * hidden + i) + r * outer(2 * hidden + i)).tanh();
            (1.0 - z) * n + z * h[i]
        })
        .collect()
}

/// The outputs of an exported network, row by row.
fn plain(network: &Network, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mut states = [vec![0.0; network.hidden], vec![0.0; network.hidden]];
    let outputs = rows.iter().map(|row| {
        states[0] = plain_step(&network.layers[0], row, &states[0]);
        states[1] = plain_step(&network.layers[1], &states[0], &states[1]);
        let heads = network.head_weights.chunks_exact(network.hidden);
        heads
            .zip(&network.head_bias)
            .map(|(weights, bias)| {
                let products = weights.iter().zip(&states[1]);
                f64::from(*bias) + products.map(|(w, h)| f64::from(*w) * h).sum::<f64>()
            })
            .collect()
    });
    outputs.collect()
}

fn exported(parameters: &TrainableParameters, network: usize) -> Network {
    let (head_weights, head_bias) = parameters.head(network);
    Network {
        sensors: vec![0],
        inputs: Vec::new(),
        target: Target::Force,
        hidden: parameters.size.hidden,
        layers: [parameters.layer(network, 0), parameters.layer(network, 1)],
        head_weights,
        head_bias,
        force_n: [1.0; 2],
        guards: Vec::new(),
    }
}

#[test]
fn forward_pass_equals_the_exported_network() {
    let (streams, rows) = (3, 200);
    let parameters = weights();
    let x = noise(SIZE.networks * streams * rows * SIZE.inputs, 1);
    let shape = (SIZE.networks, streams, rows, SIZE.inputs);
    let inputs = Tensor::from_slice(&x, shape, &Device::Cpu).unwrap();
    let mut state = LayerStates::zero(SIZE, streams);
    let weights = WeightTensors::of(&parameters).unwrap();
    // In two windows, to carry the state over.
    let mut halves = Vec::new();
    for half in 0..2 {
        let window = inputs.narrow(2, half * rows / 2, rows / 2).unwrap();
        let window = window.contiguous().unwrap();
        let window = window.reshape((SIZE.networks, streams * rows / 2, SIZE.inputs)).unwrap();
        let outputs = weights.forward(&window, streams, &mut state).unwrap();
        let outputs = outputs.reshape((SIZE.networks, streams, rows / 2, SIZE.outputs));
        halves.push(outputs.unwrap());
    }
    let outputs = Tensor::cat(&halves, 2).unwrap();
    for network in 0..SIZE.networks {
        let exported = exported(&parameters, network);
        for stream in 0..streams {
            let of_stream = |t: &Tensor| -> Vec<Vec<f64>> {
                let t = t.get(network).unwrap().get(stream).unwrap();
                t.to_dtype(DType::F64).unwrap().to_vec2().unwrap()
            };
            let expected = plain(&exported, &of_stream(&inputs));
            for (found, expected) in of_stream(&outputs).iter().zip(&expected) {
                for (found, expected) in found.iter().zip(expected) {
                    assert!((found - expected).abs() < 1e-5, "{found} {expected}");
                }
            }
        }
    }
}

/// The library's own layer, step by step, over one network's variables.
fn library_layer(layer: [&Tensor; 3], inputs: &Tensor) -> Tensor {
    let [input, state, bias] = layer.map(|t| t.squeeze(0).unwrap());
    let tensors = HashMap::from([
        ("weight_ih_l0".to_owned(), input.t().unwrap()),
        ("weight_hh_l0".to_owned(), state.t().unwrap()),
        ("bias_ih_l0".to_owned(), bias.get(0).unwrap()),
        ("bias_hh_l0".to_owned(), bias.get(1).unwrap()),
    ]);
    let builder = VarBuilder::from_tensors(tensors, DType::F32, &Device::Cpu);
    let (inner, hidden) = input.dims2().map(|(i, wide)| (i, wide / 3)).unwrap();
    let gru = GRU::new(inner, hidden, GRUConfig::default(), builder).unwrap();
    let states = gru.seq(inputs).unwrap();
    let (streams, rows, _) = inputs.dims3().unwrap();
    let states = gru.states_to_tensor(&states).unwrap();
    states.reshape((streams, rows, hidden)).unwrap()
}

#[test]
fn gradients_equal_those_of_the_library() {
    let size = NetworkSize { networks: 1, ..SIZE };
    let (streams, rows) = (2, 40);
    let mut parameters = TrainableParameters::random(size, 5, &[0]);
    parameters.copy_network(0, &weights());
    let inputs = noise(streams * rows * size.inputs, 1);
    let inputs = Tensor::from_vec(inputs, (1, streams * rows, size.inputs), &Device::Cpu).unwrap();
    let truth =
        Tensor::from_vec(noise(streams * rows * 2, 2), (1, streams * rows, 2), &Device::Cpu);
    let truth = truth.unwrap();
    let weight = truth.ones_like().unwrap();
    let gradients = |variables: &[Var], outputs: Tensor| -> Vec<Vec<f32>> {
        let loss = losses(&outputs, &truth, &weight).unwrap().sum_all().unwrap();
        let gradients = loss.backward().unwrap();
        let flat = |v: &Var| gradients.get(v).unwrap().flatten_all()?.to_vec1::<f32>();
        variables.iter().map(|v| flat(v).unwrap()).collect()
    };
    let own = WeightTensors::of(&parameters).unwrap();
    let mut state = LayerStates::zero(size, streams);
    let found = gradients(&own.all, own.forward(&inputs, streams, &mut state).unwrap());

    let theirs = WeightTensors::of(&parameters).unwrap();
    let mut flow = inputs.reshape((streams, rows, size.inputs)).unwrap();
    for layer in index::LAYERS {
        flow = library_layer(layer.map(|i| theirs.all[i].as_tensor()), &flow);
    }
    let flow = flow.reshape((1, streams * rows, size.hidden)).unwrap();
    let head = flow.matmul(theirs.all[index::HEAD_WEIGHTS].as_tensor()).unwrap();
    let outputs = head.broadcast_add(theirs.all[index::HEAD_BIAS].as_tensor()).unwrap();
    let expected = gradients(&theirs.all, outputs);

    for (found, (expected, parameter)) in found.iter().zip(expected.iter().zip(&parameters.all)) {
        let max_gradient = expected.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!(max_gradient > 0.1, "{}", parameter.name);
        for (found, expected) in found.iter().zip(expected) {
            let error = (found - expected).abs();
            assert!(error < 2e-5 * max_gradient, "{}: {found} {expected}", parameter.name);
        }
    }
}

#[test]
fn optimiser_steps_equal_those_of_the_library() {
    let mut parameters = weights();
    let before = parameters.all[0].values.clone();
    let variable = Var::from_slice(&before, before.len(), &Device::Cpu).unwrap();
    let settings = ParamsAdamW { weight_decay: WEIGHT_DECAY, ..ParamsAdamW::default() };
    let mut library = AdamW::new(vec![variable.clone()], settings).unwrap();
    let mut own = Adam::new(&parameters);
    for step in 0..5 {
        let rate = 0.01 / f64::from(step + 1);
        let mut gradients: Vec<Vec<f32>> =
            parameters.all.iter().map(|p| vec![0.0; p.values.len()]).collect();
        gradients[0] = noise(before.len(), u64::from(step as u32));
        let gradient = Tensor::from_slice(&gradients[0], before.len(), &Device::Cpu).unwrap();
        let loss = (variable.as_tensor() * gradient).unwrap().sum_all().unwrap();
        library.set_learning_rate(rate);
        library.step(&loss.backward().unwrap()).unwrap();
        own.step(&mut parameters, &gradients, rate);
    }
    let expected = variable.to_vec1::<f32>().unwrap();
    for ((found, expected), before) in parameters.all[0].values.iter().zip(&expected).zip(&before) {
        assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        assert!((expected - before).abs() > 1e-4);
    }
}

#[test]
fn gradient_is_clipped_per_network() {
    let mut gradients = vec![vec![3.0, 0.3], vec![4.0, 0.4]];
    clip_gradients(&mut gradients, 2);
    assert_eq!(gradients, [[0.6, 0.3], [0.8, 0.4]]);
}

#[test]
fn weights_are_clipped_to_the_device_range() {
    let mut parameters = weights();
    // One in each row, so that no sum is too large.
    for (place, parameter) in parameters.all.iter_mut().enumerate() {
        let columns = *parameter.shape.last().unwrap();
        let only = if place % 3 == 2 { 0.0 } else { -20.0 };
        parameter.values.fill(0.0);
        for network in 0..SIZE.networks {
            parameter.of_mut(network)[..columns].fill(only);
        }
    }
    parameters.clip_to_device();
    let layer = parameters.layer(0, 1);
    let (gates, candidate) = layer.state_weights.split_at(2 * SIZE.hidden * SIZE.hidden);
    let within = |weights: &[f32], limit: f32| {
        let known = |weight: &f32| *weight == 0.0 || *weight == -limit;
        weights.iter().all(known) && weights.contains(&-limit)
    };
    assert!(within(&layer.input_weights, MAX_WEIGHT));
    assert!(within(gates, MAX_WEIGHT) && within(candidate, MAX_CANDIDATE_WEIGHT));
}

/// With inputs, for quantisation.
fn with_inputs(parameters: &TrainableParameters, network: usize) -> Network {
    let input =
        |axis| ScaledInput { input: Input::Field { sensor: 0, axis }, middle: 0.0, span: 100.0 };
    Network {
        sensors: vec![0; SIZE.outputs / OUTPUTS],
        inputs: (0..SIZE.inputs).map(input).collect(),
        ..exported(parameters, network)
    }
}

#[test]
fn clipped_rows_fit_the_device_and_keep_their_direction() {
    let mut large = 0;
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut parameters = weights();
        // Well within, and as large as every single weight may be.
        let size = if seed % 2 == 0 { 1.0 } else { 3.9_f32 };
        for value in parameters.all.iter_mut().flat_map(|p| &mut p.values) {
            *value = rng.random_range(-size..size);
        }
        let before = parameters.clone();
        let refused = |p: &TrainableParameters| {
            let networks = (0..SIZE.networks).map(|network| with_inputs(p, network));
            networks.filter(|n| QuantisedNetwork::new(n, 0.125).is_err()).count()
        };
        large += refused(&parameters);
        parameters.clip_to_device();
        assert_eq!(refused(&parameters), 0, "seed {seed}");
        for (now, then) in parameters.all.iter().zip(&before.all) {
            let columns = *then.shape.last().unwrap();
            for column in 0..columns {
                let values = |p: &ParameterTensor| -> Vec<f32> {
                    p.of(0).iter().skip(column).step_by(columns).copied().collect()
                };
                let (now, then) = (values(now), values(then));
                let of_size = |values: &[f32]| values.iter().map(|v| v.abs()).sum::<f32>();
                let factor = of_size(&now) / of_size(&then);
                assert!(factor > 0.3 && factor < 1.0 + 1e-5, "{factor}");
                let mut both = now.iter().zip(&then);
                let same = both.all(|(now, then)| (now - factor * then).abs() < 1e-4);
                assert!(same, "{now:?} {then:?}");
            }
        }
        // Values within the limits stay unchanged except for rounding.
        let within = parameters.clone();
        parameters.clip_to_device();
        for (again, once) in parameters.all.iter().zip(&within.all) {
            for (again, once) in again.values.iter().zip(&once.values) {
                assert!((again - once).abs() <= 1e-6 * once.abs());
            }
        }
    }
    assert!(large >= 5, "{large}");
}

#[test]
fn row_too_large_for_the_device_needs_clipping() {
    let mut parameters = weights();
    parameters.all[index::LAYERS[1][1]].values.fill(3.9);
    // Five states of 3.9 make 19.5 where a candidate's recurrent sum ends at 16.
    assert!(QuantisedNetwork::new(&with_inputs(&parameters, 0), 0.125).is_err());
    parameters.clip_to_device();
    assert!(QuantisedNetwork::new(&with_inputs(&parameters, 0), 0.125).is_ok());
    let layer = parameters.layer(0, 1);
    let row = &layer.state_weights[2 * SIZE.hidden * SIZE.hidden..][..SIZE.hidden];
    let sum = row.iter().sum::<f32>() + layer.state_bias[2 * SIZE.hidden].abs();
    assert!(sum > 15.5 && sum < 16.0, "{sum}");
}

#[test]
fn part_of_a_recording_has_its_rows_and_later_references() {
    let whole = Sequence {
        name: "whole".to_owned(),
        rows: 10,
        tracks: vec![SensorSequence {
            number: 3,
            field_g: (0..10).map(|row| [row as f32; 3]).collect(),
            ideal_n: (0..10).map(|row| [0.0, row as f32]).collect(),
            truth_n: [0, 2, 4, 6, 8].map(|row| (row, [row as f32; 2])).to_vec(),
            ..SensorSequence::default()
        }],
    };
    let part = whole.part(3..8, 5);
    assert_eq!((part.rows, part.tracks[0].number), (5, 3));
    assert_eq!(part.tracks[0].field_g.first(), Some(&[3.0; 3]));
    assert_eq!(part.tracks[0].ideal_n.last(), Some(&[0.0, 7.0]));
    // Row 4 is before `known`, row 8 after the end.
    assert_eq!(part.tracks[0].truth_n, [(3, [6.0; 2])]);
    assert_eq!(whole.part(0..99, 0), whole);
    assert_eq!(whole.part(20..30, 0).rows, 0);
}

#[test]
fn zero_force_weight_has_the_documented_form() {
    assert_eq!(zero_force_weight(0.0, 250.0, 4.0), 4.0);
    // exp(-1/2) = 0.60653 at 25 N.
    assert!((zero_force_weight(-25.0, 250.0, 4.0) - 2.819_59).abs() < 1e-5);
    assert!((zero_force_weight(200.0, 250.0, 4.0) - 1.0).abs() < 1e-12);
    assert_eq!(zero_force_weight(17.0, 250.0, 1.0), 1.0);
    // Half a newton is to 5 N what 25 N are to 250; 2 N are far from nothing there.
    assert_eq!(zero_force_weight(0.5, 5.0, 4.0), zero_force_weight(25.0, 250.0, 4.0));
    assert!(zero_force_weight(2.0, 5.0, 4.0) < 1.01);
    let recording = Sequence {
        name: String::new(),
        rows: 2,
        tracks: vec![SensorSequence {
            number: 0,
            field_g: vec![[0.0; 3], [1.0; 3]],
            // The target is the residual, the weight depends on the force.
            ideal_n: vec![[50.0; 2]; 2],
            truth_n: vec![(0, [25.0, 0.0]), (1, [250.0, 25.0])],
            ..SensorSequence::default()
        }],
    };
    let topology = Topology {
        axes: vec![0],
        ideal: false,
        target: Target::Residual,
        shared: false,
        hidden: 2,
    };
    let groups = topology.groups(&[0]);
    let training_data = [recording];
    let scaling = Scaling::of(&training_data, &topology, &groups).unwrap();
    let of = |near_zero| {
        let counts = |n| zero_force_weight(n, 250.0, near_zero);
        ScaledSequence::of(&training_data[0], &scaling, &groups, Target::Residual, counts).weight
    };
    assert_eq!(of(1.0), [1.0; 4]);
    let known = [2.819_59, 4.0, 1.0, 2.819_59];
    for (weight, known) in of(4.0).into_iter().zip(known) {
        assert!((weight - known).abs() < 1e-5, "{weight}, {known}");
    }
}
