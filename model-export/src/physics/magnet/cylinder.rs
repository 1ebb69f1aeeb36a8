//! Field of a cylinder (complete elliptic integrals) and its gradient.
//!
//! The error of a point dipole of the same moment is 36 % at the nominal gap.

use magba::base::Float;
use magba::fields::{circular_B, cylinder_B};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use crate::physics::magnet::GAUSS_PER_TESLA;

/// A cylinder with axis `z`, centred at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Diameter in mm.
    pub diameter_mm: f64,
    /// Length along the axis in mm.
    pub length_mm: f64,
}

impl Cylinder {
    /// Field at `at_mm` in gauss per tesla of remanence, magnetised along the axis.
    pub fn unit_field(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        self.magnetised_along(Vector3::z(), at_mm)
    }

    /// Field at `at_mm` in gauss per tesla of remanence, magnetised along `x`.
    pub fn diametric(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        self.magnetised_along(Vector3::x(), at_mm)
    }

    /// At the radius of the edge the elliptic integrals are singular, although the field is not: moves the
    /// point inwards by 1e-12 of the radius.
    fn avoid_edge(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        const OFFSET: f64 = 1e-12;
        let radius_mm = 0.5 * self.diameter_mm;
        let distance_mm = radius(&at_mm) - radius_mm;
        if distance_mm.abs() < OFFSET * radius_mm {
            Vector3::new(at_mm.x * (1.0 - OFFSET), at_mm.y * (1.0 - OFFSET), at_mm.z)
        } else {
            at_mm
        }
    }

    /// Volume in mm^3.
    pub fn volume_mm3(&self) -> f64 {
        0.25 * std::f64::consts::PI * self.diameter_mm.powi(2) * self.length_mm
    }

    #[inline]
    fn magnetised_along(&self, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Vector3<f64> {
        // Only ratios of lengths enter, so millimetres are equivalent to metres.
        let unit_field_t = cylinder_B(
            Point3::from(self.avoid_edge(at_mm)),
            Point3::origin(),
            UnitQuaternion::identity(),
            direction,
            self.diameter_mm,
            self.length_mm,
        );
        unit_field_t * GAUSS_PER_TESLA
    }

    /// Derivative of [`Cylinder::unit_field`] along the axis, per mm. A magnetised cylinder is a stack of current loops: a shift of it
    /// along the axis adds one at one end and removes one at the other.
    fn axial_derivative(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        let end = Vector3::z() * (0.5 * self.length_mm);
        let field_t = |at: Vector3<f64>| {
            circular_B(
                Point3::from(at),
                Point3::origin(),
                UnitQuaternion::identity(),
                self.diameter_mm,
                // One tesla of remanence is a sheet current of 1/mu0 amperes per metre.
                f64::recip_mu0(),
            )
        };
        (field_t(at_mm + end) - field_t(at_mm - end)) * GAUSS_PER_TESLA
    }

    /// Field with axial magnetisation, and gradient `gradient[(i, j)]` = dB_i/dx_j in gauss per mm and tesla.
    ///
    /// Outside the magnet the gradient is symmetric and traceless (curl B = 0, div B = 0). With the
    /// axial symmetry, the derivative along the axis determines it.
    pub fn unit_field_and_gradient(&self, at_mm: Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let field = self.unit_field(at_mm);
        let along = self.axial_derivative(at_mm);
        let (x, y) = (at_mm.x, at_mm.y);
        let radius = radius(&at_mm);
        let dbz_dz = along.z;
        if radius < 1e-9 {
            let across = -0.5 * dbz_dz;
            return (field, Matrix3::from_diagonal(&Vector3::new(across, across, dbz_dz)));
        }
        let (cos, sin) = (x / radius, y / radius);
        // The derivative along the circle is the radial field divided by the radius.
        let around = (field.x * cos + field.y * sin) / radius;
        let outward = -around - dbz_dz;
        let mixed = (outward - around) * cos * sin;
        let gradient = Matrix3::new(
            outward * cos * cos + around * sin * sin,
            mixed,
            along.x,
            mixed,
            outward * sin * sin + around * cos * cos,
            along.y,
            along.x,
            along.y,
            dbz_dz,
        );
        (field, gradient)
    }
}

/// Distance from the axis. (`hypot` is not the same on every system, and takes longer.)
fn radius(at: &Vector3<f64>) -> f64 {
    (at.x * at.x + at.y * at.y).sqrt()
}

/// Step of the central differences in mm. At 2 mm from the nearest edge the relative error is of the order of
/// (1e-3 / 2)^2; rounding errors are smaller.
const DIFFERENCE_MM: f64 = 1e-3;

/// The field and its gradient per mm. The gradient is symmetric and traceless, so the derivatives along two
/// axes determine it; the redundant element is averaged.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NOMINAL: Cylinder = Cylinder { diameter_mm: 3.0, length_mm: 2.0 };

    #[test]
    fn field_is_continuous_across_the_edge_radius() {
        for direction in [0.0, 0.3, 1.2_f64] {
            let at = |radius_mm: f64| {
                let (sin, cos) = direction.sin_cos();
                Vector3::new(radius_mm * cos, radius_mm * sin, 2.5)
            };
            let fields = |of: fn(&Cylinder, Vector3<f64>) -> Vector3<f64>| {
                [1.5 - 1e-6, 1.5, 1.5 + 1e-6].map(|radius_mm| of(&NOMINAL, at(radius_mm)))
            };
            for [inside, above, outside] in
                [fields(Cylinder::unit_field), fields(Cylinder::diametric)]
            {
                let middle = (inside + outside) * 0.5;
                assert!((above - middle).norm() < 1e-6 * middle.norm(), "{above}");
            }
        }
    }

    proptest! {
        #[test]
        fn gradient_by_symmetry_matches_central_differences(
            x in -1.5..1.5_f64, y in -1.5..1.5_f64, z in 2.0..4.0_f64,
        ) {
            let at = Vector3::new(x, y, z);
            let (_, gradient) = NOMINAL.unit_field_and_gradient(at);
            let scale = gradient.amax();
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-3;
                let plain = (NOMINAL.unit_field(at + step) - NOMINAL.unit_field(at - step)) / 2e-3;
                let difference = (plain - gradient.column(axis)).amax();
                prop_assert!(difference < 1e-5 * scale, "axis {axis}: {difference} of {scale}");
            }
        }
    }

    #[test]
    fn gradient_on_the_axis_is_traceless_and_isotropic() {
        let (_, gradient) = NOMINAL.unit_field_and_gradient(Vector3::new(0.0, 0.0, 2.5));
        assert!(gradient.trace().abs() < 1e-9);
        assert_eq!(gradient[(0, 0)], gradient[(1, 1)]);
    }
}
