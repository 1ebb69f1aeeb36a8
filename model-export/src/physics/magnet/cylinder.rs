//! Field of a cylinder (complete elliptic integrals) and its gradient.
//!
//! The error of a point dipole of the same moment is 36 % at the nominal gap.
//!
//! Magnetised along its axis it has the field of a solenoid (Derby and Olbert, "Cylindrical magnets and ideal solenoids", American
//! Journal of Physics 78, 2010), evaluated here so that the elliptic integrals of field and gradient are the same, and few digits are
//! lost near the axis, near the edges and in the gradient far away. The field itself far away is the difference of the two ends: its
//! relative error grows from 1e-14 within two radii from the centre to 1e-10 at thirty (compared with 40 digits).
//!
//! The loop over the points of a block has no branches, and the compiler vectorises it. Only sums, products, quotients and square
//! roots enter, which are rounded alike on every processor: results are the same bits everywhere, whichever points share a block.

#![allow(unsafe_code)] // Instructions that not every processor has.

use std::f64::consts::{FRAC_1_PI, FRAC_PI_2};

use magba::fields::cylinder_B;
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

/// Points in a block.
const BLOCK: usize = 16;

/// Landen transformations of an elliptic integral. The relative error of the arithmetic-geometric mean after `n` of them is
/// (c_n / a_n)^2 / 4 (Digital Library of Mathematical Functions, 19.8): after five 2e-16 at [`LEAST_MODULUS`].
const STEPS: usize = 5;
/// The same near the edge of an end, down to a modulus of 1e-13.
const STEPS_AT_EDGE: usize = 10;
/// Complementary modulus below which [`STEPS_AT_EDGE`] are taken: within about an eighth of the radius from the edge.
const LEAST_MODULUS: f64 = 0.0625;

impl Cylinder {
    /// Field at `at_mm` in gauss per tesla of remanence, magnetised along the axis.
    pub fn unit_field(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        let [[x], [y], [z]] = self.block(&[[at_mm.x], [at_mm.y], [at_mm.z]]);
        Vector3::new(x, y, z)
    }

    /// Field with axial magnetisation, and gradient `gradient[(i, j)]` = dB_i/dx_j in gauss per mm and tesla.
    ///
    /// Outside the magnet the gradient is symmetric and traceless (curl B = 0, div B = 0). With the
    /// axial symmetry, the derivative along the axis determines it.
    pub fn unit_field_and_gradient(&self, at_mm: Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let found = self.block(&[[at_mm.x], [at_mm.y], [at_mm.z]]);
        field_and_gradient_of(found.map(|[value]| value))
    }

    /// [`Cylinder::unit_field`] at many points.
    pub fn unit_fields(&self, at_mm: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        self.in_blocks(at_mm, |[x, y, z]| Vector3::new(x, y, z))
    }

    /// [`Cylinder::unit_field_and_gradient`] at many points.
    pub(crate) fn unit_fields_and_gradients(
        &self,
        at_mm: &[Vector3<f64>],
    ) -> Vec<(Vector3<f64>, Matrix3<f64>)> {
        self.in_blocks(at_mm, field_and_gradient_of)
    }

    /// Field at `at_mm` in gauss per tesla of remanence, magnetised along `x`.
    pub(crate) fn diametric(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        // Only ratios of lengths enter, so millimetres are equivalent to metres.
        let unit_field_t = cylinder_B(
            Point3::from(self.avoid_edge(at_mm)),
            Point3::origin(),
            UnitQuaternion::identity(),
            Vector3::x(),
            self.diameter_mm,
            self.length_mm,
        );
        unit_field_t * GAUSS_PER_TESLA
    }

    /// The point moved off the radius of the edge ([`off_edge`]).
    fn avoid_edge(&self, at_mm: Vector3<f64>) -> Vector3<f64> {
        let inwards = off_edge(radius(at_mm.x, at_mm.y), 0.5 * self.diameter_mm);
        Vector3::new(at_mm.x * inwards, at_mm.y * inwards, at_mm.z)
    }

    /// `of` the values of each point, in blocks.
    fn in_blocks<const VALUES: usize, T>(
        &self,
        at_mm: &[Vector3<f64>],
        of: impl Fn([f64; VALUES]) -> T,
    ) -> Vec<T> {
        let mut all = Vec::with_capacity(at_mm.len());
        let mut block_mm = [[0.0; BLOCK]; 3];
        for points_mm in at_mm.chunks(BLOCK) {
            for (place, point_mm) in points_mm.iter().enumerate() {
                (0..3).for_each(|axis| block_mm[axis][place] = point_mm[axis]);
            }
            let found: [_; VALUES] = self.block(&block_mm);
            let at = |place: usize| std::array::from_fn(|value| found[value][place]);
            all.extend((0..points_mm.len()).map(|place| of(at(place))));
        }
        all
    }

