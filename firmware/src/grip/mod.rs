//! Grip control at 1 kHz: from estimated forces, motor status and host commands to motor set-points. Forces in
//! newtons, lengths in millimetres; closing is positive.
//!
//! Two state machines ([`states`]) with transition tables ([`transitions`]): a command that the table does not list
//! is refused with a reason ([`commands::RefusalReason`]). Arming belongs to [`crate::protocol::session`].
//!
//! - [`commands`]: decoded host commands, profiles, refusals.
//! - [`finger_force`], [`contact`], [`ground_contact`]: forces, contact of the fingers, contact of a foot.
//! - [`force_controller`], [`homing`]: control laws; `setpoint`: the motor set-point of each state.
//! - [`slip_detector`], [`stall_detector`]: detectors.
//! - [`fault_reactions`]: reaction to each fault, and the first cause; [`redundant_copy`]: memory check.
//! - `power_layer`, `task_layer`: one step of each state machine; `interface`: inputs and outputs.

pub mod commands;
pub mod contact;
mod debounce;
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
mod setpoint;
pub mod slip_detector;
pub mod stall_detector;
pub mod states;
mod status_message;
mod task_layer;
#[cfg(test)]
mod tests;
pub mod transitions;

pub use crate::grip::interface::{ArmingRequest, ControlInputs, ControlOutputs, SessionStatus};

use crate::config::limits::GripLimits;
use crate::estimator::Estimate;
use crate::grip::commands::{CommandRefusal, GraspTarget, GripCommand, MoveTarget};
use crate::grip::contact::ContactDetector;
use crate::grip::debounce::{next_ms, next_ticks};
use crate::grip::fault_reactions::{FirstFault, FirstFaultLatch, Reaction};
use crate::grip::finger_force::{BeyondRange, FingerForce, FingerForces};
use crate::grip::force_controller::StiffnessEstimator;
use crate::grip::ground_contact::{GroundContact, GroundContactDetector};
use crate::grip::hold_current::HoldCurrent;
use crate::grip::homing::{Homing, HomingStep};
use crate::grip::rise::RiseDetector;
use crate::grip::slip_detector::SlipDetector;
use crate::grip::stall_detector::{StallDetector, VelocityFilter};
use crate::grip::states::{PowerState, TaskState};
use crate::math::{greater, lesser};
use crate::motor::Setpoint;
use crate::motor::screw::Screw;
use crate::protocol::messages::GripStatus;
use crate::sensors::hall::SENSORS;
use crate::system::faults::{Fault, FaultSet};

/// Words of the redundant copies ([`redundant_copy`]).
pub const COPY_WORDS: usize = 8;
/// Time constant of the mean force while holding, in steps.
const MEAN_TICKS: f32 = 16.0;
/// Difference of the fingers' forces in newtons up to which a hold controls their mean: one that reads low raises the force by at
/// most half of it.
const SYMMETRIC_N: f32 = 2.0;

