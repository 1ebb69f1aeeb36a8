//! What is learned, and that it is the same every time.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::checkpoint;
use super::course::{Course, Settings};
use super::lesson::{Sequence, Topology, Track};
use crate::gru::network::Target;

/// A load that jumps at random; its sensor's field is the load itself, and the force lags behind it
/// by `lag` rows. The second force is a fifth of the load and has no memory.
fn lagging(name: &str, rows: usize, lag: f32, seed: u64, sensors: &[u32]) -> Sequence {
    let track = |&number: &u32| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut track = Track {
            number,
            ..Track::default()
        };
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
                track
                    .truth_n
                    .push((row, [force + noise, 0.2 * load + noise]));
            }
        }
        track
    };
    Sequence {
        name: name.to_owned(),
        rows,
        tracks: sensors.iter().map(track).collect(),
    }
}

fn topology(target: Target, shared: bool) -> Topology {
    Topology {
        axes: vec![0],
        ideal: false,
        target,
        shared,
        hidden: 6,
    }
}

fn course(epochs: u32, seed: u64, sensors: &[u32], shared: bool) -> Course {
    let settings = Settings {
        seed,
        epochs,
        patience: epochs,
        rate: 0.02,
        near_zero: 1.0,
        force_range_n: 250.0,
    };
    let lessons = [1, 2].map(|i| lagging("lesson", 4000, 60.0, i, sensors));
    let held_out = lagging("held out", 3000, 60.0, 3, sensors);
    Course::new(
        settings,
        topology(Target::Force, shared),
        &lessons,
        &held_out,
    )
    .unwrap()
}

fn run(mut course: Course) -> Course {
    while !course.finished() {
        course.epoch().unwrap();
    }
    course
}

/// Root mean square error of the first force on the held-out recording, in newtons.
fn error_n(course: &Course) -> f64 {
    let told = &course.told().unwrap()[0][0];
    let squares = told.iter().map(|one| (one.mean - one.truth).powi(2));
    course.scaling.force_n[0] * (squares.sum::<f64>() / told.len() as f64).sqrt()
}

#[test]
fn a_lag_is_learned_far_better_than_any_line_without_memory_could_tell_it() {
    let held_out = lagging("held out", 3000, 60.0, 3, &[0]);
    let track = &held_out.tracks[0];
    let pairs: Vec<(f64, f64)> = track
        .truth_n
        .iter()
        .map(|(row, n)| (f64::from(track.field_g[*row][0]), f64::from(n[0])))
        .collect();
    // Even the line fitted to the held-out recording itself.
    let count = pairs.len() as f64;
    let (mean_x, mean_y) = pairs
        .iter()
        .fold((0.0, 0.0), |s, p| (s.0 + p.0 / count, s.1 + p.1 / count));
    let slope = pairs
        .iter()
        .map(|p| (p.0 - mean_x) * (p.1 - mean_y))
        .sum::<f64>()
        / pairs.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>();
    let squares = pairs
        .iter()
        .map(|p| (p.1 - mean_y - slope * (p.0 - mean_x)).powi(2));
    let line_n = (squares.sum::<f64>() / count).sqrt();
    let course = run(course(60, 1, &[0], false));
    let network_n = error_n(&course);
    assert!(line_n > 8.0, "{line_n}");
    assert!(network_n < 0.15 * line_n, "{network_n} of {line_n}");
    let told = &course.told().unwrap()[0][0];
    let within = told
        .iter()
        .filter(|one| (one.mean - one.truth).abs() < 2.0 * one.log_sigma.exp())
        .count() as f64;
    assert!(
        within > 0.85 * told.len() as f64,
        "{within} of {}",
        told.len()
    );
}

