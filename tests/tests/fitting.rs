//! Fits: true parameters within their standard errors, the noise floor on clean data, refusal of implausible columns.

use model_export::fit::base_model::CylinderBase;
use model_export::fit::block_bootstrap::Block;
use model_export::fit::cross_validation::all_rows;
use model_export::fit::joint::SensorFit;
use model_export::fit::parameters::{COUNT, PARAMETERS, tolerances, values, with_values};
use model_export::fit::problem::SensorProblem;
use model_export::fit::rows::SensorRows;
use model_export::fit::sensor_fit::{self, SensorSolution};
use model_export::fit::solver::{FINE_TOLERANCE, minimise, weighted_jacobian};
use model_export::fit::{CampaignFits, FitError, FitOptions, campaign};
use model_export::model_file::{ModelFile, Provenance};
use model_export::physics::ForwardModel;
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::{Campaign, Notice};
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use tempfile::TempDir;
use tests::{SyntheticCampaign, data, nominal};

const NO_DELAY: Alignment = Alignment { delay_us: 0.0 };

fn read(folder: &std::path::Path) -> Campaign {
    Campaign::read(folder, NO_DELAY, |_| ()).unwrap()
}

fn cylinder_fits(campaign: &Campaign) -> (CampaignFits, Vec<SensorFit>) {
    let (fits, _) = campaign::cylinder(campaign, FitOptions::default(), |_| ()).unwrap();
    match &fits {
        CampaignFits::Cylinder(_, fit) => (fits.clone(), fit.sensors.clone()),
        CampaignFits::Polynomial(_) => unreachable!("not a cylinder"),
    }
}

#[test]
fn held_out_errors_of_clean_data_are_at_the_noise_floor() {
    let (fits, _) = cylinder_fits(&read(&data("clean")));
    let scores = fits.scores();
    assert_eq!(scores.len(), 12);
    for score in scores {
        let ratio = score.held_out_rms_g / score.floor_g;
        // A ratio far below one indicates a wrong floor.
        assert!(
            (0.93..=1.05).contains(&ratio),
            "sensor {} {:?}: {ratio}",
            score.sensor,
            score.axis
        );
    }
}

#[test]
fn the_noise_floor_combines_sensor_and_reference_noise() {
    // 0.35 G and 0.036 G of quantisation through eleven samples, 0.15 N through 1.17 and 0.73 G/N.
    let (fits, _) = cylinder_fits(&read(&data("clean")));
    let sensor = 0.308_22 * 0.351_9_f64;
    let expected = [sensor.hypot(0.15 * 1.17), sensor, sensor.hypot(0.15 * 0.73)];
    for (score, expected) in fits.scores().iter().zip(expected.iter().cycle()) {
        // Sensors differ by 15 % in stiffness.
        let ratio = score.floor_g / expected;
        assert!((0.85..1.15).contains(&ratio), "{score:?}: {ratio}");
    }
}

#[test]
fn true_parameters_are_within_three_standard_errors() {
    let design = nominal();
    let scale = tolerances(&design);
    let (mut within, mut total, mut identifiable) = (0, 0, 0);
    for seed in 1..=12 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let start = values(&design);
        let truth: [f64; COUNT] = std::array::from_fn(|i| {
            let scatter: f64 = StandardNormal.sample(&mut rng);
            start[i] + scale[i] * scatter.clamp(-2.0, 2.0)
        });
        let folder = TempDir::new().unwrap();
        let bench = SyntheticCampaign {
            model: with_values(&design, &truth),
            seconds: 8.0,
            noise: (0.35, 0.15),
            seed,
        };
        bench.write_campaign(folder.path(), 3);
        let (_, fits) = cylinder_fits(&read(folder.path()));
        for (i, truth) in truth.into_iter().enumerate() {
            total += 1;
            identifiable += usize::from(fits[0].identifiable[i]);
            within += usize::from((fits[0].values[i] - truth).abs() <= 3.0 * fits[0].std_error(i));
        }
    }
    assert!(within as f64 >= 0.97 * total as f64, "{within} of {total}");
    // Standard errors as large as the tolerances would pass the assertion above.
    assert!(identifiable as f64 >= 0.6 * total as f64, "{identifiable} of {total} identifiable");
}

