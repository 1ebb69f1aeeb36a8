//! Noise floor of slow, jittered and unordered recordings, and recordings that are not independent.

use std::path::Path;

use model_export::fit::FitOptions;
use model_export::fit::campaign::{self, CampaignFits};
use model_export::fit::cross_validation::CvSplit;
use model_export::fit::rows::SensorRows;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::dependence::{Dependence, DependenceKind, dependences};
use model_export::recordings::noise_estimate::{NoiseEstimator, RowOrder};
use nalgebra::Vector3;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use tempfile::TempDir;
use tests::{RECORDING_TOML, SyntheticCampaign, nominal, write_recording};

const NOISE: (f64, f64) = (0.35, 0.15);

fn bench(seconds: f64) -> SyntheticCampaign {
    SyntheticCampaign { model: nominal(), seconds, noise: NOISE, seed: 3 }
}

fn read(folder: &Path) -> Campaign {
    Campaign::read(folder, Alignment { delay_us: 0.0 }, |_| ()).unwrap()
}

/// A table with its rows changed; the header stays.
fn rows(table: &str, change: impl FnOnce(Vec<&str>) -> Vec<String>) -> String {
    let mut lines = table.lines();
    let header = lines.next().unwrap().to_owned();
    [vec![header], change(lines.collect())].concat().join("\n") + "\n"
}

fn every(table: &str, step: usize, first: usize) -> String {
    rows(table, |all| all.into_iter().skip(first).step_by(step).map(str::to_owned).collect())
}

fn recording(hall: &str, force: &str) -> Campaign {
    let folder = TempDir::new().unwrap();
    write_recording(folder.path(), RECORDING_TOML, hall, force);
    read(folder.path())
}

/// `hall.csv` and `force.csv` with rows at the same times: noise of 0.2 G about a line in one force, of 0.5 N.
fn settings(newtons: &[f64]) -> (String, String) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut hall = "t_us,s0_x_gauss,s0_y_gauss,s0_z_gauss\n".to_owned();
    let mut force = "t_us,f0_x_n,f0_z_n\n".to_owned();
    for (row, load) in newtons.iter().enumerate() {
        let noise: [f64; 3] = std::array::from_fn(|_| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            0.2 * normal
        });
        let b = [1.5 * load + noise[0], 900.0 + noise[1], 0.4 * load + noise[2]];
        hall += &format!("{},{:.5},{:.5},{:.5}\n", 1000 * row, b[0], b[1], b[2]);
        force += &format!("{},{load:.4},{:.4}\n", 1000 * row, 0.5 * load);
    }
    (hall, force)
}

#[test]
fn noise_of_a_reference_at_10_hz_is_that_of_its_rows() {
    let (hall, force) = bench(40.0).tables(1);
    let dense = &recording(&hall, &force).recordings[0];
    assert_eq!(dense.noise.estimator, NoiseEstimator::Differences);
    let slow = &recording(&hall, &every(&force, 10, 0)).recordings[0];
    assert_eq!(slow.noise.estimator, NoiseEstimator::ResidualDifferences);
    assert!(slow.noise.differences_hold_motion);
    for force in dense.forces.values().chain(slow.forces.values()) {
        assert!((force.noise_n / NOISE.1 - 1.0).abs() < 0.15, "{}", force.noise_n);
    }
}

#[test]
fn jitter_of_the_reference_clock_is_measured() {
    let (hall, force) = bench(20.0).tables(1);
    let jittered = |std_us: f64| {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        rows(&force, |all| {
            let row = |line: &&str| {
                let (time, forces) = line.split_once(',').unwrap();
                let error: f64 = StandardNormal.sample(&mut rng);
                // Times stay in order.
                let time = time.parse::<f64>().unwrap() + (std_us * error).clamp(-4900.0, 4900.0);
                format!("{:.0},{forces}", time + 5000.0)
            };
            all.iter().map(row).collect()
        })
    };
    let (found_s, error_s) = recording(&hall, &jittered(2000.0)).recordings[0].noise.jitter_s;
    assert!((found_s - 2e-3).abs() < (4.0 * error_s).min(2e-4), "{found_s} {error_s}");
    assert_eq!(recording(&hall, &force).recordings[0].noise.jitter_s.0, 0.0);
}

