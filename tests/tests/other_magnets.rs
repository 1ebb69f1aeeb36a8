//! The device's tables of other magnets, other flexures, other ranges of force.

use firmware::params;
use model_export::inverse::at_rest::AtRest;
use model_export::inverse::search::choose;
use model_export::physics::ForwardModel;
use model_export::recordings::description::{Design, Magnet, MagnetAxis, Shape};

/// A magnet that is magnetised across the gap, on flexures of this stiffness in N/mm, for forces up to so
/// many N.
fn design(shape: Shape, body_axis: Option<MagnetAxis>, stiffness: f64, range_n: f64) -> Design {
    Design {
        magnet: Magnet {
            shape,
            remanence_t: 1.2,
            axis: MagnetAxis::Y,
            body_axis,
        },
        stiffness_x_n_per_mm: stiffness,
        stiffness_z_n_per_mm: 1.5 * stiffness,
        force_range_n: Some(range_n),
        ..Design::magpie()
    }
}

#[test]
fn cube_sphere_and_lying_tube_are_inverted_to_below_the_noise_of_a_reading_at_8_40_and_800_newtons()
{
    let tube = Shape::Tube {
        diameter_mm: 3.0,
        hole_mm: 1.0,
        length_mm: 4.0,
    };
    let designs = [
        design(Shape::Sphere { diameter_mm: 3.0 }, None, 20.0, 8.0),
        design(Shape::Cube { side_mm: 2.5 }, None, 100.0, 40.0),
        design(tube, Some(MagnetAxis::Z), 2000.0, 800.0),
    ];
    for design in designs {
        let model = ForwardModel::nominal(&design);
        let slopes = model.per_newton(&model.respond(nalgebra::Vector3::zeros()));
        let noise_n = slopes.map(|slope| params::SENSOR_NOISE.value / slope.norm());
        let (scale, range) = (params::SENSOR_SCALE.value, params::SENSOR_RANGE.value);
        let chosen = choose(&[AtRest::plain(model)], &[2], 7, scale, range).unwrap();
        let errors = chosen.errors[0];
        for (axis, noise_n) in noise_n.into_iter().enumerate() {
            let (inverse, fixed) = (errors.model.0[axis], errors.fixed.0[axis]);
            assert!(inverse < 0.5 * noise_n, "{inverse} {noise_n} {design:?}");
            assert!(fixed < 0.2 * noise_n, "{fixed} {noise_n} {design:?}");
            // Where no model were needed, none would be tested.
            assert!(errors.linear.0[axis] > 2.0 * inverse, "{errors:?}");
        }
    }
}