#[test]
fn remanence_and_bias_along_the_gap_are_not_identifiable() {
    let (_, fits) = cylinder_fits(&read(&data("clean")));
    for fit in fits {
        let of = |name: &str| PARAMETERS.iter().position(|p| p.name == name).unwrap();
        assert!(!fit.identifiable[of("bias_y")] && fit.identifiable[of("stiffness_x")]);
        let names: Vec<&str> = fit
            .unidentifiable
            .iter()
            .flat_map(|held| held.shares.iter().map(|share| PARAMETERS[share.0].name))
            .collect();
        assert!(names.contains(&"bias_y") && names.contains(&"remanence"), "{names:?}");
    }
}

#[test]
fn an_unmodelled_effect_keeps_parameters_within_tolerances() {
    // An additional oscillation of 20 G: far more than any parameter explains.
    let folder = TempDir::new().unwrap();
    let bench = SyntheticCampaign { model: nominal(), seconds: 8.0, noise: (0.35, 0.15), seed: 5 };
    for recording in 1..=3 {
        let (hall, force) = bench.tables(recording);
        let mut rows = hall.lines();
        let mut modified = rows.next().unwrap().to_owned() + "\n";
        for (ms, row) in rows.enumerate() {
            let cells: Vec<i64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            let swing = (160.0 * (ms as f64 * 1e-3 * 0.9 + recording as f64).sin()) as i64;
            modified += &format!(
                "{},{},{},{}\n",
                cells[0],
                cells[1] + swing,
                cells[2] - 2 * swing,
                cells[3]
            );
        }
        let path = folder.path().join(recording.to_string());
        tests::write_recording(&path, tests::RECORDING_TOML, &modified, &force);
    }
    let (fits, list) = cylinder_fits(&read(folder.path()));
    assert!(fits.scores().iter().any(|s| s.held_out_rms_g > 20.0 * s.floor_g));
    let (start, scale) = (values(&nominal()), tolerances(&nominal()));
    for i in 0..COUNT {
        let change = (list[0].values[i] - start[i]).abs() / scale[i];
        assert!(change < 3.0, "{} changed by {change} tolerances", PARAMETERS[i].name);
    }
}

#[test]
fn a_model_file_is_read_as_it_was_written() {
    let campaign = read(&data("clean"));
    let (fits, list) = cylinder_fits(&campaign);
    let provenance = Provenance::of(&campaign, 0.0, FitOptions::default()).unwrap();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.toml");
    let written = ModelFile::of(&campaign, &fits, provenance);
    written.write(&path).unwrap();
    let read = ModelFile::read(&path).unwrap();
    assert_eq!(read, written);
    for fit in list {
        let model = read.forward(fit.sensor).unwrap();
        let fitted = with_values(&nominal(), fit.values[..].first_chunk().unwrap());
        let difference = model.field([100.0, -50.0]) - fitted.field([100.0, -50.0]);
        assert!(difference.amax() < 1e-6);
    }
}

#[test]
fn a_file_of_another_program_is_not_overwritten() {
    let campaign = read(&data("clean"));
    let (fits, _) = cylinder_fits(&campaign);
    let provenance = Provenance::of(&campaign, 0.0, FitOptions::default()).unwrap();
    let model = ModelFile::of(&campaign, &fits, provenance);
    let folder = TempDir::new().unwrap();
    let foreign = folder.path().join("recording.toml");
    std::fs::write(&foreign, "start_s = 0.0").unwrap();
    let refused = model.write(&foreign).unwrap_err().to_string();
    assert!(refused.contains("it is not overwritten"), "{refused}");
    assert_eq!(std::fs::read_to_string(&foreign).unwrap(), "start_s = 0.0");
    let own = folder.path().join("model.toml");
    std::fs::write(&own, "").unwrap();
    model.write(&own).unwrap();
    model.write(&own).unwrap();
}

#[test]
fn a_constant_channel_and_a_constant_force_are_refused() {
    let dead = error_of("hall.csv", &[], Some((3, 0.0)));
    assert!(dead.contains("column s0_z: the channel never changes"), "{dead}");
    let resting = with_lateral_force("3.0").err().unwrap().to_string();
    assert!(
        resting.contains("column f0_x_n: the force does not move beyond its noise"),
        "{resting}"
    );
}