#[test]
fn the_rest_that_the_ideal_model_leaves_is_learned_as_well() {
    let settings = course(20, 1, &[0], false).settings;
    let lessons = [1, 2].map(|i| lagging("lesson", 4000, 60.0, i, &[0]));
    let held_out = lagging("held out", 3000, 60.0, 3, &[0]);
    let course = Course::new(settings, topology(Target::Rest, false), &lessons, &held_out).unwrap();
    let first = held_out.tracks[0].targets(Target::Rest).next().unwrap();
    let (row, truth) = held_out.tracks[0].truth_n[0];
    let ideal = held_out.tracks[0].ideal_n[row];
    assert_eq!(
        first,
        (
            row,
            [0, 1].map(|i| f64::from(truth[i]) - f64::from(ideal[i]))
        )
    );
    let begun = error_n(&course);
    assert!(error_n(&run(course)) < 0.5 * begun);
}

fn in_threads<R: Send>(threads: usize, what: impl FnOnce() -> R + Send) -> R {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.unwrap().install(what)
}

#[test]
fn the_same_seed_gives_the_same_bits_on_one_thread_and_on_three_and_another_seed_does_not() {
    let train = |threads, seed| in_threads(threads, || run(course(3, seed, &[0, 1], false)));
    let one = train(1, 1);
    assert_eq!(one, train(3, 1));
    assert_ne!(one.best, train(1, 2).best);
}

#[test]
fn a_network_is_the_same_whichever_are_trained_beside_it() {
    let (alone, beside) = (
        run(course(3, 1, &[1], false)),
        run(course(3, 1, &[0, 1], false)),
    );
    assert_eq!(alone.networks()[0].layers, beside.networks()[1].layers);
    assert_ne!(beside.networks()[0].layers, beside.networks()[1].layers);
}

#[test]
fn a_shared_network_tells_the_forces_of_all_its_sensors() {
    let course = run(course(100, 1, &[0, 1], true));
    let network = &course.networks()[0];
    assert_eq!(network.sensors, [0, 1]);
    assert_eq!(network.inputs.len(), 2);
    assert_eq!(network.head_bias.len(), 8);
    let told = course.told().unwrap();
    for (i, force) in told[0].iter().enumerate() {
        let squares = force.iter().map(|one| (one.mean - one.truth).powi(2));
        let error = (squares.sum::<f64>() / force.len() as f64).sqrt();
        let power = force.iter().map(|one| one.truth.powi(2)).sum::<f64>();
        assert!(
            error < 0.6 * (power / force.len() as f64).sqrt(),
            "{i}: {error}"
        );
    }
}

#[test]
fn a_training_that_was_interrupted_goes_on_as_if_it_had_not_been() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("training");
    let mut begun = course(5, 1, &[0, 1], false);
    for _ in 0..2 {
        begun.epoch().unwrap();
    }
    checkpoint::write(&path, &begun, "data").unwrap();
    let mut resumed = course(5, 1, &[0, 1], false);
    checkpoint::resume(&path, &mut resumed, "data").unwrap();
    assert_eq!(resumed, begun);
    assert_eq!(run(resumed), run(course(5, 1, &[0, 1], false)));
}

#[test]
fn a_checkpoint_of_other_data_or_of_another_seed_is_refused() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("training");
    checkpoint::write(&path, &course(5, 1, &[0], false), "data").unwrap();
    let resume = |seed, inputs| {
        let mut course = course(5, seed, &[0], false);
        checkpoint::resume(&path, &mut course, inputs)
            .unwrap_err()
            .to_string()
    };
    assert!(resume(1, "other data").contains("other recordings"));
    assert!(resume(2, "data").contains("another --seed"));
}

#[test]
fn a_field_that_never_changes_is_named() {
    let lessons = [lagging("lesson", 4000, 60.0, 1, &[4])];
    let wrong = Topology {
        axes: vec![0, 2],
        ..topology(Target::Force, false)
    };
    let settings = course(5, 1, &[0], false).settings;
    let error = Course::new(settings, wrong, &lessons, &lessons[0]).unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("the field of sensor 4 along z never changes"),
        "{error}"
    );
}
