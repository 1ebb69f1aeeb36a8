use approx::assert_abs_diff_eq;
use proptest::prelude::*;

use super::*;

/// The paper's shapes in a box of 2.5 mm, the tube's hole 1 mm wide.
const BODIES: [Body; 4] = [
    Body::Cylinder(BOXED),
    Body::Tube {
        outer: BOXED,
        hole_mm: 1.0,
    },
    Body::Cube { side_mm: 2.5 },
    Body::Sphere { diameter_mm: 2.5 },
];

const BOXED: Cylinder = Cylinder {
    diameter_mm: 2.5,
    length_mm: 2.5,
};

/// All of them, magnetised either way.
fn magnets() -> impl Iterator<Item = Magnet> {
    let both = [Magnetised::Axial, Magnetised::Diametric];
    BODIES
        .into_iter()
        .flat_map(move |body| both.map(|magnetised| Magnet { body, magnetised }))
}

proptest! {
    #[test]
    fn gradients_are_those_of_finer_differences(
        direction in proptest::array::uniform3(-1.0..1.0_f64), distance in 2.5..6.0_f64,
    ) {
        let direction = Vector3::from(direction);
        prop_assume!(direction.norm() > 0.1);
        let at = direction.normalize() * distance;
        for magnet in magnets() {
            let (field, gradient) = magnet.unit_field_and_gradient(at);
            prop_assert_eq!(field, magnet.unit_field(at));
            for axis in 0..3 {
                let plain = derivative(&magnet, at, axis);
                let difference = (plain - gradient.column(axis)).norm();
                prop_assert!(difference < 2e-6 * gradient.norm(), "{:?} {}: {}", magnet, axis, difference / gradient.norm());
            }
        }
    }

    #[test]
    fn a_static_field_has_neither_curl_nor_divergence(
        direction in proptest::array::uniform3(-1.0..1.0_f64), distance in 2.5..6.0_f64,
    ) {
        let direction = Vector3::from(direction);
        prop_assume!(direction.norm() > 0.1);
        let at = direction.normalize() * distance;
        for magnet in magnets() {
            let (_, gradient) = magnet.unit_field_and_gradient(at);
            let scale = gradient.norm();
            prop_assert!(gradient.trace().abs() < 1e-9 * scale);
            prop_assert!((gradient - gradient.transpose()).norm() < 1e-9 * scale);
        }
    }
}

/// Of fourth order, with steps that leave an error of some 1e-7 and no rounding to speak of.
fn derivative(magnet: &Magnet, at: Vector3<f64>, axis: usize) -> Vector3<f64> {
    let apart = |h: f64| {
        let mut step = Vector3::zeros();
        step[axis] = h;
        magnet.unit_field(at + step) - magnet.unit_field(at - step)
    };
    let h = 0.01;
    (8.0 * apart(h) - apart(2.0 * h)) / (12.0 * h)
}

#[test]
fn on_the_axis_a_cylinder_has_the_textbook_s_field() {
    // B = Br/2 [(z + L)/sqrt(R^2 + (z + L)^2) - z/sqrt(R^2 + z^2)], z from the face: 1.5 mm off the
    // nominal magnet 0.5 (3.5/3.808 - 1.5/2.121) of a tesla, 1060 G.
    let magnet = Magnet {
        body: Body::Cylinder(Cylinder {
            diameter_mm: 3.0,
            length_mm: 2.0,
        }),
        magnetised: Magnetised::Axial,
    };
    let field = magnet.unit_field(Vector3::new(0.0, 0.0, 2.5));
    assert_abs_diff_eq!(field.z, 1060.19, epsilon = 0.01);
}

#[test]
fn a_sphere_is_a_dipole_twice_as_strong_over_its_pole() {
    // 2/3 (R/r)^3 tesla over the pole, half of it and against it at the equator: R/r = 1/2.
    let magnet = Magnet {
        body: Body::Sphere { diameter_mm: 2.5 },
        magnetised: Magnetised::Axial,
    };
    let (pole, slope) = magnet.unit_field_and_gradient(Vector3::new(0.0, 0.0, 2.5));
    let equator = magnet.unit_field(Vector3::new(2.5, 0.0, 0.0));
    assert_abs_diff_eq!(pole.z, 1e4 / 12.0, epsilon = 1e-9);
    assert_abs_diff_eq!(equator.z, -1e4 / 24.0, epsilon = 1e-9);
    // The field falls with the third power: -3 B / r along the axis.
    assert_abs_diff_eq!(slope[(2, 2)], -1e3, epsilon = 1e-9);
}

#[test]
fn the_tube_lacks_what_its_hole_would_hold() {
    let [cylinder, tube, ..] = BODIES.map(|body| Magnet {
        body,
        magnetised: Magnetised::Axial,
    });
    let hole = Magnet {
        body: Body::Cylinder(Cylinder {
            diameter_mm: 1.0,
            length_mm: 2.5,
        }),
        ..cylinder
    };
    let at = Vector3::new(0.3, -0.2, 2.75);
    let sum = tube.unit_field(at) + hole.unit_field(at);
    assert_abs_diff_eq!(sum, cylinder.unit_field(at), epsilon = 1e-9);
    // A hole of 1 in 2.5 mm takes 16 % of the volume.
    assert_abs_diff_eq!(
        tube.volume_mm3() / cylinder.volume_mm3(),
        0.84,
        epsilon = 1e-12
    );
}

#[test]
fn from_afar_only_volume_and_remanence_count() {
    for magnet in magnets() {
        let at = Vector3::new(30.0, -20.0, 25.0);
        let r: f64 = at.norm();
        let moment = magnet.direction() * (magnet.volume_mm3() * GAUSS_PER_TESLA);
        let outward = at / r;
        let dipole = (outward * (3.0 * moment.dot(&outward)) - moment)
            / (4.0 * std::f64::consts::PI * r.powi(3));
        let difference = (magnet.unit_field(at) - dipole).norm() / dipole.norm();
        assert!(difference < 2e-3, "{magnet:?}: {difference}");
    }
}

#[test]
fn a_magnetised_along_x_is_the_same_cube_and_sphere_turned() {
    for body in [
        Body::Cube { side_mm: 2.5 },
        Body::Sphere { diameter_mm: 2.5 },
    ] {
        let of = |magnetised, at| Magnet { body, magnetised }.unit_field(at);
        let along = of(Magnetised::Axial, Vector3::new(0.4, 0.7, 2.6));
        let across = of(Magnetised::Diametric, Vector3::new(2.6, 0.7, 0.4));
        assert_abs_diff_eq!(
            along,
            Vector3::new(across.z, across.y, across.x),
            epsilon = 1e-9
        );
    }
}
