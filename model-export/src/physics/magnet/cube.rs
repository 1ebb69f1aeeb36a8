//! The field of a cube magnetised along an edge, and its gradient.
//!
//! With magnetic charges on two faces, the field is a sum of logarithms and angles over the eight
//! corners, and its gradient a sum of plain fractions.

use magba::fields::cuboid_B;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use super::{GAUSS_PER_TESLA, Magnetised};

/// Field in gauss for each tesla of remanence along `direction` at `at_mm`.
pub fn unit_field(side_mm: f64, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Vector3<f64> {
    let unit_field_t = cuboid_B(
        Point3::from(at_mm),
        Point3::origin(),
        UnitQuaternion::identity(),
        direction,
        Vector3::repeat(side_mm),
    );
    unit_field_t * GAUSS_PER_TESLA
}

/// `gradient[(i, j)]` = dB_i/dx_j in gauss per mm and tesla, outside the cube.
pub fn unit_gradient(side_mm: f64, magnetised: Magnetised, at_mm: Vector3<f64>) -> Matrix3<f64> {
    match magnetised {
        Magnetised::Axial => axial(side_mm, at_mm),
        // The cube is the same with x and z exchanged.
        Magnetised::Diametric => {
            let swap = |v: Vector3<f64>| Vector3::new(v.z, v.y, v.x);
            let swapped = axial(side_mm, swap(at_mm));
            Matrix3::from_fn(|i, j| swapped[(2 - i, 2 - j)])
        }
    }
}

fn axial(side_mm: f64, at_mm: Vector3<f64>) -> Matrix3<f64> {
    // In the octant of positive coordinates no term is close to a singularity but at the cube itself.
    let side = at_mm.map(|v| 1.0_f64.copysign(v));
    let at = at_mm.abs();
    let half = 0.5 * side_mm;
    let (mut xx, mut xy, mut xz, mut yy, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for corner in 0..8 {
        let [sx, sy, sz] = [0, 1, 2].map(|bit| if (corner >> bit) & 1 == 0 { 1.0 } else { -1.0 });
        let to = at - half * Vector3::new(sx, sy, sz);
        let r = to.norm();
        let share = sx * sy * sz / r;
        xx -= share * to.x / (r + to.y);
        xz -= share * to.z / (r + to.y);
        yy -= share * to.y / (r + to.x);
        yz -= share * to.z / (r + to.x);
        xy -= share;
    }
    let zz = -(xx + yy);
    let first = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    // The potential is even in x and y and odd in z, and each derivative turns that round.
    let scale = side.z * GAUSS_PER_TESLA / (4.0 * std::f64::consts::PI);
    Matrix3::from_fn(|i, j| first[(i, j)] * side[i] * side[j] * scale)
}
