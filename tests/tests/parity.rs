//! Three axes of a field against two forces: what the device sees beside the surface of a sensor's
//! fields.

use firmware::compensate::Memory;
use firmware::force::estimate;
use firmware::hall::Reading;
use firmware::surroundings::Surroundings;
use model_export::inverse::at_rest::AtRest;
use model_export::inverse::search::choose;
use model_export::physics::ForwardModel;
use nalgebra::Vector3;

const GAUSS_PER_LSB: f64 = 0.125;
/// What counts and the polynomial may leave: half a count along three axes, and a little.
const NOTHING_G: f64 = 0.13;

/// A gripper that is not quite straight.
fn made() -> AtRest {
    AtRest::plain(ForwardModel {
        offset_mm: [0.06, -0.04],
        tilt_rad: [0.02, -0.01],
        rotation_rad: Vector3::new(0.01, 0.02, -0.015),
        ..tests::nominal()
    })
}

/// The departure that the device tells of a field, in gauss, with the tables of `model`.
fn departures(model: &AtRest, fields: &[Vector3<f64>]) -> Vec<f64> {
    let chosen = choose(std::slice::from_ref(model), &[0], 7, GAUSS_PER_LSB, 2000.0).unwrap();
    let surface = &chosen.surfaces[0];
    assert!(surface.left_g < 0.01, "{}", surface.left_g);
    let mut tables = chosen.tables.clone();
    tables.sensors[0].parity = surface.table(0, 0.1, GAUSS_PER_LSB).unwrap();
    let told = |field: &Vector3<f64>| {
        let counts = field.map(|g| (g / GAUSS_PER_LSB).round() as i16);
        let reading = Reading {
            field: counts.into(),
            temperature: 0,
        };
        let around = Surroundings::default();
        let mut memory = Memory::default();
        let found = estimate(&tables.tables(&[]), 0, Some(reading), &around, &mut memory);
        assert_eq!(
            found.parity.spread,
            (0.1_f64.hypot(surface.left_g) * 128.0 * 256.0).round() as i32
        );
        found.parity.departure.counts() * GAUSS_PER_LSB
    };
    fields.iter().map(told).collect()
}

#[test]
fn whatever_the_forces_a_field_of_the_own_magnet_lies_on_its_surface() {
    let model = made();
    let loads =
        (-4..=4).flat_map(|x| (-4..=4).map(move |z| [60.0 * f64::from(x), 60.0 * f64::from(z)]));
    let fields: Vec<Vector3<f64>> = loads.map(|load| model.field(load)).collect();
    for departure in departures(&model, &fields) {
        assert!(departure.abs() < NOTHING_G, "{departure}");
    }
}

#[test]
fn a_foreign_field_is_seen_by_what_of_it_stands_across_the_surface() {
    let model = made();
    let foreign = Vector3::new(6.0, -8.0, 5.0);
    let loads = [[0.0, 0.0], [150.0, -120.0], [-200.0, 90.0]];
    let fields: Vec<Vector3<f64>> = loads
        .iter()
        .map(|load| model.field(*load) + foreign)
        .collect();
    for (load, found) in loads.iter().zip(departures(&model, &fields)) {
        let [gx, gz] = model.per_newton(*load);
        let across = gx.cross(&gz);
        let expected = across.dot(&foreign) / across.y;
        // The surface is curved: some hundredths of a gauss over eight.
        assert!(
            (found - expected).abs() < NOTHING_G + 0.1,
            "{found} {expected}"
        );
    }
}
