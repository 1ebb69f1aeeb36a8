//! The device's arithmetic against its definition and against floating point, and the exporter's
//! promise that nothing overflows.

use firmware::compensate::Memory;
use firmware::force::{Estimate, Validity};
use firmware::frame::{Frame, SENSORS};
use firmware::hall::Reading;
use firmware::model::grbf;
use firmware::model::table::{COORDINATE_LIMIT, CentrePair, Tables};
use firmware::surroundings::Surroundings;
use model_export::inverse::at_rest::AtRest;
use model_export::inverse::build::Variant;
use model_export::inverse::design_box::DesignBox;
use model_export::inverse::error_map::ErrorMap;
use model_export::inverse::grbf::{Grbf, Shape};
use model_export::inverse::quantise::{TableSet, representable};
use model_export::inverse::samples::{nearest, training};
use model_export::inverse::search::{Chosen, choose};
use nalgebra::Vector3;
use proptest::prelude::*;

/// The nominal design at rest, without any effect.
fn nominal() -> AtRest {
    AtRest::plain(tests::nominal())
}

/// The device's estimate where nothing is undone around the ideal model.
fn estimate(tables: &Tables, number: usize, reading: Option<Reading>) -> Estimate {
    let mut memory = Memory::default();
    firmware::force::estimate(
        tables,
        number,
        reading,
        &Surroundings::default(),
        &mut memory,
    )
}

fn estimate_all(tables: &Tables, frame: &Frame) -> [Estimate; SENSORS] {
    let mut memories = [Memory::default(); SENSORS];
    firmware::force::estimate_all(tables, frame, &Surroundings::default(), &mut memories)
}

const GAUSS_PER_LSB: f64 = 0.125;
const RANGE_G: f64 = 2000.0;

fn chosen() -> &'static Chosen {
    static CHOSEN: std::sync::OnceLock<Chosen> = std::sync::OnceLock::new();
    CHOSEN.get_or_init(|| {
        choose(
            &[(); 4].map(|()| nominal()),
            &[0, 1, 2, 3],
            7,
            GAUSS_PER_LSB,
            RANGE_G,
        )
        .unwrap()
    })
}

fn reading(field_g: Vector3<f64>) -> Reading {
    let field = field_g.map(|g| (g / GAUSS_PER_LSB).round() as i16);
    Reading {
        field: field.into(),
        temperature: 0,
    }
}

#[test]
fn fixed_point_is_within_a_tenth_of_a_newton_of_floating_point_and_half_a_newton_at_worst() {
    for errors in &chosen().errors {
        let (rms, worst) = errors.fixed;
        assert!(rms.iter().all(|rms| *rms <= 0.1), "{rms:?}");
        assert!(worst.iter().all(|worst| *worst <= 0.5), "{worst:?}");
    }
}

#[test]
fn the_inverse_is_below_the_noise_of_a_reading_and_far_better_than_the_linear_model() {
    for errors in &chosen().errors {
        let (rms, _) = errors.model;
        let (linear, _) = errors.linear;
        for axis in 0..2 {
            assert!(rms[axis] < 0.2, "{rms:?}");
            // Far better than expected would mean that the samples are not what they should be.
            assert!(
                (5.0..60.0).contains(&(linear[axis] / rms[axis])),
                "{linear:?} {rms:?}"
            );
        }
    }
}

#[test]
fn the_error_map_covers_the_box_and_its_worst_place_is_below_a_newton() {
    let chosen = chosen();
    let map = ErrorMap::of(&nominal(), [250.0; 2], 11, |field| {
        chosen.tables.force(0, field, GAUSS_PER_LSB)
    });
    assert_eq!(
        (map.loads_n[0], map.loads_n[10], map.errors_n.len()),
        (-250.0, 250.0, 11)
    );
    assert!(map.worst_n() < 1.0, "{}", map.worst_n());
}

