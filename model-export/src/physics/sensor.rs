//! One finger's sensor: two flexures move a magnet in front of a Hall element.
//!
//! Frame of the gripper, origin at the Hall element: `x` lateral (grasping), `z` longitudinal
//! (ground reaction), `y` from the element to the magnet. A positive force moves the magnet along
//! its positive axis, so Bx follows Fx, Bz follows Fz, and By is of second order in both.

use nalgebra::{Rotation3, Vector3};

use super::magnet::{Magnet, Magnetised};
use super::response::{Response, read};
use super::state::State;
use crate::recordings::description::{Design, MagnetAxis};

/// Weight of the gap axis where a field is turned into forces, against 1 for each axis in the plane of
/// motion: temperature, a changed gap and a neighbour's magnet show there first.
pub const GAP_WEIGHT: f64 = 0.01;

/// The forward model of one sensor, geometry and flexures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForwardModel {
    /// The magnet.
    pub magnet: Magnet,
    /// The sensor's axis along which the magnet is magnetised.
    pub axis: MagnetAxis,
    /// Where the axis of its body lies; asked only of a magnet that is magnetised across it.
    pub body_axis: MagnetAxis,
    /// Remanence in T; negative where the magnet is mounted the other way round.
    pub remanence_t: f64,
    /// Face of the magnet to the Hall element at rest, in mm.
    pub gap_mm: f64,
    /// Lateral and longitudinal stiffness in N/mm.
    pub stiffness_n_per_mm: [f64; 2],
    /// Misalignment of the magnet in the plane of motion, x and z, in mm.
    pub offset_mm: [f64; 2],
    /// Tilt of the magnet's axis, a rotation vector about the gripper's x and z, in rad. (A tilt of
    /// a lying magnet about y is not modelled.)
    pub tilt_rad: [f64; 2],
    /// Orientation of the Hall element against the gripper: a rotation vector in rad.
    pub rotation_rad: Vector3<f64>,
    /// Constant field in gauss, sensor's axes: its own offset and whatever stands outside.
    pub bias_g: Vector3<f64>,
    /// Force that each axis is designed for, either way, in newtons: what an inverse covers.
    pub force_range_n: f64,
}

/// The rotations of a [`ForwardModel`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// From the magnet's frame (its body's axis is z) to the gripper's.
    pub magnet: Rotation3<f64>,
    /// From the gripper's frame to the sensor's.
    pub element: Rotation3<f64>,
    /// How the magnet turns about the gripper's axes for each rad of lean about x and z.
    pub lean: [Vector3<f64>; 2],
}

impl ForwardModel {
    /// The nominal design, perfectly made.
    pub fn nominal(design: &Design) -> Self {
        Self {
            magnet: Magnet::of(&design.magnet),
            axis: design.magnet.axis,
            body_axis: design.magnet.body_axis.unwrap_or(design.magnet.axis),
            remanence_t: design.magnet.remanence_t,
            gap_mm: design.gap_mm,
            stiffness_n_per_mm: [design.stiffness_x_n_per_mm, design.stiffness_z_n_per_mm],
            offset_mm: [0.0; 2],
            tilt_rad: [0.0; 2],
            rotation_rad: Vector3::zeros(),
            bias_g: Vector3::zeros(),
            force_range_n: design.force_range_n(),
        }
    }

    /// Displacement of the magnet in mm under the forces `[Fx, Fz]` in N.
    pub fn displacement(&self, force_n: [f64; 2]) -> Vector3<f64> {
        let [kx, kz] = self.stiffness_n_per_mm;
        Vector3::new(force_n[0] / kx, 0.0, force_n[1] / kz)
    }

    /// Field in gauss under the forces `[Fx, Fz]` in N.
    pub fn field(&self, force_n: [f64; 2]) -> Vector3<f64> {
        self.field_in(
            &self.frames(),
            &State::displaced(self.displacement(force_n)),
        )
    }

    /// Field in gauss at any state.
    pub fn field_in(&self, frames: &Frames, state: &State) -> Vector3<f64> {
        let turn = self.turned(frames, state);
        let unit_g = turn * self.magnet.unit_field(turn.inverse() * self.element(state));
        let at_element = frames.element * (unit_g * self.strength_t(state) + state.outside_g);
        read(at_element, self.bias_g, state).field_g
    }

