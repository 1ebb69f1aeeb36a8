//! Convergence, reproducibility and checkpoints of training.

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::network::Target;
use crate::gru::tensors::TensorFileKind;
use crate::gru::train::checkpoint;
use crate::gru::train::dataset::{SensorSequence, Sequence, Topology};
use crate::gru::train::trainer::{Trainer, TrainingSettings};
use crate::output::{Output, Overwrite};

/// A load with random steps; the field equals the load, and the force lags behind it by `lag` rows. The second
/// force is a fifth of the load without lag.
fn lagging(name: &str, rows: usize, lag: f32, seed: u64, sensors: &[u32]) -> Sequence {
    let track = |&number: &u32| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut track = SensorSequence { number, ..SensorSequence::default() };
        let (mut load, mut force) = (0.0_f32, 0.0_f32);
        for row in 0..rows {
            if row % 40 == 0 {
                load = rng.random_range(-50.0..50.0);
            }
            force += (load - force) / lag;
            let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
            track.field_g.push([sign * load, 0.1 * load, 0.0]);
            track.ideal_n.push([load, 0.2 * load]);
            if row % 10 == 3 {
                let noise = rng.random_range(-0.1..0.1_f32);
                track.truth_n.push((row, [force + noise, 0.2 * load + noise]));
            }
        }
        track
    };
    Sequence { name: name.to_owned(), rows, tracks: sensors.iter().map(track).collect() }
}

fn topology(target: Target, shared: bool) -> Topology {
    Topology { axes: vec![0], ideal: false, target, shared, hidden: 6 }
}

fn trainer(epochs: u32, seed: u64, sensors: &[u32], shared: bool) -> Trainer {
    let settings = TrainingSettings {
        seed,
        epochs,
        patience: epochs,
        rate: 0.02,
        near_zero: 1.0,
        force_range_n: 250.0,
    };
    let training_data = [1, 2].map(|i| lagging("recording", 4000, 60.0, i, sensors));
    let held_out = lagging("held out", 3000, 60.0, 3, sensors);
    Trainer::new(settings, topology(Target::Force, shared), &training_data, &held_out).unwrap()
}

fn run(mut trainer: Trainer) -> Trainer {
    while !trainer.finished() {
        trainer.epoch().unwrap();
    }
    trainer
}

/// Root mean square error of the first force on the held-out recording, in newtons.
fn error_n(trainer: &Trainer) -> f64 {
    let predictions = &trainer.predictions()[0][0];
    let squares = predictions.iter().map(|one| (one.mean - one.truth).powi(2));
    trainer.scaling.force_n[0] * (squares.sum::<f64>() / predictions.len() as f64).sqrt()
}

#[test]
fn network_predicts_a_lag_better_than_a_static_line() {
    let held_out = lagging("held out", 3000, 60.0, 3, &[0]);
    let track = &held_out.tracks[0];
    let pairs: Vec<(f64, f64)> = track
        .truth_n
        .iter()
        .map(|(row, n)| (f64::from(track.field_g[*row][0]), f64::from(n[0])))
        .collect();
    // The line is fitted to the held-out recording itself.
    let count = pairs.len() as f64;
    let (mean_x, mean_y) =
        pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0 / count, s.1 + p.1 / count));
    let gradient = pairs.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum::<f64>()
        / pairs.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>();
    let squares = pairs.iter().map(|p| (p.1 - mean_y - gradient * (p.0 - mean_x)).powi(2));
    let line_n = (squares.sum::<f64>() / count).sqrt();
    let trainer = run(trainer(60, 1, &[0], false));
    let network_n = error_n(&trainer);
    assert!(line_n > 8.0, "{line_n}");
    assert!(network_n < 0.15 * line_n, "{network_n} of {line_n}");
    let predictions = &trainer.predictions()[0][0];
    let within = predictions
        .iter()
        .filter(|one| (one.mean - one.truth).abs() < 2.0 * one.log_sigma.exp())
        .count() as f64;
    assert!(within > 0.85 * predictions.len() as f64, "{within} of {}", predictions.len());
}

