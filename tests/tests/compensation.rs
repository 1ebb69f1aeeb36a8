//! What an effect does to the field on the host, the device undoes: forces through the forward model
//! with the effect, rounded to the sensor's counts, through the device's code, and back.

use std::collections::BTreeMap;

use firmware::compensate::{Compensation, Memory};
use firmware::force::estimate;
use firmware::hall::Reading;
use firmware::params;
use firmware::surroundings::{Attitude, Motor, Surroundings};
use model_export::effects::{Addition, REFERENCE_C, Series, Track, find};
use model_export::inverse::at_rest::AtRest;
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::search::{Chosen, choose};
use nalgebra::Rotation3;
use tests::nominal;

const GAUSS_PER_LSB: f64 = 0.125;
/// Rows of a made-up recording, one for each tick of the board.
const ROWS: usize = 6000;

/// Six seconds at the board's rate, everything moving.
fn track() -> Track {
    let time_s: Vec<f64> = (0..ROWS).map(|i| i as f64 * 1e-3).collect();
    let wave = |hertz: f64, size: f64| -> Vec<f64> {
        time_s
            .iter()
            .map(|t| size * (std::f64::consts::TAU * hertz * t).sin())
            .collect()
    };
    // It starts at rest and unloaded, as a recording should.
    let soft = |t: f64| (t - 0.3).clamp(0.0, 1.0);
    let (x, z) = (wave(0.6, 180.0), wave(0.43, 150.0));
    let force_n: Vec<[f64; 2]> = time_s
        .iter()
        .zip(x.iter().zip(&z))
        .map(|(t, (x, z))| [soft(*t) * x, soft(*t) * z])
        .collect();
    let iq = wave(0.5, 8.0);
    let angle: Vec<f64> = time_s.iter().map(|t| 3.0 * t).collect();
    let turning = |of: fn(f64) -> f64, sign: f64| -> Vec<f64> {
        iq.iter()
            .zip(&angle)
            .map(|(iq, angle)| sign * iq * of(params::POLE_PAIRS.value * angle))
            .collect()
    };
    let shifted =
        |values: Vec<f64>, by: f64| -> Vec<f64> { values.into_iter().map(|v| v + by).collect() };
    let covariates = [
        ("opening_mm", shifted(wave(0.2, 18.0), 22.0)),
        ("motor_alpha_a", turning(f64::sin, -1.0)),
        ("motor_beta_a", turning(f64::cos, 1.0)),
        ("accel_x_mps2", wave(1.1, 8.0)),
        ("accel_y_mps2", wave(0.9, 5.0)),
        ("accel_z_mps2", shifted(wave(0.7, 6.0), 9.81)),
        ("roll_rad", wave(0.15, 2.0)),
        ("pitch_rad", wave(0.11, 1.0)),
        ("yaw_rad", wave(0.13, 3.0)),
        ("motor_iq_a", iq),
        ("motor_angle_rad", angle),
    ];
    Track {
        smooth_n: force_n.clone(),
        rate_n_per_s: vec![[0.0; 2]; ROWS],
        cycles: vec![[0.0; 2]; ROWS],
        temperature_c: time_s.iter().map(|t| 20.0 + 2.5 * t).collect(),
        covariates: covariates
            .into_iter()
            .map(|(name, values)| (name.to_owned(), values))
            .collect::<BTreeMap<_, _>>(),
        force_n,
        time_s,
        ..Track::default()
    }
}

fn surroundings(track: &Track, row: usize) -> Surroundings {
    let of = |name: &str| track.covariates[name][row];
    let milli = |name: &str| (1e3 * of(name)).round() as i32;
    let (sin, cos) = (params::POLE_PAIRS.value * of("motor_angle_rad")).sin_cos();
    let turn = Rotation3::from_euler_angles(of("roll_rad"), of("pitch_rad"), of("yaw_rad"));
    let entry = |i: usize, j: usize| (turn[(i, j)] * f64::from(1 << Attitude::BITS)).round() as i32;
    Surroundings {
        opening_um: Some(milli("opening_mm")),
        motor: Some(Motor {
            iq_ma: milli("motor_iq_a"),
            electrical: [sin, cos].map(|share| (share * 32768.0).round() as i32),
            angle_urad: (1e6 * of("motor_angle_rad").rem_euclid(std::f64::consts::TAU)).round()
                as i32,
        }),
        acceleration: Some(["accel_x_mps2", "accel_y_mps2", "accel_z_mps2"].map(milli)),
        attitude: Some(Attitude {
            to_world: [0, 1, 2].map(|i| [0, 1, 2].map(|j| entry(i, j))),
        }),
    }
}