    /// Field and derivatives with the magnet displaced by `displacement_mm` from its rest.
    pub fn respond(&self, displacement_mm: Vector3<f64>) -> Response {
        self.respond_in(&self.frames(), &State::displaced(displacement_mm))
    }

    /// The rotations of this model, for loops over many rows.
    pub fn frames(&self) -> Frames {
        let [x, z] = self.tilt_rad;
        let tilt = Vector3::new(x, 0.0, z);
        Frames {
            magnet: self.magnet_frame([0.0; 2]),
            element: Rotation3::from_scaled_axis(self.rotation_rad),
            lean: [Vector3::x(), Vector3::z()].map(|axis| spin(tilt, axis)),
        }
    }

    /// Field and derivatives at any state, with the model's own rotations at hand.
    pub fn respond_in(&self, frames: &Frames, state: &State) -> Response {
        let turn = self.turned(frames, state);
        let element_mm = self.element(state);
        let (unit, gradient) = self
            .magnet
            .unit_field_and_gradient(turn.inverse() * element_mm);
        let unit_g = turn * unit;
        let strength_t = self.strength_t(state);
        // The element stands still and the magnet moves, hence the sign.
        let per_mm = -(turn.matrix() * gradient * turn.matrix().transpose()) * strength_t;
        // A lean turns the magnet's field, and carries the element to another place in it.
        let per_lean = frames
            .lean
            .map(|spin| spin.cross(&(unit_g * strength_t)) + per_mm * spin.cross(&element_mm));
        let at_element = frames.element * (unit_g * strength_t + state.outside_g);
        let reading = read(at_element, self.bias_g, state);
        let seen = reading.per_field * frames.element.matrix();
        Response {
            field_g: reading.field_g,
            at_element_g: at_element,
            per_field: reading.per_field,
            per_mm: seen * per_mm,
            per_lean: per_lean.map(|lean| seen * lean),
            per_strength: seen * (unit_g * self.remanence_t),
            per_outside: seen,
            per_gain: reading.per_gain,
            per_offset: reading.per_offset,
            per_compression: reading.per_compression,
        }
    }

    /// `[dB/dFx, dB/dFz]` in G/N at the response's load.
    pub fn per_newton(&self, response: &Response) -> [Vector3<f64>; 2] {
        let [kx, kz] = self.stiffness_n_per_mm;
        [
            response.per_mm.column(0) / kx,
            response.per_mm.column(2) / kz,
        ]
    }

    /// The Hall element as seen from the magnet's centre, gripper's axes, in mm.
    fn element(&self, state: &State) -> Vector3<f64> {
        let reach = reach_mm(&self.magnet, self.axis, self.body_axis);
        let [x, z] = self.offset_mm;
        -(state.displacement_mm + Vector3::new(x, self.gap_mm + reach, z))
    }

    fn strength_t(&self, state: &State) -> f64 {
        self.remanence_t * state.strength
    }

    fn turned(&self, frames: &Frames, state: &State) -> Rotation3<f64> {
        match state.lean_rad {
            [0.0, 0.0] => frames.magnet,
            lean => self.magnet_frame(lean),
        }
    }

    fn magnet_frame(&self, lean_rad: [f64; 2]) -> Rotation3<f64> {
        let upright = upright(&self.magnet, self.axis, self.body_axis);
        let [x, z] = [0, 1].map(|i| self.tilt_rad[i] + lean_rad[i]);
        Rotation3::from_scaled_axis(Vector3::new(x, 0.0, z)) * upright
    }
}

/// From a magnet's own frame to the gripper's: magnetised along `axis`, and where that is across its
/// body, with the body along `body_axis`.
pub fn upright(magnet: &Magnet, axis: MagnetAxis, body_axis: MagnetAxis) -> Rotation3<f64> {
    let quarter = std::f64::consts::FRAC_PI_2;
    match (magnet.magnetised, axis) {
        (Magnetised::Axial, MagnetAxis::X) => {
            Rotation3::from_axis_angle(&Vector3::y_axis(), quarter)
        }
        (Magnetised::Axial, MagnetAxis::Y) => {
            Rotation3::from_axis_angle(&Vector3::x_axis(), -quarter)
        }
        (Magnetised::Axial, MagnetAxis::Z) => Rotation3::identity(),
        (Magnetised::Diametric, _) => {
            let (x, z) = (axis.unit(), body_axis.unit());
            Rotation3::from_basis_unchecked(&[x, z.cross(&x), z])
        }
    }
}