#[test]
fn a_load_worked_out_by_hand_comes_back() {
    // 100 N over 500 N/mm is 0.2 mm: 584.95 * 0.2 - 79.99 * 0.008 = 116.35 G laterally.
    let mut field = nominal().field([100.0, 0.0]);
    assert!((field.x - 116.35).abs() < 0.02);
    field.x = 116.35;
    let chosen = chosen();
    let found = estimate(&chosen.tables.tables(&[]), 0, Some(reading(field)));
    assert_eq!(found.validity, Validity::Valid);
    let [x, z] = found.force.map(|force| force.newtons());
    assert!((x - 100.0).abs() < 0.4 && z.abs() < 0.4, "{x} {z}");
}

#[test]
fn one_centre_sums_to_weight_times_the_exponential() {
    // At the centre the exponential is one; one table step away in each direction it is known.
    let chosen = chosen();
    let exp = chosen.tables.tables(&[]).exp;
    let pair = CentrePair {
        xy: [[100, -200], [0, 0]],
        z: [300, 0],
        weight: [[1000, 0], [-2000, 0]],
    };
    let [fx, fz] = grbf::sum(exp, &[pair], [100, -200, 300]);
    assert!((fx - 32_767 * 1000).abs() <= 1000, "{fx}");
    assert!((fz + 32_767 * 2000).abs() <= 2000, "{fz}");
    let gamma = chosen.shape.gamma;
    for distance in [0, 500, 3000, 9000, 11_000] {
        let [fx, _] = grbf::sum(exp, &[pair], [100 + distance, -200, 300]);
        let d = f64::from(distance) / f64::from(COORDINATE_LIMIT);
        let expected = 32_768_000.0 * (-gamma * d * d).exp();
        assert!(
            (f64::from(fx) - expected).abs() < 3e-4 * 32_768_000.0,
            "{distance}: {fx} {expected}"
        );
    }
}

#[test]
fn what_cannot_be_trusted_says_why() {
    let tables = chosen().tables.tables(&[]);
    let rest = nominal().field([0.0, 0.0]);
    let of = |field| estimate(&tables, 1, Some(reading(field))).validity;
    assert_eq!(of(rest), Validity::Valid);
    assert_eq!(of(Vector3::new(0.0, 1999.9, 0.0)), Validity::Saturated);
    assert_eq!(of(Vector3::new(0.0, -1999.9, 0.0)), Validity::Saturated);
    assert_eq!(of(Vector3::new(700.0, 1272.0, 0.0)), Validity::OutsideModel);
    assert_eq!(of(Vector3::new(0.0, 300.0, 0.0)), Validity::OutsideModel);
    assert_eq!(estimate(&tables, 1, None).validity, Validity::Missing);
    assert_eq!(
        estimate(&tables, 9, Some(reading(rest))).validity,
        Validity::Missing
    );
}

#[test]
fn a_model_of_some_sensors_serves_those_and_calls_the_others_missing() {
    let chosen = choose(
        &[(); 2].map(|()| nominal()),
        &[1, 3],
        7,
        GAUSS_PER_LSB,
        RANGE_G,
    )
    .unwrap();
    let loaded = Some(reading(nominal().field([50.0, -80.0])));
    let frame = Frame {
        time_us: 0,
        readings: [loaded; 4],
    };
    let found = estimate_all(&chosen.tables.tables(&[]), &frame).map(|estimate| estimate.validity);
    let (valid, missing) = (Validity::Valid, Validity::Missing);
    assert_eq!(found, [missing, valid, missing, valid]);
}

#[test]
fn a_missing_sensor_does_not_disturb_the_others() {
    let tables = chosen().tables.tables(&[]);
    let loaded = Some(reading(nominal().field([50.0, -80.0])));
    let frame = Frame {
        time_us: 0,
        readings: [loaded, None, loaded, loaded],
    };
    let estimates = estimate_all(&tables, &frame);
    assert_eq!(estimates[1].validity, Validity::Missing);
    assert_eq!(estimates[0], estimates[3]);
    assert!((estimates[2].force[1].newtons() + 80.0).abs() < 0.5);
}

