//! Integer network versus floating point, and rejected networks.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::network::{FloatRun, GATES, Input, Layer, Network, OUTPUTS, ScaledInput, Target};
use crate::gru::pack::pack;
use crate::gru::quantise::{QuantiseError, WeightRow};
use firmware::estimator::{Estimate, Validity};
use firmware::fixed_point::Force;
use firmware::model::formats::InputSource;
use firmware::sensors::hall::SENSORS;

/// A scale at which a field of one gauss is one unit, and an input of one is 2^14 units.
const GAUSS_PER_LSB: f64 = 16.0;
const SPAN_G: f64 = 16_384.0;

/// Ranges of uniform random weights.
#[derive(Clone, Copy)]
struct Sizes {
    /// Of inputs and of the first layer to a candidate.
    input: f32,
    between: f32,
    /// Of everything to a reset or update gate.
    gates: f32,
    /// Recurrent, to a candidate.
    candidate: f32,
    bias: f32,
    /// Added to every update gate.
    update: f32,
}

/// As training begins with: up to 1 / sqrt(hidden).
fn nominal(hidden: usize) -> Sizes {
    let most = 1.0 / (hidden as f32).sqrt();
    Sizes { input: most, between: most, gates: most, candidate: most, bias: most, update: 0.0 }
}

fn random(seed: u64, inputs: usize, hidden: usize, sensors: u32, sizes: Sizes) -> Network {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = |number: usize, most: f32| -> Vec<f32> {
        (0..number).map(|_| rng.random_range(-most..most)).collect()
    };
    let mut layer = |inputs: usize, input: f32| {
        let mut state_weights = draw(2 * hidden * hidden, sizes.gates);
        state_weights.extend(draw(hidden * hidden, sizes.candidate));
        let mut input_bias = draw(GATES * hidden, sizes.bias);
        input_bias[hidden..2 * hidden].iter_mut().for_each(|bias| *bias += sizes.update);
        let mut input_weights = draw(2 * hidden * inputs, sizes.gates);
        input_weights.extend(draw(hidden * inputs, input));
        Layer {
            input_weights,
            state_weights,
            input_bias,
            state_bias: draw(GATES * hidden, sizes.bias),
        }
    };
    let layers = [layer(inputs, sizes.input), layer(hidden, sizes.between)];
    let outputs = sensors as usize * OUTPUTS;
    Network {
        sensors: (0..sensors).collect(),
        inputs: (0..inputs)
            .map(|number| ScaledInput {
                input: Input::Field { sensor: (number / 3) as u32, axis: number % 3 },
                middle: 0.0,
                span: SPAN_G,
            })
            .collect(),
        target: Target::Force,
        hidden,
        layers,
        head_weights: draw(outputs * hidden, 1.0),
        head_bias: draw(outputs, 1.0),
        force_n: [20.0, 30.0],
        guards: Vec::new(),
    }
}

/// Errors of the states: root mean square of each third of the run, greatest, and of the outputs.
struct Errors {
    thirds: [f64; 3],
    worst: f64,
    worst_output: f64,
}

fn errors(network: &Network, steps: usize) -> Errors {
    let packed = pack(network, GAUSS_PER_LSB).unwrap();
    let mut run = packed.run();
    let mut float = FloatRun::new(network);
    let mut rng = ChaCha8Rng::seed_from_u64(99);
    let mut offset = 0.0;
    let mut errors = Errors { thirds: [0.0; 3], worst: 0.0, worst_output: 0.0 };
    for step in 0..steps {
        // Slow and fast waves on piecewise constant offsets.
        if step % 700 == 0 {
            offset = rng.random_range(-0.5..0.5);
        }
        let time = step as f64;
        let value = |number: usize| {
            let n = number as f64;
            let wave =
                0.3 * libm::sin(time * (0.002 + 0.001 * n)) + 0.2 * libm::sin(time * 0.1 + n);
            ((offset + wave) * SPAN_G).round()
        };
        let _ = run.step(&|source| match source {
            InputSource::Field { sensor, axis } => value(usize::from(sensor * 3 + axis)) as i32,
            _ => 0,
        });
        let inputs: Vec<f32> =
            (0..network.inputs.len()).map(|n| (value(n) / SPAN_G) as f32).collect();
        let outputs = float.step(&inputs).to_vec();
        let states = run.states();
        for (layer, states) in states.iter().enumerate() {
            for (&fixed, exact) in states.iter().zip(float.state(layer)) {
                let error = f64::from(fixed) / f64::from(1 << 30) - f64::from(*exact);
                errors.thirds[3 * step / steps] += error * error;
                errors.worst = errors.worst.max(error.abs());
            }
        }
        for (fixed, exact) in run.outputs().into_iter().zip(outputs) {
            let error = (f64::from(fixed) / f64::from(1 << 26) - f64::from(exact)).abs();
            errors.worst_output = errors.worst_output.max(error);
        }
    }
    let count = (steps * 2 * network.hidden) as f64 / 3.0;
    errors.thirds = errors.thirds.map(|sum| (sum / count).sqrt());
    errors
}

