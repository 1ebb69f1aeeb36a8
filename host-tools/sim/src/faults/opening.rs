//! RELEASE in every state and under every fault that does not concern motor and power stage: a person gets free.

use crate::closed_loop::grasp_rig::{contact_object, grip_command};
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::parameters::Lead;
use crate::faults::hazards::HazardTable;
use crate::faults::injection::InjectedFault;
use crate::faults::operating_state::{SET_N, motion};
use firmware::grip::commands::{flag, mode};
use firmware::grip::fault_reactions::Reaction;
use firmware::grip::states::{GripPhase, PowerState, TaskState};
use firmware::protocol::messages::Command;
use model_export::inverse::quantise::TableSet;

/// Contact stiffness of the object in N/mm, its width in mm, and the initial distance to it.
const CONTACT: f64 = 333.0;
const WIDTH_MM: f64 = 30.0;
const DISTANCE_MM: f64 = 2.0;
/// Time from the fault to RELEASE in s: a stop has ended.
const PAUSE_S: f64 = 0.3;
/// Longest time in s until the controller rejoins the CAN bus.
const REJOIN_S: f64 = 1.2;
/// Commanded opening beyond the present one in mm, and speed in mm/s.
const FARTHER_MM: f64 = 20.0;
const SPEED_MM_S: f64 = 20.0;

/// State in which the fault occurs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartState {
    /// A state of the enabled drive.
    Task(TaskState),
    /// A session, the drive disabled.
    Armed,
    /// After a restart of the board while it held an object.
    Restarted,
}

impl StartState {
    /// All states but foot mode, whose reason to refuse RELEASE is in the hazard table.
    pub fn all(lead: Lead) -> Vec<Self> {
        let is_reachable = |task: &TaskState| match task {
            TaskState::Foot => false,
            // Only a self-locking screw holds without current.
            TaskState::HoldLatched => lead == Lead::A,
            _ => true,
        };
        let tasks = TaskState::ALL.iter().copied().filter(is_reachable).map(Self::Task);
        tasks.chain([Self::Armed, Self::Restarted]).collect()
    }

    /// Brings a gripper into this state; none where it is not reached.
    fn reach(
        self,
        lead: Lead,
        seed: u64,
        (tables, change): (&TableSet, Option<fn(&mut ClosedLoopSetup)>),
    ) -> Option<ClosedLoop> {
        let is_task = |task| self == Self::Task(task);
        let is_unhomed = is_task(TaskState::Unhomed) || is_task(TaskState::Homing);
        let mut setup = ClosedLoopSetup {
            opening_mm: if is_task(TaskState::NoObject) { 3.0 } else { WIDTH_MM + DISTANCE_MM },
            is_homed: !is_unhomed,
            ..ClosedLoopSetup::scattered(lead, seed)
        };
        if let Some(change) = change {
            change(&mut setup);
        }
        let mut cell = ClosedLoop::new(&setup, tables);
        let without_object = [
            TaskState::Unhomed,
            TaskState::Homing,
            TaskState::Idle,
            TaskState::Moving,
            TaskState::Stopping,
            TaskState::TimeoutHold,
            TaskState::NoObject,
        ];
        if !without_object.into_iter().any(is_task) {
            let object = contact_object(&setup.plant, WIDTH_MM, CONTACT);
            cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
        }
        if !cell.enable() {
            return None;
        }
        cell.run(0.3);
        match self {
            Self::Task(task) => enter(&mut cell, task)?,
            Self::Armed => {
                cell.host.order(Command { mode: mode::DISABLE, ..Command::default() });
                cell.until(0.2, |cell| cell.state() == PowerState::Armed as u8)?;
            }
            Self::Restarted => {
                enter(&mut cell, TaskState::HoldActive)?;
                InjectedFault::MemoryCorruption.inject(&mut cell, 0);
                cell.until(0.5, |cell| cell.state() == PowerState::Safe as u8)?;
            }
        }
        Some(cell)
    }
}

