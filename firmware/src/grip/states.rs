//! The states of both layers. The power layer says whether the gripper may move at all; while it is
//! [`Power::Enabled`], the task layer says what the fingers do.
//!
//! Each state names the states from which it is entered and to which it is left; a test holds these words
//! against the tables of [`super::table`].

/// Declares the states of a layer: code on the wire, name, entered from, left to.
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

            /// The states from which this one is entered.
            pub const fn entered_from(self) -> &'static [Self] {
                match self {
                    $(Self::$state => &[$(Self::$from,)*],)*
                }
            }

            /// The states to which this one is left.
            pub const fn left_to(self) -> &'static [Self] {
                match self {
                    $(Self::$state => &[$(Self::$to,)*],)*
                }
            }
        }
    };
}

states! {
    /// Whether the gripper may move. The number is the heartbeat's, except while enabled.
    Power {
        /// The program has begun; the motor is off.
        Boot = 0, from [], to [SelfTest];
        /// Tables, memory and sensors are being looked at; the motor is off.
        SelfTest = 1, from [Boot], to [Safe Fault];
        /// Nobody has armed; the motor is off.
        Safe = 2, from [SelfTest ArmPending Armed Calibrating Fault], to [ArmPending Calibrating];
        /// A nonce is offered, not yet said back; the motor is off.
        ArmPending = 3, from [Safe], to [Armed Safe];
        /// A session is open. The fingers rest: a load that would turn the screw back is held by the rotor's
        /// place, else the motor is off.
        Armed = 4, from [ArmPending Enabled QuickStop], to [Enabled Safe FaultReaction];
        /// The task layer drives.
        Enabled = 5, from [Armed], to [Armed QuickStop FaultReaction];
        /// The fingers are being stopped; after too much force they give way until little is left.
        QuickStop = 6, from [Enabled], to [Armed FaultReaction];
        /// The windings are shorted, or the switches are off, until the rotor rests.
        FaultReaction = 7, from [Armed Enabled QuickStop], to [Fault];
        /// Off, or the windings shorted still, and the first cause is kept. A host clears it once the cause is gone, and has to arm anew.
        Fault = 8, from [FaultReaction SelfTest], to [Safe];
        /// A tare or the motor's commissioning is under way: no one may arm.
        Calibrating = 9, from [Safe], to [Safe];
    }
}

states! {
    /// What the fingers do. On the wire [`TASK_CODE`] is added.
    Task {
        /// The opening is not known: only homing moves.
        Unhomed = 0, from [Homing Stopping], to [Homing];
        /// Closes until the fingers press, opens to the end, compares the way with the stroke.
        Homing = 1, from [Unhomed Idle], to [Idle Unhomed Stopping];
        /// Holds its place.
        Idle = 2,
            from [Homing Moving ContactStop Stopping Releasing Foot NoObject Lost TimeoutHold],
            to [Homing Moving Approach Foot];
        /// On the way to an opening.
        Moving = 3, from [Idle NoObject Lost TimeoutHold], to [Idle ContactStop Stopping];
        /// Something was touched on the way: stops.
        ContactStop = 4, from [Moving], to [Idle];
        /// Closes at the speed that the force allows.
        Approach = 5, from [Idle NoObject Lost TimeoutHold], to [Force NoObject GripFailed Stopping];
        /// Brings the force to the one that was asked for.
        Force = 6,
            from [Approach HoldActive HoldLatched HoldFrozen],
            to [HoldActive HoldFrozen GripFailed Lost Releasing];
        /// Keeps the force, the loop closed.
        HoldActive = 7, from [Force], to [HoldLatched HoldFrozen Force Lost Releasing];
        /// The screw keeps the force: no current.
        HoldLatched = 8, from [HoldActive], to [HoldFrozen Force Lost Releasing];
        /// The forces are not to be believed: the rotor's place is kept, with no more current than the hold
        /// took; a screw that locks itself needs none.
        HoldFrozen = 9, from [Force HoldActive HoldLatched], to [Force Releasing];
        /// The fingers met where an object should be: stops.
        NoObject = 10, from [Approach], to [Moving Approach Idle];
        /// No grip came about in time, or not within the window: holds its place, for something may hang on it.
        GripFailed = 11, from [Approach Force], to [Releasing];
        /// The object is gone: stops closing.
        Lost = 12, from [Force HoldActive HoldLatched], to [Moving Approach Idle];
        /// Opens.
        Releasing = 13, from [Force HoldActive HoldLatched HoldFrozen GripFailed], to [Idle Stopping];
        /// A foot: nothing moves, whatever is asked.
        Foot = 14, from [Idle], to [Idle];
        /// Stops because a host asked, or fell silent.
        Stopping = 15, from [Homing Moving Approach Releasing], to [Idle TimeoutHold Unhomed];
        /// The host fell silent during a motion: holds its place.
        TimeoutHold = 16, from [Stopping], to [Moving Approach Idle];
    }
}

/// On the wire a state of the task layer stands behind those of the power layer.
pub const TASK_CODE: u8 = 16;

/// The number that the heartbeat tells.
pub const fn code(power: Power, task: Task) -> u8 {
    match power {
        Power::Enabled => TASK_CODE.saturating_add(task as u8),
        power => power as u8,
    }
}

/// What a fault meets: the columns of the matrix of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing is gripped: the fingers move, or may.
    Moving,
    /// Something is gripped.
    Holding,
    /// A foot.
    Foot,
}

impl Task {
    /// What a fault meets; `is_gripped` while a force was once reached and the object not let go.
    pub const fn phase(self, is_gripped: bool) -> Phase {
        match self {
            Self::Foot => Phase::Foot,
            Self::HoldActive | Self::HoldLatched | Self::HoldFrozen => Phase::Holding,
            Self::Force if is_gripped => Phase::Holding,
            _ => Phase::Moving,
        }
    }

    /// Whether the fingers are meant to move.
    pub const fn moves(self) -> bool {
        matches!(
            self,
            Self::Homing | Self::Moving | Self::Approach | Self::Releasing
        )
    }

    /// Whether an object hangs on the fingers.
    pub const fn holds(self) -> bool {
        matches!(
            self,
            Self::Force | Self::HoldActive | Self::HoldLatched | Self::HoldFrozen
        )
    }
}
