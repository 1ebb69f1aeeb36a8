//! The magnet of the opposite finger: the same as the sensor's own, beside it along the opening.
//!
//! The paper lets it come within 1.5 mm and finds less than three resolutions of 0.1 G. Both cannot be: a
//! magnet of 3 by 2 mm gives 0.3 G no nearer than 35 mm.

use firmware::params::{Constant, assumed};
use nalgebra::Vector3;

use super::{Inverse, Sensed, Shift, Surroundings, sizes};
use crate::physics::ForwardModel;
use crate::physics::sensor::reach_mm;

/// Between the centres of opposite magnets with the gripper closed.
pub const CLOSED: Constant = assumed(
    "opposite magnets, gripper closed",
    10.0,
    "mm",
    "the paper's 1.5 mm contradicts its three resolutions",
);

/// With the gripper closed, against one that is wide open.
pub fn shift(sensed: &Sensed, rest: &Inverse, around: &Surroundings) -> Shift {
    let closed = field(&sensed.model, around.closed_mm);
    Shift::new(
        ("neighbour magnet", "gripper closed"),
        sizes(closed, rest),
        sensed,
    )
}

/// Field at the element, in gauss, of the same magnet so far away along the opening (`x`), in mm.
pub fn field(model: &ForwardModel, distance_mm: f64) -> Vector3<f64> {
    let across_mm = model.gap_mm + reach_mm(&model.magnet, model.axis, model.body_axis);
    let turn = model.frames().magnet;
    let element_mm = -Vector3::new(distance_mm, across_mm, 0.0);
    turn * model.magnet.unit_field(turn.inverse() * element_mm) * model.remanence_t
}

/// Distance in mm beyond which the neighbour gives less than so many gauss.
pub fn distance_mm(model: &ForwardModel, most_g: f64) -> f64 {
    // Field falls with the distance where the two magnets do not overlap.
    let (mut near, mut far) = (2.0 * model.magnet.half_width_mm(), 1e4);
    while far - near > 1e-6 * far {
        let middle = (near * far).sqrt();
        match field(model, middle).norm() > most_g {
            true => near = middle,
            false => far = middle,
        }
    }
    far
}