/// Brings an enabled gripper into a task state.
fn enter(cell: &mut ClosedLoop, task: TaskState) -> Option<()> {
    let close = motion(mode::MOVE, 2.0, 20.0);
    let stop = Command { mode: mode::STOP, ..Command::default() };
    match task {
        TaskState::Unhomed | TaskState::Idle | TaskState::Foot => {}
        TaskState::Homing => {
            cell.host.order(Command { mode: mode::HOME, ..Command::default() });
        }
        TaskState::Moving | TaskState::ContactStop => cell.host.order(close),
        TaskState::Stopping => {
            cell.host.order(close);
            cell.run(0.2);
            cell.host.order(stop);
        }
        TaskState::TimeoutHold => {
            cell.host.order(close);
            cell.run(0.2);
            cell.host.is_silent = true;
        }
        TaskState::Approach
        | TaskState::Force
        | TaskState::HoldActive
        | TaskState::HoldLatched
        | TaskState::NoObject => cell.host.order(grip_command(SET_N)),
        TaskState::GripFailed => {
            // The object is wider than expected: 1 mm around 10 mm.
            let window = 1 << flag::WINDOW.trailing_zeros();
            let grip = grip_command(SET_N);
            cell.host.order(Command { position: 200, flags: grip.flags | window, ..grip });
        }
        TaskState::HoldFrozen | TaskState::Lost | TaskState::Releasing => {
            enter(cell, TaskState::HoldActive)?;
            match task {
                TaskState::HoldFrozen => InjectedFault::AllSensorsGone.inject(cell, 0),
                TaskState::Lost => cell.gripper.borrow_mut().rig.plant.set_object(None),
                _ => cell.host.order(motion(mode::RELEASE, WIDTH_MM + FARTHER_MM, SPEED_MM_S)),
            }
        }
    }
    cell.until(4.0, |cell| cell.is_in(task)).map(|_| ())
}

/// One RELEASE under a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpeningCase {
    /// State at the fault.
    pub state: StartState,
    /// The fault.
    pub fault: InjectedFault,
    /// Screw.
    pub lead: Lead,
    /// Seed of the gripper and its noise.
    pub seed: u64,
}

/// Result of a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpeningOutcome {
    /// The state was reached.
    pub was_reached: bool,
    /// Travel of the fingers in mm within the time of the hazard table.
    pub opened_mm: f64,
    /// State at the end, as in the heartbeat.
    pub end: u8,
}

impl OpeningCase {
    /// All cases with a seed.
    pub fn all(seed: u64) -> Vec<Self> {
        let faults = InjectedFault::ALL.into_iter().filter(|fault| allows_opening(*fault));
        let cases = faults.flat_map(|fault| {
            let of_lead = move |lead| {
                let states = StartState::all(lead).into_iter();
                states.map(move |state| Self { state, fault, lead, seed })
            };
            Lead::BOTH.into_iter().flat_map(of_lead)
        });
        cases.collect()
    }

    /// Runs the case; `change` may disable a protection.
    pub fn run(
        &self,
        tables: &TableSet,
        change: Option<fn(&mut ClosedLoopSetup)>,
    ) -> OpeningOutcome {
        let (_, within_s) = HazardTable::gripper().bounds().opens;
        let Some(mut cell) = self.state.reach(self.lead, self.seed, (tables, change)) else {
            return OpeningOutcome { was_reached: false, opened_mm: 0.0, end: 0 };
        };
        self.fault.inject(&mut cell, self.seed as usize % 12);
        cell.run(PAUSE_S);
        // A command arrives only once host and bus work again.
        cell.host.is_silent = false;
        cell.board.connections.can.borrow_mut().disturbed = false;
        if self.fault == InjectedFault::BusOff {
            cell.run(REJOIN_S);
        }
        let opening_mm = |cell: &ClosedLoop| 1e3 * cell.gripper.borrow().rig.plant.opening_m();
        let from_mm = opening_mm(&cell);
        open_session(&mut cell);
        let release = motion(mode::RELEASE, from_mm + FARTHER_MM, SPEED_MM_S);
        cell.host.order(Command { flags: flag::AGAIN, ..release });
        cell.run(within_s);
        OpeningOutcome {
            was_reached: true,
            opened_mm: opening_mm(&cell) - from_mm,
            end: cell.state(),
        }
    }
}

/// Opens a session where the board has none.
fn open_session(cell: &mut ClosedLoop) {
    let has_session = |cell: &ClosedLoop| {
        TaskState::of_code(cell.state()).is_some() || cell.state() == PowerState::Armed as u8
    };
    if !has_session(cell) {
        cell.host.arm();
        cell.until(0.3, has_session);
    }
}

/// Whether the hazard table demands that RELEASE works under a fault. A locked rotor cannot turn, a power stage that is too
/// hot gets no current, and foot mode refuses.
pub fn allows_opening(fault: InjectedFault) -> bool {
    let code = fault.specification().fault;
    let reaction = HazardTable::gripper().reaction(code, GripPhase::Releasing, true);
    let is_prevented =
        matches!(fault, InjectedFault::Jam | InjectedFault::Hot | InjectedFault::FootOverload);
    reaction.is_some_and(|reaction| reaction < Reaction::QuickStop) && !is_prevented
}
