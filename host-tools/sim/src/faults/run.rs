//! Injects one fault in one operating state and evaluates detection, reaction and state transitions.

use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::parameters::Lead;
use crate::faults::hazards::HazardTable;
use crate::faults::injection::{EXPANSION_N, InjectedFault, expand};
use crate::faults::operating_state::{OperatingState, SET_N};
use crate::random::{Purpose, stream};
use firmware::config::constants::TICK_US;
use firmware::config::limits::GripLimits;
use firmware::grip::fault_reactions::{Reaction, fault_of};
use firmware::grip::states::{PowerState, TASK_CODE, TaskState, state_code};
use firmware::grip::transitions::{POWER_TRANSITIONS, TASK_TRANSITIONS};
use firmware::system::faults::{Event, Fault};
use model_export::inverse::quantise::TableSet;
use rand::RngExt;

/// Simulated time after the fault in ms: the host timeout of 100 ms, and a stop.
const AFTER_MS: u32 = 400;
/// Frames of a bus flood per millisecond.
const FLOOD_PER_MS: u32 = 20;
/// Time in which an object expands off centre, in ms: 18 kN/s.
const EXPANDS_MS: u32 = 20;
/// Largest distance of an object from the middle of a finger, as a share of half the sensors' distance, and its random stream.
const OFF_CENTRE: f64 = 0.8;
const OFF_CENTRE_DRAW: u32 = u32::MAX;

/// One run of the campaign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultCase {
    /// Injected fault.
    pub fault: InjectedFault,
    /// Operating state at the injection.
    pub state: OperatingState,
    /// Screw variant.
    pub lead: Lead,
    /// Contact stiffness of the object in N/mm.
    pub contact_n_per_mm: f64,
    /// Seed of the gripper, its noise and the time of injection.
    pub seed: u64,
}

/// What is seen after the fault: travel, forbidden transitions and restarts as in [`FaultOutcome`], and when the controller
/// left the CAN bus, in microseconds.
struct Observation {
    travel_mm: f64,
    forbidden: u32,
    restarts: u32,
    left_us: Option<u64>,
}

/// Result of one run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultOutcome {
    /// The operating state was reached.
    pub was_reached: bool,
    /// Detection latency in milliseconds; none where it was not detected.
    pub found_ms: Option<f64>,
    /// Peak true force after the fault in N, between or around the fingers.
    pub peak_n: f64,
    /// True force at the end, in N.
    pub end_n: f64,
    /// State at the end, as in the heartbeat.
    pub end: u8,
    /// The final state is one that the specified reaction leads to.
    pub is_as_specified: bool,
    /// Greatest distance of the fingers from their opening before the fault, in mm.
    pub travel_mm: f64,
    /// Transitions outside the state tables.
    pub forbidden: u32,
    /// Starts of the drive on its own after the fault had switched it off, while the host repeated its command.
    pub restarts: u32,
}

impl FaultCase {
    /// Runs the case; `change` may disable a detector.
    pub fn run(&self, tables: &TableSet, change: Option<fn(&mut ClosedLoopSetup)>) -> FaultOutcome {
        let mut setup = ClosedLoopSetup::scattered(self.lead, self.seed);
        let mut rng = stream(self.seed, Purpose::FaultInjection, OFF_CENTRE_DRAW);
        setup.towards_first = rng.random_range(-OFF_CENTRE..=OFF_CENTRE);
        if let Some(change) = change {
            change(&mut setup);
        }
        match self.state.reach(&setup, self.contact_n_per_mm, tables) {
            Some(cell) => self.inject(cell),
            None => FaultOutcome {
                was_reached: false,
                found_ms: None,
                peak_n: 0.0,
                end_n: 0.0,
                end: 0,
                is_as_specified: false,
                travel_mm: 0.0,
                forbidden: 0,
                restarts: 0,
            },
        }
    }

    fn inject(&self, mut cell: ClosedLoop) -> FaultOutcome {
        let mut rng = stream(self.seed, Purpose::FaultInjection, self.fault as u32);
        let (phase_us, pick) = (rng.random_range(0..1000_u64), rng.random_range(0..12_usize));
        cell.advance_us(phase_us);
        let at_us = cell.time_us() + phase_us;
        let mut observable_us = self.fault.observable_us(at_us, cell.time_us() + TICK_US);
        cell.board.events.borrow_mut().clear();
        let opening_mm = {
            let gripper = &mut *cell.gripper.borrow_mut();
            (gripper.peak_n, gripper.outward_peak_n) = (gripper.rig.plant.grip_n(), 0.0);
            (gripper.tripped, gripper.out_us) = (None, None);
            1e3 * gripper.rig.plant.opening_m()
        };
        self.fault.inject(&mut cell, pick);
        let Observation { travel_mm, forbidden, restarts, left_us } =
            self.observe(&mut cell, opening_mm);
        if let (InjectedFault::BusOff, Some(left_us)) = (self.fault, left_us) {
            observable_us = left_us;
        }
        let found_us = self.found_us(&cell);
        let gripper = cell.gripper.borrow();
        FaultOutcome {
            was_reached: true,
            found_ms: found_us.map(|us| 1e-3 * us.saturating_sub(observable_us) as f64),
            peak_n: gripper.peak_n.max(gripper.outward_peak_n),
            end_n: gripper.rig.plant.grip_n(),
            end: cell.state(),
            is_as_specified: self.is_specified(cell.state()),
            travel_mm,
            forbidden,
            restarts,
        }
    }

