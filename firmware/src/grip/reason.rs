//! Why something that a host asked for is not done.

use super::states::Task;
use crate::session::{op, status};
use crate::wire::messages::ServiceReply;

/// A reason; the number goes on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// The mode has no meaning.
    UnknownMode = 1,
    /// The drive is not enabled.
    NotEnabled = 2,
    /// A fault is active.
    Faulty = 3,
    /// A fault is latched: clear it first.
    Latched = 4,
    /// The motor is not ready: its offsets are being taken, or it has tripped.
    MotorNotReady = 5,
    /// The opening is not known: home first.
    NotHomed = 6,
    /// The fingers are under way: stop first.
    Busy = 7,
    /// Something is gripped: release first.
    Gripping = 8,
    /// It is a foot: leave that first.
    IsFoot = 9,
    /// In this state it means nothing.
    Senseless = 10,
    /// A number is beyond its range, or beyond the profile's cap.
    OutOfRange = 11,
    /// No finger's force is to be believed.
    Blind = 12,
    /// A load is on the fingers.
    Loaded = 13,
    /// The fingers are not where the foot wants them.
    NotParked = 14,
}

impl Reason {
    /// Why a state does not do what its table does not list.
    pub const fn of(state: Task) -> Self {
        match state {
            Task::Unhomed => Self::NotHomed,
            Task::Homing
            | Task::Moving
            | Task::ContactStop
            | Task::Approach
            | Task::Releasing
            | Task::Stopping => Self::Busy,
            Task::Force
            | Task::HoldActive
            | Task::HoldLatched
            | Task::HoldFrozen
            | Task::GripFailed => Self::Gripping,
            Task::Foot => Self::IsFoot,
            Task::Idle | Task::NoObject | Task::Lost | Task::TimeoutHold => Self::Senseless,
        }
    }
}

/// A command that is not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Mode asked for.
    pub mode: u8,
    /// Why not.
    pub reason: Reason,
    /// State in which it was asked for, as in the heartbeat.
    pub state: u8,
}

impl Refused {
    /// The answer to the host: reason in the lowest byte of the detail, then the state, then the mode.
    pub fn reply(&self) -> ServiceReply {
        let [mode, state, reason] = [self.mode, self.state, self.reason as u8].map(u32::from);
        ServiceReply {
            op: op::COMMAND,
            status: status::REFUSED,
            nonce: 0,
            detail: mode << 16 | state << 8 | reason,
        }
    }
}
