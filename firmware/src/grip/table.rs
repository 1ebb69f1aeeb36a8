//! Which state follows which: two tables, and nothing that is not in them happens.

use super::reason::Reason;
use super::states::{Power, Task};

/// What happens to the power layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerEvent {
    /// The program runs.
    Started,
    /// The self-test found nothing.
    Passed,
    /// The self-test found something.
    Failed,
    /// A tare or the commissioning began.
    CalibrationBegan,
    /// It ended.
    CalibrationEnded,
    /// A host asked for a nonce.
    NonceOffered,
    /// The nonce was not said back in time.
    NonceExpired,
    /// The nonce was said back: a session is open.
    SessionOpened,
    /// The session ended and nothing is held.
    SessionClosed,
    /// A host asks for the drive.
    Enable,
    /// A host gives the drive back.
    Disable,
    /// A stop for everybody, or a fault for which stopping is enough.
    QuickStop,
    /// The fingers rest.
    Stopped,
    /// A fault for which stopping is not enough.
    Fault,
    /// The reaction to it is over.
    Reacted,
    /// A host clears, and the cause is gone.
    Cleared,
}

impl PowerEvent {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::Started,
        Self::Passed,
        Self::Failed,
        Self::CalibrationBegan,
        Self::CalibrationEnded,
        Self::NonceOffered,
        Self::NonceExpired,
        Self::SessionOpened,
        Self::SessionClosed,
        Self::Enable,
        Self::Disable,
        Self::QuickStop,
        Self::Stopped,
        Self::Fault,
        Self::Reacted,
        Self::Cleared,
    ];
}

/// What happens to the task layer: first what hosts ask for, then what is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskEvent {
    /// Home.
    Home,
    /// Go to an opening.
    Move,
    /// Grip with a force.
    Grip,
    /// Open.
    Release,
    /// Stop.
    Stop,
    /// Be a foot.
    Foot,
    /// Be a foot no more.
    Leave,
    /// Both ends were found, and the stroke is right.
    Homed,
    /// They were not.
    NotHomed,
    /// The way has ended.
    Reached,
    /// The fingers press against something.
    Contact,
    /// The fingers rest, and a host is there.
    AtRest,
    /// The fingers rest, and no host is there.
    AtRestAlone,
    /// The fingers rest, and the opening is not known.
    AtRestUnhomed,
    /// The fingers are nearer than any object is.
    NothingThere,
    /// It took too long, or the object's width is not the one that was asked for.
    Failed,
    /// The force has been right for long enough.
    Settled,
    /// The screw may hold alone.
    Lock,
    /// Without current the force fell.
    Weak,
    /// The object slips.
    Slipped,
    /// The object is gone.
    Gone,
    /// No finger's force is to be believed.
    Blind,
    /// A finger's force is to be believed again.
    Sighted,
    /// The host fell silent.
    Silent,
}

impl TaskEvent {
    /// All of them.
    pub const ALL: [Self; 24] = [
        Self::Home,
        Self::Move,
        Self::Grip,
        Self::Release,
        Self::Stop,
        Self::Foot,
        Self::Leave,
        Self::Homed,
        Self::NotHomed,
        Self::Reached,
        Self::Contact,
        Self::AtRest,
        Self::AtRestAlone,
        Self::AtRestUnhomed,
        Self::NothingThere,
        Self::Failed,
        Self::Settled,
        Self::Lock,
        Self::Weak,
        Self::Slipped,
        Self::Gone,
        Self::Blind,
        Self::Sighted,
        Self::Silent,
    ];
}

/// The power layer.
pub const POWER: &[(Power, PowerEvent, Power)] = {
    use Power::{
        ArmPending, Armed, Boot, Calibrating, Enabled, Fault, FaultReaction, QuickStop, Safe,
        SelfTest,
    };
    &[
        (Boot, PowerEvent::Started, SelfTest),
        (SelfTest, PowerEvent::Passed, Safe),
        (SelfTest, PowerEvent::Failed, Fault),
        (Safe, PowerEvent::CalibrationBegan, Calibrating),
        (Calibrating, PowerEvent::CalibrationEnded, Safe),
        (Safe, PowerEvent::NonceOffered, ArmPending),
        (ArmPending, PowerEvent::NonceExpired, Safe),
        (ArmPending, PowerEvent::SessionOpened, Armed),
        (Armed, PowerEvent::SessionClosed, Safe),
        (Armed, PowerEvent::Enable, Enabled),
        (Enabled, PowerEvent::Disable, Armed),
        (Enabled, PowerEvent::QuickStop, QuickStop),
        (QuickStop, PowerEvent::Stopped, Armed),
        (Armed, PowerEvent::Fault, FaultReaction),
        (Enabled, PowerEvent::Fault, FaultReaction),
        (QuickStop, PowerEvent::Fault, FaultReaction),
        (FaultReaction, PowerEvent::Reacted, Fault),
        (Fault, PowerEvent::Cleared, Safe),
    ]
};

