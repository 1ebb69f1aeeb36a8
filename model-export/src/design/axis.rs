//! One axis of a design: what a force does to its flexure and its magnet.

use nalgebra::Vector3;

use super::beam::{Beam, Bent};
use super::design::Design;
use super::material::Strength;
use crate::physics::State;

/// The lateral or the longitudinal axis.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// 0 for the lateral, 1 for the longitudinal.
    pub number: usize,
    /// The beam.
    pub beam: Beam,
    /// What it is made of.
    pub strength: Strength,
    /// Compliance of what the beam stands on, in m/N.
    pub mount_m_per_n: f64,
}

/// An axis under a force.
#[derive(Clone, Copy, Debug)]
pub struct Moved {
    /// Motion of the magnet along the force, beam and mount, in mm.
    pub motion_mm: f64,
    /// Lean of the magnet, in rad.
    pub lean_rad: f64,
    /// How far the magnet comes towards the sensor, in mm.
    pub nearer_mm: f64,
    /// The beam.
    pub bent: Bent,
}

impl Axis {
    /// Axis 0 (lateral) or 1 (longitudinal) of a design.
    pub fn of(design: &Design, number: usize) -> Self {
        let strength = design.strength(number);
        Self {
            number,
            beam: design.flexure(number).beam(&strength),
            strength,
            mount_m_per_n: design.mount_m_per_n(number),
        }
    }

    /// Under a force in N. As the effect `tip_slope` has it, a beam stands along the gap: a tip that comes
    /// down closes it (assumed).
    pub fn under(&self, force_n: f64) -> Moved {
        let bent = self.beam.bend(force_n);
        Moved {
            motion_mm: 1e3 * (bent.deflection_m + self.mount_m_per_n * force_n),
            lean_rad: bent.slope_rad,
            nearer_mm: 1e3 * bent.shortening_m,
            bent,
        }
    }

    /// Unit vector of its motion, gripper's axes.
    pub fn direction(&self) -> Vector3<f64> {
        match self.number {
            0 => Vector3::x(),
            _ => Vector3::z(),
        }
    }

    /// State of the sensor under that motion.
    pub fn state(&self, moved: &Moved) -> State {
        let across = self.direction() * moved.motion_mm;
        let mut state = State::displaced(across - Vector3::y() * moved.nearer_mm);
        // Moving along x leans the axis about z, and the other way round.
        state.lean_rad[1 - self.number] = moved.lean_rad;
        state
    }
}
