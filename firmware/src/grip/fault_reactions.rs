//! Reaction to each fault, and the latch of the first fault.
//!
//! On a motor trip ([`crate::motor::Trip`]) the current loop reacts first, within a PWM period, and the rows here apply after
//! it. The break input and the watchdog switch the bridges off without software; [`Fault::PowerStage`] and
//! [`Fault::Crashed`] report it.

use crate::grip::states::GripPhase;
use crate::motor::Trip;
use crate::system::faults::Fault;

/// Reactions, mildest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    /// R0: report only.
    Warn,
    /// R1: keep the grip. The force controller continues with the valid finger, or holds the position if there is none;
    /// no transition is needed for it.
    Hold,
    /// R2: stop, then hold the position.
    QuickStop,
    /// R3: short the windings until the rotor is at rest.
    Brake,
    /// R4: all bridges off; a self-locking screw keeps its grip.
    Off,
}

/// Reactions to one fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReactionRow {
    /// The fault.
    pub fault: Fault,
    /// Reaction while nothing is gripped.
    pub moving: Reaction,
    /// Reaction while an object is gripped: on a self-locking screw, on a backdrivable one.
    pub holding: [Reaction; 2],
    /// Reaction while the fingers open on command.
    pub releasing: Reaction,
    /// Reaction in foot mode.
    pub foot: Reaction,
}

const fn row(
    fault: Fault,
    moving: Reaction,
    holding: [Reaction; 2],
    releasing: Reaction,
    foot: Reaction,
) -> ReactionRow {
    ReactionRow { fault, moving, holding, releasing, foot }
}

/// A fault of the forces: a held object stays held, and the fingers can always be opened.
const fn force_fault(fault: Fault) -> ReactionRow {
    row(fault, Reaction::QuickStop, [Reaction::Hold; 2], Reaction::Warn, Reaction::Warn)
}

/// The fingers stop, and can be opened.
const fn motion_fault(fault: Fault) -> ReactionRow {
    row(fault, Reaction::QuickStop, [Reaction::QuickStop; 2], Reaction::Warn, Reaction::Warn)
}

const fn any_phase(fault: Fault, reaction: Reaction) -> ReactionRow {
    row(fault, reaction, [reaction; 2], reaction, reaction)
}

const fn warning(fault: Fault) -> ReactionRow {
    any_phase(fault, Reaction::Warn)
}

/// One row per fault, in the order of [`Fault::ALL`].
pub const REACTION_TABLE: [ReactionRow; Fault::ALL.len()] = [
    force_fault(Fault::SensorLost),
    force_fault(Fault::SensorFrozen),
    force_fault(Fault::SensorSaturated),
    force_fault(Fault::BusStuck),
    force_fault(Fault::OutsideModel),
    // A fixed object, or a hand at one finger, loads the fingers unequally.
    warning(Fault::Unbalanced),
    force_fault(Fault::Disturbed),
    row(
        Fault::TablesUnsound,
        Reaction::QuickStop,
        [Reaction::QuickStop; 2],
        Reaction::Warn,
        Reaction::QuickStop,
    ),
    warning(Fault::StoreUnsound),
    warning(Fault::TicksMissed),
    warning(Fault::Crashed),
    // The session's timeout stops a motion; a held object stays held.
    warning(Fault::BusOff),
    warning(Fault::HostSilent),
    warning(Fault::Flooded),
    warning(Fault::StrangeFrames),
    any_phase(Fault::OverCurrent, Reaction::Off),
    any_phase(Fault::OverSpeed, Reaction::Brake),
    // Without its angle the rotor of a backdrivable screw cannot be held; with shorted windings it yields slowly.
    row(
        Fault::RotorSensor,
        Reaction::Brake,
        [Reaction::Off, Reaction::Brake],
        Reaction::Brake,
        Reaction::Off,
    ),
    any_phase(Fault::CurrentSense, Reaction::Off),
    any_phase(Fault::NotANumber, Reaction::Off),
    force_fault(Fault::Blind),
    motion_fault(Fault::OverForce),
    motion_fault(Fault::Jammed),
    motion_fault(Fault::StrokeWrong),
    warning(Fault::ObjectLost),
    warning(Fault::Slipping),
    warning(Fault::FootOverload),
    // The forces of the ideal model are used instead.
    warning(Fault::NetworkDiverged),
    row(Fault::Supply, Reaction::Brake, [Reaction::Hold; 2], Reaction::Brake, Reaction::Warn),
    row(Fault::Hot, Reaction::QuickStop, [Reaction::Hold; 2], Reaction::Warn, Reaction::Warn),
    any_phase(Fault::Runaway, Reaction::Brake),
    any_phase(Fault::PowerStage, Reaction::Off),
];

impl ReactionRow {
    /// Reaction in a phase.
    pub const fn reaction(&self, phase: GripPhase, self_locking: bool) -> Reaction {
        let [locked, backdrivable] = self.holding;
        match (phase, self_locking) {
            (GripPhase::Moving, _) => self.moving,
            (GripPhase::Holding, true) => locked,
            (GripPhase::Holding, false) => backdrivable,
            (GripPhase::Releasing, _) => self.releasing,
            (GripPhase::Foot, _) => self.foot,
        }
    }
}