/// An effect with a value for each parameter: a few times its typical size.
fn sized(id: &str) -> (Addition, Vec<f64>) {
    let effect = Addition::Catalogue(find(id).unwrap());
    let values = match id {
        "sensor_temperature" => vec![0.2, -0.15, 0.1, 0.03],
        "motor_leakage" => vec![0.1, -0.05, 0.08, 0.06, 0.1, -0.07, -0.2, 0.15, 0.1],
        "earth_field" => vec![0.3, 0.1, -0.5],
        "neighbour_magnet" => vec![0.3, -4.0, 0.5, 10.0, 1.0, -2.0],
        "magnet_temperature" => vec![-0.12],
        "thermal_gap" => vec![1.5],
        "viscous_lag" => vec![10.0, 5.0],
        "creep" => vec![5.0, 3.0, 1.0, 6.0, 0.5],
        "hysteresis" => vec![
            8.0, 5.0, 12.0, 38.0, 70.0, 1.0, 2.0, 12.0, 38.0, 70.0, 1.0, 2.0, 0.0, 0.0,
        ],
        "hard_stop" => vec![50.0, 40.0, 20.0, 40.0, 110.0, 90.0],
        "fingertip_mass" => vec![0.3],
        other => panic!("{other} has no size here"),
    };
    (effect, values)
}

fn chosen(rest: &AtRest) -> Chosen {
    choose(std::slice::from_ref(rest), &[0], 7, GAUSS_PER_LSB, 2000.0).unwrap()
}

/// Root mean square error in newtons, both forces, with and without the compensation.
fn errors(id: &str) -> (f64, f64) {
    let effects = [sized(id)];
    let rest = AtRest::new(nominal(), &effects, 1);
    let compensation = OwnedCompensation::build(0, &rest, &effects, GAUSS_PER_LSB)
        .unwrap()
        .unwrap();
    let chosen = chosen(&rest);
    let list: Vec<(&Addition, &[f64])> = effects
        .iter()
        .map(|(effect, values)| (effect, values.as_slice()))
        .collect();
    let track = track();
    let states = Series::of(&track, rest.model.stiffness_n_per_mm, &list).states;
    let frames = rest.model.frames();
    let run = |compensations: &[Compensation]| {
        let tables = chosen.tables.tables(compensations);
        let mut memory = Memory::default();
        let mut squares = 0.0;
        for (row, state) in states.iter().enumerate() {
            let counts = rest
                .model
                .field_in(&frames, state)
                .map(|g| (g / GAUSS_PER_LSB).round() as i16);
            let warmer = track.temperature_c[row] - REFERENCE_C;
            let reading = Reading {
                field: counts.into(),
                temperature: (warmer * params::TEMPERATURE_SCALE.value).round() as i16,
            };
            let around = surroundings(&track, row);
            let found = estimate(&tables, 0, Some(reading), &around, &mut memory);
            assert!(!found.lacking);
            for (found, truth) in found.force.iter().zip(track.force_n[row]) {
                squares += (found.newtons() - truth).powi(2);
            }
        }
        (squares / (2 * states.len()) as f64).sqrt()
    };
    (run(&[compensation.view()]), run(&[]))
}

#[test]
fn each_effect_that_the_host_makes_the_device_undoes() {
    // Without any effect the ideal model and the counts leave 0.1 to 0.2 N.
    for (id, limit_n) in [
        ("sensor_temperature", 0.25),
        ("motor_leakage", 0.25),
        ("earth_field", 0.25),
        ("neighbour_magnet", 0.25),
        ("magnet_temperature", 0.25),
        ("thermal_gap", 0.25),
        ("fingertip_mass", 0.25),
        ("hard_stop", 0.4),
        ("creep", 0.3),
        ("hysteresis", 0.3),
        // Its rate trails the load by two low passes.
        ("viscous_lag", 0.6),
    ] {
        let (with, without) = errors(id);
        assert!(
            with < limit_n && without > 1.9 * with,
            "{id}: {with} N with, {without} N without"
        );
    }
}

#[test]
fn what_the_board_does_not_know_is_not_undone_and_the_estimate_says_so() {
    let effects = [sized("neighbour_magnet"), sized("fingertip_mass")];
    let rest = AtRest::new(nominal(), &effects, 1);
    let own = OwnedCompensation::build(0, &rest, &effects, GAUSS_PER_LSB)
        .unwrap()
        .unwrap();
    let views = [own.view()];
    let chosen = chosen(&rest);
    let tables = chosen.tables.tables(&views);
    let field = rest
        .field([40.0, 0.0])
        .map(|g| (g / GAUSS_PER_LSB).round() as i16);
    let reading = Some(Reading {
        field: field.into(),
        temperature: 0,
    });
    let mut memory = Memory::default();
    let blind = estimate(&tables, 0, reading, &Surroundings::default(), &mut memory);
    let [x, _] = blind.force.map(|force| force.newtons());
    assert!(blind.lacking && (x - 40.0).abs() < 0.5, "{x}");
    let seeing = surroundings(&track(), 0);
    assert!(!estimate(&tables, 0, reading, &seeing, &mut memory).lacking);
}
