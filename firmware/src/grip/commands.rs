//! Host commands: decoding of [`Command`] into newtons and millimetres, force and speed profiles, refusals.
//!
//! Hosts repeat a command while it is in force. A repeated command is executed once; toggling [`flag::AGAIN`] makes
//! it a new one, for example to grip again after a failure.

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::grip::states::TaskState;
use crate::protocol::messages::{Command, ServiceReply};
use crate::protocol::session::{op, status};

/// Modes of a [`Command`].
pub mod mode {
    /// Disable the drive.
    pub const DISABLE: u8 = 0;
    /// Enable the drive; once enabled, a sign of life.
    pub const ENABLE: u8 = 1;
    /// Home on force.
    pub const HOME: u8 = 2;
    /// Move to an opening: position, speed.
    pub const MOVE: u8 = 3;
    /// Grip: force, speed (0: maximum for the force), flags; the expected width as position if the flags give
    /// a window.
    pub const GRIP: u8 = 4;
    /// Open, from every state but foot mode and under every fault of the sensing: position, speed.
    pub const RELEASE: u8 = 5;
    /// Stop; a held object stays held.
    pub const STOP: u8 = 6;
    /// Enter foot mode: flags.
    pub const FOOT: u8 = 7;
    /// Leave foot mode.
    pub const LEAVE: u8 = 8;
}

/// Flags of a [`Command`].
pub mod flag {
    /// MOVE: the forces are not believed, as before a calibration. Slower, with little current, until the current finds an
    /// obstacle.
    pub const UNCALIBRATED: u8 = 0b0000_0001;
    /// GRIP, two bits: a [`super::GripProfile`].
    pub const PROFILE: u8 = 0b0000_0011;
    /// Three bits: 0 accepts any width; n a window of 2^(n-1) mm on either side of the expected width.
    pub const WINDOW: u8 = 0b0001_1100;
    /// Maximum speed until close to the window.
    pub const FAST: u8 = 0b0010_0000;
    /// Foot mode with open fingers on a line; else flat on closed fingers.
    pub const LINE: u8 = 0b0100_0000;
    /// Toggled to make a repeated command a new one.
    pub const AGAIN: u8 = 0b1000_0000;
}

/// Bus counts per unit of position, speed and force.
const PER_UNIT: [f32; 3] = match Command::LAYOUT.signals {
    [_, position, speed, force, ..] => [
        position.counts_per_unit() as f32,
        speed.counts_per_unit() as f32,
        force.counts_per_unit() as f32,
    ],
    _ => panic!("the layout needs position, speed and force"),
};

/// Widths in millimetres at which an object is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidthWindow {
    /// Minimum.
    pub min_mm: f32,
    /// Maximum.
    pub max_mm: f32,
}

/// Parameters of a grasp.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GraspTarget {
    /// Force set-point in newtons.
    pub setpoint_n: f32,
    /// Maximum closing speed in mm/s.
    pub max_mm_s: f32,
    /// Maximum force after slips, in newtons.
    pub cap_n: f32,
    /// Expected width of the object.
    pub window: Option<WidthWindow>,
    /// See [`flag::FAST`].
    pub is_fast: bool,
}

/// Target of a move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MoveTarget {
    /// Opening in millimetres between the fingers.
    pub opening_mm: f32,
    /// Maximum speed in mm/s.
    pub speed_mm_s: f32,
    /// See [`flag::UNCALIBRATED`].
    pub is_uncalibrated: bool,
}

/// A decoded command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GripCommand {
    /// See [`mode::DISABLE`].
    Disable,
    /// See [`mode::ENABLE`].
    Enable,
    /// See [`mode::HOME`].
    Home,
    /// See [`mode::MOVE`].
    Move(MoveTarget),
    /// See [`mode::GRIP`].
    Grip(GraspTarget),
    /// See [`mode::RELEASE`].
    Release(MoveTarget),
    /// See [`mode::STOP`].
    Stop,
    /// See [`mode::FOOT`].
    Foot {
        /// See [`flag::LINE`].
        on_line: bool,
    },
    /// See [`mode::LEAVE`].
    LeaveFoot,
}

impl GripCommand {
    /// Decodes a command.
    ///
    /// # Errors
    /// [`RefusalReason::UnknownMode`], or [`RefusalReason::OutOfRange`] for a profile or value out of range.
    pub fn of(command: &Command, limits: &GripLimits) -> Result<Self, RefusalReason> {
        match command.mode {
            mode::DISABLE => Ok(Self::Disable),
            mode::ENABLE => Ok(Self::Enable),
            mode::HOME => Ok(Self::Home),
            mode::MOVE => move_target(command).map(Self::Move),
            mode::GRIP => grasp_target(command, limits).map(Self::Grip),
            mode::RELEASE => move_target(command).map(Self::Release),
            mode::STOP => Ok(Self::Stop),
            mode::FOOT => Ok(Self::Foot { on_line: command.flags & flag::LINE != 0 }),
            mode::LEAVE => Ok(Self::LeaveFoot),
            _ => Err(RefusalReason::UnknownMode),
        }
    }
}

