//! What the gripper does as a fault comes.

use firmware::grip::order::mode;
use firmware::grip::states::{Phase, Task};
use firmware::wire::messages::Command;
use model_export::inverse::quantise::TableSet;

use crate::drive::grasp::{grip_command, object};
use crate::drive::workcell::{Plan, Workcell};
use crate::plant::parameters::Lead;

/// Force of the grasps, in N.
pub const SET_N: f64 = 100.0;
/// Width of what is gripped, in mm, where it does not give way by more.
const WIDTH_MM: f64 = 40.0;
/// What is left of it, in mm.
const LEFT_MM: f64 = 5.0;
/// Before the object, in mm.
const BEFORE_MM: f64 = 1.5;
/// Opening of closed fingers, in mm.
const FLAT_MM: f64 = 0.5;

/// A situation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Situation {
    /// The fingers close on something.
    Approach,
    /// They touch it, and the force rises.
    Force,
    /// The force is held.
    Hold,
    /// A foot on closed fingers.
    Foot,
    /// Enabled, at rest, nothing gripped.
    Idle,
}

impl Situation {
    /// All.
    pub const ALL: [Self; 5] = [
        Self::Approach,
        Self::Force,
        Self::Hold,
        Self::Foot,
        Self::Idle,
    ];

    /// The column of the matrix that it stands for.
    pub const fn phase(self) -> Phase {
        match self {
            Self::Approach | Self::Force | Self::Idle => Phase::Moving,
            Self::Hold => Phase::Holding,
            Self::Foot => Phase::Foot,
        }
    }

    /// Brings a gripper into it; `contact_n_per_mm` is what there is to grip. None where it does not come to it,
    /// which no fault excuses.
    pub fn reach(self, plan: &Plan, contact_n_per_mm: f64, tables: &TableSet) -> Option<Workcell> {
        let width_mm = WIDTH_MM.max(SET_N / contact_n_per_mm + LEFT_MM);
        let plan = Plan {
            opening_mm: match self {
                Self::Foot => FLAT_MM,
                _ => width_mm + BEFORE_MM,
            },
            ..plan.clone()
        };
        let mut cell = Workcell::new(&plan, tables);
        let thing = object(&plan.plant, width_mm, contact_n_per_mm);
        if matches!(self, Self::Approach | Self::Force | Self::Hold) {
            cell.gripper.borrow_mut().rig.plant.hold(Some(&thing));
        }
        if !cell.enable() {
            return None;
        }
        // The watch for magnets knows its means, and a foot that its fingers rest.
        cell.run(0.3);
        match self {
            Self::Idle => {}
            Self::Foot => {
                cell.host.order(Command {
                    mode: mode::FOOT,
                    ..Command::default()
                });
                cell.until(0.2, |cell| cell.is_in(Task::Foot))?;
            }
            Self::Approach => {
                cell.host.order(grip_command(SET_N));
                cell.until(0.2, |cell| cell.is_in(Task::Approach))?;
                cell.run(0.04);
            }
            Self::Force => {
                cell.host.order(grip_command(SET_N));
                cell.until(1.0, |cell| cell.is_in(Task::Force))?;
                cell.run(0.005);
            }
            Self::Hold => {
                cell.host.order(grip_command(SET_N));
                cell.until(4.0, |cell| cell.is_in(Task::HoldActive))?;
                let settles_s = if plan.lead == Lead::A { 0.35 } else { 0.2 };
                cell.run(settles_s);
            }
        }
        Some(cell)
    }
}
