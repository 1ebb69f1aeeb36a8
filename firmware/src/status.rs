//! Faults: what is wrong, where, since when.
//!
//! Codes stand in ranges: 100 sensing, 200 what is stored, 300 the program, 400 the buses to the host, 500 the
//! motor, 600 the grasp. A fault has a source (a sensor, a bus, a loop); the heartbeat has one bit for each kind.

use crate::wire::messages::FaultEvent;

/// A kind of fault; the number is its code on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Fault {
    /// A sensor gave no reading twice or more in a row. Source: the sensor; detail: its age in ticks.
    SensorLost = 100,
    /// A sensor repeats its reading. Source: the sensor; detail: its age in ticks.
    SensorFrozen = 101,
    /// A sensor is at the end of its range. Source: the sensor.
    SensorSaturated = 102,
    /// A line of a bus stays low. Source: the bus.
    BusStuck = 103,
    /// A field is where no force brings it. Source: the sensor.
    OutsideModel = 106,
    /// The fingers press with different forces. Detail: the difference in 1/1024 N.
    Unbalanced = 104,
    /// A foreign magnet is near.
    Disturbed = 105,
    /// A network is far from the ideal model, whose forces count meanwhile. Source: the sensor.
    NetworkAstray = 107,
    /// The tables are not what was exported.
    TablesUnsound = 200,
    /// What was stored cannot be read; defaults hold. Detail: why.
    StoreUnsound = 201,
    /// Ticks were missed. Detail: how many since boot.
    TicksMissed = 300,
    /// The program broke off before this boot. Detail: where.
    Crashed = 301,
    /// The CAN controller left the bus.
    BusOff = 400,
    /// A host that had armed is silent.
    HostSilent = 401,
    /// More frames arrive than may be meant. Detail: how many were dropped.
    Flooded = 402,
    /// Frames are dropped that are malformed, late or repeated. Detail: how many since boot.
    StrangeFrames = 403,
    /// A phase's current was beyond its bound.
    OverCurrent = 500,
    /// The rotor turned too fast.
    OverSpeed = 501,
    /// The rotor's angle is not known.
    RotorSensor = 502,
    /// At no current the amplifiers told one, the currents do not sum to nothing, or they do not follow.
    CurrentSense = 503,
    /// Something in the motor's control is not a number.
    NotANumber = 504,
    /// The bus voltage is beyond its bounds. Detail: in millivolts.
    Supply = 505,
    /// Motor or power stage is too hot for any current.
    Hot = 506,
    /// The current that should brake the rotor does not, or those who lead the control have missed their turns.
    Runaway = 507,
    /// The power stage has switched itself off.
    PowerStage = 508,
    /// No finger's force is told.
    Blind = 600,
    /// The fingers press too hard. Detail: the force in 1/1024 N.
    OverForce = 601,
    /// Current flows, nothing moves, nothing presses. Detail: the current in milliamperes.
    Jammed = 602,
    /// Homing took too long, the way between the ends is not the stroke, or the opening is beyond its ends.
    /// Detail: in micrometres.
    StrokeWrong = 603,
    /// What was held is gone.
    ObjectLost = 604,
    /// What is held slips. Detail: the force in 1/1024 N that is asked for since.
    Slipping = 605,
    /// A fingertip of the foot bears too much. Detail: the peak in 1/1024 N.
    FootOverload = 606,
}

impl Fault {
    /// All kinds, in the order of the heartbeat's bits.
    pub const ALL: [Self; 32] = [
        Self::SensorLost,
        Self::SensorFrozen,
        Self::SensorSaturated,
        Self::BusStuck,
        Self::OutsideModel,
        Self::Unbalanced,
        Self::Disturbed,
        Self::TablesUnsound,
        Self::StoreUnsound,
        Self::TicksMissed,
        Self::Crashed,
        Self::BusOff,
        Self::HostSilent,
        Self::Flooded,
        Self::StrangeFrames,
        Self::OverCurrent,
        Self::OverSpeed,
        Self::RotorSensor,
        Self::CurrentSense,
        Self::NotANumber,
        Self::Blind,
        Self::OverForce,
        Self::Jammed,
        Self::StrokeWrong,
        Self::ObjectLost,
        Self::Slipping,
        Self::FootOverload,
        Self::NetworkAstray,
        Self::Supply,
        Self::Hot,
        Self::Runaway,
        Self::PowerStage,
    ];

