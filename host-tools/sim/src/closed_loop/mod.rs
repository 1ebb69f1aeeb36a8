//! Closed loop: firmware, board, drivetrain and a host on the CAN bus, from Hall counts to the PWM and back.
//!
//! - [`motor_rig`], [`frequency_response`]: motor control on the plant; [`drive_result`]: its figures.
//! - [`grasp_rig`]: the grasp with ideal force sensing; [`grasp_result`], [`landing`]: its runs.
//! - [`requirements`]: specified figures of drive and grasp next to the simulated ones.
//! - [`coupling`]: the simulated gripper at the connections of a board.
//! - [`emulated_board`]: the image in an emulated chip.
//! - [`mod@bench`], [`bench_programme`]: a gripper with hidden effects on a test bench, for recordings over the serial line.

pub mod bench;
pub mod bench_programme;
pub mod coupling;
pub mod drive_result;
pub mod emulated_board;
pub mod frequency_response;
pub mod grasp_result;
pub mod grasp_rig;
pub mod landing;
pub mod motor_rig;
pub mod requirements;

#[cfg(test)]
mod tests;

use crate::board::host::CanHost;
use crate::board::{MotorConnection, Program, SimulatedBoard, VirtualTimeBoard};
use crate::closed_loop::coupling::{GripperMotor, GripperWorld, SharedGripper, SimulatedGripper};
use crate::closed_loop::emulated_board::EmulatedBoard;
use crate::closed_loop::motor_rig::MotorRig;
use crate::drivetrain::fingertips::{Fingertips, distribute_forces};
use crate::drivetrain::parameters::{Lead, PlantParameters, SCATTER};
use crate::hall_sensor::NOISE_G;
use anyhow::Result;
use firmware::config::constants::{SENSOR_RANGE, SENSOR_SCALE, TICK_US};
use firmware::config::limits::{DetectionLimits, GripLimits};
use firmware::estimator::tare::Tare;
use firmware::fixed_point::Force;
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TaskState, state_code};
use firmware::motor::{self, MotorCommand};
use firmware::parameters::Parameters;
use firmware::parameters::schema::id;
use firmware::protocol::messages::Command;
use firmware::sensors::hall::SENSORS;
use model_export::inverse::model_selection::select_models;
use model_export::inverse::quantise::TableSet;
use model_export::inverse::static_model::StaticModel;
use model_export::physics::ForwardModel;
use model_export::recordings::description::NominalDesign;
use std::cell::RefCell;
use std::rc::Rc;

/// Boot time of a board that does not expose whether it may be armed.
const READY_US: u64 = 300_000;

/// Configuration of a closed loop.
#[derive(Clone)]
pub struct ClosedLoopSetup {
    /// Screw variant.
    pub lead: Lead,
    /// Parameters of the drivetrain.
    pub plant: PlantParameters,
    /// Initial opening in millimetres.
    pub opening_mm: f64,
    /// The motor starts with a known opening, as after homing.
    pub is_homed: bool,
    /// Thresholds of the sensors.
    pub limits: DetectionLimits,
    /// Thresholds of the grasp.
    pub grasp: GripLimits,
    /// Thresholds of the motor.
    pub motor: motor::settings::MotorLimits,
    /// Error of both fingers' forces in newtons, by a wrong tare.
    pub offset_n: f64,
    /// Contact point of objects ([`SimulatedGripper::towards_first`]).
    pub towards_first: f64,
    /// Protection that is switched off.
    pub disabled: Option<DisabledProtection>,
    /// Seed of all noise.
    pub seed: u64,
}

/// A protection that is no threshold, switched off to check that its absence is noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DisabledProtection {
    /// The redundant copies follow a bit error in memory.
    MemoryCheck,
    /// The CAN controller does not report that it has left the bus.
    BusOffDetection,
    /// The tables have no standard deviation of the parity residual.
    DisturbanceDetection,
    /// Commands are valid for the longest time that a host can set.
    HostTimeout,
    /// The screw is declared self-locking, whatever it is.
    Backdrivability,
}

impl ClosedLoopSetup {
    /// A nominal, homed gripper.
    pub fn nominal(lead: Lead, opening_mm: f64, seed: u64) -> Self {
        Self {
            lead,
            plant: PlantParameters::nominal(lead),
            opening_mm,
            is_homed: true,
            limits: DetectionLimits::GRIPPER,
            grasp: GripLimits::GRIPPER,
            motor: motor::settings::MotorLimits::GRIPPER,
            offset_n: 0.0,
            towards_first: 0.0,
            disabled: None,
            seed,
        }
    }

