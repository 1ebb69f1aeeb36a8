//! Training arithmetic compared with plain equations and with another program.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::network::{Input, Layer, Network, OUTPUTS, ScaledInput, Target};
use crate::gru::quantise::QuantisedNetwork;
use crate::gru::train::adam::{Adam, clip_gradients};
use crate::gru::train::backprop::{NetworkWeights, StreamPass, StreamRows, mean_output};
use crate::gru::train::dataset::{
    ScaledSequence, Scaling, SensorSequence, Sequence, Topology, zero_force_weight,
};
use crate::gru::train::parameters::{
    MAX_CANDIDATE_WEIGHT, MAX_WEIGHT, NetworkSize, ParameterTensor, TensorKind,
    TrainableParameters, index,
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

/// States of both layers.
type States = [Vec<f64>; 2];

fn reset() -> States {
    [0, 1].map(|_| vec![0.0; SIZE.hidden])
}

/// The outputs of an exported network, row by row.
fn plain(network: &Network, states: &mut States, rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
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

/// Rows of one stream with references in two of three rows.
fn rows(count: usize, seed: u64) -> StreamRows {
    let mut weight = noise(2 * count, seed + 2);
    weight.iter_mut().enumerate().for_each(|(at, w)| *w = if at % 3 == 0 { 0.0 } else { w.abs() });
    StreamRows {
        inputs: noise(count * SIZE.inputs, seed),
        truth: noise(2 * count, seed + 1),
        weight,
    }
}

/// Inputs row by row.
fn in_rows(inputs: &[f32]) -> Vec<Vec<f64>> {
    let rows = inputs.chunks_exact(SIZE.inputs);
    rows.map(|row| row.iter().map(|value| f64::from(*value)).collect()).collect()
}

#[test]
fn forward_pass_equals_the_exported_network() {
    let parameters = weights();
    for network in 0..SIZE.networks {
        let weights = NetworkWeights::of(&parameters, network);
        let mut pass = StreamPass::new(&parameters, 100);
        let mut inputs = Vec::new();
        let mut found = Vec::new();
        // In two windows, to carry the state over.
        for window in 0..2 {
            pass.rows = rows(100, 10 * window);
            inputs.extend(in_rows(&pass.rows.inputs));
            pass.predict(&weights);
            found.extend_from_slice(&pass.outputs);
        }
        let expected = plain(&exported(&parameters, network), &mut reset(), &inputs);
        for (found, expected) in found.iter().zip(expected.iter().flatten()) {
            assert!((f64::from(*found) - expected).abs() < 1e-5, "{found} {expected}");
        }
    }
}

/// Weighted negative log-likelihood of rows after a state, from the equations alone.
fn plain_loss(parameters: &TrainableParameters, mut states: States, rows: &StreamRows) -> f64 {
    let outputs = plain(&exported(parameters, 0), &mut states, &in_rows(&rows.inputs));
    let known = rows.truth.iter().zip(&rows.weight).enumerate();
    let losses = known.map(|(at, (truth, weight))| {
        let (row, mean) = (&outputs[at / 2], mean_output(at % 2));
        let log_sigma = row[mean + 2].clamp(-7.6, 0.7);
        let share = (row[mean] - f64::from(*truth)) / log_sigma.exp();
        f64::from(*weight) * (0.5 * share * share + log_sigma)
    });
    losses.sum()
}

#[test]
fn gradients_equal_differences_of_the_loss() {
    let mut parameters = weights();
    // The logarithms of the first force pass their upper limit in both directions.
    parameters.all[index::HEAD_BIAS].values[2] = 1.32;
    let (before, rows) = (rows(40, 50), rows(40, 1));
    let weights = NetworkWeights::of(&parameters, 0);
    let mut found = StreamPass::new(&parameters, 40);
    found.rows = before.clone();
    found.predict(&weights);
    found.rows = rows.clone();
    found.train(&weights);
    let logarithms = || found.outputs.chunks_exact(OUTPUTS).map(|row| row[2]);
    assert!(logarithms().any(|raw| raw > 0.7) && logarithms().any(|raw| raw < 0.7));
    // The state before the rows is a constant of truncated back-propagation.
    let mut states = reset();
    plain(&exported(&parameters, 0), &mut states, &in_rows(&before.inputs));
    let loss = plain_loss(&parameters, states.clone(), &rows);
    assert!((found.loss - loss).abs() < 1e-5 * loss.abs(), "{} {loss}", found.loss);

    for (tensor, gradient) in found.gradients.iter().enumerate() {
        let name = parameters.all[tensor].name;
        let largest = gradient.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        assert!(largest > 0.1, "{name}");
        for (at, found) in gradient.iter().enumerate() {
            let loss = |by: f32| {
                let mut changed = parameters.clone();
                changed.all[tensor].values[at] += by;
                (
                    f64::from(changed.all[tensor].values[at]),
                    plain_loss(&changed, states.clone(), &rows),
                )
            };
            let ((lower, less), (upper, more)) = (loss(-1e-4), loss(1e-4));
            let expected = (more - less) / (upper - lower);
            let error = (f64::from(*found) - expected).abs();
            assert!(error < 2e-3 * f64::from(largest), "{name} {at}: {found} {expected}");
        }
    }
}

#[test]
fn optimiser_steps_equal_those_of_pytorch() {
    // torch.optim.AdamW of PyTorch 2.15.0 in double precision: betas 0.9 and 0.999, eps 1e-8, weight decay 0.01.
    let gradients = [
        [0.3, -0.7, 0.01],
        [-0.2, 0.4, 0.02],
        [0.9, 0.1, -0.03],
        [0.05, -0.6, 0.04],
        [-0.8, 0.25, 0.0],
    ];
    let expected = [0.485_655_04, -1.236_975_5, 1.983_318_2];
    let mut parameters = TrainableParameters::zero(SIZE);
    let decays = parameters.all.iter().position(|p| p.kind == TensorKind::Weights).unwrap();
    parameters.all[decays].values[..3].copy_from_slice(&[0.5, -1.25, 2.0]);
    let mut adam = Adam::new(&parameters);
    for (step, gradient) in (1..).zip(gradients) {
        let mut all = TrainableParameters::zero(SIZE);
        all.all[decays].values[..3].copy_from_slice(&gradient);
        adam.step(&mut parameters, &all, 0.01 / f64::from(step));
    }
    for (found, expected) in parameters.all[decays].values.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }
}

#[test]
fn gradient_is_clipped_per_network() {
    let size = NetworkSize { networks: 2, inputs: 1, hidden: 1, outputs: 4 };
    let mut gradients = TrainableParameters::zero(size);
    gradients.all[0].of_mut(0)[0] = 3.0;
    gradients.all[1].of_mut(0)[0] = 4.0;
    gradients.all[0].of_mut(1)[0] = 0.3;
    gradients.all[1].of_mut(1)[0] = 0.4;
    clip_gradients(&mut gradients);
    let found = [0, 1].map(|network| [0, 1].map(|tensor| gradients.all[tensor].of(network)[0]));
    assert_eq!(found, [[0.6, 0.8], [0.3, 0.4]]);
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
