//! Events and transition tables of both state machines. An event that a table does not list for a state has no effect.

use crate::grip::commands::RefusalReason;
use crate::grip::states::{PowerState, TaskState};

/// Declares an enum of events with a list of all of them.
macro_rules! events {
    ($(#[doc = $doc:literal])+ $name:ident { $($(#[doc = $words:literal])+ $event:ident,)* }) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[doc = $words])+ $event,)*
        }

        impl $name {
            /// All events.
            pub const ALL: &[Self] = &[$(Self::$event,)*];
        }
    };
}

events! {
    /// Events of the power layer.
    PowerEvent {
        /// The program runs.
        Started,
        /// The self-test passed.
        SelfTestPassed,
        /// The self-test failed.
        SelfTestFailed,
        /// A tare or commissioning began.
        CalibrationBegan,
        /// The tare or commissioning ended.
        CalibrationEnded,
        /// A host requested a nonce.
        NonceOffered,
        /// The nonce was not returned in time.
        NonceExpired,
        /// The nonce was returned: a session is open.
        SessionOpened,
        /// The session ended and no load needs the motor.
        SessionClosed,
        /// A host enables the drive.
        Enable,
        /// A host disables the drive.
        Disable,
        /// Stop-all frame, or a fault whose reaction is a quick stop.
        QuickStop,
        /// The fingers have come to rest.
        Stopped,
        /// A fault whose reaction is braking or switching off.
        Fault,
        /// The reaction to the fault has ended.
        ReactionDone,
        /// A host clears the faults, and the cause is gone.
        Cleared,
    }
}

events! {
    /// Events of the task layer: first the host commands, then what the controller detects.
    TaskEvent {
        /// Command: home.
        Home,
        /// Command: move to an opening.
        Move,
        /// Command: grip with a force.
        Grip,
        /// Command: open.
        Release,
        /// Command: stop.
        Stop,
        /// Command: enter foot mode.
        Foot,
        /// Command: leave foot mode.
        LeaveFoot,
        /// Both ends were found, and the stroke is right.
        Homed,
        /// An end was not found, or the stroke is wrong.
        HomingFailed,
        /// The target opening is reached.
        Reached,
        /// The fingers press against something.
        Contact,
        /// The fingers rest, and a host is alive.
        Stopped,
        /// The fingers rest, and no host is alive.
        StoppedWithoutHost,
        /// The fingers rest, and the opening is unknown.
        StoppedUnhomed,
        /// The opening is smaller than any expected object.
        NoObject,
        /// Timeout, or the object is wider than its window.
        Failed,
        /// The force has been in its band for the settling time.
        Settled,
        /// The screw may hold the force without current.
        ReleaseCurrent,
        /// The force fell while the screw held it.
        ForceDropped,
        /// The object slips.
        Slipped,
        /// The object is lost.
        ObjectLost,
        /// No finger has a valid force.
        ForceLost,
        /// A finger has a valid force again.
        ForceRestored,
        /// The fingers opened, and the opening is unknown.
        ReachedUnhomed,
        /// The fingers rest while they were releasing an object.
        StoppedReleasing,
        /// No slip for some time: the force returns to the requested one.
        SlipEnded,
        /// No command within the session's timeout.
        HostTimeout,
    }
}

/// Transitions of the power layer.
pub const POWER_TRANSITIONS: &[(PowerState, PowerEvent, PowerState)] = {
    use PowerState::{
        ArmPending, Armed, Boot, Calibrating, Enabled, Fault, FaultReaction, QuickStop, Safe,
        SelfTest,
    };
    &[
        (Boot, PowerEvent::Started, SelfTest),
        (SelfTest, PowerEvent::SelfTestPassed, Safe),
        (SelfTest, PowerEvent::SelfTestFailed, Fault),
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
        (FaultReaction, PowerEvent::ReactionDone, Fault),
        (Fault, PowerEvent::Cleared, Safe),
    ]
};