    /// A homed, closed gripper with all tolerances.
    pub fn scattered(lead: Lead, seed: u64) -> Self {
        Self {
            plant: PlantParameters::scattered(lead, SCATTER, seed),
            ..Self::nominal(lead, 0.0, seed)
        }
    }
}

/// Board, gripper and host in one virtual time.
pub struct ClosedLoop<B = VirtualTimeBoard> {
    /// The board.
    pub board: B,
    /// Gripper at its connections.
    pub gripper: SharedGripper,
    /// Host on the CAN bus.
    pub host: CanHost,
    time_us: u64,
}

impl ClosedLoop {
    /// Switches everything on, with nominal fingertips and tables ([`nominal_tables`]); the screw is
    /// commissioned.
    pub fn new(plan: &ClosedLoopSetup, tables: &TableSet) -> Self {
        let mut rig =
            MotorRig::with_limits(plan.motor, plan.lead, plan.plant, plan.opening_mm, plan.seed);
        if plan.is_homed {
            // The opening needs one sample of the rotor.
            rig.run(1e-3);
            let opening_mm = plan.opening_mm as f32;
            rig.motor.handle_command(MotorCommand::SetOpening { opening_mm });
        }
        let tips = Fingertips::new(plan.seed, 0.0, &[]).unwrap_or_else(|_| unreachable!());
        let mut gripper = SimulatedGripper::new(rig, tips, plan.seed);
        gripper.towards_first = plan.towards_first;
        let gripper = Rc::new(RefCell::new(gripper));
        let screw = plan.lead.screw();
        let is_disabled = |protection| plan.disabled == Some(protection);
        let mut parameters = Parameters::DEFAULT;
        let locks = screw.self_locking || is_disabled(DisabledProtection::Backdrivability);
        // The values are in their ranges.
        let _ = parameters.set(id::SELF_LOCKING, if locks { 1 } else { 2 });
        if is_disabled(DisabledProtection::HostTimeout) {
            let _ = parameters.set(id::COMMAND_TIMEOUT, 500);
        }
        let [lateral, ..] = distribute_forces(-plan.offset_n, 0.0, 0.0)[0];
        let counts = (lateral * Force::PER_NEWTON) as i32;
        parameters.set_tare(&Tare([1, 1, -1, -1].map(|sign| [Force(sign * counts), Force(0)])));
        let mut tables = tables.clone();
        if is_disabled(DisabledProtection::DisturbanceDetection) {
            tables.sensors.iter_mut().for_each(|sensor| sensor.parity.sigma = 0);
        }
        let program = Program {
            tables,
            compensations: Vec::new(),
            networks: None,
            description: "",
            parameters,
            limits: plan.limits,
        };
        let driven = MotorConnection {
            motor: Box::new(GripperMotor(gripper.clone())),
            screw,
            grasp: plan.grasp,
        };
        let mut board = VirtualTimeBoard::start_with_motor(
            program,
            Box::new(GripperWorld(gripper.clone())),
            driven,
        );
        board.hides_corruption = is_disabled(DisabledProtection::MemoryCheck);
        board.controller.hides_bus_off.set(is_disabled(DisabledProtection::BusOffDetection));
        Self::from_board(board, gripper)
    }
}

impl ClosedLoop<EmulatedBoard> {
    /// A copy in its present state, without injected errors: both go on from here, alike.
    pub fn copy(&self) -> Self {
        let gripper = Rc::new(RefCell::new(self.gripper.borrow().copy()));
        let board = self.board.copy(Box::new(GripperWorld(gripper.clone())), gripper.clone());
        let host = self.host.copy(board.connections.can.clone());
        Self { board, gripper, host, time_us: self.time_us }
    }
}

impl<B: SimulatedBoard> ClosedLoop<B> {
    /// From a board that is switched on, and its gripper.
    pub fn from_board(board: B, gripper: SharedGripper) -> Self {
        let host = CanHost::new(board.connections().can.clone());
        Self { board, gripper, host, time_us: 0 }
    }

