//! The gripper's own rigidity: under a grasp its fingers are further apart than the screw says.
//!
//! What follows the opening, follows a wrong one: the neighbour's magnet is corrected for where it is not.

use firmware::params::{Constant, stated};

use super::{Inverse, Sensed, Shift, Surroundings, neighbour, sizes};

/// Load at which the paper measured the deflection.
pub const LOAD: Constant = stated("load on the whole gripper", 200.0, "N", "paper V-D");
/// Deflection of the whole gripper under [`LOAD`].
pub const DEFLECTION: Constant = stated("deflection of the whole gripper", 0.3, "mm", "paper V-D");

/// Force for a millimetre, in N: 667.
pub const fn n_per_mm() -> f64 {
    LOAD.value / DEFLECTION.value
}

/// Error of the opening in mm under the design's greatest force.
pub fn opening_error_mm(sensed: &Sensed, around: &Surroundings) -> f64 {
    sensed.model.force_range_n / around.rigidity_n_per_mm
}

/// What the neighbour's magnet changes over the error of the opening, with the gripper closed.
pub fn shift(sensed: &Sensed, rest: &Inverse, around: &Surroundings) -> Shift {
    let error_mm = opening_error_mm(sensed, around);
    let at = |distance_mm| neighbour::field(&sensed.model, distance_mm);
    let change = at(around.closed_mm + error_mm) - at(around.closed_mm);
    Shift::new(
        (
            "rigidity",
            "neighbour magnet, opening wrong under the greatest force",
        ),
        sizes(change, rest),
        sensed,
    )
}
