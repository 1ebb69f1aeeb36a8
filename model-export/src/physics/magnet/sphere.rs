//! The field of a sphere: outside it is that of a dipole at its centre, exactly.

use magba::fields::sphere_B;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use super::GAUSS_PER_TESLA;

/// Field in gauss for each tesla of remanence along `direction` at `at_mm`.
pub fn unit_field(diameter_mm: f64, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Vector3<f64> {
    let unit_field_t = sphere_B(
        Point3::from(at_mm),
        Point3::origin(),
        UnitQuaternion::identity(),
        direction,
        diameter_mm,
    );
    unit_field_t * GAUSS_PER_TESLA
}

/// `gradient[(i, j)]` = dB_i/dx_j in gauss per mm and tesla, outside the sphere.
pub fn unit_gradient(
    diameter_mm: f64,
    direction: Vector3<f64>,
    at_mm: Vector3<f64>,
) -> Matrix3<f64> {
    let r = at_mm.norm();
    let outward = at_mm / r;
    let along = direction.dot(&outward);
    let mixed = direction * outward.transpose();
    let moment = GAUSS_PER_TESLA * (0.5 * diameter_mm).powi(3) / 3.0;
    let gradient = mixed + mixed.transpose() + Matrix3::identity() * along
        - outward * outward.transpose() * (5.0 * along);
    gradient * (3.0 * moment / r.powi(4))
}