/// Limits for every network: root mean square and maximum error of the states.
const RMS: f64 = 3e-4;
const WORST: f64 = 2.5e-3;

fn check(name: &str, network: &Network, steps: usize) -> Errors {
    let errors = errors(network, steps);
    let Errors { thirds, worst, worst_output } = &errors;
    let message = format!("{name}: {thirds:?}, worst {worst:.2e}, outputs {worst_output:.2e}");
    println!("{message}");
    assert!(thirds.iter().all(|rms| *rms <= RMS) && *worst <= WORST, "{message}");
    errors
}

#[test]
fn integer_network_tracks_float_at_every_size() {
    for (inputs, hidden, sensors) in [(2, 8, 1), (3, 8, 1), (5, 16, 1), (3, 16, 1), (12, 32, 4)] {
        let network = random(7, inputs, hidden, sensors, nominal(hidden));
        check(&format!("{inputs}/{hidden}"), &network, 10_000);
    }
}

#[test]
fn padding_to_a_device_size_keeps_the_outputs() {
    // 3 inputs and 11 units in 4 and 16.
    let network = random(3, 3, 11, 1, nominal(11));
    assert_eq!(pack(&network, GAUSS_PER_LSB).unwrap().size(), [2, 8, 1]);
    let errors = check("3/11", &network, 10_000);
    assert!(errors.thirds[2] < 1e-4);
}

#[test]
fn slow_gates_do_not_drift_over_a_million_steps() {
    // Update gates about 0.99: a memory of a hundred steps.
    let slow = Sizes { update: 4.6, ..nominal(8) };
    let errors = check("slow", &random(1, 3, 8, 1, slow), 1_000_000);
    let [first, _, last] = errors.thirds;
    assert!(last < 1.3 * first, "{:?}", errors.thirds);
}

#[test]
fn large_weights_stay_within_error_limits() {
    let large =
        Sizes { input: 3.0, between: 1.5, gates: 0.5, candidate: 0.25, bias: 1.0, update: 0.0 };
    let slow = Sizes { gates: 0.2, bias: 0.3, update: 4.6, ..large };
    for seed in 0..3 {
        check("large", &random(seed, 3, 16, 1, large), 10_000);
        check("large and slow", &random(seed, 3, 16, 1, slow), 10_000);
    }
}

#[test]
fn row_that_could_wrap_is_rejected_by_name() {
    let mut network = random(1, 3, 8, 1, nominal(8));
    // Candidate of unit 5 in the second layer: eight weights of 4, in sum the accumulator's end.
    let row = 2 * 8 + 5;
    network.layers[1].input_weights[row * 8..][..8].fill(4.0);
    let refused = pack(&network, GAUSS_PER_LSB).unwrap_err();
    let QuantiseError::Wraps { row, greatest, .. } = &refused else {
        panic!("{refused}");
    };
    let (layer, gate, unit) = (1, 2, 5);
    assert_eq!(*row, WeightRow::Layer { layer, gate, unit });
    assert!(*greatest > 32.0 && *greatest < 35.0);
    assert!(refused.to_string().starts_with("layer 2, candidate row 5: its sum may reach 3"));
}

#[test]
fn row_is_accepted_up_to_the_accumulator_limit() {
    let mut network = random(1, 2, 8, 1, nominal(8));
    let layer = &mut network.layers[0];
    // Both inputs at ±2 with weights of ±7.9: 31.6, and nothing else in the row.
    layer.input_weights[..2].copy_from_slice(&[7.9, -7.9]);
    layer.state_weights[..8].fill(0.0);
    (layer.input_bias[0], layer.state_bias[0]) = (0.0, 0.3);
    assert!(pack(&network, GAUSS_PER_LSB).is_ok());
    network.layers[0].state_bias[0] = 0.5;
    let refused = pack(&network, GAUSS_PER_LSB).unwrap_err().to_string();
    assert!(refused.starts_with("layer 1, reset row 0: its sum"), "{refused}");
}

#[test]
fn weights_beyond_their_format_are_rejected_by_name() {
    let message = |spoil: fn(&mut Network)| {
        let mut network = random(1, 3, 8, 1, nominal(8));
        spoil(&mut network);
        pack(&network, GAUSS_PER_LSB).unwrap_err().to_string()
    };
    let update = message(|network| network.layers[0].input_weights[9 * 3 + 2] = -8.5);
    assert!(
        update.starts_with("layer 1, update row 1: input weight 2 -8.5000e0 does not fit ±7.9998"),
        "{update}"
    );
    let candidate = message(|network| network.layers[1].state_weights[16 * 8 + 7] = 4.1);
    assert!(
        candidate.starts_with("layer 2, candidate row 0: recurrent weight 7 4.1"),
        "{candidate}"
    );
    let head = message(|network| network.head_weights[2 * 8] = f32::NAN);
    assert!(head.starts_with("head, row 2: weight 0 NaN does not fit"), "{head}");
    let input = message(|network| network.inputs[1].span = 0.0);
    assert!(input.starts_with("input 1: gain inf does not fit"), "{input}");
    let force = message(|network| network.force_n[1] = 0.0);
    assert!(force.starts_with("force of Fz: newtons"), "{force}");
    let short = message(|network| network.layers[0].state_bias.truncate(23));
    assert_eq!(short, "recurrent biases of a layer: 23 numbers where 24 are expected");
}

