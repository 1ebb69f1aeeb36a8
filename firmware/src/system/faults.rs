//! Faults and events.
//!
//! Ranges of fault codes: 100 sensing, 200 stored data, 300 program, 400 buses to the host, 500 motor, 600 grasp. A fault has
//! a source (sensor, bus, task); the heartbeat has one bit for each kind.

use crate::protocol::messages::FaultEvent;
use core::sync::atomic::{AtomicU32, Ordering};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;

/// Declares the kinds of faults with meaning and code.
macro_rules! faults {
    ($(#[doc = $about:literal])+ $name:ident {
        $($(#[doc = $words:literal])+ $fault:ident = $code:literal;)*
    }) => {
        $(#[doc = $about])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u16)]
        pub enum $name {
            $($(#[doc = $words])+ $fault = $code,)*
        }

        impl $name {
            /// All kinds, in the order of the bits of the heartbeat.
            pub const ALL: [Self; 32] = [$(Self::$fault,)*];

            /// Meaning in words, for documents.
            pub const fn meaning(self) -> &'static str {
                match self {
                    $(Self::$fault => concat!($($words),+),)*
                }
            }
        }
    };
}

faults! {
    /// Kinds of faults with their codes on the bus, in the order of the bits of the heartbeat.
    Fault {
        /// No reading of a sensor for several ticks. Source: the sensor; detail: its age in ticks.
        SensorLost = 100;
        /// A sensor repeats its reading. Source: the sensor; detail: its age in ticks.
        SensorFrozen = 101;
        /// A sensor is saturated. Source: the sensor.
        SensorSaturated = 102;
        /// A bus line is stuck low. Source: the bus.
        BusStuck = 103;
        /// A field outside the range of the model. Source: the sensor.
        OutsideModel = 106;
        /// The forces of the fingers differ. Detail: the difference in 1/1024 N.
        Unbalanced = 104;
        /// Magnetic disturbance.
        Disturbed = 105;
        /// Wrong checksum of the tables.
        TablesUnsound = 200;
        /// Stored parameters and key (source 0) are damaged, and defaults or those saved before are used; or an uploaded
        /// calibration (source 1), and the previous or the linked one is used; or the chip's option bytes (source 2) are
        /// unsuitable, or its crystal does not start. Detail: the reason.
        StoreUnsound = 201;
        /// Ticks were missed. Detail: how many since boot.
        TicksMissed = 300;
        /// The previous run ended in a crash. Detail: kind and address.
        Crashed = 301;
        /// The CAN controller was bus-off.
        BusOff = 400;
        /// No commands from a host that had armed.
        HostSilent = 401;
        /// Too many frames. Detail: dropped frames.
        Flooded = 402;
        /// Malformed, late or repeated frames. Detail: rejected frames since boot.
        StrangeFrames = 403;
        /// Phase current above its limit.
        OverCurrent = 500;
        /// Rotor speed above its limit.
        OverSpeed = 501;
        /// Rotor angle unknown.
        RotorSensor = 502;
        /// Current offset too large, sum of the currents not zero, or currents do not follow the set-point.
        CurrentSense = 503;
        /// NaN in the motor control.
        NotANumber = 504;
        /// No valid force of any finger.
        Blind = 600;
        /// Force above its limit. Detail: the force in 1/1024 N.
        OverForce = 601;
        /// Stall: current without motion or force. Detail: the current in milliamperes.
        Jammed = 602;
        /// Homing time-out, wrong distance between the end stops, or opening beyond them.
        /// Detail: in micrometres.
        StrokeWrong = 603;
        /// Object lost.
        ObjectLost = 604;
        /// Object slips. Detail: the new force set-point in 1/1024 N.
        Slipping = 605;
        /// Overload of a fingertip in ground contact. Detail: the peak in 1/1024 N.
        FootOverload = 606;
        /// A network deviates from the ideal model, which is used instead. Source: the sensor.
        NetworkDiverged = 107;
        /// Bus voltage out of range. Detail: in millivolts.
        Supply = 505;
        /// Motor or power stage above its temperature limit.
        Hot = 506;
        /// The braking current does not slow the rotor, or a control loop has missed its ticks. Detail: 1 for the latter.
        Runaway = 507;
        /// The power stage has tripped.
        PowerStage = 508;
    }
}

impl Fault {
    /// Index in [`Self::ALL`]. A look-up table, as it is needed some thirty times per millisecond; constant for a constant.
    #[inline(always)]
    pub fn index(self) -> usize {
        #[allow(clippy::indexing_slicing)] // Out of bounds would not compile.
        const INDICES: [[u8; 10]; 7] = {
            let mut indices = [[0; 10]; 7];
            let mut index = 0;
            while index < Fault::ALL.len() {
                let code = Fault::ALL[index] as usize;
                indices[code / 100][code % 100] = index as u8;
                index += 1;
            }
            indices
        };
        let code = self as usize;
        let group = INDICES.get(code / 100);
        let index = group.and_then(|group| group.get(code % 100)).copied();
        usize::from(index.unwrap_or_default())
    }

    /// The kind with this code.
    pub fn from_code(code: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|fault| *fault as u16 == code)
    }
}

/// The active faults.
#[derive(Clone, Copy, Debug, Default)]
pub struct FaultSet {
    /// For each kind, one bit for each source.
    sources: [u8; Fault::ALL.len()],
    /// One bit for each active kind.
    bits: u32,
}

impl FaultSet {
    /// Sets or clears a fault; returns the message if that is a change.
    pub fn update(
        &mut self,
        fault: Fault,
        source: u8,
        active: bool,
        detail: u32,
    ) -> Option<FaultEvent> {
        let sources = self.sources.get_mut(fault.index())?;
        let bit = 1 << (source & 7);
        if (*sources & bit != 0) == active {
            return None;
        }
        *sources ^= bit;
        let kind = 1 << fault.index();
        self.bits = (self.bits & !kind) | if *sources != 0 { kind } else { 0 };
        Some(FaultEvent { code: fault as u16, source, active: u8::from(active), detail })
    }

    /// Whether a fault of this source is active.
    #[inline(always)]
    pub fn has(&self, fault: Fault, source: u8) -> bool {
        let sources = self.sources.get(fault.index());
        sources.is_some_and(|sources| sources & (1 << (source & 7)) != 0)
    }

    /// Whether a fault of any source is active.
    pub fn is_active(&self, fault: Fault) -> bool {
        self.bits & (1 << fault.index()) != 0
    }

    /// One bit for each active kind.
    pub const fn bits(&self) -> u32 {
        self.bits
    }
}

/// Capacity of the queue; further events are dropped and counted.
const QUEUED_EVENTS: usize = 32;

/// An event for the log and for hosts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Result of the address scan at boot.
    BusScanned {
        /// The bus.
        bus: u8,
        /// One bit for each address from 0x60 on.
        answers: u16,
    },
    /// A bus was recovered by nine clocks and a stop.
    BusCleared {
        /// The bus.
        bus: u8,
        /// Whether both lines are high afterwards.
        free: bool,
    },
    /// The inertial sensor was found, or is absent or has failed.
    InertialSensor {
        /// Whether it answers.
        is_present: bool,
    },
    /// A fault was set or cleared.
    Fault(FaultEvent),
}

/// Queue of events.
pub struct EventQueue<M: RawMutex> {
    queue: Channel<M, Event, QUEUED_EVENTS>,
    dropped: AtomicU32,
}

impl<M: RawMutex> EventQueue<M> {
    /// Empty.
    pub const fn new() -> Self {
        Self { queue: Channel::new(), dropped: AtomicU32::new(0) }
    }

    /// Appends an event. Never waits.
    pub fn post(&self, event: Event) {
        if self.queue.try_send(event).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The oldest event.
    pub async fn next(&self) -> Event {
        self.queue.receive().await
    }

    /// Dropped events since boot.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl<M: RawMutex> Default for EventQueue<M> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fault_gives_an_event_only_on_change() {
        let mut faults = FaultSet::default();
        let event = faults.update(Fault::SensorLost, 2, true, 7).unwrap();
        assert_eq!((event.code, event.source, event.active), (100, 2, 1));
        assert_eq!(faults.update(Fault::SensorLost, 2, true, 8), None);
        assert!(faults.update(Fault::SensorLost, 3, true, 2).is_some());
        assert_eq!(faults.update(Fault::SensorLost, 2, false, 0).unwrap().active, 0);
        assert!(faults.is_active(Fault::SensorLost));
        assert!(faults.update(Fault::SensorLost, 3, false, 0).is_some());
        assert!(!faults.is_active(Fault::SensorLost));
        assert_eq!(faults.update(Fault::SensorLost, 3, false, 0), None);
    }

    #[test]
    fn fault_index_is_its_position() {
        let indices = Fault::ALL.map(Fault::index);
        assert!(indices.into_iter().eq(0..Fault::ALL.len()));
    }

    #[test]
    fn fault_bits_and_codes_are_unique() {
        let mut faults = FaultSet::default();
        for (bit, fault) in Fault::ALL.into_iter().enumerate() {
            faults.update(fault, 0, true, 0);
            assert_eq!(faults.bits(), u32::MAX >> (31 - bit));
            assert_eq!(Fault::from_code(fault as u16), Some(fault));
        }
        assert_eq!(Fault::from_code(99), None);
    }
}