/// The grip controller. [`GripController::tick`] runs once a millisecond.
#[derive(Clone, Debug)]
pub struct GripController {
    limits: GripLimits,
    screw: Screw,
    /// The screw holds its load without current.
    self_locking: bool,
    power: PowerState,
    task: TaskState,
    now_ms: u32,
    power_ms: u32,
    task_ms: u32,
    /// Last executed command and its repeat flag.
    last_command: Option<(GripCommand, bool)>,
    target: GraspTarget,
    move_target: MoveTarget,
    is_opening: bool,
    /// The fingers were in contact when the state was entered, and still are.
    was_touching: bool,
    /// Force set-point in newtons; raised after a slip.
    setpoint_n: f32,
    fingers: FingerForces,
    /// Last valid force.
    force_n: f32,
    force_rise: RiseDetector,
    /// Rise of the force in newtons since the fingers were last unloaded.
    rise_n: f32,
    /// Force beyond the range of the model.
    beyond: BeyondRange,
    /// Rotor position in radians at the contact of a calibration.
    touched_rad: Option<f32>,
    /// Mean opening current in amperes.
    opening_a: f32,
    /// Its rise since the last valid force.
    current_rise: RiseDetector,
    /// Milliseconds since an opening began.
    opening_ms: u32,
    /// Rotor position in radians at which an opening without valid forces met an obstacle.
    obstacle_rad: Option<f32>,
    /// Mean force of each finger in newtons; none while it is invalid.
    means_n: [Option<f32>; 2],
    /// Mean of both means, less than the greater by half of [`SYMMETRIC_N`] at most; the greater of two noisy forces would be biased.
    mean_n: f32,
    invalid_ticks: u8,
    lost_ticks: u8,
    valid_ms: u16,
    last_mm: Option<f32>,
    contact: ContactDetector,
    stiffness: StiffnessEstimator,
    slip: SlipDetector,
    homing: Homing,
    homing_step: HomingStep,
    /// The opening was set by a homing that has not found the far end yet.
    is_provisional: bool,
    stall: StallDetector,
    ground_detector: GroundContactDetector,
    ground_contact: GroundContact,
    unloaded_ms: u16,
    velocity: VelocityFilter,
    resting_ms: u16,
    in_band_ms: u16,
    low_force_ms: u16,
    /// Times of the last regrips, newest first.
    regrips_ms: [Option<u32>; 3],
    /// An object is, or may be, between the fingers.
    is_gripped: bool,
    /// The force was reached and the object not released since.
    has_settled: bool,
    /// Last current while holding, in amperes.
    hold_a: f32,
    hold: HoldCurrent,
    /// Position to be held in millimetres; none until the fingers rest.
    hold_mm: Option<f32>,
    first_fault: FirstFaultLatch,
    faults: FaultSet,
    /// Reaction to the latched fault.
    reaction: Reaction,
    /// The fingers reduce an excessive force.
    backs_off: bool,
    slipping_ms: u16,
    since_slip_ms: u32,
    /// A stop frame arrived, and no host has cleared it at rest since.
    is_stopped: bool,
    implausible_ms: u16,
    clearing_ms: u8,
    copies: [u32; COPY_WORDS],
}

impl GripController {
    /// `self_locking`: whether the screw holds its load without current.
    pub fn new(limits: GripLimits, screw: Screw, self_locking: bool) -> Self {
        let mut grip = Self {
            limits,
            screw,
            self_locking,
            power: PowerState::Boot,
            task: TaskState::Unhomed,
            now_ms: 0,
            power_ms: 0,
            task_ms: 0,
            last_command: None,
            target: GraspTarget {
                setpoint_n: 0.0,
                max_mm_s: 0.0,
                cap_n: 0.0,
                window: None,
                is_fast: false,
            },
            move_target: MoveTarget { opening_mm: 0.0, speed_mm_s: 0.0, is_uncalibrated: false },
            is_opening: false,
            was_touching: false,
            setpoint_n: 0.0,
            fingers: FingerForces::of(&[Estimate::MISSING; SENSORS]),
            force_n: 0.0,
            force_rise: RiseDetector::default(),
            rise_n: 0.0,
            beyond: BeyondRange::default(),
            touched_rad: None,
            opening_a: 0.0,
            current_rise: RiseDetector::default(),
            opening_ms: 0,
            obstacle_rad: None,
            means_n: [None; 2],
            mean_n: 0.0,
            invalid_ticks: 0,
            lost_ticks: 0,
            valid_ms: 0,
            last_mm: None,
            contact: ContactDetector::default(),
            stiffness: StiffnessEstimator::default(),
            slip: SlipDetector::default(),
            homing: Homing::default(),
            homing_step: HomingStep::Drive(Setpoint::Off),
            is_provisional: false,
            stall: StallDetector::default(),
            ground_detector: GroundContactDetector::default(),
            ground_contact: GroundContact::default(),
            unloaded_ms: 0,
            velocity: VelocityFilter::default(),
            resting_ms: 0,
            in_band_ms: 0,
            low_force_ms: 0,
            regrips_ms: [None; 3],
            is_gripped: false,
            has_settled: false,
            hold_a: 0.0,
            hold: HoldCurrent::default(),
            hold_mm: None,
            first_fault: FirstFaultLatch::default(),
            faults: FaultSet::default(),
            reaction: Reaction::Warn,
            backs_off: false,
            slipping_ms: 0,
            since_slip_ms: 0,
            is_stopped: false,
            implausible_ms: 0,
            clearing_ms: 0,
            copies: [0; COPY_WORDS],
        };
        grip.copy();
        grip
    }

