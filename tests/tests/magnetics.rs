//! The field of the magnet against another program's.

use model_export::physics::Cylinder;
use nalgebra::Vector3;
use tests::data;

#[test]
fn the_field_is_magpylib_s_to_nine_digits() {
    let mut reader = csv::Reader::from_path(data("magpylib_cylinder.csv")).unwrap();
    let rows: Vec<[f64; 8]> = reader.deserialize().map(|row| row.unwrap()).collect();
    assert_eq!(rows.len(), 500);
    for [diameter_mm, length_mm, x, y, z, bx, by, bz] in rows {
        let field = Cylinder {
            diameter_mm,
            length_mm,
        }
        .unit_field(Vector3::new(x, y, z));
        let expected = Vector3::new(bx, by, bz);
        let difference = (field - expected).norm() / expected.norm();
        assert!(difference <= 1e-9, "at {x} {y} {z}: {difference:e}");
    }
}