    /// Its place in [`Self::ALL`]. Looked up, for it is asked some thirty times a millisecond; of a constant it is one.
    #[inline(always)]
    pub fn place(self) -> usize {
        #[allow(clippy::indexing_slicing)] // Beyond its end it would not compile.
        const PLACES: [[u8; 10]; 7] = {
            let mut places = [[0; 10]; 7];
            let mut place = 0;
            while place < Fault::ALL.len() {
                let code = Fault::ALL[place] as usize;
                places[code / 100][code % 100] = place as u8;
                place += 1;
            }
            places
        };
        let code = self as usize;
        let group = PLACES.get(code / 100);
        let place = group.and_then(|group| group.get(code % 100)).copied();
        usize::from(place.unwrap_or_default())
    }

    /// The kind with this code.
    pub fn of_code(code: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|fault| *fault as u16 == code)
    }
}

/// The faults that are active.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// For each kind one bit for each source.
    sources: [u8; Fault::ALL.len()],
    /// One bit for each kind that has one.
    bits: u32,
}

impl Faults {
    /// Notes whether a fault is there; returns the message where that is news.
    pub fn note(
        &mut self,
        fault: Fault,
        source: u8,
        active: bool,
        detail: u32,
    ) -> Option<FaultEvent> {
        let sources = self.sources.get_mut(fault.place())?;
        let bit = 1 << (source & 7);
        if (*sources & bit != 0) == active {
            return None;
        }
        *sources ^= bit;
        let kind = 1 << fault.place();
        self.bits = (self.bits & !kind) | if *sources != 0 { kind } else { 0 };
        Some(FaultEvent {
            code: fault as u16,
            source,
            active: u8::from(active),
            detail,
        })
    }

    /// Whether a fault is there, from this source.
    #[inline(always)]
    pub fn has(&self, fault: Fault, source: u8) -> bool {
        let sources = self.sources.get(fault.place());
        sources.is_some_and(|sources| sources & (1 << (source & 7)) != 0)
    }

    /// Whether a fault is there, from whatever source.
    pub fn is_active(&self, fault: Fault) -> bool {
        self.bits & (1 << fault.place()) != 0
    }

    /// One bit for each kind that is active.
    pub const fn bits(&self) -> u32 {
        self.bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_told_when_it_comes_and_when_it_goes_and_not_between() {
        let mut faults = Faults::default();
        let event = faults.note(Fault::SensorLost, 2, true, 7).unwrap();
        assert_eq!((event.code, event.source, event.active), (100, 2, 1));
        assert_eq!(faults.note(Fault::SensorLost, 2, true, 8), None);
        assert!(faults.note(Fault::SensorLost, 3, true, 2).is_some());
        assert_eq!(
            faults.note(Fault::SensorLost, 2, false, 0).unwrap().active,
            0
        );
        assert!(faults.is_active(Fault::SensorLost));
        assert!(faults.note(Fault::SensorLost, 3, false, 0).is_some());
        assert!(!faults.is_active(Fault::SensorLost));
        assert_eq!(faults.note(Fault::SensorLost, 3, false, 0), None);
    }

    #[test]
    fn a_fault_s_place_is_where_it_stands() {
        let places = Fault::ALL.map(Fault::place);
        assert!(places.into_iter().eq(0..Fault::ALL.len()));
    }

    #[test]
    fn the_heartbeat_has_a_bit_for_each_kind_and_codes_are_no_two_faults() {
        let mut faults = Faults::default();
        for (bit, fault) in Fault::ALL.into_iter().enumerate() {
            faults.note(fault, 0, true, 0);
            assert_eq!(faults.bits(), u32::MAX >> (31 - bit));
            assert_eq!(Fault::of_code(fault as u16), Some(fault));
        }
        assert_eq!(Fault::of_code(99), None);
    }
}
