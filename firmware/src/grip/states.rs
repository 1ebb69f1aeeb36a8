//! States of both state machines. The power layer determines whether the gripper may move; while it is
//! [`PowerState::Enabled`], the task layer determines what the fingers do.
//!
//! Each state lists its predecessors and successors; a test compares them with [`super::transitions`].

/// Declares the states of a layer: name, code on the wire, predecessors, successors.
macro_rules! states {
    ($(#[doc = $layer:literal])+ $name:ident {
        $(
            $(#[doc = $words:literal])+
            $state:ident = $code:literal, from [$($from:ident)*], to [$($to:ident)*];
        )*
    }) => {
        $(#[doc = $layer])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum $name {
            $(
                $(#[doc = $words])+
                #[doc = ""]
                #[doc = concat!("Entered from: ", $(stringify!($from), " ",)* ".")]
                #[doc = ""]
                #[doc = concat!("Left to: ", $(stringify!($to), " ",)* ".")]
                $state = $code,
            )*
        }

        impl $name {
            /// All states.
            pub const ALL: &[Self] = &[$(Self::$state,)*];

            /// Meaning in words, for documents.
            pub const fn meaning(self) -> &'static str {
                match self {
                    $(Self::$state => concat!($($words),+),)*
                }
            }

            /// Predecessors.
            pub const fn entered_from(self) -> &'static [Self] {
                match self {
                    $(Self::$state => &[$(Self::$from,)*],)*
                }
            }

            /// Successors.
            pub const fn left_to(self) -> &'static [Self] {
                match self {
                    $(Self::$state => &[$(Self::$to,)*],)*
                }
            }
        }
    };
}

states! {
    /// State of the power layer; its number is the state code of the heartbeat, except while enabled.
    PowerState {
        /// Start of the program; the motor is off.
        Boot = 0, from [], to [SelfTest];
        /// Check of tables, memory and sensors; the motor is off.
        SelfTest = 1, from [Boot], to [Safe Fault];
        /// No session; the motor is off.
        Safe = 2, from [SelfTest ArmPending Armed Calibrating Fault], to [ArmPending Calibrating];
        /// A nonce is offered and not yet returned; the motor is off.
        ArmPending = 3, from [Safe], to [Armed Safe];
        /// A session is open. A load on a backdrivable screw is held at its position, else the motor is off.
        Armed = 4, from [ArmPending Enabled QuickStop], to [Enabled Safe FaultReaction];
        /// The task layer controls the motor.
        Enabled = 5, from [Armed], to [Armed QuickStop FaultReaction];
        /// The fingers stop; after excessive force they back off first.
        QuickStop = 6, from [Enabled], to [Armed FaultReaction];
        /// Windings shorted or bridges off until the rotor rests.
        FaultReaction = 7, from [Armed Enabled QuickStop], to [Fault];
        /// Bridges off or windings still shorted; the first fault is latched. A host clears it once its cause is gone,
        /// and must arm again.
        Fault = 8, from [FaultReaction SelfTest], to [Safe];
        /// A tare or commissioning is in progress; arming is refused.
        Calibrating = 9, from [Safe], to [Safe];
    }
}

states! {
    /// State of the task layer; its state code is its number plus [`TASK_CODE`].
    TaskState {
        /// The opening is unknown; only homing and opening are accepted.
        Unhomed = 0, from [Homing Stopping ContactStop Releasing], to [Homing Releasing];
        /// Finds the zero of the opening: closes until the fingers meet, then opens to the other end.
        Homing = 1, from [Unhomed Idle], to [Idle Unhomed Stopping Releasing];
        /// Holds its position.
        Idle = 2,
            from [Homing Moving ContactStop Stopping Releasing Foot NoObject Lost TimeoutHold],
            to [Homing Moving Approach Foot Releasing];
        /// Moves to an opening.
        Moving = 3, from [Idle NoObject Lost TimeoutHold], to [Idle ContactStop Stopping Releasing];
        /// Stops after a contact during a move or while opening.
        ContactStop = 4, from [Moving Releasing], to [Idle Unhomed Releasing];
        /// Closes at the approach speed of the force.
        Approach = 5,
            from [Idle NoObject Lost TimeoutHold],
            to [Force NoObject GripFailed Stopping Releasing];
        /// Controls the force to its set-point.
        Force = 6,
            from [Approach HoldActive HoldLatched HoldFrozen],
            to [HoldActive HoldFrozen GripFailed Lost Releasing];
        /// Holds the force in closed loop.
        HoldActive = 7, from [Force], to [HoldLatched HoldFrozen Force Lost Releasing];
        /// The screw holds the force without current.
        HoldLatched = 8, from [HoldActive], to [HoldFrozen Force Lost Releasing];
        /// Without a valid force: holds the position with the last holding current; a self-locking screw needs none.
        HoldFrozen = 9, from [Force HoldActive HoldLatched], to [Force Releasing];
        /// The fingers closed without an object.
        NoObject = 10, from [Approach], to [Moving Approach Idle Releasing];
        /// Timeout, or the object is wider than the window: holds its position, as an object may be gripped.
        GripFailed = 11, from [Approach Force Stopping], to [Releasing];
        /// The object was lost: holds its position.
        Lost = 12, from [Force HoldActive HoldLatched], to [Moving Approach Idle Releasing];
        /// Opens: from every state but foot mode, and with an unknown opening or without valid forces as well.
        Releasing = 13,
            from [Unhomed Homing Idle Moving ContactStop Approach Force HoldActive HoldLatched HoldFrozen
                NoObject GripFailed Lost Stopping TimeoutHold],
            to [Idle Stopping ContactStop Unhomed];
        /// Foot mode: the fingers do not move.
        Foot = 14, from [Idle], to [Idle];
        /// Stops after a command or a timeout of the host.
        Stopping = 15,
            from [Homing Moving Approach Releasing],
            to [Idle TimeoutHold Unhomed GripFailed Releasing];
        /// Holds its position after a timeout of the host during a motion.
        TimeoutHold = 16, from [Stopping], to [Moving Approach Idle Releasing];
    }
}

