//! What each fault does: the matrix of faults as a table.
//!
//! A fault that the motor trips on is answered there within a period of its pulses ([`crate::motor::Trip`]);
//! the rows here follow it. What hardware answers alone (a short at the comparators, a locked-up core, a
//! watchdog) has no row: the pins are then without a driver.

use super::states::Phase;
use crate::motor::Trip;
use crate::status::Fault;

/// What is done, the milder first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    /// R0: tells.
    Warn,
    /// R1: keeps the force by itself, on the finger that is left, or the rotor's place where none is.
    Hold,
    /// R2: stops, then keeps its place.
    QuickStop,
    /// R3: shorts the windings until the rotor rests.
    Brake,
    /// R4: all switches off; a screw that locks itself keeps its grip.
    Off,
}

/// What one fault does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The fault.
    pub fault: Fault,
    /// While nothing is gripped.
    pub moving: Reaction,
    /// While something is: on a screw that locks itself, on one that is driven back.
    pub holding: [Reaction; 2],
    /// As a foot.
    pub foot: Reaction,
}

const fn row(fault: Fault, moving: Reaction, holding: [Reaction; 2], foot: Reaction) -> Row {
    Row {
        fault,
        moving,
        holding,
        foot,
    }
}

/// A sensor's trouble: the other finger holds.
const fn sensing(fault: Fault) -> Row {
    row(
        fault,
        Reaction::QuickStop,
        [Reaction::Hold; 2],
        Reaction::Warn,
    )
}

const fn told(fault: Fault) -> Row {
    row(fault, Reaction::Warn, [Reaction::Warn; 2], Reaction::Warn)
}

const fn everywhere(fault: Fault, reaction: Reaction) -> Row {
    row(fault, reaction, [reaction; 2], reaction)
}

/// All faults, in the order of [`Fault::ALL`].
pub const TABLE: [Row; Fault::ALL.len()] = [
    sensing(Fault::SensorLost),
    sensing(Fault::SensorFrozen),
    sensing(Fault::SensorSaturated),
    sensing(Fault::BusStuck),
    sensing(Fault::OutsideModel),
    sensing(Fault::Unbalanced),
    sensing(Fault::Disturbed),
    everywhere(Fault::TablesUnsound, Reaction::QuickStop),
    told(Fault::StoreUnsound),
    told(Fault::TicksMissed),
    told(Fault::Crashed),
    // The session's silence stops what moves; a hold goes on.
    told(Fault::BusOff),
    told(Fault::HostSilent),
    told(Fault::Flooded),
    told(Fault::StrangeFrames),
    everywhere(Fault::OverCurrent, Reaction::Off),
    everywhere(Fault::OverSpeed, Reaction::Brake),
    // Without its angle the rotor of a screw that is driven back cannot be held; shorted it gives way slowly.
    row(
        Fault::RotorSensor,
        Reaction::Brake,
        [Reaction::Off, Reaction::Brake],
        Reaction::Off,
    ),
    everywhere(Fault::CurrentSense, Reaction::Off),
    everywhere(Fault::NotANumber, Reaction::Off),
    row(
        Fault::Blind,
        Reaction::QuickStop,
        [Reaction::Off, Reaction::QuickStop],
        Reaction::Warn,
    ),
    row(
        Fault::OverForce,
        Reaction::QuickStop,
        [Reaction::QuickStop; 2],
        Reaction::Warn,
    ),
    row(
        Fault::Jammed,
        Reaction::QuickStop,
        [Reaction::QuickStop; 2],
        Reaction::Warn,
    ),
    row(
        Fault::StrokeWrong,
        Reaction::QuickStop,
        [Reaction::QuickStop; 2],
        Reaction::Warn,
    ),
    told(Fault::ObjectLost),
    told(Fault::Slipping),
    told(Fault::FootOverload),
    // The ideal model's forces count: nothing is lost but what the network knew better.
    told(Fault::NetworkAstray),
    row(
        Fault::Supply,
        Reaction::Brake,
        [Reaction::Hold; 2],
        Reaction::Warn,
    ),
    row(
        Fault::Hot,
        Reaction::QuickStop,
        [Reaction::Hold; 2],
        Reaction::Warn,
    ),
    everywhere(Fault::Runaway, Reaction::Brake),
    everywhere(Fault::PowerStage, Reaction::Off),
];

impl Row {
    /// What is done in a phase; `locks` is whether the screw is known to lock itself.
    pub const fn reaction(&self, phase: Phase, locks: bool) -> Reaction {
        let [locked, driven_back] = self.holding;
        match (phase, locks) {
            (Phase::Moving, _) => self.moving,
            (Phase::Holding, true) => locked,
            (Phase::Holding, false) => driven_back,
            (Phase::Foot, _) => self.foot,
        }
    }
}

/// Faults that a motor's trips are told as.
pub const TRIPPED: [Fault; 7] = [
    Fault::OverCurrent,
    Fault::OverSpeed,
    Fault::RotorSensor,
    Fault::CurrentSense,
    Fault::NotANumber,
    Fault::Runaway,
    Fault::PowerStage,
];

/// The fault that a trip is told as, one of [`TRIPPED`].
pub const fn fault_of(trip: Trip) -> Fault {
    match trip {
        Trip::OverCurrent => Fault::OverCurrent,
        Trip::OverSpeed => Fault::OverSpeed,
        Trip::Encoder => Fault::RotorSensor,
        Trip::CurrentSense => Fault::CurrentSense,
        Trip::NotANumber => Fault::NotANumber,
        Trip::Runaway | Trip::Unled => Fault::Runaway,
        Trip::PowerStage => Fault::PowerStage,
    }
}

/// What is done about a fault.
pub fn reaction(fault: Fault, phase: Phase, locks: bool) -> Reaction {
    TABLE
        .get(fault.place())
        .map_or(Reaction::Off, |row| row.reaction(phase, locks))
}

/// The strongest reaction to the faults in the heartbeat's bits, and to which of them; none without a fault.
pub fn strongest(bits: u32, phase: Phase, locks: bool) -> Option<(Reaction, Fault)> {
    let mut left = bits;
    let mut strongest = None;
    // The first of those that are equally strong: the nearest to the cause.
    while let Some(row) = TABLE.get(left.trailing_zeros() as usize) {
        let reaction = row.reaction(phase, locks);
        if strongest.is_none_or(|(other, _)| reaction > other) {
            strongest = Some((reaction, row.fault));
        }
        left &= left - 1;
    }
    strongest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_has_its_row_at_its_place() {
        for (row, fault) in TABLE.iter().zip(Fault::ALL) {
            assert_eq!(row.fault, fault);
        }
    }

    #[test]
    fn no_fault_that_is_survived_drops_what_is_held() {
        for fault in [
            Fault::SensorLost,
            Fault::SensorFrozen,
            Fault::Unbalanced,
            Fault::Disturbed,
            Fault::BusOff,
            Fault::HostSilent,
            Fault::Flooded,
        ] {
            for locks in [false, true] {
                assert!(reaction(fault, Phase::Holding, locks) <= Reaction::Hold);
            }
        }
    }

    #[test]
    fn of_several_faults_the_strongest_reaction_counts() {
        let bit = |fault: Fault| 1 << fault.place();
        let bits = bit(Fault::SensorLost) | bit(Fault::OverSpeed) | bit(Fault::HostSilent);
        let told = strongest(bits, Phase::Moving, true);
        assert_eq!(told, Some((Reaction::Brake, Fault::OverSpeed)));
        assert_eq!(strongest(0, Phase::Moving, true), None);
    }
}
