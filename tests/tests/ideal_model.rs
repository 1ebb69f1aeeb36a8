//! The ideal model on the device compared with floating point; its bounds; the parity residual; other magnets.

use firmware::compensation::CompensationState;
use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::config::constants;
use firmware::estimator::{Estimate, Validity};
use firmware::model::formats::{COORDINATE_LIMIT, CentrePair, Tables};
use firmware::model::kernel::grbf;
use firmware::sensors::hall::{HallFrame, HallReading, SENSORS};
use model_export::inverse::build::ModelVariant;
use model_export::inverse::grbf::{ErrorMap, Grbf, GrbfShape, nearest_forces, training_samples};
use model_export::inverse::model_selection::{SelectedModels, select_models};
use model_export::inverse::quantise::{TableSet, representable};
use model_export::inverse::static_model::{DesignBox, ForceRegion, StaticModel};
use model_export::physics::ForwardModel;
use model_export::recordings::description::{MagnetAxis, MagnetShape, MagnetSpec, NominalDesign};
use nalgebra::Vector3;
use proptest::prelude::*;

/// The nominal design without additional effects.
fn nominal() -> StaticModel {
    StaticModel::without_effects(tests::nominal())
}

/// The device's estimate without compensation.
fn estimate(tables: &Tables, number: usize, reading: Option<HallReading>) -> Estimate {
    let mut state = CompensationState::default();
    firmware::estimator::estimate(tables, number, reading, &AuxiliaryInputs::default(), &mut state)
}

fn estimate_all(tables: &Tables, frame: &HallFrame) -> [Estimate; SENSORS] {
    let mut states = [CompensationState::default(); SENSORS];
    let mut estimates = [Estimate::MISSING; SENSORS];
    let inputs = AuxiliaryInputs::default();
    let all = [true; SENSORS];
    firmware::estimator::estimate_all(tables, frame, &inputs, &mut states, all, &mut estimates);
    estimates
}

const GAUSS_PER_LSB: f64 = 0.125;
const RANGE_G: f64 = 2000.0;

fn chosen() -> &'static SelectedModels {
    static CHOSEN: std::sync::OnceLock<SelectedModels> = std::sync::OnceLock::new();
    CHOSEN.get_or_init(|| {
        select_models(&[(); 4].map(|()| nominal()), &[0, 1, 2, 3], 7, GAUSS_PER_LSB, RANGE_G, None)
            .unwrap()
    })
}

fn reading(field_g: Vector3<f64>) -> HallReading {
    let field = field_g.map(|g| (g / GAUSS_PER_LSB).round() as i16);
    HallReading { field: field.into(), temperature: 0 }
}

#[test]
fn fixed_point_agrees_with_floating_point_to_0_1_n_rms() {
    for errors in chosen().errors() {
        let (rms, worst) = errors.fixed;
        assert!(rms.iter().all(|rms| *rms <= 0.1), "{rms:?}");
        assert!(worst.iter().all(|worst| *worst <= 0.5), "{worst:?}");
    }
}

#[test]
fn the_inverse_error_is_below_the_noise_of_a_reading() {
    for errors in chosen().errors() {
        let (rms, _) = errors.model;
        let (linear, _) = errors.linear;
        for axis in 0..2 {
            assert!(rms[axis] < 0.2, "{rms:?}");
            // A larger improvement would indicate wrong samples.
            assert!((5.0..60.0).contains(&(linear[axis] / rms[axis])), "{linear:?} {rms:?}");
        }
    }
}

#[test]
fn the_maximum_of_the_error_map_is_below_a_newton() {
    let chosen = chosen();
    let map = ErrorMap::of(&nominal(), ForceRegion::symmetric(250.0), 11, |field| {
        chosen.tables.force(0, field, GAUSS_PER_LSB)
    });
    assert_eq!((map.loads_n[0][0], map.loads_n[1][10], map.errors_n.len()), (-250.0, 250.0, 11));
    assert!(map.worst_n() < 1.0, "{}", map.worst_n());
}