    /// One step of 1 ms. Between steps the state may change only through [`GripController::set_self_locking`]
    /// ([`GripController::is_intact`]).
    pub fn tick(&mut self, inputs: &ControlInputs) -> ControlOutputs {
        self.now_ms = self.now_ms.wrapping_add(1);
        self.power_ms = self.power_ms.saturating_add(1);
        self.task_ms = self.task_ms.saturating_add(1);
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
        self.update_estimates(inputs);
        self.detect_faults(inputs, &mut outputs);
        self.update_power(inputs, &mut outputs);
        if let Some(command) = inputs.command
            && let Err(reason) = self.handle_command(&command, inputs)
        {
            outputs.refused =
                Some(CommandRefusal { mode: command.mode, reason, state: self.state() });
        }
        if self.power == PowerState::Enabled {
            self.update_task(inputs, &mut outputs);
        }
        let is_homing = self.power == PowerState::Enabled && self.task == TaskState::Homing;
        if self.is_provisional && !is_homing {
            self.is_provisional = false;
            outputs.opening_mm = Some(f32::NAN);
        }
        outputs.setpoint = self.motor_setpoint(&inputs.motor);
        self.report(inputs, &mut outputs);
        self.copy();
        outputs
    }

    /// Sets whether the screw holds its load without current; ignored unless [`PowerState::Safe`].
    pub const fn set_self_locking(&mut self, self_locking: bool) {
        if matches!(self.power, PowerState::Safe) {
            self.self_locking = self_locking;
        }
    }

    /// Whether the motor is driven, or may be.
    pub const fn is_driven(&self) -> bool {
        matches!(
            self.power,
            PowerState::Armed
                | PowerState::Enabled
                | PowerState::QuickStop
                | PowerState::FaultReaction
        )
    }

    /// Whether the fingers move, or are being stopped.
    pub fn is_moving(&self) -> bool {
        match self.power {
            PowerState::Enabled => self.task.moves(),
            power => matches!(power, PowerState::QuickStop | PowerState::FaultReaction),
        }
    }

    /// Whether an object is, or may be, gripped, or the gripper is a foot.
    pub const fn is_loaded(&self) -> bool {
        self.is_gripped || matches!(self.task, TaskState::Foot)
    }

    /// Whether both fingers press as on an object that a self-locking screw holds since before a reboot. Offsets without a tare
    /// can look the same.
    pub fn may_be_loaded(&self) -> bool {
        let presses = |finger| matches!(finger, FingerForce::Valid(n) if n > self.limits.move_n);
        presses(self.fingers.left) && presses(self.fingers.right)
    }

    /// State code of the heartbeat.
    pub const fn state(&self) -> u8 {
        states::state_code(self.power, self.task)
    }

    /// Whether a stop is latched.
    pub const fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// State of the power layer.
    pub const fn power(&self) -> PowerState {
        self.power
    }

    /// State of the task layer, valid while [`PowerState::Enabled`].
    pub const fn task(&self) -> TaskState {
        self.task
    }

    /// First fault since a host last cleared the faults.
    pub const fn first_cause(&self) -> Option<FirstFault> {
        self.first_fault.cause()
    }

    /// Active faults of motor and grip as heartbeat bits.
    pub fn fault_bits(&self) -> u32 {
        self.faults.bits()
    }

    /// Last valid force in newtons, the greater of both fingers.
    pub const fn force_n(&self) -> f32 {
        self.force_n
    }

    /// Ground contact of the fingertips.
    pub const fn ground_contact(&self) -> &GroundContact {
        &self.ground_contact
    }

    /// Estimated contact stiffness in N/mm.
    pub const fn stiffness(&self) -> f32 {
        self.stiffness.value()
    }