    fn observe(&self, cell: &mut ClosedLoop, opening_mm: f64) -> Observation {
        let mut seen = Observation { travel_mm: 0.0, forbidden: 0, restarts: 0, left_us: None };
        let (mut last, mut was_off) = (cell.state(), false);
        for ms in 0..AFTER_MS + GripLimits::GRIPPER.stop_ms {
            // A stop is simulated to its end.
            if ms >= AFTER_MS && last != PowerState::QuickStop as u8 {
                break;
            }
            match self.fault {
                InjectedFault::Flood => {
                    cell.board.connections.can.borrow_mut().flood(FLOOD_PER_MS);
                }
                InjectedFault::OverForceAside if ms <= EXPANDS_MS => {
                    let first = (SET_N / EXPANSION_N).min(1.0);
                    expand(cell, first + (1.0 - first) * f64::from(ms) / f64::from(EXPANDS_MS));
                }
                _ => {}
            }
            cell.tick();
            if seen.left_us.is_none() && cell.board.controller.is_off() {
                seen.left_us = Some(cell.time_us() - TICK_US);
            }
            let state = cell.state();
            // A restart may lead from any state to one without drive.
            let restarts =
                self.fault == InjectedFault::MemoryCorruption && state <= PowerState::Safe as u8;
            seen.forbidden += u32::from(!may_follow(last, state) && !restarts);
            // The host repeats its command; it must not restart the drive.
            was_off |= state < TASK_CODE;
            seen.restarts += u32::from(was_off && state >= TASK_CODE && last < TASK_CODE);
            let now_mm = 1e3 * cell.gripper.borrow().rig.plant.opening_m();
            seen.travel_mm = seen.travel_mm.max((now_mm - opening_mm).abs());
            last = state;
        }
        seen
    }

    fn found_us(&self, cell: &ClosedLoop) -> Option<u64> {
        if self.fault.is_found_by_motor() {
            let gripper = cell.gripper.borrow();
            return match self.fault.specification().fault {
                Fault::Supply => gripper.out_us,
                fault => gripper
                    .tripped
                    .filter(|(_, trip)| fault_of(*trip) == fault)
                    .map(|(at_us, _)| at_us),
            };
        }
        let fault = self.fault.specification().fault as u16;
        let events = cell.board.events.borrow();
        events.iter().find_map(|(time_us, event)| match event {
            Event::Fault(event_data) => {
                (event_data.code == fault && event_data.active != 0).then_some(*time_us)
            }
            _ => None,
        })
    }

    /// Whether a final state conforms to the specified reaction.
    pub fn is_specified(&self, state: u8) -> bool {
        let is = |task| state == state_code(PowerState::Enabled, task);
        let is_calibrating = state == PowerState::Calibrating as u8;
        let is_safe = state == PowerState::Safe as u8;
        let is_one = |tasks: &[TaskState]| tasks.iter().any(|task| is(*task));
        let continues = match self.state {
            OperatingState::Approach | OperatingState::Force | OperatingState::Hold => is_one(&[
                TaskState::HoldActive,
                TaskState::HoldLatched,
                TaskState::HoldFrozen,
                TaskState::Force,
            ]),
            OperatingState::Foot => is(TaskState::Foot),
            OperatingState::Idle => is(TaskState::Idle),
            OperatingState::Moving => is_one(&[TaskState::Moving, TaskState::Idle]),
            OperatingState::Homing => is(TaskState::Homing),
            OperatingState::Releasing | OperatingState::Opening => {
                is_one(&[TaskState::Releasing, TaskState::ContactStop, TaskState::Idle])
            }
            OperatingState::Calibrating => is_calibrating,
        };
        let without_host = match self.state {
            OperatingState::Homing => is_one(&[TaskState::Unhomed, TaskState::TimeoutHold]),
            OperatingState::Releasing => is(TaskState::GripFailed),
            OperatingState::Approach | OperatingState::Moving | OperatingState::Opening => {
                is(TaskState::TimeoutHold)
            }
            _ => false,
        };
        let stopped = state == PowerState::Armed as u8;
        let off = state == PowerState::Fault as u8;
        match (self.fault, self.state) {
            (InjectedFault::HostSilent | InjectedFault::BusOff, _) => without_host || continues,
            // Without current, or with shorted windings, a load backdrives this screw.
            (
                InjectedFault::Hot | InjectedFault::BusHigh | InjectedFault::BusLow,
                OperatingState::Hold,
            ) if self.lead == Lead::B => continues || stopped || off,
            (InjectedFault::ObjectGone, _) => is(TaskState::Lost),
            (InjectedFault::MemoryCorruption, _) => is_safe,
            (_, OperatingState::Calibrating) => {
                // Ends with the motor off.
                match self.fault.reaction(self.state, self.lead == Lead::A) {
                    Some(Reaction::Warn | Reaction::Hold) => continues,
                    Some(Reaction::QuickStop | Reaction::Brake | Reaction::Off) => is_safe,
                    None => false,
                }
            }
            _ => match self.fault.reaction(self.state, self.lead == Lead::A) {
                // At an obstacle the opening has ended, and the fault stops the fingers.
                Some(Reaction::Warn) if self.state == OperatingState::Opening => {
                    continues || stopped
                }
                Some(Reaction::Warn | Reaction::Hold) => continues || is(TaskState::Approach),
                Some(Reaction::QuickStop) => stopped,
                Some(Reaction::Brake | Reaction::Off) => off,
                None => false,
            },
        }
    }

