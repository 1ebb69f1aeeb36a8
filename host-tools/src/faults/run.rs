//! One fault in one situation, and what became of it.

use embedded_can::{Frame, StandardId};
use firmware::events::Event;
use firmware::grip::react::{Reaction, fault_of};
use firmware::grip::states::{Power, TASK_CODE, Task, code};
use firmware::limits::Grasp;
use firmware::params::TICK_US;
use firmware::status::Fault;
use firmware::wire::can::CanFrame;
use firmware::wire::{DEFAULT_NODE, identifier};
use model_export::inverse::quantise::TableSet;
use rand::RngExt;

use super::path::may_follow;
use super::row::Row;
use super::situation::{SET_N, Situation};
use crate::bench::draw::{Purpose, stream};
use crate::drive::workcell::{Plan, Workcell};
use crate::plant::parameters::{Lead, Parameters};

/// What is uncertain is off by up to this share.
const SCATTER: f64 = 0.2;
/// Milliseconds after the fault: a host is missed after 100, and then a stop takes its time.
const AFTER_MS: u32 = 400;
/// Movement of a foot's fingers that is one, in mm.
const MOVED_MM: f64 = 0.1;
/// A flood's frames in a millisecond, and how many of them wait at the most.
const FLOOD: (usize, usize) = (20, 50);

/// What is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// The fault.
    pub row: Row,
    /// When it comes.
    pub situation: Situation,
    /// The screw.
    pub lead: Lead,
    /// What there is to grip, in newtons to the millimetre.
    pub contact_n_per_mm: f64,
    /// Of the gripper, its noise, and the moment.
    pub seed: u64,
}

/// What became of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The situation came about.
    pub was_reached: bool,
    /// Milliseconds until it was found.
    pub found_ms: Option<f64>,
    /// Greatest true force after the fault, in N.
    pub peak_n: f64,
    /// True force at the end, in N.
    pub end_n: f64,
    /// The state at the end, as in the heartbeat.
    pub end: u8,
    /// The state at the end is one that its reaction leads to.
    pub is_as_specified: bool,
    /// Steps that no table lists, a foot that moved, a drive that came back by itself.
    pub forbidden: u32,
}

impl Case {
    /// Runs it; `change` may raise a detector out of reach.
    pub fn run(&self, tables: &TableSet, change: Option<fn(&mut Plan)>) -> Outcome {
        let mut plan = Plan {
            plant: Parameters::scattered(self.lead, SCATTER, self.seed),
            ..Plan::nominal(self.lead, 0.0, self.seed)
        };
        if let Some(change) = change {
            change(&mut plan);
        }
        let reached = self.situation.reach(&plan, self.contact_n_per_mm, tables);
        match reached {
            Some(cell) => self.throw(cell),
            None => Outcome {
                was_reached: false,
                found_ms: None,
                peak_n: 0.0,
                end_n: 0.0,
                end: 0,
                is_as_specified: false,
                forbidden: 0,
            },
        }
    }

    fn throw(&self, mut cell: Workcell) -> Outcome {
        let mut rng = stream(self.seed, Purpose::Mischance, self.row as u32);
        let (phase_us, pick) = (rng.random_range(0..1000_u64), rng.random_range(0..12_usize));
        cell.creep(phase_us);
        let at_us = cell.time_us() + phase_us;
        let mut shows_us = self.row.shows_us(at_us, cell.time_us() + TICK_US);
        cell.board.events.borrow_mut().clear();
        let opening_mm = {
            let gripper = &mut *cell.gripper.borrow_mut();
            gripper.peak_n = gripper.rig.plant.grip_n();
            (gripper.tripped, gripper.out_us) = (None, None);
            1e3 * gripper.rig.plant.opening_m()
        };
        self.row.inject(&mut cell, pick);
        let (forbidden, left_us) = self.watch(&mut cell, opening_mm);
        if let (Row::BusOff, Some(left_us)) = (self.row, left_us) {
            shows_us = left_us;
        }
        let found_us = self.found_us(&cell);
        let gripper = cell.gripper.borrow();
        Outcome {
            was_reached: true,
            found_ms: found_us.map(|us| 1e-3 * us.saturating_sub(shows_us) as f64),
            peak_n: gripper.peak_n,
            end_n: gripper.rig.plant.grip_n(),
            end: cell.state(),
            is_as_specified: self.is_specified(cell.state()),
            forbidden,
        }
    }