/// Offset of the task states in the state code.
pub const TASK_CODE: u8 = 16;

/// State code of the heartbeat.
pub const fn state_code(power: PowerState, task: TaskState) -> u8 {
    match power {
        PowerState::Enabled => TASK_CODE.saturating_add(task as u8),
        power => power as u8,
    }
}

impl PowerState {
    /// State of the power layer of a state code; none for the code of a task state.
    pub fn of_code(code: u8) -> Option<Self> {
        Self::ALL.iter().copied().find(|state| *state as u8 == code)
    }
}

impl TaskState {
    /// Task state of a state code; none where the drive is not enabled.
    pub fn of_code(code: u8) -> Option<Self> {
        let number = code.checked_sub(TASK_CODE)?;
        Self::ALL.iter().copied().find(|state| *state as u8 == number)
    }
}

/// Situation in which a fault occurs: the columns of the reaction table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GripPhase {
    /// Nothing is gripped.
    Moving,
    /// An object is gripped.
    Holding,
    /// The fingers open on command.
    Releasing,
    /// Foot mode.
    Foot,
}

impl TaskState {
    /// Column of the reaction table; `has_settled`: the force was reached and the object not released since.
    pub const fn phase(self, has_settled: bool) -> GripPhase {
        match self {
            Self::Foot => GripPhase::Foot,
            Self::Releasing => GripPhase::Releasing,
            Self::HoldActive | Self::HoldLatched | Self::HoldFrozen => GripPhase::Holding,
            Self::Force if has_settled => GripPhase::Holding,
            _ => GripPhase::Moving,
        }
    }

    /// Whether the fingers should move.
    pub const fn moves(self) -> bool {
        matches!(self, Self::Homing | Self::Moving | Self::Approach | Self::Releasing)
    }

    /// Whether an object is gripped.
    pub const fn holds(self) -> bool {
        matches!(self, Self::Force | Self::HoldActive | Self::HoldLatched | Self::HoldFrozen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn state_codes_decode_to_their_states() {
        for power in PowerState::ALL {
            assert_eq!(PowerState::of_code(*power as u8), Some(*power));
            assert_eq!(TaskState::of_code(*power as u8), None);
        }
        for (task, code) in TaskState::ALL.iter().zip(16..) {
            assert_eq!(TaskState::of_code(code), Some(*task));
            assert_eq!(PowerState::of_code(code), None);
        }
        assert_eq!((TaskState::of_code(33), PowerState::of_code(10)), (None, None));
    }

    #[test]
    fn states_that_move_or_hold() {
        use TaskState::*;
        let moving: [TaskState; 4] = [Homing, Moving, Approach, Releasing];
        let holding: [TaskState; 4] = [Force, HoldActive, HoldLatched, HoldFrozen];
        for task in TaskState::ALL {
            assert_eq!(task.moves(), moving.contains(task), "{task:?}");
            assert_eq!(task.holds(), holding.contains(task), "{task:?}");
            let phase = match task {
                Foot => GripPhase::Foot,
                Releasing => GripPhase::Releasing,
                task if holding.contains(task) => GripPhase::Holding,
                _ => GripPhase::Moving,
            };
            assert_eq!(task.phase(true), phase, "{task:?}");
            // Without a settled force the grip has not begun.
            let unsettled = if *task == Force { GripPhase::Moving } else { phase };
            assert_eq!(task.phase(false), unsettled, "{task:?}");
        }
    }
}