fn move_target(command: &Command) -> Result<MoveTarget, RefusalReason> {
    let [per_mm, per_mm_s, _] = PER_UNIT;
    let opening_mm = f32::from(command.position) / per_mm;
    let speed_mm_s = f32::from(command.speed) / per_mm_s;
    let is_in_range = opening_mm <= constants::STROKE.value as f32 && command.speed > 0;
    let is_uncalibrated = command.mode == mode::MOVE && command.flags & flag::UNCALIBRATED != 0;
    let target = MoveTarget { opening_mm, speed_mm_s, is_uncalibrated };
    is_in_range.then_some(target).ok_or(RefusalReason::OutOfRange)
}

fn grasp_target(command: &Command, limits: &GripLimits) -> Result<GraspTarget, RefusalReason> {
    let [per_mm, per_mm_s, per_n] = PER_UNIT;
    let profile =
        GripProfile::of(command.flags & flag::PROFILE).ok_or(RefusalReason::OutOfRange)?;
    let setpoint_n = f32::from(command.force) / per_n;
    let cap_n = profile.max_n().min(limits.max_n);
    if setpoint_n < limits.contact_n || setpoint_n > cap_n {
        return Err(RefusalReason::OutOfRange);
    }
    let width_mm = f32::from(command.position) / per_mm;
    let window = match (command.flags & flag::WINDOW) >> flag::WINDOW.trailing_zeros() {
        0 => None,
        n => {
            let half_mm = f32::from(1_u8 << (n - 1));
            Some(WidthWindow { min_mm: width_mm - half_mm, max_mm: width_mm + half_mm })
        }
    };
    let requested_mm_s = match command.speed {
        0 => profile.max_mm_s(),
        speed => f32::from(speed) / per_mm_s,
    };
    Ok(GraspTarget {
        setpoint_n,
        max_mm_s: requested_mm_s.min(profile.max_mm_s()),
        cap_n,
        window,
        is_fast: command.flags & flag::FAST != 0,
    })
}

/// Limits of force and speed of a grasp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GripProfile {
    /// Default.
    #[default]
    Normal,
    /// Fragile objects, such as eggs.
    Fragile,
    /// Tools.
    Strong,
}

impl GripProfile {
    /// From the flags of a command; none for an undefined value.
    pub const fn of(bits: u8) -> Option<Self> {
        match bits {
            0 => Some(Self::Normal),
            1 => Some(Self::Fragile),
            2 => Some(Self::Strong),
            _ => None,
        }
    }

    /// Maximum force in newtons, including increases after a slip.
    pub const fn max_n(self) -> f32 {
        match self {
            Self::Fragile => 20.0,
            Self::Normal => 100.0,
            Self::Strong => constants::GRASP_FORCE.value as f32,
        }
    }

    /// Maximum closing speed in mm/s.
    pub const fn max_mm_s(self) -> f32 {
        match self {
            Self::Fragile => 5.0,
            Self::Normal | Self::Strong => constants::CLOSING_SPEED.value as f32,
        }
    }
}

const _: () = {
    let limits = GripLimits::GRIPPER;
    assert!(GripProfile::Strong.max_n() <= limits.max_n && limits.max_n < limits.trip_n);
};

/// Why a command is refused; the number is sent to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum RefusalReason {
    /// The mode is undefined.
    UnknownMode = 1,
    /// The drive is not enabled.
    NotEnabled = 2,
    /// A fault is active.
    FaultActive = 3,
    /// A fault is latched and must be cleared first.
    FaultLatched = 4,
    /// The motor measures its current offsets or has tripped.
    MotorNotReady = 5,
    /// The opening is unknown: home first.
    NotHomed = 6,
    /// The fingers are moving: stop first.
    Busy = 7,
    /// An object is gripped: release first.
    Gripping = 8,
    /// Foot mode is active: leave it first.
    FootMode = 9,
    /// The command does not apply in this state.
    NotApplicable = 10,
    /// A value is out of range or above the cap of the profile, or of the bench.
    OutOfRange = 11,
    /// No finger has a valid force.
    Blind = 12,
    /// The fingers are loaded.
    Loaded = 13,
    /// The fingers are not at the opening of foot mode.
    NotParked = 14,
    /// A stop is latched: clear it first, at rest.
    Stopped = 15,
}

