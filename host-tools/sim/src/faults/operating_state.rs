//! Operating states in which faults are injected.

use crate::closed_loop::grasp_rig::{contact_object, grip_command, object_width_mm};
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::parameters::Lead;
use firmware::grip::commands::mode;
use firmware::grip::states::{GripPhase, PowerState, TaskState};
use firmware::motor::calibration::CalibrationKind;
use firmware::protocol::messages::Command;
use firmware::protocol::session::op;
use model_export::inverse::quantise::TableSet;

/// Force set-point of the grasps, in N.
pub const SET_N: f64 = 100.0;
/// Stiffness of a hand or an arm between, or around, the fingers, in N/mm.
pub const HAND_N_PER_MM: f64 = 10.0;
/// Initial distance to the object in mm.
const DISTANCE_MM: f64 = 1.5;
/// Opening of closed fingers, in mm.
const FLAT_MM: f64 = 0.5;
/// Moves: initial opening and target, and the width of the hand between the fingers, in mm.
const FROM_MM: f64 = 60.0;
const TO_MM: f64 = 5.0;
const HAND_MM: f64 = 45.0;
/// Openings: initial opening, target, and the width inside of what is around the fingers, in mm.
const INSIDE_MM: f64 = 30.0;
const TUBE_MM: f64 = 40.0;

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
    /// The fingers close to an opening; a hand is between them.
    Moving,
    /// The fingers close to find their zero.
    Homing,
    /// The fingers have begun to release an object.
    Releasing,
    /// The fingers open inside of something soft.
    Opening,
    /// The backdrive test grips a part.
    Calibrating,
}

impl OperatingState {
    /// All operating states.
    pub const ALL: [Self; 10] = [
        Self::Approach,
        Self::Force,
        Self::Hold,
        Self::Foot,
        Self::Idle,
        Self::Moving,
        Self::Homing,
        Self::Releasing,
        Self::Opening,
        Self::Calibrating,
    ];

    /// Column of the hazard table.
    pub const fn phase(self) -> GripPhase {
        match self {
            Self::Approach
            | Self::Force
            | Self::Idle
            | Self::Moving
            | Self::Homing
            | Self::Calibrating => GripPhase::Moving,
            Self::Hold => GripPhase::Holding,
            Self::Releasing | Self::Opening => GripPhase::Releasing,
            Self::Foot => GripPhase::Foot,
        }
    }

    /// Whether an object of some stiffness is gripped, or will be.
    pub const fn has_object(self) -> bool {
        matches!(
            self,
            Self::Approach | Self::Force | Self::Hold | Self::Releasing | Self::Calibrating
        )
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
                Self::Moving => FROM_MM,
                Self::Opening | Self::Homing => INSIDE_MM,
                _ => width_mm + DISTANCE_MM,
            },
            ..setup.clone()
        };
        let mut cell = ClosedLoop::new(&setup, tables);
        {
            let plant = &mut cell.gripper.borrow_mut().rig.plant;
            if self.has_object() {
                plant.set_object(Some(&contact_object(&setup.plant, width_mm, contact_n_per_mm)));
            }
            if self == Self::Moving {
                plant.set_object(Some(&contact_object(&setup.plant, HAND_MM, HAND_N_PER_MM)));
            }
            if self == Self::Opening {
                let around = contact_object(&setup.plant, TUBE_MM, HAND_N_PER_MM);
                plant.set_outer_object(Some(&around));
            }
        }
        if self == Self::Calibrating {
            return calibrating(cell);
        }
        if !cell.enable() {
            return None;
        }
        // Settling of the disturbance detector's mean, and of the resting fingers.
        cell.run(0.3);
        self.enter(&mut cell, setup.lead, width_mm)?;
        Some(cell)
    }

    fn enter(self, cell: &mut ClosedLoop, lead: Lead, width_mm: f64) -> Option<()> {
        let (task, order, settles_s) = match self {
            Self::Idle | Self::Calibrating => return Some(()),
            Self::Foot => {
                (TaskState::Foot, Command { mode: mode::FOOT, ..Command::default() }, 0.0)
            }
            Self::Approach => (TaskState::Approach, grip_command(SET_N), 0.04),
            Self::Force => (TaskState::Force, grip_command(SET_N), 0.005),
            Self::Hold | Self::Releasing => {
                let settles_s = if lead == Lead::A { 0.35 } else { 0.2 };
                (TaskState::HoldActive, grip_command(SET_N), settles_s)
            }
            Self::Moving => (TaskState::Moving, motion(mode::MOVE, TO_MM, 40.0), 0.15),
            Self::Homing => {
                (TaskState::Homing, Command { mode: mode::HOME, ..Command::default() }, 0.2)
            }
            Self::Opening => (TaskState::Releasing, motion(mode::RELEASE, FROM_MM, 20.0), 0.3),
        };
        cell.host.order(order);
        cell.until(4.0, |cell| cell.is_in(task))?;
        cell.run(settles_s);
        if self == Self::Releasing {
            cell.host.order(motion(mode::RELEASE, width_mm + 20.0, 40.0));
            cell.until(0.2, |cell| cell.is_in(TaskState::Releasing))?;
            cell.run(0.005);
        }
        Some(())
    }
}

/// Starts the backdrive test; the part is gripped when it returns.
fn calibrating(mut cell: ClosedLoop) -> Option<ClosedLoop> {
    if !cell.is_ready_within(1.0) {
        return None;
    }
    cell.run(0.3);
    cell.host.service(op::MEASURE, CalibrationKind::Screw as u32);
    cell.until(0.2, |cell| cell.state() == PowerState::Calibrating as u8)?;
    cell.run(0.45);
    (cell.state() == PowerState::Calibrating as u8).then_some(cell)
}

/// Command to an opening in mm with a speed in mm/s.
pub fn motion(mode: u8, opening_mm: f64, speed_mm_s: f64) -> Command {
    Command {
        mode,
        position: (20.0 * opening_mm) as u16,
        speed: (4.0 * speed_mm_s) as u8,
        ..Command::default()
    }
}