/// Faults that report a motor trip.
pub const TRIP_FAULTS: [Fault; 7] = [
    Fault::OverCurrent,
    Fault::OverSpeed,
    Fault::RotorSensor,
    Fault::CurrentSense,
    Fault::NotANumber,
    Fault::Runaway,
    Fault::PowerStage,
];

/// [`TRIP_FAULTS`] as heartbeat bits.
pub(super) fn trip_bits() -> u32 {
    TRIP_FAULTS.iter().fold(0, |bits, fault| bits | 1 << fault.index())
}

/// The fault that reports a trip, one of [`TRIP_FAULTS`].
pub const fn fault_of(trip: Trip) -> Fault {
    match trip {
        Trip::OverCurrent => Fault::OverCurrent,
        Trip::OverSpeed => Fault::OverSpeed,
        Trip::Encoder => Fault::RotorSensor,
        Trip::CurrentSense => Fault::CurrentSense,
        Trip::NotANumber => Fault::NotANumber,
        Trip::Runaway | Trip::CommandTimeout => Fault::Runaway,
        Trip::PowerStage => Fault::PowerStage,
    }
}

/// Reaction to a fault in a phase.
pub fn reaction(fault: Fault, phase: GripPhase, self_locking: bool) -> Reaction {
    REACTION_TABLE.get(fault.index()).map_or(Reaction::Off, |row| row.reaction(phase, self_locking))
}

/// The strongest reaction to the faults in the heartbeat bits, and its fault; of equal ones the first in [`Fault::ALL`].
pub fn strongest_reaction(
    bits: u32,
    phase: GripPhase,
    self_locking: bool,
) -> Option<(Reaction, Fault)> {
    let mut remaining = bits;
    let mut strongest = None;
    while let Some(row) = REACTION_TABLE.get(remaining.trailing_zeros() as usize) {
        let reaction = row.reaction(phase, self_locking);
        if strongest.is_none_or(|(other, _)| reaction > other) {
            strongest = Some((reaction, row.fault));
        }
        remaining &= remaining - 1;
    }
    strongest
}

/// Whether a fault is set in the heartbeat bits.
pub(super) fn is_active(bits: u32, fault: Fault) -> bool {
    bits & (1 << fault.index()) != 0
}

/// The first of a sequence of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstFault {
    /// The fault.
    pub fault: Fault,
    /// State code when it occurred, as in the heartbeat.
    pub state: u8,
    /// Milliseconds since start.
    pub at_ms: u32,
}

/// Stores the first fault with a reaction of at least [`Reaction::QuickStop`] until a host clears it.
#[derive(Clone, Copy, Debug, Default)]
pub struct FirstFaultLatch(Option<FirstFault>);

impl FirstFaultLatch {
    /// Stores a fault unless one is stored already.
    pub fn record(&mut self, cause: FirstFault) {
        self.0.get_or_insert(cause);
    }

    /// The stored fault.
    pub const fn cause(&self) -> Option<FirstFault> {
        self.0
    }

    /// Clears the stored fault unless it is still active.
    pub fn clear(&mut self, is_active: impl Fn(Fault) -> bool) {
        self.0 = self.0.filter(|cause| is_active(cause.fault));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reaction_table_has_the_order_of_faults() {
        for (row, fault) in REACTION_TABLE.iter().zip(Fault::ALL) {
            assert_eq!(row.fault, fault);
        }
    }

    #[test]
    fn survivable_faults_do_not_drop_the_object() {
        for fault in [
            Fault::SensorLost,
            Fault::SensorFrozen,
            Fault::Unbalanced,
            Fault::Disturbed,
            Fault::BusOff,
            Fault::HostSilent,
            Fault::Flooded,
        ] {
            for self_locking in [false, true] {
                assert!(reaction(fault, GripPhase::Holding, self_locking) <= Reaction::Hold);
            }
        }
    }

    #[test]
    fn strongest_reaction_of_several_faults_wins() {
        let bit = |fault: Fault| 1 << fault.index();
        let bits = bit(Fault::SensorLost) | bit(Fault::OverSpeed) | bit(Fault::HostSilent);
        let strongest = strongest_reaction(bits, GripPhase::Moving, true);
        assert_eq!(strongest, Some((Reaction::Brake, Fault::OverSpeed)));
        assert_eq!(strongest_reaction(0, GripPhase::Moving, true), None);
        // Of equal ones the first.
        let bits = bit(Fault::SensorFrozen) | bit(Fault::SensorLost) | bit(Fault::Blind);
        let strongest = strongest_reaction(bits, GripPhase::Moving, true);
        assert_eq!(strongest, Some((Reaction::QuickStop, Fault::SensorLost)));
    }

    #[test]
    fn first_cause_stays_until_inactive_and_cleared() {
        let cause = |fault, at_ms| FirstFault { fault, state: 22, at_ms };
        let mut latch = FirstFaultLatch::default();
        latch.record(cause(Fault::SensorLost, 5));
        latch.record(cause(Fault::Blind, 6));
        assert_eq!(latch.cause(), Some(cause(Fault::SensorLost, 5)));
        latch.clear(|fault| fault == Fault::SensorLost);
        assert!(latch.cause().is_some());
        latch.clear(|fault| fault == Fault::Blind);
        assert_eq!(latch.cause(), None);
    }
}
