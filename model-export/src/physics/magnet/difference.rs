//! A gradient from differences of a field, completed by what a static field obeys.
//!
//! Outside the magnet a static field has neither curl nor divergence: its gradient is symmetric and
//! its trace is zero. The derivatives along two axes determine it, and what is told twice is averaged.

use nalgebra::{Matrix3, Vector3};

/// Half the span of a central difference in mm. Two millimetres from the nearest edge the error is of
/// the order of (1e-3 / 2)^2 relative; rounding is far below.
pub const DIFFERENCE_MM: f64 = 1e-3;

/// The field of `unit_field` and its gradient in its unit per mm.
pub fn field_and_gradient(
    at_mm: Vector3<f64>,
    unit_field: impl Fn(Vector3<f64>) -> Vector3<f64>,
) -> (Vector3<f64>, Matrix3<f64>) {
    let along = |axis: Vector3<f64>| {
        let step = axis * DIFFERENCE_MM;
        (unit_field(at_mm + step) - unit_field(at_mm - step)) / (2.0 * DIFFERENCE_MM)
    };
    let (x, z) = (along(Vector3::x()), along(Vector3::z()));
    let xz = 0.5 * (x.z + z.x);
    let gradient = Matrix3::new(x.x, x.y, xz, x.y, -(x.x + z.z), z.y, xz, z.y, z.z);
    (unit_field(at_mm), gradient)
}