/// The task layer.
pub const TASK: &[(Task, TaskEvent, Task)] = {
    use Task::{
        Approach, ContactStop, Foot, Force, GripFailed, HoldActive, HoldFrozen, HoldLatched,
        Homing, Idle, Lost, Moving, NoObject, Releasing, Stopping, TimeoutHold, Unhomed,
    };
    &[
        (Unhomed, TaskEvent::Home, Homing),
        (Unhomed, TaskEvent::Stop, Unhomed),
        (Homing, TaskEvent::Home, Homing),
        (Homing, TaskEvent::Homed, Idle),
        (Homing, TaskEvent::NotHomed, Unhomed),
        (Homing, TaskEvent::Stop, Stopping),
        (Homing, TaskEvent::Silent, Stopping),
        (Idle, TaskEvent::Home, Homing),
        (Idle, TaskEvent::Move, Moving),
        (Idle, TaskEvent::Grip, Approach),
        (Idle, TaskEvent::Stop, Idle),
        (Idle, TaskEvent::Foot, Foot),
        (Moving, TaskEvent::Move, Moving),
        (Moving, TaskEvent::Reached, Idle),
        (Moving, TaskEvent::Contact, ContactStop),
        (Moving, TaskEvent::Stop, Stopping),
        (Moving, TaskEvent::Silent, Stopping),
        (ContactStop, TaskEvent::Stop, ContactStop),
        (ContactStop, TaskEvent::AtRest, Idle),
        (ContactStop, TaskEvent::AtRestAlone, Idle),
        (Approach, TaskEvent::Grip, Approach),
        (Approach, TaskEvent::Contact, Force),
        (Approach, TaskEvent::NothingThere, NoObject),
        (Approach, TaskEvent::Failed, GripFailed),
        (Approach, TaskEvent::Stop, Stopping),
        (Approach, TaskEvent::Silent, Stopping),
        (Force, TaskEvent::Grip, Force),
        (Force, TaskEvent::Stop, Force),
        (Force, TaskEvent::Settled, HoldActive),
        (Force, TaskEvent::Slipped, Force),
        (Force, TaskEvent::Failed, GripFailed),
        (Force, TaskEvent::Gone, Lost),
        (Force, TaskEvent::Blind, HoldFrozen),
        (Force, TaskEvent::Release, Releasing),
        (HoldActive, TaskEvent::Grip, Force),
        (HoldActive, TaskEvent::Stop, HoldActive),
        (HoldActive, TaskEvent::Lock, HoldLatched),
        (HoldActive, TaskEvent::Slipped, Force),
        (HoldActive, TaskEvent::Gone, Lost),
        (HoldActive, TaskEvent::Blind, HoldFrozen),
        (HoldActive, TaskEvent::Release, Releasing),
        (HoldLatched, TaskEvent::Grip, Force),
        (HoldLatched, TaskEvent::Stop, HoldLatched),
        (HoldLatched, TaskEvent::Weak, Force),
        (HoldLatched, TaskEvent::Slipped, Force),
        (HoldLatched, TaskEvent::Gone, Lost),
        (HoldLatched, TaskEvent::Blind, HoldFrozen),
        (HoldLatched, TaskEvent::Release, Releasing),
        (HoldFrozen, TaskEvent::Stop, HoldFrozen),
        (HoldFrozen, TaskEvent::Sighted, Force),
        (HoldFrozen, TaskEvent::Release, Releasing),
        (NoObject, TaskEvent::Move, Moving),
        (NoObject, TaskEvent::Grip, Approach),
        (NoObject, TaskEvent::Stop, Idle),
        (GripFailed, TaskEvent::Stop, GripFailed),
        (GripFailed, TaskEvent::Release, Releasing),
        (Lost, TaskEvent::Move, Moving),
        (Lost, TaskEvent::Grip, Approach),
        (Lost, TaskEvent::Stop, Idle),
        (Releasing, TaskEvent::Release, Releasing),
        (Releasing, TaskEvent::Reached, Idle),
        (Releasing, TaskEvent::Stop, Stopping),
        (Releasing, TaskEvent::Silent, Stopping),
        (Foot, TaskEvent::Foot, Foot),
        (Foot, TaskEvent::Stop, Foot),
        (Foot, TaskEvent::Leave, Idle),
        (Stopping, TaskEvent::Stop, Stopping),
        (Stopping, TaskEvent::AtRest, Idle),
        (Stopping, TaskEvent::AtRestAlone, TimeoutHold),
        (Stopping, TaskEvent::AtRestUnhomed, Unhomed),
        (TimeoutHold, TaskEvent::Move, Moving),
        (TimeoutHold, TaskEvent::Grip, Approach),
        (TimeoutHold, TaskEvent::Stop, Idle),
    ]
};

/// What follows in the power layer; none where the table lists nothing.
pub fn power(from: Power, event: PowerEvent) -> Option<Power> {
    let mut rows = POWER.iter();
    rows.find_map(|(state, happens, to)| (*state == from && *happens == event).then_some(*to))
}

/// What follows in the task layer.
///
/// # Errors
/// The table lists nothing: why, for whoever asked.
pub fn task(from: Task, event: TaskEvent) -> Result<Task, Reason> {
    let mut rows = TASK.iter();
    rows.find_map(|(state, happens, to)| (*state == from && *happens == event).then_some(*to))
        .ok_or(Reason::of(from))
}