    /// The first of the values at each point ([`Cylinder::values`]), with the instructions of this processor.
    fn block<const POINTS: usize, const VALUES: usize>(
        &self,
        at_mm: &[[f64; POINTS]; 3],
    ) -> [[f64; POINTS]; VALUES] {
        #[cfg(target_arch = "x86_64")]
        if POINTS > 1 && std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has these instructions.
            return unsafe { self.block_avx2(at_mm) };
        }
        self.block_of(at_mm)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn block_avx2<const POINTS: usize, const VALUES: usize>(
        &self,
        at_mm: &[[f64; POINTS]; 3],
    ) -> [[f64; POINTS]; VALUES] {
        self.block_of(at_mm)
    }

    #[inline(always)]
    fn block_of<const POINTS: usize, const VALUES: usize>(
        &self,
        [x, y, z]: &[[f64; POINTS]; 3],
    ) -> [[f64; POINTS]; VALUES] {
        let mut found = [[0.0; POINTS]; VALUES];
        let mut moduli = [0.0; POINTS];
        for i in 0..POINTS {
            let (values, modulus) = self.values::<STEPS>(x[i], y[i], z[i]);
            (0..VALUES).for_each(|value| found[value][i] = values[value]);
            moduli[i] = modulus;
        }
        for i in (0..POINTS).filter(|&i| moduli[i] < LEAST_MODULUS) {
            let (values, _) = self.values::<STEPS_AT_EDGE>(x[i], y[i], z[i]);
            (0..VALUES).for_each(|value| found[value][i] = values[value]);
        }
        found
    }

    /// Field and gradient in the order of [`field_and_gradient_of`], and the smaller complementary modulus of both ends.
    #[inline(always)]
    fn values<const STEPS: usize>(&self, x_mm: f64, y_mm: f64, z_mm: f64) -> ([f64; 9], f64) {
        let (radius_mm, half_length_mm) = (0.5 * self.diameter_mm, 0.5 * self.length_mm);
        let r_mm = radius(x_mm, y_mm);
        let r_mm = r_mm * off_edge(r_mm, radius_mm);
        let upper = EndField::at::<STEPS>(radius_mm, r_mm, z_mm + half_length_mm);
        let lower = EndField::at::<STEPS>(radius_mm, r_mm, z_mm - half_length_mm);
        let radial = (upper.radial - lower.radial) * GAUSS_PER_TESLA;
        let axial = (upper.axial - lower.axial) * GAUSS_PER_TESLA;
        let mixed = (upper.radial_slope - lower.radial_slope) * GAUSS_PER_TESLA;
        let along = (upper.axial_slope - lower.axial_slope) * GAUSS_PER_TESLA;
        // The derivative along the circle is the radial field divided by the radius; the divergence is zero.
        let outward = -radial - along;
        // At the axis the difference vanishes with the square of the radius.
        let curved = (outward - radial) / (r_mm * r_mm).max(f64::MIN_POSITIVE);
        let values = [
            radial * x_mm,
            radial * y_mm,
            axial,
            radial + curved * x_mm * x_mm,
            radial + curved * y_mm * y_mm,
            along,
            curved * x_mm * y_mm,
            mixed * x_mm,
            mixed * y_mm,
        ];
        (values, upper.modulus.min(lower.modulus))
    }
}

