//! Inputs and outputs of one control step.

use crate::config::limits::GripLimits;
use crate::estimator::Estimate;
use crate::grip::commands::CommandRefusal;
use crate::motor::screw::Screw;
use crate::motor::{MotorStatus, Setpoint};
use crate::protocol::messages::{Command, FaultEvent, Foot, GripStatus};
use crate::sensors::hall::SENSORS;

/// Maximum fault events per step: more than the controller has faults of its own.
const EVENTS: usize = 24;

/// Status of the session with a host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionStatus {
    /// A challenge for arming is pending ([`crate::protocol::session::Session::is_arming`]).
    pub is_offered: bool,
    /// A host is armed ([`crate::protocol::session::Session::is_armed`]).
    pub is_open: bool,
    /// Commands arrive in time ([`crate::protocol::session::Session::is_alive`]).
    pub is_alive: bool,
}

/// Inputs of one control step.
#[derive(Clone, Copy, Debug)]
pub struct ControlInputs<'a> {
    /// Forces, tare subtracted.
    pub estimates: &'a [Estimate; SENSORS],
    /// Status of the motor.
    pub motor: MotorStatus,
    /// Status of the session.
    pub host: SessionStatus,
    /// Authenticated command ([`crate::protocol::session::SessionEvent::Command`]).
    pub command: Option<Command>,
    /// Stop frame ([`crate::protocol::session::SessionEvent::Stop`]).
    pub stop: bool,
    /// A host clears the faults ([`crate::protocol::session::op::CLEAR_FAULTS`]).
    pub clear: bool,
    /// Active faults of other tasks as heartbeat bits ([`crate::system::faults::FaultSet::bits`]).
    pub faults: u32,
    /// Result of the self-test; none while it runs.
    pub is_sound: Option<bool>,
    /// A tare or commissioning is in progress.
    pub is_calibrating: bool,
    /// Acceleration of the fingertips in mm/s^2, gripper axes, with gravity; none where it is unknown or the
    /// estimates are compensated for it already.
    pub acceleration: Option<[i32; 3]>,
}

/// Request to arm or disarm the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmingRequest {
    /// Enables the power stage ([`crate::motor::MotorCommand::Arm`]).
    Arm,
    /// Disables it ([`crate::motor::MotorCommand::Disarm`]).
    Disarm,
}

/// Outputs of one control step.
#[derive(Clone, Debug)]
pub struct ControlOutputs {
    /// Set-point of the motor ([`crate::motor::MotorCommand::Setpoint`]).
    pub setpoint: Setpoint,
    /// To be executed before the set-point.
    pub arming: Option<ArmingRequest>,
    /// New opening of the motor control ([`crate::motor::MotorCommand::SetOpening`]), before the set-point; NaN makes the
    /// opening unknown.
    pub opening_mm: Option<f32>,
    /// Whether a host may arm ([`crate::protocol::session::Session::set_may_arm`]).
    pub may_arm: bool,
    /// State code for the heartbeat.
    pub state: u8,
    /// Status message; its counter is set by the sender.
    pub status: GripStatus,
    /// Ground-contact message in foot mode; its counter is set by the sender.
    pub foot: Option<Foot>,
    /// A refused command.
    pub refused: Option<CommandRefusal>,
    /// Changed faults of motor and grip.
    pub events: heapless::Vec<FaultEvent, EVENTS>,
}

/// Settings of a gripper.
#[derive(Clone, Debug)]
pub(super) struct GripSettings {
    pub(super) limits: GripLimits,
    pub(super) screw: Screw,
    /// The screw holds its load without current.
    pub(super) self_locking: bool,
}
