//! The fields of magnets against another program's.

use nalgebra::Vector3;
use tests::data;
use tests::points::around_magnets;

#[test]
fn the_fields_of_all_shapes_magnetised_along_and_across_are_magpylib_s_to_nine_digits() {
    let mut reader = csv::Reader::from_path(data("magpylib_fields.csv")).unwrap();
    let fields: Vec<[f64; 3]> = reader.deserialize().map(|row| row.unwrap()).collect();
    let points = around_magnets();
    assert_eq!((fields.len(), points.len()), (10_000, 10_000));
    for ((magnet, at), field) in points.iter().zip(fields) {
        let expected = Vector3::from(field);
        let difference = (magnet.unit_field(*at) - expected).norm() / expected.norm();
        assert!(difference <= 1e-9, "{magnet:?} at {at}: {difference:e}");
    }
}