/// Field and gradient of its three components and the gradient's xx, yy, zz, xy, xz and yz.
fn field_and_gradient_of(values: [f64; 9]) -> (Vector3<f64>, Matrix3<f64>) {
    let [x, y, z, xx, yy, zz, xy, xz, yz] = values;
    (Vector3::new(x, y, z), Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}

/// Share of one end in the field, in tesla per tesla of remanence: the share of the lower end is subtracted from that of the upper
/// one.
struct EndField {
    /// Radial field divided by the distance from the axis, per mm.
    radial: f64,
    axial: f64,
    /// Derivatives along the axis, per mm: a shift of the cylinder adds a current loop at one end and removes one at the other.
    radial_slope: f64,
    axial_slope: f64,
    /// Complementary modulus of the elliptic integrals.
    modulus: f64,
}

impl EndField {
    /// Of a cylinder of `radius`, at the distance `r` from the axis and `h` above the plane of the end, all in mm.
    #[inline(always)]
    fn at<const STEPS: usize>(radius: f64, r: f64, h: f64) -> Self {
        let (plus, minus) = (radius + r, radius - r);
        // Squared distances from the far and the near point of the edge.
        let (far2, near2) = (h * h + plus * plus, h * h + minus * minus);
        let per_far = 1.0 / far2.sqrt();
        let per_far2 = per_far * per_far;
        let modulus = near2.sqrt() * per_far;
        let k2 = 4.0 * radius * r * per_far2;
        // Bulirsch's integral cel(kc, gamma^2, 1, gamma) by Landen transformations (Numerische Mathematik 13, 1969); `cos` and `sin`
        // are the factors of the squares of both in its numerator. The means are not halved: `m` is 2^n times the arithmetic mean, `g`
        // 2^n times the geometric one. `sum` is that of 2^(n-1) c_n^2 / k^4, where c_n is half the difference of the means before
        // step n: K - E = K (k^2/2 + k^4 sum), and with it what remains of B_r and of the loop's field as k vanishes at the axis.
        let gamma = minus / plus;
        let (mut m, mut g, mut product) = (1.0, modulus, modulus);
        let (mut cos, mut sin, mut p) = (1.0, 1.0_f64.copysign(gamma), gamma.abs());
        let (mut difference, mut sum, mut power) = (0.5, 0.0, 1.0);
        for step in 0..STEPS {
            let per_p = 1.0 / p;
            let before = cos;
            let q = product * per_p;
            cos += sin * per_p;
            sin = 2.0 * (sin + before * q);
            p += q;
            m += g;
            let c = difference / m;
            let term = power * c * c;
            sum += term;
            difference = k2 * term;
            power *= 2.0;
            if step + 1 < STEPS {
                g = 2.0 * product.sqrt();
                product = g * m;
            }
        }
        let k = FRAC_PI_2 * power / m;
        let third_kind = FRAC_PI_2 * (sin + cos * m) / (m * (m + p));
        let of_loop = FRAC_1_PI * radius * radius * k * per_far * per_far2;
        let of_loop_at_edge = of_loop / near2;
        let share = (plus * minus - h * h) * per_far2;
        Self {
            radial: -8.0 * of_loop * sum,
            axial: FRAC_1_PI * radius * h * third_kind * per_far / plus,
            radial_slope: 2.0 * of_loop_at_edge * h * (1.0 - 2.0 * (1.0 + modulus * modulus) * sum),
            axial_slope: of_loop_at_edge * (plus * minus + h * h - 8.0 * share * r * r * sum),
            modulus,
        }
    }
}

/// Distance from the axis. (`hypot` is not the same on every system, and takes longer.)
#[inline(always)]
fn radius(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

/// At the radius of the edge the elliptic integrals are singular, although the field is not: factor by which a point at the
/// distance `r_mm` from the axis is moved inwards.
#[inline(always)]
fn off_edge(r_mm: f64, radius_mm: f64) -> f64 {
    const OFFSET: f64 = 1e-12;
    if (r_mm - radius_mm).abs() < OFFSET * radius_mm { 1.0 - OFFSET } else { 1.0 }
}

/// Step of the central differences in mm. At 2 mm from the nearest edge the relative error is of the order of
/// (1e-3 / 2)^2; rounding errors are smaller.
const DIFFERENCE_MM: f64 = 1e-3;

/// The field and its gradient per mm. The gradient is symmetric and traceless, so the derivatives along two
/// axes determine it; the redundant element is averaged.
pub(crate) fn field_and_gradient(
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
    use magba::base::Float;
    use magba::fields::circular_B;
    use proptest::prelude::*;

    const NOMINAL: Cylinder = Cylinder { diameter_mm: 3.0, length_mm: 2.0 };

    #[test]
    fn field_and_gradient_match_integrals_of_forty_digits() {
        // x and z in mm; Bx and Bz in gauss, and their derivatives along z in G/mm: near the edges, near the axis, far away, inside.
        let references = [
            (
                [1.5 + 2_f64.powi(-30), 1.0 + 2_f64.powi(-30)],
                [32919.85082135348, 572.3244350080221, -854456593861.5259, 854456582930.6514],
            ),
            (
                [1.5 - 2_f64.powi(-20), 2_f64.powi(-12) - 1.0],
                [-13614.1438627398, 6817.418172550818, 6519232.270813544, 30303.77308112703],
            ),
            (
                [2_f64.powi(-30), 2.5],
                [4.539079687760803e-7, 1060.191244157552, -4.800815194545683e-7, -974.759940643527],
            ),
            (
                [40.0, 30.0],
                [
                    0.1296142964332542,
                    0.007240370327158556,
                    -0.003459916134813346,
                    0.003886494566748435,
                ],
            ),
            (
                [0.5, 0.25],
                [227.5237533120688, 5654.60879861522, 891.8422572018541, -943.1344022449356],
            ),
        ];
        for ([x, z], [bx, bz, bx_dz, bz_dz]) in references {
            let (field, gradient) = NOMINAL.unit_field_and_gradient(Vector3::new(x, 0.0, z));
            let found = [field.x, field.z, gradient[(0, 2)], gradient[(2, 2)]];
            for (found, expected) in found.into_iter().zip([bx, bz, bx_dz, bz_dz]) {
                assert!((found - expected).abs() < 1e-10 * expected.abs(), "{found} {expected}");
            }
        }
    }

    /// Points in mm around and inside the nominal magnet, up to 30 radii away, some of them near the axis or an edge.
    fn points() -> impl Strategy<Value = Vec<Vector3<f64>>> {
        let near = || prop_oneof![Just(0.0), (-5.0..0.0_f64).prop_map(libm::exp10)];
        let anywhere = (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64, 0.0..30.0_f64)
            .prop_map(|(x, y, z, radii)| Vector3::new(x, y, z) * 1.5 * radii);
        let at_axis = (near(), -9.0..9.0_f64).prop_map(|(x, z)| Vector3::new(x, -x, z));
        let at_edge = (near(), near(), prop_oneof![Just(-1.0), Just(1.0)], 0.0..6.3_f64).prop_map(
            |(out, up, side, angle)| {
                let r = 1.5 + side * out;
                Vector3::new(r * libm::cos(angle), r * libm::sin(angle), side * (1.0 + up) + 1e-6)
            },
        );
        proptest::collection::vec(prop_oneof![anywhere, at_axis, at_edge], 1..50)
    }

    proptest! {
        #[test]
        fn field_and_slope_match_the_crate_magba(points in points()) {
            let tesla = |at: Vector3<f64>| {
                let (origin, upright) = (Point3::origin(), UnitQuaternion::identity());
                let half = Vector3::z() * (0.5 * NOMINAL.length_mm);
                // One tesla of remanence is a sheet current of 1/mu0 amperes per metre.
                let current_loop = |at: Vector3<f64>| {
                    circular_B(at.into(), origin, upright, NOMINAL.diameter_mm, f64::recip_mu0())
                };
                let (diameter, length) = (NOMINAL.diameter_mm, NOMINAL.length_mm);
                let field = cylinder_B(at.into(), origin, upright, Vector3::z(), diameter, length);
                (field, current_loop(at + half) - current_loop(at - half))
            };
            for at in points {
                let (field, gradient) = NOMINAL.unit_field_and_gradient(at);
                let (expected, slope) = tesla(NOMINAL.avoid_edge(at));
                let error = (field / GAUSS_PER_TESLA - expected).norm() / expected.norm();
                let slope_error = (gradient.column(2) / GAUSS_PER_TESLA - slope).norm() / slope.norm();
                prop_assert!(error < 1e-9 && slope_error < 1e-9, "{at}: {error:e} {slope_error:e}");
            }
        }

        #[test]
        fn points_of_a_block_have_the_bits_of_single_points(points in points()) {
            let fields = NOMINAL.unit_fields(&points);
            let with_gradients = NOMINAL.unit_fields_and_gradients(&points);
            for ((at, field), with_gradient) in points.iter().zip(fields).zip(with_gradients) {
                prop_assert_eq!(NOMINAL.unit_field_and_gradient(*at), with_gradient);
                prop_assert_eq!(NOMINAL.unit_field(*at), with_gradient.0);
                prop_assert_eq!(field, with_gradient.0);
            }
        }
    }

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

    #[test]
    fn gradient_on_the_axis_is_traceless_and_isotropic() {
        let (_, gradient) = NOMINAL.unit_field_and_gradient(Vector3::new(0.0, 0.0, 2.5));
        assert!(gradient.trace().abs() < 1e-9);
        assert_eq!(gradient[(0, 0)], gradient[(1, 1)]);
    }
}
