//! Sensor of one finger: two flexures move a magnet in front of a Hall element.
//!
//! Gripper frame, origin at the Hall element: `x` lateral (grasping), `z` longitudinal (ground reaction),
//! `y` from the element to the magnet. A positive force moves the magnet along the positive axis: Bx depends
//! on Fx, Bz on Fz, and By is of second order in both.

use nalgebra::{Matrix2x3, Matrix3, Matrix3x2, Rotation3, Vector3};

use crate::physics::magnet::{Magnet, Magnetisation};
use crate::physics::response::{FieldResponse, PhysicalState, field_of, reading_of};
use crate::recordings::description::{MagnetAxis, NominalDesign};

/// Weight of the gap axis in the inversion from field to forces, relative to the axes in the plane of motion:
/// it is the most sensitive to temperature, gap changes and the neighbouring magnet.
pub const GAP_WEIGHT: f64 = 0.01;

/// The weights of all axes with [`GAP_WEIGHT`].
pub(crate) const CYLINDER_WEIGHTS: Vector3<f64> = Vector3::new(1.0, GAP_WEIGHT, 1.0);

/// Change of both forces with the field in N/G by the device's inverse, where the field changes by `[dB/dFx, dB/dFz]` in G/N: least
/// squares with these weights of the axes. A force that the field does not depend on is no input and stays zero. `None` where the
/// field does not determine the forces.
pub fn force_per_field(
    per_newton: &[Vector3<f64>; 2],
    weights: Vector3<f64>,
) -> Option<Matrix2x3<f64>> {
    let slopes = Matrix3x2::from_columns(per_newton);
    let weighted = slopes.transpose() * Matrix3::from_diagonal(&weights);
    let mut normal = weighted * slopes;
    for axis in 0..2 {
        if per_newton[axis] == Vector3::zeros() && per_newton[1 - axis] != Vector3::zeros() {
            normal[(axis, axis)] = 1.0;
        }
    }
    Some(normal.try_inverse()? * weighted)
}

/// Forward model of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForwardModel {
    /// Shape and magnetisation.
    pub magnet: Magnet,
    /// Direction of the magnetisation.
    pub axis: MagnetAxis,
    /// Direction of the body axis; relevant for diametric magnetisation only.
    pub body_axis: MagnetAxis,
    /// Remanence in T; negative for a magnet mounted with reversed polarity.
    pub remanence_t: f64,
    /// Distance from the magnet's face to the Hall element at rest in mm.
    pub gap_mm: f64,
    /// Lateral and longitudinal stiffness in N/mm.
    pub stiffness_n_per_mm: [f64; 2],
    /// Misalignment of the magnet in the plane of motion, x and z, in mm.
    pub offset_mm: [f64; 2],
    /// Tilt of the magnet: rotation vector about the gripper's x and z in rad. (A rotation about y is not
    /// modelled.)
    pub tilt_rad: [f64; 2],
    /// Orientation of the Hall element relative to the gripper: rotation vector in rad.
    pub rotation_rad: Vector3<f64>,
    /// Bias in gauss, sensor's axes: offset of the sensor plus ambient field.
    pub bias_g: Vector3<f64>,
    /// Design force of each axis, either sign, in newtons: the range of the inverse model.
    pub force_range_n: f64,
}

/// Rotations of a [`ForwardModel`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelFrames {
    /// From the magnet frame (body axis along z) to the gripper frame.
    pub magnet: Rotation3<f64>,
    /// From the gripper frame to the sensor frame.
    pub element: Rotation3<f64>,
    /// Rotation of the magnet about the gripper's axes per rad of tilt about x and z.
    pub per_tilt: [Vector3<f64>; 2],
}

impl ForwardModel {
    /// The nominal design without manufacturing errors.
    pub fn nominal(design: &NominalDesign) -> Self {
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
        self.field_at(&self.frames(), &PhysicalState::displaced(self.displacement(force_n)))
    }