impl RefusalReason {
    /// Why a state refuses a command that its transition table does not list.
    pub const fn of(state: TaskState) -> Self {
        match state {
            TaskState::Unhomed => Self::NotHomed,
            TaskState::Homing
            | TaskState::Moving
            | TaskState::ContactStop
            | TaskState::Approach
            | TaskState::Releasing
            | TaskState::Stopping => Self::Busy,
            TaskState::Force
            | TaskState::HoldActive
            | TaskState::HoldLatched
            | TaskState::HoldFrozen
            | TaskState::GripFailed => Self::Gripping,
            TaskState::Foot => Self::FootMode,
            TaskState::Idle | TaskState::NoObject | TaskState::Lost | TaskState::TimeoutHold => {
                Self::NotApplicable
            }
        }
    }
}

/// A refused command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandRefusal {
    /// Mode of the command.
    pub mode: u8,
    /// Why it is refused.
    pub reason: RefusalReason,
    /// State code at that time, as in the heartbeat.
    pub state: u8,
}

impl CommandRefusal {
    /// Reply to the host; its detail has, from the lowest byte, reason, state and mode.
    pub fn reply(&self) -> ServiceReply {
        let [mode, state, reason] = [self.mode, self.state, self.reason as u8].map(u32::from);
        ServiceReply {
            op: op::COMMAND,
            status: status::REFUSED,
            extra: 0,
            detail: mode << 16 | state << 8 | reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: GripLimits = GripLimits::GRIPPER;

    #[test]
    fn grip_command_decodes_to_newtons_and_millimetres() {
        // 35 mm, 10 mm/s, 80 N, normal, a window of 4 mm on either side.
        let command =
            Command { mode: mode::GRIP, position: 700, speed: 40, force: 800, flags: 3 << 2 };
        let expected = GraspTarget {
            setpoint_n: 80.0,
            max_mm_s: 10.0,
            cap_n: 100.0,
            window: Some(WidthWindow { min_mm: 31.0, max_mm: 39.0 }),
            is_fast: false,
        };
        assert_eq!(GripCommand::of(&command, &LIMITS), Ok(GripCommand::Grip(expected)));
    }

    #[test]
    fn modes_decode_to_commands() {
        let of = |mode| {
            let command = Command { mode, ..Command::default() };
            GripCommand::of(&command, &LIMITS)
        };
        for (mode, order) in [
            (mode::DISABLE, GripCommand::Disable),
            (mode::ENABLE, GripCommand::Enable),
            (mode::HOME, GripCommand::Home),
            (mode::STOP, GripCommand::Stop),
            (mode::FOOT, GripCommand::Foot { on_line: false }),
            (mode::LEAVE, GripCommand::LeaveFoot),
        ] {
            assert_eq!(of(mode), Ok(order));
        }
    }

    #[test]
    fn force_outside_its_profile_is_refused() {
        let of = |force, flags| {
            let command = Command { mode: mode::GRIP, force, flags, ..Command::default() };
            GripCommand::of(&command, &LIMITS).err()
        };
        assert_eq!([of(1000, 0), of(1001, 0)], [None, Some(RefusalReason::OutOfRange)]);
        assert_eq!([of(200, 1), of(201, 1)], [None, Some(RefusalReason::OutOfRange)]);
        assert_eq!([of(3500, 2), of(3501, 2)], [None, Some(RefusalReason::OutOfRange)]);
        assert_eq!([of(50, 0), of(49, 0)], [None, Some(RefusalReason::OutOfRange)]);
        assert_eq!(of(50, 3), Some(RefusalReason::OutOfRange));
    }

    #[test]
    fn invalid_move_or_mode_is_refused() {
        let of = |mode, position, speed| {
            let command = Command { mode, position, speed, ..Command::default() };
            GripCommand::of(&command, &LIMITS).err()
        };
        assert_eq!([of(3, 1600, 1), of(3, 1601, 1)], [None, Some(RefusalReason::OutOfRange)]);
        assert_eq!(of(5, 800, 0), Some(RefusalReason::OutOfRange));
        assert_eq!([of(8, 0, 0), of(9, 0, 0)], [None, Some(RefusalReason::UnknownMode)]);
    }

    #[test]
    fn three_profiles_are_defined() {
        let caps = [0, 1, 2].map(|bits| GripProfile::of(bits).unwrap().max_n());
        assert_eq!(caps, [100.0, 20.0, 350.0]);
        assert_eq!(GripProfile::of(3), None);
    }
}
