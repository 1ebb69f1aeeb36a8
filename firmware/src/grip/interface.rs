//! What a millisecond of the grasp is told, and what it tells.

use super::reason::Refused;
use crate::force::Estimate;
use crate::frame::SENSORS;
use crate::motor::{Setpoint, Telling};
use crate::wire::messages::{Command, FaultEvent, Foot, GripStatus};

/// Events of a millisecond that are told at the most; there are as many kinds of own faults.
const EVENTS: usize = 24;

/// What hosts have to do with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Host {
    /// A nonce is offered ([`crate::session::Session::is_offered`]).
    pub is_offered: bool,
    /// A session is open ([`crate::session::Session::is_open`]).
    pub is_open: bool,
    /// Commands arrive in time ([`crate::session::Session::is_alive`]).
    pub is_alive: bool,
}

/// What is known in a millisecond.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// Forces, tare taken off.
    pub estimates: &'a [Estimate; SENSORS],
    /// The motor.
    pub motor: Telling,
    /// Hosts.
    pub host: Host,
    /// A command that counts ([`crate::session::Heard::Command`]).
    pub command: Option<Command>,
    /// Somebody says stop ([`crate::session::Heard::Stop`]).
    pub stop: bool,
    /// A host clears faults ([`crate::session::op::CLEAR_FAULTS`]).
    pub clear: bool,
    /// Active faults that others found, in the heartbeat's bits ([`crate::status::Faults::bits`]).
    pub faults: u32,
    /// What the self-test found; none while it runs.
    pub is_sound: Option<bool>,
    /// A tare or the motor's commissioning is under way.
    pub is_calibrating: bool,
    /// Of the fingertips in mm/s^2, gripper's axes, gravity included; none where it is not known, or the
    /// estimates are without it already.
    pub acceleration: Option<[i32; 3]>,
}

/// Whether the motor is to follow set-points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arming {
    /// [`crate::motor::Order::Arm`].
    Arm,
    /// [`crate::motor::Order::Disarm`].
    Disarm,
}

/// What is to be done and told.
#[derive(Clone, Debug)]
pub struct Outputs {
    /// For [`crate::motor::Order::Do`].
    pub setpoint: Setpoint,
    /// Before the set-point.
    pub arming: Option<Arming>,
    /// For [`crate::motor::Order::Opening`], before the set-point; what is not a number: not known any more.
    pub opening_mm: Option<f32>,
    /// For [`crate::session::Session::allow`].
    pub may_arm: bool,
    /// For the heartbeat.
    pub state: u8,
    /// The grip. Whoever sends it counts it.
    pub status: GripStatus,
    /// The foot, while it is one; likewise.
    pub foot: Option<Foot>,
    /// A command that is not done.
    pub refused: Option<Refused>,
    /// Faults of the motor and the grasp that came or went.
    pub events: heapless::Vec<FaultEvent, EVENTS>,
}