    /// Reading in gauss at a state.
    pub fn field_at(&self, frames: &ModelFrames, state: &PhysicalState) -> Vector3<f64> {
        let (turn, at_mm) = self.element_in_magnet(frames, state);
        self.reading(frames, state, &turn, self.magnet.unit_field(at_mm))
    }

    /// [`ForwardModel::field_at`] many states.
    pub(crate) fn fields_at(
        &self,
        frames: &ModelFrames,
        states: &[PhysicalState],
    ) -> Vec<Vector3<f64>> {
        let (turns, at_mm): (Vec<_>, Vec<_>) =
            states.iter().map(|state| self.element_in_magnet(frames, state)).unzip();
        let units = self.magnet.unit_fields(&at_mm);
        let all = states.iter().zip(turns.iter().zip(units));
        all.map(|(state, (turn, unit))| self.reading(frames, state, turn, unit)).collect()
    }

    /// Reading at a state with this field in the magnet's frame, in gauss per tesla of remanence.
    fn reading(
        &self,
        frames: &ModelFrames,
        state: &PhysicalState,
        turn: &Rotation3<f64>,
        unit: Vector3<f64>,
    ) -> Vector3<f64> {
        let unit_g = turn * unit;
        let at_element = frames.element * (unit_g * self.strength_t(state) + state.external_g);
        field_of(at_element, self.bias_g, state)
    }

    /// Reading and derivatives at a displacement of the magnet in mm.
    pub fn response(&self, displacement_mm: Vector3<f64>) -> FieldResponse {
        self.response_at(&self.frames(), &PhysicalState::displaced(displacement_mm))
    }

    /// The rotations, computed once for loops over rows.
    pub fn frames(&self) -> ModelFrames {
        let [x, z] = self.tilt_rad;
        let tilt = Vector3::new(x, 0.0, z);
        ModelFrames {
            magnet: self.magnet_frame([0.0; 2]),
            element: Rotation3::from_scaled_axis(self.rotation_rad),
            per_tilt: [Vector3::x(), Vector3::z()].map(|axis| rotation_derivative(tilt, axis)),
        }
    }

    /// Reading and derivatives at a state; `frames` from [`ForwardModel::frames`].
    pub fn response_at(&self, frames: &ModelFrames, state: &PhysicalState) -> FieldResponse {
        let (turn, at_mm) = self.element_in_magnet(frames, state);
        let in_magnet = self.magnet.unit_field_and_gradient(at_mm);
        self.response_with(frames, state, &turn, in_magnet)
    }

    /// [`ForwardModel::response_at`] many states.
    pub(crate) fn responses_at(
        &self,
        frames: &ModelFrames,
        states: &[PhysicalState],
    ) -> Vec<FieldResponse> {
        let (turns, at_mm): (Vec<_>, Vec<_>) =
            states.iter().map(|state| self.element_in_magnet(frames, state)).unzip();
        let in_magnet = self.magnet.unit_fields_and_gradients(&at_mm);
        let all = states.iter().zip(turns.iter().zip(in_magnet));
        all.map(|(state, (turn, found))| self.response_with(frames, state, turn, found)).collect()
    }

    /// Response with this field and gradient in the magnet's frame, per tesla of remanence.
    fn response_with(
        &self,
        frames: &ModelFrames,
        state: &PhysicalState,
        turn: &Rotation3<f64>,
        (unit, gradient): (Vector3<f64>, Matrix3<f64>),
    ) -> FieldResponse {
        let element_mm = self.element_mm(state);
        let unit_g = turn * unit;
        let strength_t = self.strength_t(state);
        // Negative: the magnet moves, the element is fixed.
        let per_mm = -(turn.matrix() * gradient * turn.matrix().transpose()) * strength_t;
        // A tilt rotates the field and moves the element relative to the magnet.
        let per_tilt = frames
            .per_tilt
            .map(|spin| spin.cross(&(unit_g * strength_t)) + per_mm * spin.cross(&element_mm));
        let at_element = frames.element * (unit_g * strength_t + state.external_g);
        let reading = reading_of(at_element, self.bias_g, state);
        let per_field = reading.per_field * frames.element.matrix();
        FieldResponse {
            field_g: reading.field_g,
            at_element_g: at_element,
            per_field: reading.per_field,
            per_mm: per_field * per_mm,
            per_tilt: per_tilt.map(|tilt| per_field * tilt),
            per_strength: per_field * (unit_g * self.remanence_t),
            per_external: per_field,
            per_gain: reading.per_gain,
            per_rotation: reading.per_rotation,
            per_offset: reading.per_offset,
            per_compression: reading.per_compression,
        }
    }

