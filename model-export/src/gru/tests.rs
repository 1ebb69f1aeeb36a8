//! The device's integers beside floating point, and what is refused.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::float::FloatState;
use super::network::{GATES, Input, Layer, Network, OUTPUTS, ScaledInput, Target};
use super::pack::{Packed, pack};
use super::quantise::{Row, Unfit};
use firmware::model::network::Source;

/// A scale at which a field of one gauss is one unit, and an input of one is 2^14 units.
const GAUSS_PER_LSB: f64 = 16.0;
const SPAN_G: f64 = 16_384.0;

/// How weights are drawn: evenly, up to these.
#[derive(Clone, Copy)]
struct Sizes {
    input: f32,
    gates: f32,
    candidate: f32,
    bias: f32,
    /// Added to every update gate.
    update: f32,
}

/// As training begins with: up to 1 / sqrt(hidden).
fn nominal(hidden: usize) -> Sizes {
    let most = 1.0 / (hidden as f32).sqrt();
    Sizes {
        input: most,
        gates: most,
        candidate: most,
        bias: most,
        update: 0.0,
    }
}

fn random(seed: u64, inputs: usize, hidden: usize, sensors: u32, sizes: Sizes) -> Network {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = |number: usize, most: f32| -> Vec<f32> {
        (0..number).map(|_| rng.random_range(-most..most)).collect()
    };
    let mut layer = |inputs: usize| {
        let mut state_weights = draw(2 * hidden * hidden, sizes.gates);
        state_weights.extend(draw(hidden * hidden, sizes.candidate));
        let mut input_bias = draw(GATES * hidden, sizes.bias);
        input_bias[hidden..2 * hidden]
            .iter_mut()
            .for_each(|bias| *bias += sizes.update);
        Layer {
            input_weights: draw(GATES * hidden * inputs, sizes.input),
            state_weights,
            input_bias,
            state_bias: draw(GATES * hidden, sizes.bias),
        }
    };
    let layers = [layer(inputs), layer(hidden)];
    let outputs = sensors as usize * OUTPUTS;
    Network {
        sensors: (0..sensors).collect(),
        inputs: (0..inputs)
            .map(|number| ScaledInput {
                input: Input::Field {
                    sensor: (number / 3) as u32,
                    axis: number % 3,
                },
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
    let mut float = FloatState::at(network, 0.0);
    let mut rng = ChaCha8Rng::seed_from_u64(99);
    let mut offset = 0.0;
    let mut errors = Errors {
        thirds: [0.0; 3],
        worst: 0.0,
        worst_output: 0.0,
    };
    for step in 0..steps {
        // Slow and fast waves over steps that hold for a while.
        if step % 700 == 0 {
            offset = rng.random_range(-0.5..0.5);
        }
        let time = step as f64;
        let value = |number: usize| {
            let n = number as f64;
            let wave = 0.3 * libm::sin(time * (0.002 + 0.001 * n)) + 0.2 * libm::sin(time * 0.1 + n);
            ((offset + wave) * SPAN_G).round()
        };
        let _ = run.step(&|source| match source {
            Source::Field { sensor, axis } => value(usize::from(sensor * 3 + axis)) as i32,
            _ => 0,
        });
        let inputs: Vec<f64> = (0..network.inputs.len()).map(|n| value(n) / SPAN_G).collect();
        let outputs = float.step(network, &inputs);
        let states = run.states();
        for (layer, states) in states.iter().enumerate() {
            for (&fixed, exact) in states.iter().zip(float.layer(layer)) {
                let error = f64::from(fixed) / f64::from(1 << 30) - exact;
                errors.thirds[3 * step / steps] += error * error;
                errors.worst = errors.worst.max(error.abs());
            }
        }
        for (fixed, exact) in run.outputs().into_iter().zip(outputs) {
            let error = (f64::from(fixed) / f64::from(1 << 26) - exact).abs();
            errors.worst_output = errors.worst_output.max(error);
        }
    }
    let count = (steps * 2 * network.hidden) as f64 / 3.0;
    errors.thirds = errors.thirds.map(|sum| (sum / count).sqrt());
    errors
}

#[test]
fn probe() {
    for (name, inputs, hidden, sensors, s) in [
        ("nominal 3/8", 3, 8, 1, nominal(8)),
        ("nominal 3/16", 3, 16, 1, nominal(16)),
        ("nominal 12/32", 12, 32, 4, nominal(32)),
        ("slow 3/16", 3, 16, 1, Sizes { update: 4.6, ..nominal(16) }),
        ("large 3/16", 3, 16, 1, Sizes { input: 3.0, gates: 1.0, candidate: 0.5, bias: 1.0, update: 0.0 }),
        ("larger 3/16", 3, 16, 1, Sizes { input: 4.0, gates: 2.0, candidate: 1.0, bias: 2.0, update: 0.0 }),
        ("large slow 3/16", 3, 16, 1, Sizes { input: 2.0, gates: 0.3, candidate: 0.5, bias: 1.0, update: 4.6 }),
    ] {
        for seed in 0..4 {
            match std::panic::catch_unwind(|| errors(&random(seed, inputs, hidden, sensors, s), 30_000)) {
                Ok(e) => println!("{name} {seed}: {:.2e} {:.2e} {:.2e} worst {:.2e} out {:.2e}", e.thirds[0], e.thirds[1], e.thirds[2], e.worst, e.worst_output),
                Err(_) => println!("{name} {seed} refused"),
            }
        }
    }
}
