//! Grip control at 1 kHz: from estimated forces, motor status and host commands to motor set-points. Forces in
//! newtons, lengths in millimetres; closing is positive.
//!
//! Two state machines ([`states`]) with transition tables ([`transitions`]): a command that the table does not list
//! is refused with a reason ([`commands::RefusalReason`]). Arming belongs to [`crate::protocol::session`].
//!
//! The controller has four parts, each with its own state, and calls them once a millisecond in this order:
//!
//! - `contact_observer`: forces of the fingers, contact, rest.
//! - `fault_monitor`: active faults and the first one.
//! - `power_layer`: session, arming, reactions to faults, enabling.
//! - `task_layer`: what the fingers do while the drive is enabled; its motor set-points and the state of a grasp.
//!
//! They are made of:
//!
//! - [`commands`]: decoded host commands, profiles, refusals.
//! - [`finger_force`], [`contact`], [`ground_contact`]: forces, contact of the fingers, contact of a foot.
//! - [`force_controller`], [`homing`]: control laws.
//! - [`slip_detector`], [`stall_detector`]: detectors.
//! - [`fault_reactions`]: reaction to each fault, and the first cause; [`redundant_copy`]: memory check.
//! - `interface`: inputs and outputs; `step`: what the parts read.

pub mod commands;
pub mod contact;
mod contact_observer;
mod debounce;
mod fault_monitor;
pub mod fault_reactions;
pub mod finger_force;
pub mod force_controller;
pub mod ground_contact;
mod hold_current;
pub mod homing;
mod interface;
mod power_layer;
pub mod redundant_copy;
mod rise;
pub mod slip_detector;
pub mod stall_detector;
pub mod states;
mod status_message;
mod step;
mod task_layer;
#[cfg(test)]
mod tests;
pub mod transitions;

pub use crate::grip::interface::{ArmingRequest, ControlInputs, ControlOutputs, SessionStatus};

use crate::config::limits::GripLimits;
use crate::grip::commands::CommandRefusal;
use crate::grip::contact_observer::ContactObserver;
use crate::grip::fault_monitor::FaultMonitor;
use crate::grip::fault_reactions::FirstFault;
use crate::grip::ground_contact::GroundContact;
use crate::grip::interface::GripSettings;
use crate::grip::power_layer::PowerLayer;
use crate::grip::states::{PowerState, TaskState};
use crate::grip::step::GripStep;
use crate::grip::task_layer::TaskLayer;
use crate::motor::calibration::{CalibrationFailure, CalibrationKind};
use crate::motor::screw::Screw;
use crate::motor::{MotorStatus, Setpoint};
use crate::protocol::messages::GripStatus;

/// Words of the redundant copies ([`redundant_copy`]).
pub const COPY_WORDS: usize = 8;

/// The grip controller. [`GripController::tick`] runs once a millisecond.
#[derive(Clone, Debug)]
pub struct GripController {
    settings: GripSettings,
    now_ms: u32,
    contact: ContactObserver,
    faults: FaultMonitor,
    power: PowerLayer,
    task: TaskLayer,
    copies: [u32; COPY_WORDS],
}

impl GripController {
    /// `self_locking`: whether the screw holds its load without current.
    pub fn new(limits: GripLimits, screw: Screw, self_locking: bool) -> Self {
        let mut grip = Self {
            settings: GripSettings { limits, screw, self_locking },
            now_ms: 0,
            contact: ContactObserver::default(),
            faults: FaultMonitor::default(),
            power: PowerLayer::default(),
            task: TaskLayer::default(),
            copies: [0; COPY_WORDS],
        };
        grip.copy();
        grip
    }

