//! A gripper with its board and a host on the CAN bus: the whole way from Hall sensors, over bytes on the sensor
//! buses, forces and grasp, to the pulses; and from frames of the host to what it hears.

use std::cell::RefCell;
use std::rc::Rc;

use firmware::grip::order::mode;
use firmware::grip::states::{Power, Task, code};
use firmware::limits::{Grasp, Limits};
use firmware::motor::{self, Order};
use firmware::parameters::Parameters;
use firmware::parameters::table::id;
use firmware::wire::messages::Command;
use model_export::inverse::quantise::TableSet;

use super::Rig;
use super::world::{Coupled, Gripper, Senses, Shared};
use crate::board::host::Host;
use crate::board::{Board, Driven, Program, SimulatedBoard};
use crate::plant::hall::Fingertips;
use crate::plant::parameters::{self, Lead};

/// A host's tick.
const TICK_US: u64 = 1000;
/// When a board that does not show whether it may be armed has checked its tables.
const READY_US: u64 = 300_000;

/// What is built up.
#[derive(Clone)]
pub struct Plan {
    /// The screw.
    pub lead: Lead,
    /// The plant.
    pub plant: parameters::Parameters,
    /// Between the fingers at the start, in millimetres.
    pub opening_mm: f64,
    /// The motor knows the opening, as after a homing: only a start without it shows the homing.
    pub is_homed: bool,
    /// Thresholds of sensing.
    pub limits: Limits,
    /// Thresholds of the grasp.
    pub grasp: Grasp,
    /// Thresholds of the motor.
    pub motor: motor::limits::Limits,
    /// Of all noise.
    pub seed: u64,
}

impl Plan {
    /// A nominal gripper that is homed.
    pub fn nominal(lead: Lead, opening_mm: f64, seed: u64) -> Self {
        Self {
            lead,
            plant: parameters::Parameters::nominal(lead),
            opening_mm,
            is_homed: true,
            limits: Limits::GRIPPER,
            grasp: Grasp::GRIPPER,
            motor: motor::limits::Limits::GRIPPER,
            seed,
        }
    }
}

/// All of it.
pub struct Workcell<B = Board> {
    /// The board.
    pub board: B,
    /// What hangs on it.
    pub gripper: Shared,
    /// Whoever commands.
    pub host: Host,
    time_us: u64,
}

impl Workcell {
    /// Switches everything on. The fingertips are as drawn, and so are the tables ([`super::tables`]); the
    /// screw is commissioned: it is known whether it locks.
    pub fn new(plan: &Plan, tables: &TableSet) -> Self {
        let mut rig = Rig::within(
            plan.motor,
            plan.lead,
            plan.plant,
            plan.opening_mm,
            plan.seed,
        );
        if plan.is_homed {
            // The rotor is seen before its place means an opening.
            rig.run(1e-3);
            let opening_mm = plan.opening_mm as f32;
            rig.motor.obey(Order::Opening { opening_mm });
        }
        let tips = Fingertips::new(plan.seed, 0.0, &[]).unwrap_or_else(|_| unreachable!());
        let gripper = Rc::new(RefCell::new(Gripper::new(rig, tips, plan.seed)));
        let screw = plan.lead.screw();
        let mut parameters = Parameters::DEFAULT;
        let locks = if screw.self_locking { 1 } else { 2 };
        // In its range.
        let _ = parameters.set(id::SELF_LOCKING, locks);
        let program = Program {
            tables: tables.clone(),
            compensations: Vec::new(),
            networks: None,
            parameters,
            limits: plan.limits,
        };
        let driven = Driven {
            motor: Box::new(Coupled(gripper.clone())),
            screw,
            grasp: plan.grasp,
        };
        let board = Board::start_with(program, Box::new(Senses(gripper.clone())), driven);
        Self::around(board, gripper)
    }
}

impl<B: SimulatedBoard> Workcell<B> {
    /// A board that has been switched on, with its gripper.
    pub fn around(board: B, gripper: Shared) -> Self {
        let host = Host::new(board.connections().can.clone());
        Self {
            board,
            gripper,
            host,
            time_us: 0,
        }
    }

    /// A millisecond.
    pub fn tick(&mut self) {
        let result = self.try_tick();
        result.unwrap_or_else(|error| panic!("at {} us: {error:#}", self.time_us));
    }

    /// The same, where the board may come to an end.
    ///
    /// # Errors
    /// The board's.
    pub fn try_tick(&mut self) -> anyhow::Result<()> {
        self.host.tick();
        self.time_us += TICK_US;
        self.board.run_until(self.time_us)?;
        // Nobody reads the line, and its memory would grow.
        let mut line = self.board.connections().line.borrow_mut();
        line.sent.clear();
        line.ended.clear();
        drop(line);
        self.gripper.borrow_mut().advance(self.time_us);
        Ok(())
    }

    /// Goes on so many microseconds without a word of the host, within a millisecond.
    pub fn creep(&mut self, us: u64) {
        let time_us = self.time_us + us;
        let result = self.board.run_until(time_us);
        result.unwrap_or_else(|error| panic!("at {time_us} us: {error:#}"));
        self.gripper.borrow_mut().advance(time_us);
    }

    /// Goes on until something is so; the seconds that it took, none where it was not within the time.
    pub fn until(&mut self, seconds: f64, is_so: impl Fn(&Self) -> bool) -> Option<f64> {
        let start_us = self.time_us;
        let end_us = start_us + (1e6 * seconds) as u64;
        while !is_so(self) {
            if self.time_us >= end_us {
                return None;
            }
            self.tick();
        }
        Some(1e-6 * (self.time_us - start_us) as f64)
    }

    /// Goes on so long.
    pub fn run(&mut self, seconds: f64) {
        self.until(seconds, |_| false);
    }

    /// Arms and enables over the bus; whether it came to that.
    pub fn enable(&mut self) -> bool {
        let is_ready = |cell: &Self| match cell.board.stands() {
            Some(stands) => stands.may_arm,
            None => cell.time_us > READY_US,
        };
        if self.until(1.0, is_ready).is_none() {
            return false;
        }
        self.host.arm();
        self.host.order(Command {
            mode: mode::ENABLE,
            ..Command::default()
        });
        let is_enabled = |cell: &Self| cell.state() >= code(Power::Enabled, Task::Unhomed);
        self.until(0.5, is_enabled).is_some()
    }

    /// Where the grasp stands, as in the heartbeat, without its delay where the board allows to look.
    pub fn state(&self) -> u8 {
        match (self.board.stands(), &self.host.told.heartbeat) {
            (Some(stands), _) => stands.state,
            (None, Some((_, beat))) => beat.state,
            (None, None) => 0,
        }
    }

    /// Whether it is enabled, and in this state.
    pub fn is_in(&self, task: Task) -> bool {
        self.state() == code(Power::Enabled, task)
    }

    /// True force between the fingertips in newtons.
    pub fn force_n(&self) -> f64 {
        self.gripper.borrow().rig.plant.grip_n()
    }

    /// Microseconds since it was switched on.
    pub const fn time_us(&self) -> u64 {
        self.time_us
    }
}