#[test]
fn shuffled_rows_have_no_order_and_a_force_that_moves() {
    let mut newtons: Vec<f64> = (0..400).map(|row| f64::from(row) * 0.1 - 20.0).collect();
    let (hall, force) = settings(&newtons);
    assert_eq!(recording(&hall, &force).recordings[0].noise.order, RowOrder::Time);
    newtons.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
    let (hall, force) = settings(&newtons);
    let campaign = recording(&hall, &force);
    let noise = &campaign.recordings[0].noise;
    assert_eq!((noise.order, noise.estimator), (RowOrder::Shuffled, NoiseEstimator::Smooth));
    assert!((noise.floor_g().unwrap() / 0.2 - 1.0).abs() < 0.1, "{noise:?}");
    let rows = SensorRows::with_own_forces(&campaign, 0).unwrap();
    rows.check_excitation(&campaign).unwrap();
}

#[test]
fn repeated_settings_give_their_pure_error() {
    // Twenty loads, three times each: 40 degrees of freedom on each axis.
    let newtons: Vec<f64> = (0..60).map(|row| f64::from(row % 20) * 5.0).collect();
    let (hall, force) = settings(&newtons);
    let campaign = recording(&hall, &force);
    let noise = &campaign.recordings[0].noise;
    assert_eq!(noise.estimator, NoiseEstimator::Repeats);
    let field = &campaign.recordings[0].sensors[&0].field_g;
    assert_eq!(field.len(), 60);
    let mut squares = 0.0;
    for setting in 0..20 {
        let values = [0, 20, 40].map(|repeat| Vector3::from(field[setting + repeat]));
        let mean = values.iter().sum::<Vector3<f64>>() / 3.0;
        squares += values.iter().map(|b| (b - mean).norm_squared()).sum::<f64>();
    }
    let pure_g = (squares / 120.0).sqrt();
    assert!((noise.floor_g().unwrap() / pure_g - 1.0).abs() < 1e-9);
}

/// Dependent recordings of three with these tables, a pause between them.
fn dependent(tables: [(String, String); 3], starts_s: [f64; 3]) -> (Campaign, Vec<Dependence>) {
    let folder = TempDir::new().unwrap();
    for (place, (hall, force)) in tables.iter().enumerate() {
        let start = format!("start_s = {:.1}", starts_s[place]);
        let description = RECORDING_TOML.replace("start_s = 0.0", &start);
        write_recording(&folder.path().join(place.to_string()), &description, hall, force);
    }
    let campaign = read(folder.path());
    let found = dependences(&campaign);
    (campaign, found)
}

#[test]
fn copies_turns_of_one_run_and_overlaps_are_named() {
    let bench = bench(12.0);
    let own = |place: u64| bench.tables(place);
    let apart = [0.0, 60.0, 120.0];
    assert_eq!(dependent([own(1), own(2), own(3)], apart).1, []);
    let (campaign, copies) = dependent([own(1), own(2), own(1)], apart);
    let expected = Dependence { kind: DependenceKind::Copy, recordings: vec![0, 2], share: 1.0 };
    assert_eq!(copies, [expected]);
    let (hall, force) = own(1);
    let turns = [0, 1, 2].map(|turn| (every(&hall, 3, turn), every(&force, 3, turn)));
    let (_, turns) = dependent(turns, apart);
    assert_eq!(turns.len(), 1);
    assert!(turns[0].kind >= DependenceKind::OneRun && turns[0].recordings == [0, 1, 2]);
    let (_, overlaps) = dependent([own(1), own(2), own(3)], [0.0, 6.0, 60.0]);
    assert_eq!(
        (overlaps[0].kind, &overlaps[0].recordings[..]),
        (DependenceKind::Overlap, &[0, 1][..])
    );
    assert!((overlaps[0].share - 0.5).abs() < 0.01);
    // An assumed start cannot be wrong.
    let assumed = RECORDING_TOML.replace("start_s = 0.0", "start_s = 6.0\nstart = \"assumed\"");
    let folder = TempDir::new().unwrap();
    for (place, description) in [RECORDING_TOML, &assumed].into_iter().enumerate() {
        let (hall, force) = own(1 + place as u64);
        write_recording(&folder.path().join(place.to_string()), description, &hall, &force);
    }
    assert_eq!(dependences(&read(folder.path())), []);
    // Folds hold a block out of all recordings at the same time.
    let rows = SensorRows::with_own_forces(&campaign, 0).unwrap();
    let split = CvSplit::of(std::slice::from_ref(&rows));
    let CvSplit::Blocks { block_ms, by_clock: false } = split else { panic!("{split:?}") };
    let gap_s = 1e-3 * f64::from(block_ms) / 3.0;
    let folds = split.folds(&rows, 0.0);
    let tested: usize =
        folds.iter().flat_map(|fold| &fold.test).map(|range| range.rows.len()).sum();
    assert_eq!((folds.len(), tested), (6, rows.len()));
    let times = |ranges: &[model_export::fit::cross_validation::RowRange]| -> Vec<f64> {
        let ranges = ranges.iter().flat_map(|of| of.rows.clone().map(move |row| (of.part, row)));
        ranges.map(|(part, row)| rows.parts[part].track.time_s[row]).collect()
    };
    for fold in &folds {
        let (training, test) = (times(&fold.training), times(&fold.test));
        let nearest = |time: &f64| test.iter().map(|t| (t - time).abs()).fold(f64::MAX, f64::min);
        let least = training.iter().map(nearest).fold(f64::MAX, f64::min);
        assert!(least > 0.9 * gap_s && !training.is_empty(), "{least} {gap_s}");
    }
}