    /// One step of 1 ms. Between steps the state may change only through [`GripController::set_self_locking`]
    /// ([`GripController::is_intact`]).
    pub fn tick(&mut self, inputs: &ControlInputs) -> ControlOutputs {
        self.now_ms = self.now_ms.wrapping_add(1);
        let mut outputs = ControlOutputs {
            setpoint: Setpoint::Off,
            arming: None,
            opening_mm: None,
            may_arm: false,
            state: 0,
            status: GripStatus::default(),
            foot: None,
            refused: None,
            events: heapless::Vec::new(),
        };
        let Self { settings, now_ms, contact, faults, power, task, .. } = self;
        // A tare, which begins or ends, changes all forces.
        let is_tared = inputs.is_calibrating != (power.state() == PowerState::Calibrating);
        contact.update(inputs, settings, !task.is_gripped() && !task.state().moves(), is_tared);
        let step = GripStep { inputs, contact, settings, now_ms: *now_ms };
        task.observe(step);
        faults.detect(step, (power.state(), task.state()), &mut outputs);
        power.update(step, task, faults, &mut outputs);
        if let Some(command) = inputs.command
            && let Err(reason) = power.handle_command(&command, step, task, faults)
        {
            let state = states::state_code(power.state(), task.state());
            outputs.refused = Some(CommandRefusal { mode: command.mode, reason, state });
        }
        let is_enabled = power.state() == PowerState::Enabled;
        if is_enabled {
            task.update(step, faults, &mut outputs);
        }
        if task.withdraws_opening(is_enabled) {
            outputs.opening_mm = Some(f32::NAN);
        }
        outputs.setpoint = power.setpoint(step, task);
        self.report(inputs, &mut outputs);
        self.copy();
        outputs
    }

    /// Why a calibration of the motor must end, given the faults of other tasks. To be called once in each of its
    /// milliseconds.
    pub fn calibration_failure(
        &mut self,
        kind: CalibrationKind,
        motor: &MotorStatus,
        faults: u32,
    ) -> Option<CalibrationFailure> {
        if self.faults.ends_calibration(faults, &self.settings) {
            return Some(CalibrationFailure::Fault);
        }
        self.contact.calibration_failure(kind, motor, &self.settings)
    }

    /// Sets whether the screw holds its load without current; ignored unless [`PowerState::Safe`].
    pub const fn set_self_locking(&mut self, self_locking: bool) {
        if matches!(self.power.state(), PowerState::Safe) {
            self.settings.self_locking = self_locking;
        }
    }

    /// Whether the motor is driven, or may be.
    pub const fn is_driven(&self) -> bool {
        matches!(
            self.power.state(),
            PowerState::Armed
                | PowerState::Enabled
                | PowerState::QuickStop
                | PowerState::FaultReaction
        )
    }

    /// Whether the fingers move, or are being stopped.
    pub fn is_moving(&self) -> bool {
        match self.power.state() {
            PowerState::Enabled => self.task.state().moves(),
            power => matches!(power, PowerState::QuickStop | PowerState::FaultReaction),
        }
    }

    /// Whether an object is, or may be, gripped, or the gripper is a foot.
    pub const fn is_loaded(&self) -> bool {
        self.task.is_loaded()
    }

    /// Whether both fingers press as on an object that a self-locking screw holds since before a reboot. Offsets without a tare
    /// can look the same.
    pub fn may_be_loaded(&self) -> bool {
        self.contact.is_pressed_by_more_than(self.settings.limits.move_n)
    }

    /// State code of the heartbeat.
    pub const fn state(&self) -> u8 {
        states::state_code(self.power.state(), self.task.state())
    }

    /// Whether a stop is latched.
    pub const fn is_stopped(&self) -> bool {
        self.power.is_stopped()
    }

    /// State of the power layer.
    pub const fn power(&self) -> PowerState {
        self.power.state()
    }

    /// State of the task layer, valid while [`PowerState::Enabled`].
    pub const fn task(&self) -> TaskState {
        self.task.state()
    }

    /// First fault since a host last cleared the faults.
    pub const fn first_cause(&self) -> Option<FirstFault> {
        self.faults.first_cause()
    }

    /// Active faults of motor and grip as heartbeat bits.
    pub fn fault_bits(&self) -> u32 {
        self.faults.bits()
    }

    /// Last valid force in newtons, the greater of both fingers.
    pub const fn force_n(&self) -> f32 {
        self.contact.force_n()
    }

    /// Ground contact of the fingertips.
    pub const fn ground_contact(&self) -> &GroundContact {
        self.contact.ground()
    }

    /// Estimated contact stiffness in N/mm.
    pub const fn stiffness(&self) -> f32 {
        self.task.stiffness()
    }
}
