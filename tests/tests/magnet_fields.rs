//! Fields of magnets compared with MagpyLib.

use nalgebra::Vector3;
use tests::data;
use tests::points::points_around_magnets;

#[test]
fn fields_of_all_shapes_agree_with_magpylib_to_nine_digits() {
    let mut reader = csv::Reader::from_path(data("magpylib_fields.csv")).unwrap();
    let fields: Vec<[f64; 3]> = reader.deserialize().map(|row| row.unwrap()).collect();
    let points = points_around_magnets();
    assert_eq!((fields.len(), points.len()), (10_000, 10_000));
    for ((magnet, at), field) in points.iter().zip(fields) {
        let expected = Vector3::from(field);
        let difference = (magnet.unit_field(*at) - expected).norm() / expected.norm();
        assert!(difference <= 1e-9, "{magnet:?} at {at}: {difference:e}");
    }
}