    /// `[dB/dFx, dB/dFz]` in G/N.
    pub fn per_newton(&self, response: &FieldResponse) -> [Vector3<f64>; 2] {
        let [kx, kz] = self.stiffness_n_per_mm;
        [response.per_mm.column(0) / kx, response.per_mm.column(2) / kz]
    }

    /// Position of the Hall element relative to the magnet's centre, gripper's axes, in mm.
    fn element_mm(&self, state: &PhysicalState) -> Vector3<f64> {
        let reach = reach_mm(&self.magnet, self.axis, self.body_axis);
        let [x, z] = self.offset_mm;
        -(state.displacement_mm + Vector3::new(x, self.gap_mm + reach, z))
    }

    /// The magnet's rotation at a state, and the Hall element in the magnet's frame in mm.
    fn element_in_magnet(
        &self,
        frames: &ModelFrames,
        state: &PhysicalState,
    ) -> (Rotation3<f64>, Vector3<f64>) {
        let turn = self.magnet_rotation(frames, state);
        (turn, turn.inverse() * self.element_mm(state))
    }

    fn strength_t(&self, state: &PhysicalState) -> f64 {
        self.remanence_t * state.strength
    }

    fn magnet_rotation(&self, frames: &ModelFrames, state: &PhysicalState) -> Rotation3<f64> {
        match state.extra_tilt_rad {
            [0.0, 0.0] => frames.magnet,
            tilt => self.magnet_frame(tilt),
        }
    }

    fn magnet_frame(&self, extra_tilt_rad: [f64; 2]) -> Rotation3<f64> {
        let upright = magnet_orientation(&self.magnet, self.axis, self.body_axis);
        let [x, z] = [0, 1].map(|i| self.tilt_rad[i] + extra_tilt_rad[i]);
        Rotation3::from_scaled_axis(Vector3::new(x, 0.0, z)) * upright
    }
}

/// Rotation from the magnet frame to the gripper frame for a magnetisation along `axis`; `body_axis` is
/// relevant for diametric magnetisation only.
pub fn magnet_orientation(
    magnet: &Magnet,
    axis: MagnetAxis,
    body_axis: MagnetAxis,
) -> Rotation3<f64> {
    let quarter = std::f64::consts::FRAC_PI_2;
    match (magnet.magnetised, axis) {
        (Magnetisation::Axial, MagnetAxis::X) => {
            Rotation3::from_axis_angle(&Vector3::y_axis(), quarter)
        }
        (Magnetisation::Axial, MagnetAxis::Y) => {
            Rotation3::from_axis_angle(&Vector3::x_axis(), -quarter)
        }
        (Magnetisation::Axial, MagnetAxis::Z) => Rotation3::identity(),
        (Magnetisation::Diametric, _) => {
            let (x, z) = (axis.unit(), body_axis.unit());
            Rotation3::from_basis_unchecked(&[x, z.cross(&x), z])
        }
    }
}

/// Distance from the magnet's centre to its surface along the gap in mm.
pub fn reach_mm(magnet: &Magnet, axis: MagnetAxis, body_axis: MagnetAxis) -> f64 {
    let body = match magnet.magnetised {
        Magnetisation::Axial => axis,
        Magnetisation::Diametric => body_axis,
    };
    match body {
        MagnetAxis::Y => magnet.half_length_mm(),
        MagnetAxis::X | MagnetAxis::Z => magnet.half_width_mm(),
    }
}

