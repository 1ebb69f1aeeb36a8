//! Leakage of the motor's phase currents, by the law of Biot and Savart.
//!
//! Every tooth has a coil of straight wires in air. The stator's iron, the shielding of the rotor and the
//! supply wires are neglected. The motor's geometry is assumed.

use std::f64::consts::TAU;

use firmware::config::constants::{Constant, assumed};
use magba::fields::path_current_B;
use nalgebra::{Matrix3x2, Point3, UnitQuaternion, Vector3};

use crate::design::interference::{FieldShift, InterferenceSources, LocalInverse, SensorUnderTest};
use crate::physics::magnet::GAUSS_PER_TESLA;

/// Teeth of the stator.
pub(crate) const TEETH: Constant = assumed("motor's teeth", 12.0, "", "12 slots, 14 poles");
/// Turns of wire around each tooth.
pub const TURNS: Constant = assumed("turns of a tooth", 20.0, "", "no motor named");
/// Mean radius of the coils from the motor's axis.
pub(crate) const RADIUS: Constant = assumed("radius of the coils", 18.0, "mm", "no motor named");
/// Width of a coil along the circumference.
pub const WIDTH: Constant =
    assumed("width of a coil", 7.0, "mm", "a twelfth of the circle, less slots");
/// Length of a coil along the motor's axis.
pub const LENGTH: Constant = assumed("length of a coil", 12.0, "mm", "no motor named");
/// Distance from the motor's centre to the nearest sensor along the motor's axis (`x`, the opening).
pub(crate) const ALONG: Constant = assumed("motor to sensor, along", 20.0, "mm", "gripper closed");
/// The same perpendicular to the axis, along the finger.
pub(crate) const ASIDE: Constant =
    assumed("motor to sensor, aside", 38.0, "mm", "20 mm off the coils");

/// Position of the nearest sensor relative to the motor's centre, gripper axes, in mm.
pub(crate) fn sensor_mm() -> Vector3<f64> {
    Vector3::new(ALONG.value, 0.0, ASIDE.value)
}

/// Shift at maximum current and the worst rotor angle.
pub fn shift(
    sensor: &SensorUnderTest,
    rest: &LocalInverse,
    sources: &InterferenceSources,
) -> FieldShift {
    let leakage = sources.leakage_g_per_a;
    let gauss = sources.current_a * leakage.svd(false, false).singular_values.max();
    let newtons = sources.current_a * rest.worst_case_n(&leakage);
    FieldShift::new(("motor leakage", "greatest current, worst angle"), (gauss, newtons), sensor)
}

/// Field in G/A for alpha and beta (peak of the phase) at `at_mm` from the motor's centre; the motor's axis is
/// `x`.
pub(crate) fn leakage_g_per_a(at_mm: Vector3<f64>) -> Matrix3x2<f64> {
    let half = 0.5 * 3.0_f64.sqrt();
    // Phase currents for unit alpha, and for unit beta.
    let phases = [[1.0, 0.0], [-0.5, half], [-0.5, -half]];
    let mut leakage = Matrix3x2::zeros();
    for tooth in 0..TEETH.value as u32 {
        let (phase, sign) = winding(tooth);
        let field = coil_g_per_a(tooth, at_mm) * (sign * TURNS.value);
        for (axis, amperes) in phases[phase].into_iter().enumerate() {
            leakage.column_mut(axis).axpy(amperes, &field, 1.0);
        }
    }
    leakage
}

/// Phase of a tooth and its sense: 12 coils for 14 poles are 210 degrees apart electrically, two of each sense
/// side by side.
fn winding(tooth: u32) -> (usize, f64) {
    let sector = (tooth * 210 % 360) / 60;
    [(0, 1.0), (2, -1.0), (1, 1.0), (0, -1.0), (2, 1.0), (1, -1.0)][sector as usize]
}

/// Field in G/A of one turn around a tooth: a rectangle with outward normal.
fn coil_g_per_a(tooth: u32, at_mm: Vector3<f64>) -> Vector3<f64> {
    let (sin, cos) = libm::sincos(TAU * f64::from(tooth) / TEETH.value);
    let (outward, tangent) = (Vector3::new(0.0, cos, sin), Vector3::new(0.0, -sin, cos));
    let corner = |along: f64, aside: f64| {
        let mm = outward * RADIUS.value
            + Vector3::x() * (0.5 * along * LENGTH.value)
            + tangent * (0.5 * aside * WIDTH.value);
        1e-3 * mm
    };
    // Counterclockwise about the outward normal.
    let path = [
        corner(1.0, -1.0),
        corner(-1.0, -1.0),
        corner(-1.0, 1.0),
        corner(1.0, 1.0),
        corner(1.0, -1.0),
    ];
    let field_t = path_current_B(
        Point3::from(1e-3 * at_mm),
        Point3::origin(),
        UnitQuaternion::identity(),
        1.0,
        &path,
    );
    field_t * GAUSS_PER_TESLA
}