    /// Advances by a millisecond.
    pub fn tick(&mut self) {
        let result = self.try_tick();
        result.unwrap_or_else(|error| panic!("at {} us: {error:#}", self.time_us));
    }

    /// Advances by a millisecond.
    ///
    /// # Errors
    /// The board cannot continue.
    pub fn try_tick(&mut self) -> Result<()> {
        self.step()?;
        // The serial line is not read; limit its memory.
        let mut line = self.board.connections().line.borrow_mut();
        line.sent.clear();
        line.ended.clear();
        Ok(())
    }

    /// Advances by a millisecond and keeps the bytes of the serial line.
    ///
    /// # Errors
    /// The board cannot continue.
    pub fn step(&mut self) -> Result<()> {
        self.host.tick();
        self.time_us += TICK_US;
        self.board.run_until(self.time_us)?;
        self.gripper.borrow_mut().advance(self.time_us);
        Ok(())
    }

    /// Advances by less than a millisecond, without the host.
    pub fn advance_us(&mut self, us: u64) {
        let time_us = self.time_us + us;
        let result = self.board.run_until(time_us);
        result.unwrap_or_else(|error| panic!("at {time_us} us: {error:#}"));
        self.gripper.borrow_mut().advance(time_us);
    }

    /// Runs until a condition is true; returns the time in seconds, none on timeout.
    pub fn until(&mut self, seconds: f64, condition: impl Fn(&Self) -> bool) -> Option<f64> {
        let start_us = self.time_us;
        let end_us = start_us + (1e6 * seconds) as u64;
        while !condition(self) {
            if self.time_us >= end_us {
                return None;
            }
            self.tick();
        }
        Some(1e-6 * (self.time_us - start_us) as f64)
    }

    /// Runs for a time.
    pub fn run(&mut self, seconds: f64) {
        self.until(seconds, |_| false);
    }

    /// Waits until the board may be armed; false on timeout.
    pub fn is_ready_within(&mut self, seconds: f64) -> bool {
        let is_ready = |cell: &Self| match cell.board.grip_status() {
            Some(grip_status) => grip_status.may_arm,
            None => cell.time_us > READY_US,
        };
        self.until(seconds, is_ready).is_some()
    }

    /// Arms and enables over the bus; false on timeout.
    pub fn enable(&mut self) -> bool {
        if !self.is_ready_within(1.0) {
            return false;
        }
        self.host.arm();
        self.host.order(Command { mode: mode::ENABLE, ..Command::default() });
        let is_enabled =
            |cell: &Self| cell.state() >= state_code(PowerState::Enabled, TaskState::Unhomed);
        self.until(0.5, is_enabled).is_some()
    }

    /// State as in the heartbeat, without its delay where the board exposes it.
    pub fn state(&self) -> u8 {
        match (self.board.grip_status(), &self.host.received.heartbeat) {
            (Some(grip_status), _) => grip_status.state,
            (None, Some((_, beat))) => beat.state,
            (None, None) => 0,
        }
    }

    /// Whether it is enabled and in this state.
    pub fn is_in(&self, task: TaskState) -> bool {
        self.state() == state_code(PowerState::Enabled, task)
    }

    /// True grip force in newtons.
    pub fn force_n(&self) -> f64 {
        self.gripper.borrow().rig.plant.grip_n()
    }

    /// Microseconds since power-on.
    pub const fn time_us(&self) -> u64 {
        self.time_us
    }
}

/// Identifier of the tables on the bus.
const ID: u16 = 1;

/// Tables of the nominal design for all sensors; the parity residual is the sensor noise.
///
/// # Errors
/// A table overflows.
pub fn nominal_tables() -> Result<TableSet> {
    let numbers: Vec<u32> = (0..SENSORS as u32).collect();
    let design = NominalDesign::magpie();
    let model = StaticModel::without_effects(ForwardModel::nominal(&design));
    let models = vec![model; SENSORS];
    let (scale, range) = (SENSOR_SCALE.value, SENSOR_RANGE.value);
    let mut chosen = select_models(&models, &numbers, ID, scale, range, None)?;
    let surfaces = chosen.surfaces.iter().zip(&numbers);
    for (table, (surface, &number)) in chosen.tables.sensors.iter_mut().zip(surfaces) {
        table.parity = surface.table(number, NOISE_G, scale)?;
    }
    Ok(chosen.tables)
}