#[test]
fn one_step_in_a_random_order_still_has_time() {
    // Random settings with a drift of the field: the order carries time.
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let newtons: Vec<f64> = (0..400).map(|_| rng.random_range(-20.0..20.0)).collect();
    let (hall, force) = settings(&newtons);
    let drifting = rows(&hall, |all| {
        let row = |(row, line): (usize, &&str)| {
            let cells: Vec<&str> = line.split(',').collect();
            let x: f64 = cells[1].parse().unwrap();
            let drift = 3.0 * (row as f64 / 30.0).sin();
            format!("{},{:.5},{},{}", cells[0], x + drift, cells[2], cells[3])
        };
        all.iter().enumerate().map(row).collect()
    });
    assert_eq!(recording(&drifting, &force).recordings[0].noise.order, RowOrder::Time);
    assert_eq!(recording(&hall, &force).recordings[0].noise.order, RowOrder::Shuffled);
}

/// Columns of a table of third parties, by name.
fn columns(path: &Path, names: [&str; 2]) -> Vec<[f64; 2]> {
    let text = std::fs::read_to_string(path).unwrap();
    let header: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let places = names.map(|name| header.iter().position(|own| *own == name).unwrap());
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        places.map(|place| cells[place].trim().parse().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn load_cells_of_nist_have_their_certified_pure_error() {
    let cases = [
        ("nist_handbook", "loadcell.csv", ["load", "response"], 1.0, 4.14e-5),
        ("nist_pontius", "pontius.csv", ["load", "deflection"], 1e-5, 2.147e-4),
    ];
    for (folder, file, names, scale, certified) in cases {
        let Some(folder) = tests::real_data(folder) else { return };
        let mut hall = "t_us,s0_x_gauss,s0_y_gauss,s0_z_gauss\n".to_owned();
        let mut force = "t_us,f0_z_n\n".to_owned();
        for (row, [load, y]) in columns(&folder.join(file), names).into_iter().enumerate() {
            hall += &format!("{},{y},{y},{y}\n", 1000 * row);
            force += &format!("{},{}\n", 1000 * row, scale * load);
        }
        let campaign = recording(&hall, &force);
        let pure = campaign.recordings[0].noise.floor_g().unwrap();
        assert!((pure / certified - 1.0).abs() < 2e-3, "{file}: {pure}");
        let (fits, _) =
            campaign::polynomial(&campaign, Some(2), FitOptions::default(), |_| ()).unwrap();
        for score in fits.scores() {
            let ratio = score.held_out_rms_g / score.floor_g;
            assert!((0.8..1.5).contains(&ratio), "{file}: {ratio}");
        }
    }
}

/// A campaign of two tables of 20 settings; `signals` gives the signal of a load from 1 to 20 N in both.
fn two_tables(signals: impl Fn(f64) -> [f64; 2]) -> Campaign {
    let description = RECORDING_TOML.replace("start_s", "clock = \"assumed\"\nstart_s");
    let folder = TempDir::new().unwrap();
    for table in 0..2 {
        let mut hall = "t_us,s0_x_v\n".to_owned();
        let mut force = "t_us,f0_z_n\n".to_owned();
        for load in 1..=20 {
            let t_us = 1_000_000 * load;
            hall += &format!("{t_us},{:.6}\n", signals(f64::from(load))[table]);
            force += &format!("{t_us},{load}\n");
        }
        write_recording(&folder.path().join(table.to_string()), &description, &hall, &force);
    }
    read(folder.path())
}

/// 0.01 and -0.01 in turn.
fn alternating(load: f64) -> f64 {
    if load % 2.0 == 0.0 { 0.01 } else { -0.01 }
}

#[test]
fn two_tables_of_the_same_settings_have_the_pure_error_between_them() {
    // Half a volt apart, and 0.01 V about the mean of each setting: 40 squares of 0.01 V, and 40 - 20 - 1 degrees of freedom.
    let campaign = two_tables(|load| {
        let of_table = |sign: f64| load + sign * (0.25 + alternating(load));
        [of_table(1.0), of_table(-1.0)]
    });
    for recording in &campaign.recordings {
        assert_eq!(recording.noise.estimator, NoiseEstimator::Repeats);
        let floor = recording.noise.floor_g().unwrap();
        assert!((floor - (40.0_f64 * 1e-4 / 19.0).sqrt()).abs() < 1e-7, "{floor}");
    }
}

#[test]
fn a_line_through_a_parabola_is_answered_by_the_second_degree() {
    // Noise of 0.01 V, a parabola of 0.005 V/N^2: the least squares line misses it by 0.148 V, root mean square over
    // 1 to 20 N.
    let campaign = two_tables(|load| {
        [1.0, -1.0].map(|sign| load + 0.005 * load * load + sign * alternating(load))
    });
    let fitted = |degree| {
        let (fits, _) =
            campaign::polynomial(&campaign, Some(degree), FitOptions::default(), |_| ()).unwrap();
        let CampaignFits::Polynomial(fits) = fits else { panic!("not a polynomial") };
        fits[0].higher_degree()
    };
    let higher = fitted(1).unwrap();
    assert_eq!(higher.degree, 2);
    assert!(higher.now_g > 0.15 && higher.then_g < 0.02, "{higher:?}");
    assert_eq!(fitted(2), None);
}

/// The same table with counts added to the first axis, as a function of the time in microseconds.
fn with_counts(hall: &str, added: impl Fn(u64) -> f64) -> String {
    rows(hall, |all| {
        let changed = |row: &str| {
            let mut cells: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            cells[1] += added(cells[0] as u64).round();
            cells.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
        };
        all.into_iter().map(changed).collect()
    })
}

#[test]
fn rows_with_a_knock_in_their_window_are_left_out() {
    let (hall, force) = bench(10.0).tables(1);
    let left_out = |hall: &str| -> Vec<f64> {
        let campaign = recording(hall, &force);
        let recording = &campaign.recordings[0];
        let fields = recording.sensors[&0].field_g.iter().zip(&recording.time_s);
        let times: Vec<f64> =
            fields.filter(|(field, _)| field[0].is_nan()).map(|(_, time)| *time).collect();
        let notices = recording.notices.iter().map(ToString::to_string);
        let said =
            notices.filter(|notice| notice.contains("rows of a sensor are left out")).count();
        assert_eq!(said, usize::from(!times.is_empty()));
        times
    };
    assert_eq!(left_out(&hall), Vec::<f64>::new());
    // 40 G within 5 ms once a second, between two rows of the reference.
    let knock = |us: u64| if (503..508).contains(&(us / 1000 % 1000)) { 40.0 / 0.125 } else { 0.0 };
    let knocked = left_out(&with_counts(&hall, knock));
    let near: Vec<f64> = (0..10).flat_map(|s| [f64::from(s) + 0.50, f64::from(s) + 0.51]).collect();
    assert_eq!(knocked.len(), near.len(), "{knocked:?}");
    assert!(knocked.iter().zip(&near).all(|(a, b)| (a - b).abs() < 1e-9), "{knocked:?}");
}

/// A load that moves in a curve everywhere leaves every row.
#[test]
fn rows_of_a_fast_load_are_kept() {
    let (hall, force) = bench(10.0).tables(1);
    let shake = |us: u64| 100.0 / 0.125 * (std::f64::consts::TAU * 30.0 * us as f64 * 1e-6).sin();
    let fast = with_counts(&hall, shake);
    let campaign = recording(&fast, &force);
    assert!(campaign.recordings[0].sensors[&0].field_g.iter().all(|field| field[0].is_finite()));
}