#[test]
fn residual_target_is_learned() {
    let settings = trainer(20, 1, &[0], false).settings;
    let training_data = [1, 2].map(|i| lagging("recording", 4000, 60.0, i, &[0]));
    let held_out = lagging("held out", 3000, 60.0, 3, &[0]);
    let trainer =
        Trainer::new(settings, topology(Target::Residual, false), &training_data, &held_out)
            .unwrap();
    let first = held_out.tracks[0].targets(Target::Residual).next().unwrap();
    let (row, truth) = held_out.tracks[0].truth_n[0];
    let ideal = held_out.tracks[0].ideal_n[row];
    assert_eq!(first, (row, [0, 1].map(|i| f64::from(truth[i]) - f64::from(ideal[i]))));
    let begun = error_n(&trainer);
    assert!(error_n(&run(trainer)) < 0.5 * begun);
}

fn in_threads<R: Send>(threads: usize, what: impl FnOnce() -> R + Send) -> R {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.unwrap().install(what)
}

#[test]
fn training_is_bit_equal_for_a_seed_on_any_thread_count() {
    let train = |threads, seed| in_threads(threads, || run(trainer(3, seed, &[0, 1], false)));
    let one = train(1, 1);
    assert_eq!(one, train(3, 1));
    assert_ne!(one.best, train(1, 2).best);
}

#[test]
fn network_does_not_depend_on_other_networks() {
    let (alone, both) = (run(trainer(3, 1, &[1], false)), run(trainer(3, 1, &[0, 1], false)));
    assert_eq!(alone.networks()[0].layers, both.networks()[1].layers);
    assert_ne!(both.networks()[0].layers, both.networks()[1].layers);
}

#[test]
fn shared_network_predicts_all_its_sensors() {
    let trainer = run(trainer(100, 1, &[0, 1], true));
    let network = &trainer.networks()[0];
    assert_eq!(network.sensors, [0, 1]);
    assert_eq!(network.inputs.len(), 2);
    assert_eq!(network.head_bias.len(), 8);
    let predictions = trainer.predictions();
    for (i, force) in predictions[0].iter().enumerate() {
        let squares = force.iter().map(|one| (one.mean - one.truth).powi(2));
        let error = (squares.sum::<f64>() / force.len() as f64).sqrt();
        let power = force.iter().map(|one| one.truth.powi(2)).sum::<f64>();
        assert!(error < 0.6 * (power / force.len() as f64).sqrt(), "{i}: {error}");
    }
}

fn output(path: &Path) -> Output {
    Output::check(path, TensorFileKind::Checkpoint.mark(), Vec::new(), Overwrite::NEVER).unwrap()
}

#[test]
fn resumed_training_equals_an_uninterrupted_one() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("training");
    let mut begun = trainer(5, 1, &[0, 1], false);
    for _ in 0..2 {
        begun.epoch().unwrap();
    }
    checkpoint::write(&output(&path), &begun, "data").unwrap();
    let mut resumed = trainer(5, 1, &[0, 1], false);
    checkpoint::resume(&path, &mut resumed, "data").unwrap();
    assert_eq!(resumed, begun);
    assert_eq!(run(resumed), run(trainer(5, 1, &[0, 1], false)));
}

#[test]
fn checkpoint_of_other_data_or_seed_is_rejected() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("training");
    checkpoint::write(&output(&path), &trainer(5, 1, &[0], false), "data").unwrap();
    let resume = |seed, inputs| {
        let mut trainer = trainer(5, seed, &[0], false);
        checkpoint::resume(&path, &mut trainer, inputs).unwrap_err().to_string()
    };
    assert!(resume(1, "other data").contains("other recordings"));
    assert!(resume(2, "data").contains("another --seed"));
}

#[test]
fn constant_field_is_rejected_by_name() {
    let training_data = [lagging("recording", 4000, 60.0, 1, &[4])];
    let wrong = Topology { axes: vec![0, 2], ..topology(Target::Force, false) };
    let settings = trainer(5, 1, &[0], false).settings;
    let error = Trainer::new(settings, wrong, &training_data, &training_data[0]).unwrap_err();
    assert!(
        error.to_string().starts_with("the field of sensor 4 along z never changes"),
        "{error}"
    );
}
