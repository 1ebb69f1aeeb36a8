//! Operating states in which faults are injected.

use crate::closed_loop::grasp_rig::{contact_object, grip_command, object_width_mm};
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::parameters::Lead;
use firmware::grip::commands::mode;
use firmware::grip::states::{GripPhase, TaskState};
use firmware::protocol::messages::Command;
use model_export::inverse::quantise::TableSet;

/// Force set-point of the grasps, in N.
pub const SET_N: f64 = 100.0;
/// Initial distance to the object in mm.
const DISTANCE_MM: f64 = 1.5;
/// Opening of closed fingers, in mm.
const FLAT_MM: f64 = 0.5;

/// Operating state at the injection of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatingState {
    /// The fingers approach an object.
    Approach,
    /// Contact; the force rises.
    Force,
    /// The force set-point is reached.
    Hold,
    /// The closed gripper serves as a foot.
    Foot,
    /// Enabled, at rest, without an object.
    Idle,
}

impl OperatingState {
    /// All operating states.
    pub const ALL: [Self; 5] = [Self::Approach, Self::Force, Self::Hold, Self::Foot, Self::Idle];

    /// Column of the fault matrix.
    pub const fn phase(self) -> GripPhase {
        match self {
            Self::Approach | Self::Force | Self::Idle => GripPhase::Moving,
            Self::Hold => GripPhase::Holding,
            Self::Foot => GripPhase::Foot,
        }
    }

    /// Brings a gripper into this state with an object of `contact_n_per_mm`; none where it is not reached.
    pub fn reach(
        self,
        setup: &ClosedLoopSetup,
        contact_n_per_mm: f64,
        tables: &TableSet,
    ) -> Option<ClosedLoop> {
        let width_mm = object_width_mm(SET_N, contact_n_per_mm);
        let setup = ClosedLoopSetup {
            opening_mm: match self {
                Self::Foot => FLAT_MM,
                _ => width_mm + DISTANCE_MM,
            },
            ..setup.clone()
        };
        let mut cell = ClosedLoop::new(&setup, tables);
        let object = contact_object(&setup.plant, width_mm, contact_n_per_mm);
        if matches!(self, Self::Approach | Self::Force | Self::Hold) {
            cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
        }
        if !cell.enable() {
            return None;
        }
        // Settling of the disturbance detector's mean, and of the resting fingers.
        cell.run(0.3);
        match self {
            Self::Idle => {}
            Self::Foot => {
                cell.host.order(Command { mode: mode::FOOT, ..Command::default() });
                cell.until(0.2, |cell| cell.is_in(TaskState::Foot))?;
            }
            Self::Approach => {
                cell.host.order(grip_command(SET_N));
                cell.until(0.2, |cell| cell.is_in(TaskState::Approach))?;
                cell.run(0.04);
            }
            Self::Force => {
                cell.host.order(grip_command(SET_N));
                cell.until(1.0, |cell| cell.is_in(TaskState::Force))?;
                cell.run(0.005);
            }
            Self::Hold => {
                cell.host.order(grip_command(SET_N));
                cell.until(4.0, |cell| cell.is_in(TaskState::HoldActive))?;
                let settles_s = if setup.lead == Lead::A { 0.35 } else { 0.2 };
                cell.run(settles_s);
            }
        }
        Some(cell)
    }
}