#[test]
fn networks_larger_than_the_device_are_rejected() {
    let network = random(1, 3, 33, 1, nominal(33));
    let refused = pack(&network, GAUSS_PER_LSB).unwrap_err();
    assert!(refused.to_string().starts_with("3 inputs, 33 units and 1 sensors"), "{refused}");
}

#[test]
fn warm_up_grows_with_the_memory_of_the_gates() {
    let warm_up = |update| {
        let sizes = Sizes { update, ..nominal(8) };
        super::network::warm_up_steps(&random(1, 3, 8, 1, sizes))
    };
    let (quick, slow) = (warm_up(0.0), warm_up(4.6));
    // Sigmoid of 0 and of 4.6: half a state is kept, or 99 % of it.
    assert!((5..40).contains(&quick), "{quick}");
    assert!((400..2500).contains(&slow), "{slow}");
}

#[test]
fn estimate_has_the_force_scale() {
    let mut network = random(1, 3, 8, 1, nominal(8));
    network.head_weights.fill(0.0);
    network.head_bias = vec![0.5, -0.25, -1.0, -3.0];
    let packed = pack(&network, GAUSS_PER_LSB).unwrap();
    let mut run = packed.run();
    let message = (0..1000).find_map(|_| run.step(&|_| 0)).unwrap();
    let newtons = message[0].mean.map(|force| force.newtons());
    assert_eq!(newtons, [10.0, -7.5]);
    let [x, z] = message[0].sigma.map(|force| force.newtons());
    assert!((x - 20.0 * (-1.0_f64).exp()).abs() < 1e-3, "{x}");
    assert!((z - 30.0 * (-3.0_f64).exp()).abs() < 1e-3, "{z}");
}

#[test]
fn networks_read_estimates_from_before_the_step() {
    let message = |ideal, sensor, hidden| {
        let mut network = random(1, 1, hidden, 1, nominal(hidden));
        network.sensors = vec![sensor];
        network.inputs[0].input = Input::Ideal { sensor: ideal, axis: 0 };
        network.inputs[0].span = 20.0;
        network
    };
    // The second network reads the sensor that the first predicts.
    let networks = [message(0, 0, 8), message(0, 1, 16)];
    let packed = networks.map(|network| pack(&network, GAUSS_PER_LSB).unwrap());
    let alone = |which: &[usize]| {
        let mut running: Vec<_> = which.iter().map(|&k| packed[k].run()).collect();
        let mut estimates = [Estimate::MISSING; SENSORS];
        for step in 0..3000 {
            estimates = [Estimate {
                force: [Force(step * 3); 2],
                validity: Validity::Valid,
                ..Estimate::MISSING
            }; SENSORS];
            super::pack::apply(&mut running, &mut estimates);
        }
        estimates
    };
    let (both, second) = (alone(&[0, 1]), alone(&[1]));
    assert!(both[0].sigma.is_some() && both[1].sigma.is_some() && both[2].sigma.is_none());
    assert_eq!(both[1], second[1]);
    assert_ne!(both[0].force, second[0].force);
}

#[test]
fn generated_source_names_size_and_sensors() {
    let networks: Vec<_> = (0..2)
        .map(|seed| pack(&random(seed, 3, 8, 1, nominal(8)), GAUSS_PER_LSB).unwrap())
        .collect();
    let source = crate::inverse::codegen::networks_source(&networks).unwrap();
    assert!(source.contains("pub static NETWORKS: [Network<2, 4, 1>; 2] = ["), "{source}");
    assert!(
        source.contains(
            "source: InputSource::Field { sensor: 0, axis: 2 }, offset: 0, gain: 1048576"
        )
    );
    assert!(source.contains("target: Target::Force"));
    assert_eq!(source.matches("UnitPair {").count(), 2 * 2 * 4);
    let mixed: Vec<_> = [8, 16]
        .map(|hidden| pack(&random(0, 3, hidden, 1, nominal(hidden)), GAUSS_PER_LSB).unwrap())
        .into();
    assert_eq!(
        crate::inverse::codegen::networks_source(&mixed),
        Err(crate::inverse::codegen::MixedSizes)
    );
    let none = crate::inverse::codegen::networks_source(&[]).unwrap();
    assert!(none.contains("Network<1, 4, 1>; 0] = [];\n"));
}
