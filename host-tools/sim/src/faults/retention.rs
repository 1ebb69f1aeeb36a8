//! A gripped part stays gripped when the gripper is stopped.

use crate::closed_loop::grasp_rig::{contact_object, grip_command, object_width_mm};
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::parameters::Lead;
use crate::faults::injection::InjectedFault;
use crate::random::{Purpose, stream};
use firmware::grip::commands::mode;
use firmware::grip::states::TaskState;
use firmware::protocol::messages::Command;
use model_export::inverse::quantise::TableSet;
use rand::RngExt;

/// Grip forces in N, and contact stiffnesses in N/mm.
const FORCES_N: [f64; 2] = [20.0, 350.0];
const CONTACTS: [f64; 2] = [50.0, 333.0];
/// Initial distance to the part in mm.
const DISTANCE_MM: f64 = 1.5;
/// Time after the stop in s.
const AFTER_S: f64 = 2.0;

/// What stops the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopCause {
    /// Command STOP.
    Command,
    /// Stop frame, which a quick stop follows.
    Frame,
    /// All sensors fail.
    NoSensors,
    /// The host falls silent.
    HostSilent,
}

impl StopCause {
    /// All causes.
    pub const ALL: [Self; 4] = [Self::Command, Self::Frame, Self::NoSensors, Self::HostSilent];

    /// Description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Command => "part of 20 to 350 N held: STOP",
            Self::Frame => "part of 20 to 350 N held: stop frame",
            Self::NoSensors => "part of 20 to 350 N held: all sensors fail",
            Self::HostSilent => "part of 20 to 350 N held: host silent",
        }
    }
}

/// A grip that is stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RetentionCase {
    /// What stops the gripper.
    pub cause: StopCause,
    /// Screw.
    pub lead: Lead,
    /// Grip force in N.
    pub set_n: f64,
    /// Contact stiffness in N/mm.
    pub contact_n_per_mm: f64,
    /// Seed of the gripper and its noise.
    pub seed: u64,
}

impl RetentionCase {
    /// Draws a case; the screws alternate.
    pub fn draw(cause: StopCause, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::FaultInjection, 100 + cause as u32);
        let mut logarithmic = |[from, to]: [f64; 2]| from * (to / from).powf(rng.random());
        Self {
            cause,
            lead: Lead::BOTH[seed as usize % 2],
            set_n: logarithmic(FORCES_N),
            contact_n_per_mm: logarithmic(CONTACTS),
            seed,
        }
    }

    /// Least true force after the stop, as a share of the force before; none where nothing was gripped. `change` may disable
    /// a protection.
    pub fn run(&self, tables: &TableSet, change: Option<fn(&mut ClosedLoopSetup)>) -> Option<f64> {
        let width_mm = object_width_mm(self.set_n, self.contact_n_per_mm);
        let mut setup = ClosedLoopSetup {
            opening_mm: width_mm + DISTANCE_MM,
            ..ClosedLoopSetup::scattered(self.lead, self.seed)
        };
        if let Some(change) = change {
            change(&mut setup);
        }
        let mut cell = ClosedLoop::new(&setup, tables);
        let object = contact_object(&setup.plant, width_mm, self.contact_n_per_mm);
        cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
        if !cell.enable() {
            return None;
        }
        cell.run(0.3);
        cell.host.order(grip_command(self.set_n));
        cell.until(6.0, |cell| cell.is_in(TaskState::HoldActive))?;
        cell.run(0.1);
        let before_n = cell.force_n();
        match self.cause {
            StopCause::Command => {
                cell.host.order(Command { mode: mode::STOP, ..Command::default() });
            }
            StopCause::Frame => cell.host.stop(),
            StopCause::NoSensors => InjectedFault::AllSensorsGone.inject(&mut cell, 0),
            StopCause::HostSilent => cell.host.is_silent = true,
        }
        let mut least_n = before_n;
        for _ in 0..(1e3 * AFTER_S) as u32 {
            cell.tick();
            least_n = least_n.min(cell.force_n());
        }
        Some(least_n / before_n)
    }
}
