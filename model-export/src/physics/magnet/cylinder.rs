//! The field of a cylinder, by complete elliptic integrals, and its gradient.
//!
//! A point dipole of the same moment is 36 % off at the nominal gap.

use magba::fields::cylinder_B;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use super::GAUSS_PER_TESLA;
use super::difference::DIFFERENCE_MM;

/// A cylinder; its axis is `z` of its own frame, its centre the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Diameter in mm.
    pub diameter_mm: f64,
    /// Length along the axis in mm.
    pub length_mm: f64,
}

impl Cylinder {
    /// Field in gauss for each tesla of remanence at `at_mm`, magnetised along its axis.
    pub fn unit_field(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        self.magnetised_along(Vector3::z(), at_mm)
    }

    /// The same, magnetised along `x`.
    pub fn diametric(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        self.magnetised_along(Vector3::x(), at_mm)
    }

    /// Right above the edge the formula's integrals have no value, though the field does: the field there is
    /// that of a place so little further in that no digit differs which matters.
    fn off_the_edge(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        const NEXT: f64 = 1e-12;
        let radius_mm = 0.5 * self.diameter_mm;
        let off_mm = at_mm.x.hypot(at_mm.y) - radius_mm;
        match off_mm.abs() < NEXT * radius_mm {
            true => Vector3::new(at_mm.x * (1.0 - NEXT), at_mm.y * (1.0 - NEXT), at_mm.z),
            false => at_mm,
        }
    }

    /// Volume in mm^3.
    pub fn volume_mm3(&self) -> f64 {
        0.25 * std::f64::consts::PI * self.diameter_mm.powi(2) * self.length_mm
    }

    #[inline]
    fn magnetised_along(&self, direction: Vector3<f64>, at_mm: Vector3<f64>) -> Vector3<f64> {
        // Lengths only enter as ratios, so millimetres do as well as metres.
        let unit_field_t = cylinder_B(
            Point3::from(self.off_the_edge(at_mm)),
            Point3::origin(),
            UnitQuaternion::identity(),
            direction,
            self.diameter_mm,
            self.length_mm,
        );
        unit_field_t * GAUSS_PER_TESLA
    }

    /// The field magnetised along its axis and its gradient, `gradient[(i, j)]` = dB_i/dx_j in gauss
    /// per mm and tesla.
    ///
    /// Outside the magnet a static field has neither curl nor divergence: its gradient is symmetric
    /// and its trace is zero. With the symmetry about the axis, the derivative along the axis alone
    /// determines it.
    pub fn unit_field_and_gradient(&self, at_mm: Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let field = self.unit_field(at_mm);
        let step = Vector3::z() * DIFFERENCE_MM;
        let along =
            (self.unit_field(at_mm + step) - self.unit_field(at_mm - step)) / (2.0 * DIFFERENCE_MM);
        let (x, y) = (at_mm.x, at_mm.y);
        let radius = x.hypot(y);
        let dbz_dz = along.z;
        if radius < 1e-9 {
            let across = -0.5 * dbz_dz;
            return (
                field,
                Matrix3::from_diagonal(&Vector3::new(across, across, dbz_dz)),
            );
        }
        let (cos, sin) = (x / radius, y / radius);
        // Radial field over radius is the derivative along the circle.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NOMINAL: Cylinder = Cylinder {
        diameter_mm: 3.0,
        length_mm: 2.0,
    };

    #[test]
    fn right_above_its_edge_the_field_is_that_of_both_sides() {
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
        fn the_gradient_from_symmetry_is_that_of_plain_differences(
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
    fn on_the_axis_the_gradient_has_no_trace_and_no_direction() {
        let (_, gradient) = NOMINAL.unit_field_and_gradient(Vector3::new(0.0, 0.0, 2.5));
        assert!(gradient.trace().abs() < 1e-9);
        assert_eq!(gradient[(0, 0)], gradient[(1, 1)]);
    }
}