/// Fit of a bench whose column of lateral forces has one value.
fn with_lateral_force(value: &str) -> Result<(CampaignFits, Vec<Notice>), FitError> {
    let folder = TempDir::new().unwrap();
    let bench = SyntheticCampaign { model: nominal(), seconds: 4.0, noise: (0.35, 0.15), seed: 2 };
    bench.write_campaign(folder.path(), 1);
    let path = folder.path().join("1/force.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut rows = text.lines();
    let mut edited = format!("{}\n", rows.next().unwrap());
    for row in rows {
        let mut cells: Vec<&str> = row.split(',').collect();
        cells[1] = value;
        edited += &(cells.join(",") + "\n");
    }
    std::fs::write(&path, edited).unwrap();
    campaign::cylinder(&read(folder.path()), FitOptions::default(), |_| ())
}

#[test]
fn force_of_zero_leaves_its_stiffness_at_nominal() {
    let (fits, notices) = with_lateral_force("0.0").unwrap();
    assert!(notices[0].message.starts_with("f0_x_n is zero within its noise"), "{notices:?}");
    let CampaignFits::Cylinder(_, fit) = fits else { unreachable!("a cylinder") };
    let sensor = &fit.sensors[0];
    assert_eq!(sensor.forces, [(0, Axis::Z)]);
    assert_eq!((sensor.values[0], sensor.identifiable[0]), (500.0, false));
    assert!(sensor.identifiable[1] && (sensor.values[1] - 800.0).abs() < 8.0, "{sensor:?}");
}

#[test]
fn one_recording_is_cross_validated_on_its_own_blocks() {
    let (fits, _) = cylinder_fits(&read(&data("clean/1")));
    for score in fits.scores() {
        let ratio = score.held_out_rms_g / score.floor_g;
        assert!((0.9..1.12).contains(&ratio), "{score:?}");
    }
}

/// Error message of a fit after renaming or scaling a column.
fn error_of(file: &str, rename: &[(&str, &str)], scale: Option<(usize, f64)>) -> String {
    let folder = TempDir::new().unwrap();
    let bench = SyntheticCampaign { model: nominal(), seconds: 4.0, noise: (0.35, 0.15), seed: 2 };
    bench.write_campaign(folder.path(), 1);
    let path = folder.path().join("1").join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    let mut rows = text.lines();
    let mut header = rows.next().unwrap().to_owned();
    for (i, (from, _)) in rename.iter().enumerate() {
        header = header.replace(from, &format!("#{i}#"));
    }
    for (i, (_, to)) in rename.iter().enumerate() {
        header = header.replace(&format!("#{i}#"), to);
    }
    let mut edited = header + "\n";
    for row in rows {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        if let Some((column, factor)) = scale {
            let value: f64 = cells[column].parse().unwrap();
            cells[column] = (value * factor).to_string();
        }
        edited += &(cells.join(",") + "\n");
    }
    std::fs::write(&path, edited).unwrap();
    let error =
        campaign::cylinder(&read(folder.path()), FitOptions::default(), |_| ()).unwrap_err();
    error.to_string()
}

#[test]
fn swapped_inverted_and_scaled_columns_are_refused() {
    let swapped = error_of("force.csv", &[("f0_x_n", "f0_z_n"), ("f0_z_n", "f0_x_n")], None);
    assert!(
        swapped.contains("force.csv, column f0_x_n") && swapped.contains("swapped"),
        "{swapped}"
    );
    let flipped = error_of("force.csv", &[], Some((2, -1.0)));
    assert!(flipped.contains("column f0_z_n") && flipped.contains("sign flipped"), "{flipped}");
    let kilograms = error_of("force.csv", &[], Some((1, 1.0 / 9.80665)));
    assert!(kilograms.contains("column f0_x_n") && kilograms.contains("unit"), "{kilograms}");
    // Kilonewtons that are called pounds, and grams: too small to be checked as newtons.
    for share in [4.448_222e-3, 9.806_65e-6] {
        let small = error_of("force.csv", &[], Some((1, share)));
        assert!(
            small.contains("column f0_x_n") && small.contains("times the sensitivity"),
            "{small}"
        );
    }
    let reversed = error_of("hall.csv", &[], Some((2, -1.0)));
    assert!(reversed.contains("column s0_y") && reversed.contains("sign is flipped"), "{reversed}");
    let permuted =
        error_of("hall.csv", &[("s0_x_lsb", "s0_y_lsb"), ("s0_y_lsb", "s0_x_lsb")], None);
    assert!(permuted.contains("column s0_x") && permuted.contains("permuted"), "{permuted}");
    let millitesla = error_of("hall.csv", &[("_lsb", "_gauss")], Some((2, 0.0125)));
    assert!(
        millitesla.contains("column s0_y") && millitesla.contains("1 mT is 10 G"),
        "{millitesla}"
    );
}

#[test]
fn forces_of_another_time_or_place_are_named() {
    let error = |campaign: &Campaign| {
        campaign::cylinder(campaign, FitOptions::default(), |_| ()).unwrap_err().to_string()
    };
    for (delay_s, words) in
        [(2.0, "2.00 s earlier"), (-3.0, "3.00 s later"), (-0.5, "0.50 s later")]
    {
        let alignment = Alignment { delay_us: 1e6 * delay_s };
        let message = error(&Campaign::read(&data("clean"), alignment, |_| ()).unwrap());
        let is_named = message.contains("t_us") && message.contains("the two clocks differ");
        assert!(is_named && message.contains(words), "{delay_s}: {message}");
    }
    // Too little is left to find a delay.
    let alignment = Alignment { delay_us: 8e6 };
    let message = error(&Campaign::read(&data("clean"), alignment, |_| ()).unwrap());
    assert!(message.contains("the two clocks probably differ by seconds"), "{message}");
    for name in ["clean", "demo", "friction", "ripple"] {
        let mut exchanged = read(&data(name));
        for recording in &mut exchanged.recordings {
            let (first, second) =
                (recording.sensors.remove(&0).unwrap(), recording.sensors.remove(&1).unwrap());
            recording.sensors.extend([(0, second), (1, first)]);
        }
        let message = error(&exchanged);
        assert!(message.contains("it follows those of place 1"), "{name}: {message}");
    }
    // A channel in millitesla that is called gauss.
    let mut mixed = read(&data("clean"));
    for recording in &mut mixed.recordings {
        let sensor = recording.sensors.get_mut(&0).unwrap();
        sensor.field_g.iter_mut().for_each(|field| field[2] /= 10.0);
    }
    let message = error(&mixed);
    assert!(message.contains("as if its field along z were in mT"), "{message}");
}

#[test]
fn fit_from_outside_of_the_free_directions_ends_at_its_minimum() {
    let campaign = read(&data("friction"));
    let rows = SensorRows::with_own_forces(&campaign, 0).unwrap();
    let base = CylinderBase { nominal: ForwardModel::nominal(campaign.design().unwrap()) };
    let problem = SensorProblem::new(&rows, &base, &[]);
    let SensorSolution { space, inflation, scaled, .. } =
        sensor_fit::fit_from_nominal(&problem).unwrap();
    let all = all_rows(&rows);
    // A solution of other priors: unidentifiable directions, which the fit sets to nominal, are far from it.
    let start =
        DVector::from_fn(scaled.len(), |i, _| scaled[i] + if i % 2 == 0 { 1.5 } else { -1.0 });
    let mut equations = Block::zeros(start.len());
    for (place, part) in rows.parts.iter().enumerate() {
        let (jacobian, residuals) = weighted_jacobian(&problem, place, &start);
        let acting = problem.acting(place);
        equations += &Block::of((&jacobian, &acting, start.len()), &residuals, 0..3 * part.len());
    }
    // As if the start were a minimum already.
    equations.score.fill(0.0);
    let fit = |known: Option<Block>| {
        minimise(&problem, &all, inflation, &space, (&start, known), FINE_TOLERANCE).unwrap()
    };
    let (with, without) = (fit(Some(equations)), fit(None));
    let difference = (&with - &without).amax();
    assert!(difference < 1e-6, "{difference}");
    assert!((&without - &scaled).amax() < 0.05, "another minimum: {}", (&without - &scaled).amax());
}
