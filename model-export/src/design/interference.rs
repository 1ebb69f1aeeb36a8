//! What moves a sensor's field beside its forces: each as a shift in gauss, in newtons and in
//! resolutions of the sensor.
//!
//! ```ignore
//! // Once: what is around the sensor, and the draws of the misalignment, by their seed.
//! let surroundings = Surroundings::assumed(1, DRAWS);
//! // For each design, in parallel if need be: a fifth of a millisecond.
//! for shift in interference::of(&Sensed::of(ForwardModel::nominal(&design)), &surroundings) {
//!     println!("{}: {:.2} G, {:.2} N", shift.name, shift.gauss, shift.newtons);
//! }
//! ```
//!
//! Newtons are those that the design's own inverse makes of a shift: the forces that explain it best, the
//! gap axis counting as little as in the tables ([`Inverse`]).
//!
//! - [`earth`]: the Earth's field, at its true size.
//! - [`misalignment`]: how the magnet is mounted, by Monte Carlo, before and after a tare.
//! - [`neighbour`]: the opposite finger's magnet with the gripper closed.
//! - [`inhomogeneity`]: a magnet that is weaker than its grade.
//! - [`motor`]: leakage of the phase currents, by Biot and Savart.
//! - [`rigidity`]: the gripper's own, as an error of the opening.

pub mod earth;
pub mod inhomogeneity;
pub mod inverse;
pub mod misalignment;
pub mod motor;
pub mod neighbour;
pub mod rigidity;

use firmware::params;
use nalgebra::{Matrix3x2, Vector3};

pub use inverse::Inverse;
pub use misalignment::{DRAWS, Draws, Scatter};

use crate::physics::ForwardModel;

/// One sensor as it is meant to be, and how well it is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensed {
    /// Magnet, gap, flexures and force range.
    pub model: ForwardModel,
    /// The sensor's resolution in gauss.
    pub resolution_g: f64,
    /// How far the made differs from the meant.
    pub scatter: Scatter,
}

impl Sensed {
    /// A sensor of the gripper's part, made as well as is assumed.
    pub fn of(model: ForwardModel) -> Self {
        Self {
            model,
            resolution_g: params::SENSOR_SCALE.value,
            scatter: Scatter::assumed(),
        }
    }
}

/// What is around every sensor of a gripper, whatever its design.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// The Earth's field in gauss.
    pub earth_g: f64,
    /// Between the centres of opposite magnets with the gripper closed, in mm.
    pub closed_mm: f64,
    /// Share of its strength that a magnet may lack.
    pub weaker: f64,
    /// The motor's leakage in G for each ampere of its two phase currents, alpha and beta.
    pub leakage_g_per_a: Matrix3x2<f64>,
    /// The motor's greatest current in A, peak of the phase.
    pub current_a: f64,
    /// Force that opens the gripper by a millimetre, in N.
    pub rigidity_n_per_mm: f64,
    /// Draws of the misalignment, the same for every design.
    pub draws: Draws,
}

impl Surroundings {
    /// The gripper's own as far as the paper states it, the rest assumed; with this many draws of this
    /// seed.
    pub fn assumed(seed: u64, draws: usize) -> Self {
        Self {
            earth_g: earth::GREATEST.value,
            closed_mm: neighbour::CLOSED.value,
            weaker: inhomogeneity::WEAKER.value,
            leakage_g_per_a: motor::leakage_g_per_a(motor::sensor_mm()),
            current_a: params::PEAK_TORQUE.value / params::TORQUE_CONSTANT.value,
            rigidity_n_per_mm: rigidity::n_per_mm(),
            draws: Draws::new(seed, draws),
        }
    }
}

/// What one cause does to a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// The cause.
    pub name: &'static str,
    /// What the size is that of.
    pub meaning: &'static str,
    /// Norm of the field that it adds, in gauss.
    pub gauss: f64,
    /// The greater of the two forces that the sensor makes of it, in newtons; infinite where the sensor
    /// is blind to one of the forces.
    pub newtons: f64,
    /// The same as [`Shift::gauss`] in the sensor's resolutions.
    pub resolutions: f64,
}

impl Shift {
    fn new(
        (name, meaning): (&'static str, &'static str),
        (gauss, newtons): (f64, f64),
        sensed: &Sensed,
    ) -> Self {
        Self {
            name,
            meaning,
            gauss,
            newtons,
            resolutions: gauss / sensed.resolution_g,
        }
    }
}

/// All of them, each at its greatest, in the order of this module's list.
pub fn of(sensed: &Sensed, around: &Surroundings) -> Vec<Shift> {
    let rest = Inverse::at(&sensed.model, [0.0; 2]);
    let [mounted, tared] = misalignment::shifts(sensed, &rest, &around.draws);
    vec![
        earth::shift(sensed, &rest, around),
        mounted,
        tared,
        neighbour::shift(sensed, &rest, around),
        inhomogeneity::shift(sensed, around),
        motor::shift(sensed, &rest, around),
        rigidity::shift(sensed, &rest, around),
    ]
}

/// Constants of all of them, for a card.
pub const ASSUMED: [params::Constant; 17] = [
    earth::LEAST,
    earth::GREATEST,
    misalignment::OFFSET,
    misalignment::GAP,
    misalignment::TILT,
    misalignment::REMANENCE,
    neighbour::CLOSED,
    inhomogeneity::WEAKER,
    motor::TURNS,
    motor::RADIUS,
    motor::WIDTH,
    motor::LENGTH,
    motor::ALONG,
    motor::ASIDE,
    motor::TEETH,
    rigidity::LOAD,
    rigidity::DEFLECTION,
];

/// Norm of a shift and the greater of its forces.
fn sizes(shift_g: Vector3<f64>, inverse: &Inverse) -> (f64, f64) {
    (shift_g.norm(), inverse.greatest_n(shift_g))
}

#[cfg(test)]
mod tests;