/// From a magnet's centre to its surface along the gap, in mm.
pub fn reach_mm(magnet: &Magnet, axis: MagnetAxis, body_axis: MagnetAxis) -> f64 {
    let body = match magnet.magnetised {
        Magnetised::Axial => axis,
        Magnetised::Diametric => body_axis,
    };
    match body {
        MagnetAxis::Y => magnet.half_length_mm(),
        MagnetAxis::X | MagnetAxis::Z => magnet.half_width_mm(),
    }
}

/// The turn per rad along `axis` of the rotation vector `at`, as a vector to cross with.
pub(crate) fn spin(at: Vector3<f64>, axis: Vector3<f64>) -> Vector3<f64> {
    let step = 1e-5;
    let ahead = Rotation3::from_scaled_axis(at + axis * step);
    let behind = Rotation3::from_scaled_axis(at - axis * step);
    // The antisymmetric part of a small rotation is its vector; its angle by way of the cosine
    // would lose half the digits.
    let between = (ahead * behind.inverse()).into_inner();
    let turned = Vector3::new(
        between[(2, 1)] - between[(1, 2)],
        between[(0, 2)] - between[(2, 0)],
        between[(1, 0)] - between[(0, 1)],
    );
    turned / (4.0 * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::{Body, Cylinder};
    use approx::assert_abs_diff_eq;
    use firmware::params;
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    fn nominal() -> ForwardModel {
        ForwardModel::nominal(&Design::magpie())
    }

    #[test]
    fn the_field_at_rest_is_1272_gauss_along_the_gap() {
        let rest = nominal().field([0.0, 0.0]);
        assert_abs_diff_eq!(rest, Vector3::new(0.0, 1272.0, 0.0), epsilon = 0.5);
    }

    #[test]
    fn the_slopes_at_rest_are_585_in_the_plane_and_minus_1170_along_the_axis() {
        let slopes = nominal().respond(Vector3::zeros()).per_mm;
        let expected = Matrix3::from_diagonal(&Vector3::new(585.0, -1170.0, 585.0));
        assert_abs_diff_eq!(slopes, expected, epsilon = 0.5);
    }

    #[test]
    fn the_lateral_field_is_the_known_cubic_within_half_a_millimetre() {
        for step in -50..=50 {
            let d = f64::from(step) * 0.01;
            let expected = 584.95 * d - 79.99 * d.powi(3);
            let found = nominal().respond(Vector3::new(d, 0.0, 0.0)).field_g.x;
            assert_abs_diff_eq!(found, expected, epsilon = 0.02);
        }
    }

    #[test]
    fn one_newton_of_grasp_is_1_17_gauss() {
        let model = nominal();
        let [gx, gz] = model.per_newton(&model.respond(Vector3::zeros()));
        assert_abs_diff_eq!(gx, Vector3::new(1.17, 0.0, 0.0), epsilon = 1e-3);
        assert_abs_diff_eq!(gz, Vector3::new(0.0, 0.0, 0.731), epsilon = 1e-3);
    }

    #[test]
    fn the_sensor_saturates_below_a_gap_of_1_02_mm() {
        let at = |gap_mm| {
            ForwardModel {
                gap_mm,
                ..nominal()
            }
            .field([0.0, 0.0])
            .y
        };
        let limit = params::SENSOR_RANGE.value;
        assert!(at(1.01) > limit && at(1.03) < limit);
    }

    #[test]
    fn other_magnets_have_their_known_field_and_slope() {
        let known = [
            (3.0, 1.0, 902.0, 435.0),
            (3.0, 3.0, 1449.0, 644.0),
            (3.0, 5.0, 1604.0, 684.0),
            (5.0, 2.0, 1795.0, 521.0),
            (2.5, 2.5, 1118.0, 566.0),
        ];
        for (diameter_mm, length_mm, field, slope) in known {
            let magnet = Magnet {
                body: Body::Cylinder(Cylinder {
                    diameter_mm,
                    length_mm,
                }),
                magnetised: Magnetised::Axial,
            };
            let response = ForwardModel {
                magnet,
                ..nominal()
            }
            .respond(Vector3::zeros());
            assert_abs_diff_eq!(response.field_g.y, field, epsilon = 0.5);
            assert_abs_diff_eq!(response.per_mm[(0, 0)], slope, epsilon = 0.5);
        }
    }

    #[test]
    fn a_tenth_of_a_millimetre_of_misplacement_is_58_gauss_sideways_and_111_across() {
        let model = nominal();
        let rest = model.field([0.0, 0.0]);
        let aside = ForwardModel {
            offset_mm: [0.1, 0.0],
            ..model
        }
        .field([0.0, 0.0]);
        let apart = ForwardModel {
            gap_mm: 1.6,
            ..model
        }
        .field([0.0, 0.0]);
        assert_abs_diff_eq!(aside.x, 58.4, epsilon = 0.1);
        assert_abs_diff_eq!((apart - rest).y, -111.0, epsilon = 1.0);
    }

    #[test]
    fn a_sensor_turned_by_two_degrees_reads_44_gauss_of_the_gap_field_sideways() {
        let rotation_rad = Vector3::new(0.0, 0.0, -2.0_f64.to_radians());
        let field = ForwardModel {
            rotation_rad,
            ..nominal()
        }
        .field([0.0, 0.0]);
        assert_abs_diff_eq!(field.x, 44.4, epsilon = 0.1);
    }

    #[test]
    fn a_lying_magnet_shows_its_side() {
        // Half the field of the pole face, roughly, and against the axis: a dipole's equator.
        let model = ForwardModel {
            axis: MagnetAxis::X,
            ..nominal()
        };
        let field = model.field([0.0, 0.0]);
        assert!(
            field.x < -300.0 && field.y.abs() < 1e-9 && field.z.abs() < 1e-9,
            "{field}"
        );
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_the_field_wherever_the_magnet_stands(
            offset in -0.2..0.2_f64, tilt in -0.05..0.05_f64,
            fx in -250.0..250.0_f64, fz in -250.0..250.0_f64,
        ) {
            let model = ForwardModel {
                offset_mm: [offset, -offset],
                tilt_rad: [tilt, 0.5 * tilt],
                rotation_rad: Vector3::new(tilt, -tilt, 2.0 * tilt),
                ..nominal()
            };
            let response = model.respond(model.displacement([fx, fz]));
            let slopes = model.per_newton(&response);
            let h = 0.05;
            let plain = [
                (model.field([fx + h, fz]) - model.field([fx - h, fz])) / (2.0 * h),
                (model.field([fx, fz + h]) - model.field([fx, fz - h])) / (2.0 * h),
            ];
            for (slope, plain) in slopes.iter().zip(plain) {
                prop_assert!((slope - plain).amax() < 1e-5);
            }
            prop_assert!((response.field_g - model.field([fx, fz])).amax() < 1e-9);
        }

        #[test]
        fn the_answer_to_a_change_of_the_state_is_that_of_the_field(
            d in proptest::array::uniform3(-0.3..0.3_f64), outside in proptest::array::uniform3(-20.0..20.0_f64),
            step in proptest::array::uniform11(-1.0..1.0_f64),
        ) {
            let model = ForwardModel { tilt_rad: [0.03, -0.02], rotation_rad: Vector3::new(0.02, -0.01, 0.03), ..nominal() };
            let frames = model.frames();
            let at = State {
                lean_rad: [0.01, -0.005],
                strength: 0.99,
                outside_g: outside.into(),
                gain: 1.01,
                offset_g: Vector3::new(0.3, -0.2, 0.1),
                compression: 0.01,
                ..State::displaced(d.into())
            };
            let moved = |by: f64| State {
                displacement_mm: at.displacement_mm + Vector3::new(step[0], step[1], step[2]) * by * 1e-3,
                lean_rad: [at.lean_rad[0] + by * step[3] * 1e-3, at.lean_rad[1] + by * step[4] * 1e-3],
                strength: at.strength + by * step[5] * 1e-3,
                outside_g: at.outside_g + Vector3::new(step[6], step[7], 1.0) * by,
                gain: at.gain + by * step[8] * 1e-3,
                offset_g: at.offset_g + Vector3::new(step[9], 1.0, -1.0) * by,
                compression: at.compression + by * step[10] * 1e-3,
            };
            let plain = (model.field_in(&frames, &moved(1.0)) - model.field_in(&frames, &moved(-1.0))) / 2.0;
            let found = model.respond_in(&frames, &at).change(&at, &moved(1.0));
            // A lean of some hundredths turns the axis of the next lean by as much.
            prop_assert!((plain - found).amax() < 0.01 + 0.01 * plain.amax(), "{plain} {found}");
            prop_assert!((model.respond_in(&frames, &at).field_g - model.field_in(&frames, &at)).amax() < 1e-9);
        }
    }
}
