//! The magnet of the opposing finger comes close as the gripper closes.

use nalgebra::Vector3;

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The opening at which the size is stated, in mm.
const AT_MM: f64 = 10.0;

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "neighbour_magnet",
    stage: Stage::Outside,
    physics: "Each finger carries a magnet of its own, and a Hall sensor cannot tell whose field it sees. \
              Far away a magnet is a dipole, whose field falls with the third power of the distance: felt \
              strongly with the fingers together, it is gone when they are open. A magnet of 3 by 2 mm \
              gives some 10 G at 10 mm and 0.3 G at 35 mm.",
    equation: "B + ((r0 + 10 mm) / r)^3 (3 (K e) e - K), r = (r0 + opening, aside, ahead), e = r / |r|",
    regressors: "the field of a dipole at r0 + opening, for each direction of the dipole",
    needs: &["opening_mm"],
    shows_against: &["opening_mm"],
    parameters: &[
        Parameter::coefficient("field_x", "G", 2.0),
        Parameter::coefficient("field_y", "G", 2.0),
        Parameter::coefficient("field_z", "G", 2.0),
        Parameter::shape("distance", "mm", &[2.0, 4.0, 7.0, 10.0, 14.0, 20.0, 30.0]),
        Parameter::shape("aside", "mm", &[-6.0, -3.0, 0.0, 3.0, 6.0]),
        Parameter::shape("ahead", "mm", &[-6.0, -3.0, 0.0, 3.0, 6.0]),
    ],
    size: Size {
        words: "field at an opening of 10 mm",
        unit: "G",
        first: 0,
        of: SizeOf::Mean(at_ten_millimetres),
        factor: 1.0,
        resolution: 0.0,
        typical: 2.0,
        plausible: (0.0, 100.0),
        possible: (0.0, 2000.0),
    },
    record: "Open and close over the whole stroke without load, at two speeds; then hold closed with the \
              motor off.",
    confused_with: &[
        ("motor_leakage", "closing needs current"),
        ("external_magnet", "where the gripper closed only once"),
        ("screw_backlash", "both follow the opening"),
    ],
    undone: Undone::Compensation,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], _: &Track, series: &mut Series) {
    for (state, opening_mm) in series.states.iter_mut().zip(&series.opening_mm) {
        state.outside_g += field(values, *opening_mm);
    }
}

/// Magnitude of the field in gauss where the size is stated.
fn at_ten_millimetres(values: &[f64]) -> f64 {
    field(values, AT_MM).norm()
}

/// Field of the neighbour in gauss, gripper's axes, at an opening in mm; `values` in the order of the
/// parameters.
pub fn field(values: &[f64], opening_mm: f64) -> Vector3<f64> {
    let &[x, y, z, distance_mm, aside_mm, ahead_mm] = values else {
        return Vector3::zeros();
    };
    let moment = Vector3::new(x, y, z);
    // A gripper closes to zero; what is recorded below that is the encoder's zero.
    let along = (distance_mm + opening_mm).max(0.1 * distance_mm);
    let from = Vector3::new(along, aside_mm, ahead_mm);
    let reach = from.norm();
    let towards = from / reach;
    let fall = ((distance_mm + AT_MM) / reach).powi(3);
    (towards * (3.0 * moment.dot(&towards)) - moment) * fall
}