    /// Maximum force in N by the hazard table: on a hand outside of a grip, and in a grip after a fault of one sensor. None
    /// elsewhere: in a grip something rigid is meant to be pressed.
    pub fn max_n(&self) -> Option<f64> {
        let bounds = HazardTable::gripper().bounds();
        match self.state {
            // It is injected as energy of the rotor.
            _ if self.fault == InjectedFault::OverSpeed => None,
            OperatingState::Moving | OperatingState::Homing | OperatingState::Opening => {
                Some(bounds.hand_n)
            }
            // The backdrive test grips with its own force.
            OperatingState::Calibrating => None,
            _ => self.fault.is_of_sensor().then_some(bounds.grip_n),
        }
    }

    /// Whether force, travel of a foot and restarts are within the bounds of the hazard table.
    pub fn is_bounded(&self, outcome: &FaultOutcome) -> bool {
        self.max_n().is_none_or(|max_n| outcome.peak_n <= max_n)
            && (self.state != OperatingState::Foot
                || outcome.travel_mm <= HazardTable::gripper().bounds().foot_mm)
            && outcome.restarts == 0
    }
}

/// Maximum number of transitions within a tick.
const MAX_TRANSITIONS: u32 = 2;

/// States reachable by one transition of the tables, as heartbeat codes.
fn successors(code: u8) -> Vec<u8> {
    let (power, task) = match TaskState::of_code(code) {
        Some(task) => (PowerState::Enabled, Some(task)),
        None => match PowerState::of_code(code) {
            Some(power) => (power, None),
            None => return Vec::new(),
        },
    };
    let powers = POWER_TRANSITIONS.iter().filter(|(from, ..)| *from == power);
    let mut codes: Vec<u8> = powers
        .flat_map(|(.., to)| match to {
            // The first task depends on homing and grip.
            PowerState::Enabled => vec![
                TASK_CODE + TaskState::Unhomed as u8,
                TASK_CODE + TaskState::GripFailed as u8,
                TASK_CODE + TaskState::Idle as u8,
                TASK_CODE + TaskState::Foot as u8,
                TASK_CODE + TaskState::Releasing as u8,
            ],
            to => vec![*to as u8],
        })
        .collect();
    let tasks = TASK_TRANSITIONS.iter().filter(|(from, ..)| Some(*from) == task);
    codes.extend(tasks.map(|(.., to)| TASK_CODE + *to as u8));
    codes
}

/// Whether a state may be observed one tick after another, both as heartbeat codes.
pub fn may_follow(from: u8, to: u8) -> bool {
    let mut reached = vec![from];
    for _ in 0..MAX_TRANSITIONS {
        if reached.contains(&to) {
            return true;
        }
        reached = reached.iter().flat_map(|code| successors(*code)).collect();
    }
    reached.contains(&to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::grip::states::state_code;

    #[test]
    fn transitions_outside_the_tables_are_forbidden() {
        let task = |task| state_code(PowerState::Enabled, task);
        assert!(may_follow(task(TaskState::Approach), task(TaskState::Force)));
        assert!(may_follow(task(TaskState::Idle), task(TaskState::Idle)));
        assert!(may_follow(task(TaskState::Approach), PowerState::QuickStop as u8));
        assert!(may_follow(PowerState::Armed as u8, task(TaskState::Idle)));
        assert!(!may_follow(PowerState::Fault as u8, task(TaskState::Idle)));
        assert!(!may_follow(PowerState::Safe as u8, task(TaskState::Idle)));
        assert!(!may_follow(task(TaskState::Foot), task(TaskState::Force)));
        assert!(!may_follow(task(TaskState::Idle), task(TaskState::HoldActive)));
    }
}