    /// Looks on; what happened that may not, and when the controller left the CAN bus, to a millisecond.
    fn watch(&self, cell: &mut Workcell, opening_mm: f64) -> (u32, Option<u64>) {
        let (mut forbidden, mut left_us) = (0, None);
        let (mut last, mut was_off, mut has_moved) = (cell.state(), false, false);
        for ms in 0..AFTER_MS + Grasp::GRIPPER.stop_ms {
            // What is stopping comes to where it stops.
            if ms >= AFTER_MS && last != Power::QuickStop as u8 {
                break;
            }
            if self.row == Row::Flood {
                flood(cell);
            }
            cell.tick();
            if left_us.is_none() && cell.board.controller.is_off() {
                left_us = Some(cell.time_us() - TICK_US);
            }
            let state = cell.state();
            // A restart leads from wherever it was to where nothing is driven.
            let restarts = self.row == Row::Corrupted && state <= Power::Safe as u8;
            forbidden += u32::from(!may_follow(last, state) && !restarts);
            // The host repeats its order for ever: nothing of it may begin again.
            was_off |= state < TASK_CODE;
            forbidden += u32::from(was_off && state >= TASK_CODE && last < TASK_CODE);
            let now_mm = 1e3 * cell.gripper.borrow().rig.plant.opening_m();
            has_moved |= (now_mm - opening_mm).abs() > MOVED_MM;
            last = state;
        }
        forbidden += u32::from(self.situation == Situation::Foot && has_moved);
        (forbidden, left_us)
    }

    fn found_us(&self, cell: &Workcell) -> Option<u64> {
        if self.row.is_found_by_motor() {
            let gripper = cell.gripper.borrow();
            return match self.row.facts().fault {
                Fault::Supply => gripper.out_us,
                fault => gripper
                    .tripped
                    .filter(|(_, trip)| fault_of(*trip) == fault)
                    .map(|(at_us, _)| at_us),
            };
        }
        let fault = self.row.facts().fault as u16;
        let events = cell.board.events.borrow();
        events.iter().find_map(|(time_us, event)| match event {
            Event::Fault(told) => (told.code == fault && told.active != 0).then_some(*time_us),
            _ => None,
        })
    }

    /// Whether a state is where the reaction ends.
    pub fn is_specified(&self, state: u8) -> bool {
        let is = |task| state == code(Power::Enabled, task);
        let goes_on = match self.situation {
            Situation::Approach | Situation::Force | Situation::Hold => {
                is(Task::HoldActive)
                    || is(Task::HoldLatched)
                    || is(Task::HoldFrozen)
                    || is(Task::Force)
            }
            Situation::Foot => is(Task::Foot),
            Situation::Idle => is(Task::Idle),
        };
        let stopped = state == Power::Armed as u8;
        let off = state == Power::Fault as u8;
        match (self.row, self.situation) {
            (Row::HostSilent | Row::BusOff, Situation::Approach) => {
                is(Task::TimeoutHold) || goes_on
            }
            // Without current, or with windings shorted, a load drives the screw back.
            (Row::Hot | Row::BusHigh | Row::BusLow, Situation::Hold) if self.lead == Lead::B => {
                goes_on || stopped || off
            }
            (Row::ObjectGone, _) => is(Task::Lost),
            (Row::Corrupted, _) => state == Power::Safe as u8,
            _ => match self.row.reaction(self.situation, self.lead == Lead::A) {
                Reaction::Warn | Reaction::Hold => goes_on || is(Task::Approach),
                Reaction::QuickStop => stopped,
                Reaction::Brake | Reaction::Off => off,
            },
        }
    }

    /// Whether a force was too great for a fault of one sensor.
    pub fn is_too_much(&self, outcome: &Outcome) -> bool {
        self.row.is_of_sensor() && outcome.peak_n > 1.1 * SET_N
    }
}

/// Frames of a millisecond that mean nothing.
fn flood(cell: &Workcell) {
    let (frames, waiting) = FLOOD;
    let mut can = cell.board.connections.can.borrow_mut();
    for _ in 0..frames {
        let id = StandardId::new(identifier(DEFAULT_NODE, 0x1F));
        let frame = id.and_then(|id| CanFrame::new(id, &[]));
        if let Some(frame) = frame.filter(|_| can.waiting() < waiting) {
            can.put(frame);
        }
    }
}
