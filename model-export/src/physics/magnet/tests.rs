use approx::assert_abs_diff_eq;
use proptest::prelude::*;

use super::*;

/// The paper's shapes with a bounding box of 2.5 mm; hole of the tube 1 mm.
const BODIES: [MagnetBody; 4] = [
    MagnetBody::Cylinder(BOXED),
    MagnetBody::Tube { outer: BOXED, hole_mm: 1.0 },
    MagnetBody::Cube { side_mm: 2.5 },
    MagnetBody::Sphere { diameter_mm: 2.5 },
];

const BOXED: Cylinder = Cylinder { diameter_mm: 2.5, length_mm: 2.5 };

/// All shapes with both magnetisations.
fn magnets() -> impl Iterator<Item = Magnet> {
    let both = [Magnetisation::Axial, Magnetisation::Diametric];
    BODIES.into_iter().flat_map(move |body| both.map(|magnetised| Magnet { body, magnetised }))
}

proptest! {
    #[test]
    fn gradients_match_differences_and_are_traceless(
        direction in proptest::array::uniform3(-1.0..1.0_f64), distance in 2.5..6.0_f64,
    ) {
        let direction = Vector3::from(direction);
        prop_assume!(direction.norm() > 0.1);
        let at = direction.normalize() * distance;
        for magnet in magnets() {
            let (field, gradient) = magnet.unit_field_and_gradient(at);
            prop_assert_eq!(field, magnet.unit_field(at));
            let scale = gradient.norm();
            prop_assert!(gradient.trace().abs() < 1e-9 * scale);
            prop_assert!((gradient - gradient.transpose()).norm() < 1e-9 * scale);
            for axis in 0..3 {
                let plain = derivative(&magnet, at, axis);
                let difference = (plain - gradient.column(axis)).norm();
                prop_assert!(difference < 2e-6 * scale, "{:?} {}: {}", magnet, axis, difference / scale);
            }
        }
    }
}

/// Fourth-order central difference, relative error about 1e-7.
fn derivative(magnet: &Magnet, at: Vector3<f64>, axis: usize) -> Vector3<f64> {
    let difference = |h: f64| {
        let mut step = Vector3::zeros();
        step[axis] = h;
        magnet.unit_field(at + step) - magnet.unit_field(at - step)
    };
    let h = 0.01;
    (8.0 * difference(h) - difference(2.0 * h)) / (12.0 * h)
}

#[test]
fn sphere_field_is_that_of_a_dipole() {
    // 2/3 (R/r)^3 tesla above the pole, minus half of it at the equator; R/r = 1/2.
    let magnet =
        Magnet { body: MagnetBody::Sphere { diameter_mm: 2.5 }, magnetised: Magnetisation::Axial };
    let (pole, slope) = magnet.unit_field_and_gradient(Vector3::new(0.0, 0.0, 2.5));
    let equator = magnet.unit_field(Vector3::new(2.5, 0.0, 0.0));
    assert_abs_diff_eq!(pole.z, 1e4 / 12.0, epsilon = 1e-9);
    assert_abs_diff_eq!(equator.z, -1e4 / 24.0, epsilon = 1e-9);
    // B ~ r^-3: dB/dr = -3 B / r on the axis.
    assert_abs_diff_eq!(slope[(2, 2)], -1e3, epsilon = 1e-9);
}

#[test]
fn tube_plus_hole_equals_cylinder() {
    let [cylinder, tube, ..] = BODIES.map(|body| Magnet { body, magnetised: Magnetisation::Axial });
    let hole = Magnet {
        body: MagnetBody::Cylinder(Cylinder { diameter_mm: 1.0, length_mm: 2.5 }),
        ..cylinder
    };
    let at = Vector3::new(0.3, -0.2, 2.75);
    let sum = tube.unit_field(at) + hole.unit_field(at);
    assert_abs_diff_eq!(sum, cylinder.unit_field(at), epsilon = 1e-9);
}

fn volume_mm3(magnet: &Magnet) -> f64 {
    use std::f64::consts::PI;
    let of_cylinder = 0.25 * PI * 2.5_f64.powi(3);
    match magnet.body {
        MagnetBody::Cylinder(_) => of_cylinder,
        // The hole has (1 / 2.5)^2 of it.
        MagnetBody::Tube { .. } => 0.84 * of_cylinder,
        MagnetBody::Cube { side_mm } => side_mm.powi(3),
        MagnetBody::Sphere { diameter_mm } => PI / 6.0 * diameter_mm.powi(3),
    }
}

#[test]
fn far_field_is_that_of_a_dipole() {
    for magnet in magnets() {
        let at = Vector3::new(30.0, -20.0, 25.0);
        let r: f64 = at.norm();
        let moment = magnet.direction() * (volume_mm3(&magnet) * GAUSS_PER_TESLA);
        let outward = at / r;
        let dipole = (outward * (3.0 * moment.dot(&outward)) - moment)
            / (4.0 * std::f64::consts::PI * r.powi(3));
        let difference = (magnet.unit_field(at) - dipole).norm() / dipole.norm();
        assert!(difference < 2e-3, "{magnet:?}: {difference}");
    }
}

#[test]
fn diametric_cube_and_sphere_are_rotated_axial_ones() {
    for body in [MagnetBody::Cube { side_mm: 2.5 }, MagnetBody::Sphere { diameter_mm: 2.5 }] {
        let of = |magnetised, at| Magnet { body, magnetised }.unit_field(at);
        let along = of(Magnetisation::Axial, Vector3::new(0.4, 0.7, 2.6));
        let across = of(Magnetisation::Diametric, Vector3::new(2.6, 0.7, 0.4));
        assert_abs_diff_eq!(along, Vector3::new(across.z, across.y, across.x), epsilon = 1e-9);
    }
}
