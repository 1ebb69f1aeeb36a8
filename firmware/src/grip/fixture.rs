//! What tests of the grasp share: forces as estimates.

use crate::force::{Estimate, Validity};
use crate::frame::SENSORS;
use crate::units::Force;

/// Lateral and longitudinal forces in newtons.
pub fn pressed(lateral: [f64; SENSORS], longitudinal: [f64; SENSORS]) -> [Estimate; SENSORS] {
    let force = |newtons: f64| Force((newtons * Force::PER_NEWTON) as i32);
    let mut estimates = [Estimate::MISSING; SENSORS];
    let forces = lateral.into_iter().zip(longitudinal);
    for (estimate, (x, z)) in estimates.iter_mut().zip(forces) {
        estimate.force = [force(x), force(z)];
        estimate.validity = Validity::Valid;
    }
    estimates
}