#[test]
fn a_hand_calculated_field_gives_its_load() {
    // 100 N at 500 N/mm are 0.2 mm: 584.95 * 0.2 - 79.99 * 0.008 = 116.35 G laterally.
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
fn one_centre_gives_weight_times_exponential() {
    // At the centre the exponential is one.
    let chosen = chosen();
    let exp = chosen.tables.tables(&[]).exp;
    let pair =
        CentrePair { xy: [[100, -200], [0, 0]], z: [300, 0], weight: [[1000, 0], [-2000, 0]] };
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
fn unusable_readings_have_the_right_validity() {
    let tables = chosen().tables.tables(&[]);
    let rest = nominal().field([0.0, 0.0]);
    let validity = |field| estimate(&tables, 1, Some(reading(field))).validity;
    assert_eq!(validity(rest), Validity::Valid);
    assert_eq!(validity(Vector3::new(0.0, 1999.9, 0.0)), Validity::Saturated);
    assert_eq!(validity(Vector3::new(0.0, -1999.9, 0.0)), Validity::Saturated);
    assert_eq!(validity(Vector3::new(700.0, 1272.0, 0.0)), Validity::OutsideModel);
    assert_eq!(validity(Vector3::new(0.0, 300.0, 0.0)), Validity::OutsideModel);
    assert_eq!(estimate(&tables, 1, None).validity, Validity::Missing);
    assert_eq!(estimate(&tables, 9, Some(reading(rest))).validity, Validity::Missing);
}

#[test]
fn given_shape_is_taken_only_where_the_device_can_represent_it() {
    let select = |shape| {
        select_models(&[nominal()], &[0], 7, GAUSS_PER_LSB, RANGE_G, Some(shape)).unwrap().shape
    };
    let selected = chosen().shape;
    let other = GrbfShape { ridge: 1e-3, ..selected };
    assert_eq!(select(other), other);
    // Nearly constant functions need huge weights.
    let huge = GrbfShape { gamma: 1e-4, ridge: 1e-14, ..selected };
    assert_ne!(select(huge), huge);
}

#[test]
fn sensors_without_a_table_are_missing() {
    let chosen =
        select_models(&[(); 2].map(|()| nominal()), &[1, 3], 7, GAUSS_PER_LSB, RANGE_G, None)
            .unwrap();
    let loaded = Some(reading(nominal().field([50.0, -80.0])));
    let frame = HallFrame { time_us: 0, readings: [loaded; 4] };
    let found = estimate_all(&chosen.tables.tables(&[]), &frame).map(|estimate| estimate.validity);
    let (valid, missing) = (Validity::Valid, Validity::Missing);
    assert_eq!(found, [missing, valid, missing, valid]);
}

#[test]
fn a_missing_sensor_does_not_affect_the_others() {
    let tables = chosen().tables.tables(&[]);
    let loaded = Some(reading(nominal().field([50.0, -80.0])));
    let frame = HallFrame { time_us: 0, readings: [loaded, None, loaded, loaded] };
    let estimates = estimate_all(&tables, &frame);
    assert_eq!(estimates[1].validity, Validity::Missing);
    assert_eq!(estimates[0], estimates[3]);
    assert!((estimates[2].force[1].newtons() + 80.0).abs() < 0.5);
}

#[test]
fn overflowing_weights_and_centres_are_refused() {
    let (_, design) = DesignBox::of(&nominal()).device_scale(GAUSS_PER_LSB);
    let shape = GrbfShape { centres_across: 5, gamma: 1.0, ridge: 1e-6 };
    let samples = training_samples(&nominal(), &design);
    let fitted = Grbf::fit(&nominal(), &design, shape, &samples, representable).unwrap();
    let mut overflowing = fitted.clone();
    overflowing.weights_n[7] = [1e9, 0.0];
    let refused =
        TableSet::build(0, &[fitted.clone(), overflowing], &[0, 1], GAUSS_PER_LSB, RANGE_G)
            .unwrap_err();
    let message = refused.to_string();
    assert!(message.starts_with("sensor 1, weight of centre 7 for force 0: "), "{message}");
    let mut outside = fitted;
    outside.centres[3].x = 1.5;
    let message =
        TableSet::build(0, &[outside], &[0], GAUSS_PER_LSB, RANGE_G).unwrap_err().to_string();
    assert!(message.starts_with("sensor 0, axis 0 of centre 3: "), "{message}");
}

#[test]
fn a_field_off_the_surface_gives_the_nearest_load() {
    let model = nominal();
    let mut field = model.field([120.0, -60.0]);
    assert!((nearest_forces(&model, &field, [100.0, 0.0])[0] - 120.0).abs() < 1e-6);
    // The gap axis has little influence: ten gauss change the result by a fraction of a newton.
    field.y += 10.0;
    let [x, z] = nearest_forces(&model, &field, [120.0, -60.0]);
    assert!((x - 120.0).abs() < 0.2 && (z + 60.0).abs() < 0.2, "{x} {z}");
}

/// Error of quantisation (half a count on three axes) and polynomial.
const RESIDUAL_G: f64 = 0.13;

/// A finger with tolerances.
fn with_tolerances() -> StaticModel {
    StaticModel::without_effects(ForwardModel {
        offset_mm: [0.06, -0.04],
        tilt_rad: [0.02, -0.01],
        rotation_rad: Vector3::new(0.01, 0.02, -0.015),
        ..tests::nominal()
    })
}

/// Parity residuals of the device in gauss, with the tables of `model`.
fn parity_residuals(model: &StaticModel, fields: &[Vector3<f64>]) -> Vec<f64> {
    let chosen =
        select_models(std::slice::from_ref(model), &[0], 7, GAUSS_PER_LSB, RANGE_G, None).unwrap();
    let surface = &chosen.surfaces[0];
    assert!(surface.fit_rms_g < 0.01, "{}", surface.fit_rms_g);
    let mut tables = chosen.tables.clone();
    tables.sensors[0].parity = surface.table(0, 0.1, GAUSS_PER_LSB).unwrap();
    let residual = |field: &Vector3<f64>| {
        let found = estimate(&tables.tables(&[]), 0, Some(reading(*field)));
        assert_eq!(
            found.parity.sigma,
            (0.1_f64.hypot(surface.fit_rms_g) * 128.0 * 256.0).round() as i32
        );
        found.parity.residual.counts() * GAUSS_PER_LSB
    };
    fields.iter().map(residual).collect()
}

#[test]
fn the_parity_residual_of_the_own_magnet_is_zero() {
    let model = with_tolerances();
    let loads =
        (-4..=4).flat_map(|x| (-4..=4).map(move |z| [60.0 * f64::from(x), 60.0 * f64::from(z)]));
    let fields: Vec<Vector3<f64>> = loads.map(|load| model.field(load)).collect();
    for residual in parity_residuals(&model, &fields) {
        assert!(residual.abs() < RESIDUAL_G, "{residual}");
    }
}

#[test]
fn the_parity_residual_is_the_foreign_field_off_the_surface() {
    let model = with_tolerances();
    let foreign = Vector3::new(6.0, -8.0, 5.0);
    let loads = [[0.0, 0.0], [150.0, -120.0], [-200.0, 90.0]];
    let fields: Vec<Vector3<f64>> = loads.iter().map(|load| model.field(*load) + foreign).collect();
    for (load, found) in loads.iter().zip(parity_residuals(&model, &fields)) {
        let [gx, gz] = model.per_newton(*load);
        let normal = gx.cross(&gz);
        let expected = normal.dot(&foreign) / normal.y;
        // The surface is curved: some hundredths of a gauss at eight.
        assert!((found - expected).abs() < RESIDUAL_G + 0.1, "{found} {expected}");
    }
}

/// A magnet magnetised across the gap, with flexures of this stiffness in N/mm and this range of force.
fn design_of(
    shape: MagnetShape,
    body_axis: Option<MagnetAxis>,
    stiffness: f64,
    range_n: f64,
) -> NominalDesign {
    NominalDesign {
        magnet: MagnetSpec { shape, remanence_t: 1.2, axis: MagnetAxis::Y, body_axis },
        stiffness_x_n_per_mm: stiffness,
        stiffness_z_n_per_mm: 1.5 * stiffness,
        force_range_n: Some(range_n),
        ..NominalDesign::magpie()
    }
}

#[test]
fn inverse_errors_of_other_magnets_are_below_the_noise() {
    let tube = MagnetShape::Tube { diameter_mm: 3.0, hole_mm: 1.0, length_mm: 4.0 };
    let designs = [
        design_of(MagnetShape::Sphere { diameter_mm: 3.0 }, None, 20.0, 8.0),
        design_of(MagnetShape::Cube { side_mm: 2.5 }, None, 100.0, 40.0),
        design_of(tube, Some(MagnetAxis::Z), 2000.0, 800.0),
    ];
    for design in designs {
        let model = ForwardModel::nominal(&design);
        let slopes = model.per_newton(&model.response(Vector3::zeros()));
        let noise_n = slopes.map(|slope| constants::SENSOR_NOISE.value / slope.norm());
        let (scale, range) = (constants::SENSOR_SCALE.value, constants::SENSOR_RANGE.value);
        let chosen =
            select_models(&[StaticModel::without_effects(model)], &[2], 7, scale, range, None)
                .unwrap();
        let errors = chosen.errors()[0];
        for (axis, noise_n) in noise_n.into_iter().enumerate() {
            let (inverse, fixed) = (errors.model.0[axis], errors.fixed.0[axis]);
            assert!(inverse < 0.5 * noise_n, "{inverse} {noise_n} {design:?}");
            assert!(fixed < 0.2 * noise_n, "{fixed} {noise_n} {design:?}");
            // A linear model must not be sufficient.
            assert!(errors.linear.0[axis] > 2.0 * inverse, "{errors:?}");
        }
    }
}

proptest! {
    #[test]
    fn any_reading_gives_a_bounded_force(
        x in any::<i16>(), y in any::<i16>(), z in any::<i16>(), sensor in 0..4_usize,
    ) {
        let chosen = chosen();
        let reading = HallReading { field: [x, y, z], temperature: 0 };
        let found = estimate(&chosen.tables.tables(&[]), sensor, Some(reading));
        // The box is 250 N; coordinates are clamped to its margin.
        for force in found.force {
            prop_assert!(force.newtons().abs() < 600.0, "{force:?}");
        }
    }

    #[test]
    fn the_sum_is_within_the_exporter_s_bound(
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
fn the_nominal_variant_is_equal_for_every_sensor() {
    let folder = tempfile::tempdir().unwrap();
    let campaign = model_export::recordings::Campaign::read(
        &tests::data("clean"),
        model_export::recordings::align::Alignment { delay_us: 0.0 },
        |_| (),
    )
    .unwrap();
    let options = model_export::fit::FitOptions::default();
    let (fits, _) = model_export::fit::campaign::cylinder(&campaign, options, |_| ()).unwrap();
    let provenance = model_export::model_file::Provenance::of(&campaign, 0.0, options).unwrap();
    let path = folder.path().join("model.toml");
    model_export::model_file::ModelFile::of(&campaign, &fits, provenance).write(&path).unwrap();
    let built = model_export::inverse::build::build(&path, ModelVariant::Nominal).unwrap();
    let ideal = built.chosen;
    assert_eq!(built.header.variant, "nominal design");
    assert!(ideal.tables.sensors.windows(2).all(|pair| pair[0].pairs == pair[1].pairs));
    let fitted = model_export::inverse::build::build(&path, ModelVariant::Fitted).unwrap().chosen;
    assert!(fitted.tables.sensors.windows(2).all(|pair| pair[0] != pair[1]));
}