#[test]
fn weights_that_could_overflow_are_refused_by_row() {
    let (_, design) = DesignBox::of(&nominal()).device_scale(GAUSS_PER_LSB);
    let shape = Shape {
        centres_across: 5,
        gamma: 1.0,
        ridge: 1e-6,
    };
    let samples = training(&nominal(), &design);
    let fitted = Grbf::fit(&nominal(), &design, shape, &samples, representable).unwrap();
    let mut fighting = fitted.clone();
    fighting.weights_n[7] = [1e9, 0.0];
    let refused = TableSet::build(
        0,
        &[fitted.clone(), fighting],
        &[0, 1],
        GAUSS_PER_LSB,
        RANGE_G,
    )
    .unwrap_err();
    let sentence = refused.to_string();
    assert!(
        sentence.starts_with("sensor 1, weight of centre 7 for force 0: "),
        "{sentence}"
    );
    let mut outside = fitted;
    outside.centres[3].x = 1.5;
    let sentence = TableSet::build(0, &[outside], &[0], GAUSS_PER_LSB, RANGE_G)
        .unwrap_err()
        .to_string();
    assert!(
        sentence.starts_with("sensor 0, axis 0 of centre 3: "),
        "{sentence}"
    );
}

#[test]
fn beside_the_surface_the_nearest_load_is_the_answer() {
    let model = nominal();
    let mut field = model.field([120.0, -60.0]);
    assert!((nearest(&model, &field, [100.0, 0.0])[0] - 120.0).abs() < 1e-6);
    // The gap axis hardly counts: ten gauss there move the answer by a fraction of a newton.
    field.y += 10.0;
    let [x, z] = nearest(&model, &field, [120.0, -60.0]);
    assert!((x - 120.0).abs() < 0.2 && (z + 60.0).abs() < 0.2, "{x} {z}");
}

proptest! {
    #[test]
    fn any_reading_gives_a_bounded_force_without_overflow(
        x in any::<i16>(), y in any::<i16>(), z in any::<i16>(), sensor in 0..4_usize,
    ) {
        let chosen = chosen();
        let reading = Reading { field: [x, y, z], temperature: 0 };
        let found = estimate(&chosen.tables.tables(&[]), sensor, Some(reading));
        // The box is 250 N; clamped coordinates reach its margin and no further.
        for force in found.force {
            prop_assert!(force.newtons().abs() < 600.0, "{force:?}");
        }
    }

    #[test]
    fn the_sum_never_exceeds_what_the_exporter_proved(
        x in -COORDINATE_LIMIT..=COORDINATE_LIMIT,
        y in -COORDINATE_LIMIT..=COORDINATE_LIMIT,
        z in -COORDINATE_LIMIT..=COORDINATE_LIMIT,
    ) {
        let chosen = chosen();
        let table = &chosen.tables.sensors[0];
        let pairs = &table.pairs[..usize::from(table.used_pairs)];
        let sum = grbf::sum(&chosen.tables.exp, pairs, [x, y, z]);
        for (force, sum) in sum.into_iter().enumerate() {
            let bound: i64 = pairs.iter().flat_map(|p| p.weight[force]).map(|w| i64::from(w).abs() << 15).sum();
            prop_assert!(bound <= i64::from(i32::MAX));
            prop_assert!(i64::from(sum).abs() <= bound);
        }
    }
}

#[test]
fn the_nominal_variant_is_the_same_model_for_every_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let campaign = model_export::recordings::Campaign::read(
        &tests::data("clean"),
        model_export::recordings::align::Alignment { delay_us: 0.0 },
        |_| (),
    )
    .unwrap();
    let options = model_export::fit::Options::default();
    let (fits, _) = model_export::fit::campaign::cylinder(&campaign, options, |_| ()).unwrap();
    let provenance = model_export::model_file::Provenance::of(&campaign, 0.0, options).unwrap();
    let path = folder.path().join("model.toml");
    model_export::model_file::ModelFile::of(&campaign, &fits, provenance)
        .write(&path)
        .unwrap();
    let built = model_export::inverse::build::build(&path, Variant::Nominal).unwrap();
    let ideal = built.chosen;
    assert_eq!(built.header.variant, "nominal design");
    assert!(
        ideal
            .tables
            .sensors
            .windows(2)
            .all(|pair| pair[0].pairs == pair[1].pairs)
    );
    let fitted = model_export::inverse::build::build(&path, Variant::Fitted)
        .unwrap()
        .chosen;
    assert!(
        fitted
            .tables
            .sensors
            .windows(2)
            .all(|pair| pair[0] != pair[1])
    );
}