    fn update_estimates(&mut self, inputs: &ControlInputs) {
        self.fingers = FingerForces::of(inputs.estimates);
        let valid_n = self.fingers.max_n();
        self.invalid_ticks = next_ticks(self.invalid_ticks, valid_n.is_none());
        self.lost_ticks = next_ticks(self.lost_ticks, self.fingers.are_lost());
        self.valid_ms = next_ms(self.valid_ms, valid_n.is_some());
        let motor = &inputs.motor;
        if let Some(force_n) = valid_n {
            self.force_n = force_n;
            self.update_means();
            self.contact.update(force_n, &self.limits);
            self.rise_n = self.force_rise.update(force_n);
            if !self.is_gripped && !self.task.moves() {
                self.force_rise.follow(force_n);
            }
            let is_loading = matches!(self.task, TaskState::Approach | TaskState::Force);
            // The force lags the opening by one step.
            if let Some(opening_mm) = self.last_mm
                && is_loading
                && self.contact.is_suspected()
            {
                self.stiffness.update(-opening_mm, force_n);
            }
        }
        if inputs.is_calibrating != (self.power == PowerState::Calibrating) {
            // It begins or ends; a tare changes all forces.
            self.force_rise = RiseDetector::default();
        }
        self.beyond.update(inputs.estimates, &self.limits);
        let is_clear_of = |obstacle_rad: f32| {
            (motor.rotor_rad - obstacle_rad) * self.screw.ratio_mm > self.limits.clear_mm
        };
        if valid_n.is_some() || inputs.clear || self.obstacle_rad.is_some_and(is_clear_of) {
            (self.obstacle_rad, self.current_rise) = (None, RiseDetector::default());
        }
        self.opening_a += (-motor.current.q - self.opening_a) / MEAN_TICKS;
        self.last_mm = motor.opening_mm;
        let speed_mm_s = self.velocity.update(motor.closing_mm_s);
        let is_slow = speed_mm_s.abs() < self.limits.resting_mm_s;
        self.resting_ms = next_ms(self.resting_ms, is_slow);
        self.ground_contact = self.ground_detector.update(
            inputs.estimates,
            inputs.acceleration,
            motor.opening_mm,
            &self.limits,
        );
        self.unloaded_ms = next_ms(self.unloaded_ms, self.ground_contact.is_unloaded);
    }

    fn update_means(&mut self) {
        let fingers = [self.fingers.left, self.fingers.right];
        for (mean_n, finger) in self.means_n.iter_mut().zip(fingers) {
            *mean_n = match (finger, *mean_n) {
                (FingerForce::Valid(now_n), Some(mean_n)) => {
                    Some(mean_n + (now_n - mean_n) / MEAN_TICKS)
                }
                (FingerForce::Valid(now_n), None) => Some(now_n),
                _ => None,
            };
        }
        self.mean_n = match self.means_n {
            // A field that is the same at both fingers, as of the Earth, raises one and lowers the other.
            [Some(left_n), Some(right_n)] => {
                greater(left_n, right_n) - 0.5 * lesser((left_n - right_n).abs(), SYMMETRIC_N)
            }
            [Some(one_n), None] | [None, Some(one_n)] => one_n,
            [None, None] => self.force_n,
        };
    }

    fn is_at_rest(&self) -> bool {
        self.resting_ms >= self.limits.resting_ms
    }

    /// Whether neither finger has had a valid force for [`GripLimits::invalid_ticks`].
    fn is_blind(&self) -> bool {
        self.invalid_ticks >= self.limits.invalid_ticks
    }

    /// Sets or clears one of this controller's own faults.
    fn set_fault(&mut self, fault: Fault, active: bool, detail: u32, outputs: &mut ControlOutputs) {
        if self.faults.has(fault, 0) == active {
            return;
        }
        if let Some(event) = self.faults.update(fault, 0, active, detail) {
            // There is room for each kind; an event that does not fit is still in the heartbeat's bits.
            let _ = outputs.events.push(event);
        }
    }
}