/// Derivative of the rotation with vector `at` along `axis`: angular velocity vector per rad.
pub(crate) fn rotation_derivative(at: Vector3<f64>, axis: Vector3<f64>) -> Vector3<f64> {
    let step = 1e-5;
    let ahead = Rotation3::from_scaled_axis(at + axis * step);
    let behind = Rotation3::from_scaled_axis(at - axis * step);
    // From the antisymmetric part: the angle from the cosine would lose half the digits.
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
    use crate::physics::{Cylinder, MagnetBody};
    use approx::assert_abs_diff_eq;
    use firmware::config::constants;
    use proptest::prelude::*;

    fn nominal() -> ForwardModel {
        ForwardModel::nominal(&NominalDesign::magpie())
    }

    #[test]
    fn field_at_rest_is_1272_gauss_along_the_gap() {
        let rest = nominal().field([0.0, 0.0]);
        assert_abs_diff_eq!(rest, Vector3::new(0.0, 1272.0, 0.0), epsilon = 0.5);
    }

    #[test]
    fn gradient_at_rest_is_585_in_plane_and_minus_1170_axial() {
        let slopes = nominal().response(Vector3::zeros()).per_mm;
        let expected = Matrix3::from_diagonal(&Vector3::new(585.0, -1170.0, 585.0));
        assert_abs_diff_eq!(slopes, expected, epsilon = 0.5);
    }

    #[test]
    fn lateral_field_is_cubic_within_half_a_millimetre() {
        for step in -50..=50 {
            let d = f64::from(step) * 0.01;
            let expected = 584.95 * d - 79.99 * d.powi(3);
            let found = nominal().response(Vector3::new(d, 0.0, 0.0)).field_g.x;
            assert_abs_diff_eq!(found, expected, epsilon = 0.02);
        }
    }

    #[test]
    fn sensitivity_to_grasp_force_is_1_17_gauss_per_newton() {
        let model = nominal();
        let [gx, gz] = model.per_newton(&model.response(Vector3::zeros()));
        assert_abs_diff_eq!(gx, Vector3::new(1.17, 0.0, 0.0), epsilon = 1e-3);
        assert_abs_diff_eq!(gz, Vector3::new(0.0, 0.0, 0.731), epsilon = 1e-3);
    }

    #[test]
    fn sensor_saturates_below_a_gap_of_1_02_mm() {
        let at = |gap_mm| ForwardModel { gap_mm, ..nominal() }.field([0.0, 0.0]).y;
        let limit = constants::SENSOR_RANGE.value;
        assert!(at(1.01) > limit && at(1.03) < limit);
    }

    #[test]
    fn other_magnets_match_reference_field_and_gradient() {
        let references = [
            (3.0, 1.0, 902.0, 435.0),
            (3.0, 3.0, 1449.0, 644.0),
            (3.0, 5.0, 1604.0, 684.0),
            (5.0, 2.0, 1795.0, 521.0),
            (2.5, 2.5, 1118.0, 566.0),
        ];
        for (diameter_mm, length_mm, field, slope) in references {
            let magnet = Magnet {
                body: MagnetBody::Cylinder(Cylinder { diameter_mm, length_mm }),
                magnetised: Magnetisation::Axial,
            };
            let response = ForwardModel { magnet, ..nominal() }.response(Vector3::zeros());
            assert_abs_diff_eq!(response.field_g.y, field, epsilon = 0.5);
            assert_abs_diff_eq!(response.per_mm[(0, 0)], slope, epsilon = 0.5);
        }
    }

    #[test]
    fn misalignment_of_0_1_mm_changes_field_by_58_and_111_gauss() {
        let model = nominal();
        let rest = model.field([0.0, 0.0]);
        let shifted = ForwardModel { offset_mm: [0.1, 0.0], ..model }.field([0.0, 0.0]);
        let widened = ForwardModel { gap_mm: 1.6, ..model }.field([0.0, 0.0]);
        assert_abs_diff_eq!(shifted.x, 58.4, epsilon = 0.1);
        assert_abs_diff_eq!((widened - rest).y, -111.0, epsilon = 1.0);
    }

    #[test]
    fn rotation_of_2_degrees_leaks_44_gauss_of_the_gap_field() {
        let rotation_rad = Vector3::new(0.0, 0.0, -2.0_f64.to_radians());
        let field = ForwardModel { rotation_rad, ..nominal() }.field([0.0, 0.0]);
        assert_abs_diff_eq!(field.x, 44.4, epsilon = 0.1);
    }

    #[test]
    fn magnet_along_x_has_its_equatorial_field() {
        // About minus half the field of the pole face, as at a dipole's equator.
        let model = ForwardModel { axis: MagnetAxis::X, ..nominal() };
        let field = model.field([0.0, 0.0]);
        assert!(field.x < -300.0 && field.y.abs() < 1e-9 && field.z.abs() < 1e-9, "{field}");
    }

    proptest! {
        #[test]
        fn derivatives_match_differences_of_the_field(
            offset in -0.2..0.2_f64, tilt in -0.05..0.05_f64,
            fx in -250.0..250.0_f64, fz in -250.0..250.0_f64,
        ) {
            let model = ForwardModel {
                offset_mm: [offset, -offset],
                tilt_rad: [tilt, 0.5 * tilt],
                rotation_rad: Vector3::new(tilt, -tilt, 2.0 * tilt),
                ..nominal()
            };
            let response = model.response(model.displacement([fx, fz]));
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
        fn first_order_change_matches_differences_of_the_field(
            d in proptest::array::uniform3(-0.3..0.3_f64), outside in proptest::array::uniform3(-20.0..20.0_f64),
            step in proptest::array::uniform14(-1.0..1.0_f64),
        ) {
            let model = ForwardModel { tilt_rad: [0.03, -0.02], rotation_rad: Vector3::new(0.02, -0.01, 0.03), ..nominal() };
            let frames = model.frames();
            let at = PhysicalState {
                extra_tilt_rad: [0.01, -0.005],
                strength: 0.99,
                external_g: outside.into(),
                gain: Vector3::new(1.01, 0.99, 1.02),
                rotation_rad: Vector3::new(0.003, -0.002, 0.004),
                offset_g: Vector3::new(0.3, -0.2, 0.1),
                compression: 0.01,
                ..PhysicalState::displaced(d.into())
            };
            let moved = |by: f64| PhysicalState {
                displacement_mm: at.displacement_mm + Vector3::new(step[0], step[1], step[2]) * by * 1e-3,
                extra_tilt_rad: [at.extra_tilt_rad[0] + by * step[3] * 1e-3, at.extra_tilt_rad[1] + by * step[4] * 1e-3],
                strength: at.strength + by * step[5] * 1e-3,
                external_g: at.external_g + Vector3::new(step[6], step[7], 1.0) * by,
                gain: at.gain + Vector3::new(step[8], -0.5 * step[8], step[11]) * by * 1e-3,
                rotation_rad: at.rotation_rad + Vector3::new(step[11], step[12], step[13]) * by * 1e-3,
                offset_g: at.offset_g + Vector3::new(step[9], 1.0, -1.0) * by,
                compression: at.compression + by * step[10] * 1e-3,
            };
            let plain = (model.field_at(&frames, &moved(1.0)) - model.field_at(&frames, &moved(-1.0))) / 2.0;
            let found = model.response_at(&frames, &at).change(&at, &moved(1.0));
            // The tolerance covers the second order of the tilts.
            prop_assert!((plain - found).amax() < 0.01 + 0.01 * plain.amax(), "{plain} {found}");
            prop_assert!((model.response_at(&frames, &at).field_g - model.field_at(&frames, &at)).amax() < 1e-9);
        }
    }
}