/// Transitions of the task layer.
pub const TASK_TRANSITIONS: &[(TaskState, TaskEvent, TaskState)] = {
    use TaskState::{
        Approach, ContactStop, Foot, Force, GripFailed, HoldActive, HoldFrozen, HoldLatched,
        Homing, Idle, Lost, Moving, NoObject, Releasing, Stopping, TimeoutHold, Unhomed,
    };
    &[
        (Unhomed, TaskEvent::Home, Homing),
        (Unhomed, TaskEvent::Stop, Unhomed),
        (Unhomed, TaskEvent::Release, Releasing),
        (Homing, TaskEvent::Home, Homing),
        (Homing, TaskEvent::Homed, Idle),
        (Homing, TaskEvent::HomingFailed, Unhomed),
        (Homing, TaskEvent::Stop, Stopping),
        (Homing, TaskEvent::HostTimeout, Stopping),
        (Homing, TaskEvent::Release, Releasing),
        (Idle, TaskEvent::Home, Homing),
        (Idle, TaskEvent::Move, Moving),
        (Idle, TaskEvent::Grip, Approach),
        (Idle, TaskEvent::Stop, Idle),
        (Idle, TaskEvent::Foot, Foot),
        (Idle, TaskEvent::Release, Releasing),
        (Moving, TaskEvent::Move, Moving),
        (Moving, TaskEvent::Reached, Idle),
        (Moving, TaskEvent::Contact, ContactStop),
        (Moving, TaskEvent::Stop, Stopping),
        (Moving, TaskEvent::HostTimeout, Stopping),
        (Moving, TaskEvent::Release, Releasing),
        (ContactStop, TaskEvent::Stop, ContactStop),
        (ContactStop, TaskEvent::Stopped, Idle),
        (ContactStop, TaskEvent::StoppedWithoutHost, Idle),
        (ContactStop, TaskEvent::StoppedUnhomed, Unhomed),
        (ContactStop, TaskEvent::Release, Releasing),
        (Approach, TaskEvent::Grip, Approach),
        (Approach, TaskEvent::Contact, Force),
        (Approach, TaskEvent::NoObject, NoObject),
        (Approach, TaskEvent::Failed, GripFailed),
        (Approach, TaskEvent::Stop, Stopping),
        (Approach, TaskEvent::HostTimeout, Stopping),
        (Approach, TaskEvent::Release, Releasing),
        (Force, TaskEvent::Grip, Force),
        (Force, TaskEvent::Stop, Force),
        (Force, TaskEvent::Settled, HoldActive),
        (Force, TaskEvent::Slipped, Force),
        (Force, TaskEvent::Failed, GripFailed),
        (Force, TaskEvent::ObjectLost, Lost),
        (Force, TaskEvent::ForceLost, HoldFrozen),
        (Force, TaskEvent::Release, Releasing),
        (HoldActive, TaskEvent::Grip, Force),
        (HoldActive, TaskEvent::Stop, HoldActive),
        (HoldActive, TaskEvent::ReleaseCurrent, HoldLatched),
        (HoldActive, TaskEvent::Slipped, Force),
        (HoldActive, TaskEvent::SlipEnded, Force),
        (HoldActive, TaskEvent::ObjectLost, Lost),
        (HoldActive, TaskEvent::ForceLost, HoldFrozen),
        (HoldActive, TaskEvent::Release, Releasing),
        (HoldLatched, TaskEvent::Grip, Force),
        (HoldLatched, TaskEvent::Stop, HoldLatched),
        (HoldLatched, TaskEvent::ForceDropped, Force),
        (HoldLatched, TaskEvent::Slipped, Force),
        (HoldLatched, TaskEvent::SlipEnded, Force),
        (HoldLatched, TaskEvent::ObjectLost, Lost),
        (HoldLatched, TaskEvent::ForceLost, HoldFrozen),
        (HoldLatched, TaskEvent::Release, Releasing),
        (HoldFrozen, TaskEvent::Stop, HoldFrozen),
        (HoldFrozen, TaskEvent::ForceRestored, Force),
        (HoldFrozen, TaskEvent::Release, Releasing),
        (NoObject, TaskEvent::Move, Moving),
        (NoObject, TaskEvent::Grip, Approach),
        (NoObject, TaskEvent::Stop, Idle),
        (NoObject, TaskEvent::Release, Releasing),
        (GripFailed, TaskEvent::Stop, GripFailed),
        (GripFailed, TaskEvent::Release, Releasing),
        (Lost, TaskEvent::Move, Moving),
        (Lost, TaskEvent::Grip, Approach),
        (Lost, TaskEvent::Stop, Idle),
        (Lost, TaskEvent::Release, Releasing),
        (Releasing, TaskEvent::Release, Releasing),
        (Releasing, TaskEvent::Reached, Idle),
        (Releasing, TaskEvent::ReachedUnhomed, Unhomed),
        (Releasing, TaskEvent::Contact, ContactStop),
        (Releasing, TaskEvent::Stop, Stopping),
        (Releasing, TaskEvent::HostTimeout, Stopping),
        (Foot, TaskEvent::Foot, Foot),
        (Foot, TaskEvent::Stop, Foot),
        (Foot, TaskEvent::LeaveFoot, Idle),
        (Stopping, TaskEvent::Stop, Stopping),
        (Stopping, TaskEvent::Stopped, Idle),
        (Stopping, TaskEvent::StoppedWithoutHost, TimeoutHold),
        (Stopping, TaskEvent::StoppedUnhomed, Unhomed),
        (Stopping, TaskEvent::StoppedReleasing, GripFailed),
        (Stopping, TaskEvent::Release, Releasing),
        (TimeoutHold, TaskEvent::Move, Moving),
        (TimeoutHold, TaskEvent::Grip, Approach),
        (TimeoutHold, TaskEvent::Stop, Idle),
        (TimeoutHold, TaskEvent::Release, Releasing),
    ]
};

/// Next state of the power layer; none where the table lists nothing.
pub fn next_power_state(from: PowerState, event: PowerEvent) -> Option<PowerState> {
    let mut rows = POWER_TRANSITIONS.iter();
    rows.find_map(|(state, on, to)| (*state == from && *on == event).then_some(*to))
}

/// Next state of the task layer.
///
/// # Errors
/// The table lists nothing: the reason to refuse a command in this state.
pub fn next_task_state(from: TaskState, event: TaskEvent) -> Result<TaskState, RefusalReason> {
    let mut rows = TASK_TRANSITIONS.iter();
    rows.find_map(|(state, on, to)| (*state == from && *on == event).then_some(*to))
        .ok_or(RefusalReason::of(from))
}
