//! The loops that run on the gripper: each awaits, calls a pure function, publishes. They are generic over
//! clock and buses: tasks wrap them on the chip, a simulation polls them in virtual time.
//!
//! | loop | awaits | level | deadline | when it is missed |
//! | --- | --- | --- | --- | --- |
//! | [`sense`] | each millisecond | interrupt executor, above the next two | [`SENSE_LIMIT_US`](crate::params::SENSE_LIMIT_US) after the tick began | the tick is skipped and counted |
//! | [`estimate`] | what was sensed | interrupt executor | the next tick | the older frame is lost; the next tick's number shows it |
//! | [`grip`](fn@grip) | estimates | interrupt executor | the next tick; from sample to set-point within 1 ms | the older forces are lost; the motor keeps its set-point until the watchdog resets |
//! | [`report`] | estimates, the grasp, events, replies | thread | 1 ms from sample to frame | the bus sees the next estimate |
//! | [`telemetry`] | estimates | thread | 1 ms | the line misses a tick, its time shows it |
//! | [`listen`], [`listen_serial`] | frames, bytes | thread | three frames of the controller's memory, 141 us | the controller drops frames |
//! | [`command`] | what was heard | thread | 1 ms | as a silent host |
//! | [`scrub`] | each 5 ms | thread | none | a broken table is found later |

mod command;
mod estimate;
mod grip;
mod listen;
mod report;
mod scrub;
mod sense;
mod telemetry;

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;

pub use command::{Desk, begin, command};
pub use estimate::{Around, Told, estimate};
pub use grip::{Asked, Felt, Hosts, Reins, Stands, Turns, grip};
pub use listen::{CAN, Heard, SERIAL, listen, listen_serial};
pub use report::report;
pub use scrub::scrub;
pub use sense::{FIRST_TICK_US, Sensed, sense};
pub use telemetry::telemetry;

use crate::crash::Crash;
use crate::events::{Event, Events};
use crate::motor::calibration::Outcome;
use crate::parameters::Parameters;
use crate::parameters::table::counter;
use crate::progress::Progress;
use crate::status::{Fault, Faults};
use crate::tare::Step;
use crate::wire::messages::{FaultEvent, Message};
use crate::wire::serial::{Packet, Tick};

/// Loops that find faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Finder {
    /// [`sense`].
    Sense,
    /// [`estimate`].
    Estimate,
    /// [`report`].
    Report,
    /// [`command`].
    Command,
    /// [`listen`].
    Listen,
    /// [`listen_serial`].
    ListenSerial,
    /// [`scrub`].
    Scrub,
    /// The start, of what was before it.
    Crash,
    /// [`grip`](fn@grip), of grasp and motor.
    Grip,
}

const FINDERS: usize = 9;

/// A value that one loop sets and others look at.
pub struct Shown<M: RawMutex, T>(Mutex<M, Cell<T>>);

impl<M: RawMutex, T: Copy> Shown<M, T> {
    const fn new(value: T) -> Self {
        Self(Mutex::new(Cell::new(value)))
    }

    /// The value now.
    pub fn get(&self) -> T {
        self.0.lock(Cell::get)
    }

    /// Another one; what was there before.
    pub fn set(&self, value: T) -> T {
        self.0.lock(|cell| cell.replace(value))
    }

    /// Changes it in place.
    pub fn change(&self, change: impl FnOnce(&mut T)) {
        self.0.lock(|cell| {
            let mut value = cell.get();
            change(&mut value);
            cell.set(value);
        });
    }
}

/// What the loops hand to each other. Each part has one writer and one reader, named beside it.
pub struct Exchange<M: RawMutex> {
    /// From [`sense`] to [`estimate`].
    pub sensed: Signal<M, Sensed>,
    /// From [`estimate`] to [`report`].
    pub told: Signal<M, Told>,
    /// From [`estimate`] to [`telemetry`].
    pub ticks: Signal<M, Tick>,
    /// From [`estimate`] to [`grip`](fn@grip).
    pub felt: Signal<M, Felt>,
    /// From [`command`] to [`grip`](fn@grip): hosts, always up to date when one of them asks for something.
    pub hosts: Shown<M, Hosts>,
    /// From [`command`] to [`grip`](fn@grip), which takes it in each tick.
    pub asked: Shown<M, Asked>,
    /// From [`grip`](fn@grip) to [`command`] and [`report`].
    pub stands: Shown<M, Stands>,
    /// From [`grip`](fn@grip) to [`report`]: the grip, the foot, commands that are refused.
    pub grasp: Channel<M, Message, 4>,
    /// From [`listen`] and [`listen_serial`] to [`command`].
    pub heard: Channel<M, Heard, 8>,
    /// From [`command`] to [`report`].
    pub replies: Channel<M, Message, 8>,
    /// From [`command`] to [`estimate`]: a tare is wanted.
    pub tare_wanted: Signal<M, ()>,
    /// From [`estimate`] to [`command`]: how it ended.
    pub tare_ended: Signal<M, Step>,
    /// From [`grip`](fn@grip) to [`command`]: how it ended.
    pub measured: Signal<M, Outcome>,
    /// From [`scrub`] to [`command`]: tables and networks were looked at.
    pub checked: Signal<M, ()>,
    /// From [`listen`] to [`report`]: the controller has left the bus.
    pub bus_off: Signal<M, ()>,
    /// From [`report`] to [`telemetry`].
    pub lines: Channel<M, Packet, 8>,
    /// From everybody to [`report`].
    pub events: Events<M>,
    /// Whether the loops move on; each checks in.
    pub progress: Progress,
    /// Figures that loops count and [`report`] tells.
    pub counts: Counts,
    /// Written by [`command`] alone.
    parameters: Shown<M, Parameters>,
    /// Active faults, each word written by its finder.
    faults: [AtomicU32; FINDERS],
}

/// Figures since boot; each has one writer.
#[derive(Debug, Default)]
pub struct Counts {
    /// Transfers from sensors that failed ([`sense`]).
    pub transfers_failed: AtomicU32,
    /// Ticks that were skipped ([`sense`]).
    pub ticks_missed: AtomicU32,
    /// Longest time from the beginning of a tick to its estimate since [`report`] told it last, in
    /// microseconds ([`estimate`]).
    pub worst_tick_us: AtomicU32,
    /// Longest estimate, likewise.
    pub worst_estimate_us: AtomicU32,
    /// Hosts' commands arrive in time: 1, else 0 ([`command`]).
    pub command_alive: AtomicU32,
    /// Sensors that answer, one bit each ([`estimate`]).
    pub sensors_ok: AtomicU32,
    /// Frames for this node that moved nothing ([`command`]).
    pub dropped: AtomicU32,
    /// Packets on the serial line that were not understood ([`listen_serial`]).
    pub packets_broken: AtomicU32,
    /// Frames that [`command`] did not find time for ([`listen`], [`listen_serial`]).
    pub unheard: AtomicU32,
    /// Frames that nobody acknowledged ([`report`]).
    pub frames_unsent: AtomicU32,
    /// Packets that found no place or no line ([`report`], [`telemetry`]).
    pub packets_unsent: AtomicU32,
}

impl Counts {
    /// The counter with this identifier, if there is one.
    pub fn counter(&self, id: u16) -> Option<u32> {
        let count = match id {
            counter::TRANSFERS_FAILED => &self.transfers_failed,
            counter::TICKS_MISSED => &self.ticks_missed,
            counter::FRAMES_REFUSED => &self.dropped,
            counter::PACKETS_BROKEN => &self.packets_broken,
            counter::RECEIVE_OVERRUN => &self.unheard,
            counter::FRAMES_UNSENT => &self.frames_unsent,
            counter::PACKETS_UNSENT => &self.packets_unsent,
            _ => return None,
        };
        Some(count.load(Ordering::Relaxed))
    }
}

impl<M: RawMutex> Exchange<M> {
    /// Nothing has been said.
    pub const fn new() -> Self {
        Self {
            sensed: Signal::new(),
            told: Signal::new(),
            ticks: Signal::new(),
            felt: Signal::new(),
            hosts: Shown::new(Hosts::NONE),
            asked: Shown::new(Asked::NOTHING),
            stands: Shown::new(Stands::NOWHERE),
            grasp: Channel::new(),
            heard: Channel::new(),
            replies: Channel::new(),
            tare_wanted: Signal::new(),
            tare_ended: Signal::new(),
            measured: Signal::new(),
            checked: Signal::new(),
            bus_off: Signal::new(),
            lines: Channel::new(),
            events: Events::new(),
            progress: Progress::new(),
            counts: Counts {
                transfers_failed: AtomicU32::new(0),
                ticks_missed: AtomicU32::new(0),
                worst_tick_us: AtomicU32::new(0),
                worst_estimate_us: AtomicU32::new(0),
                command_alive: AtomicU32::new(0),
                sensors_ok: AtomicU32::new(0),
                dropped: AtomicU32::new(0),
                packets_broken: AtomicU32::new(0),
                unheard: AtomicU32::new(0),
                frames_unsent: AtomicU32::new(0),
                packets_unsent: AtomicU32::new(0),
            },
            parameters: Shown::new(Parameters::DEFAULT),
            faults: [const { AtomicU32::new(0) }; FINDERS],
        }
    }

    /// Notes a fault in its finder's own list, and posts it where it is news.
    #[inline(always)] // Mostly there is no news: a few instructions then.
    pub fn note(
        &self,
        finder: Finder,
        faults: &mut Faults,
        (fault, source): (Fault, u8),
        active: bool,
        detail: u32,
    ) {
        if faults.has(fault, source) != active {
            self.note_news(finder, faults, (fault, source), active, detail);
        }
    }

    #[cold]
    fn note_news(
        &self,
        finder: Finder,
        faults: &mut Faults,
        (fault, source): (Fault, u8),
        active: bool,
        detail: u32,
    ) {
        if let Some(event) = faults.note(fault, source, active, detail) {
            self.events.post(Event::Fault(event));
            self.set_faults(finder, faults.bits());
        }
    }

    /// Tells what ended the last start.
    pub fn note_crash(&self, crash: &Crash) {
        let crashed = (Fault::Crashed, 0);
        let mut faults = Faults::default();
        self.note(Finder::Crash, &mut faults, crashed, true, crash.detail());
    }

    /// Takes over the faults of a finder that keeps them itself, and posts the news.
    pub fn tell(&self, finder: Finder, bits: u32, news: &[FaultEvent]) {
        self.set_faults(finder, bits);
        for event in news {
            self.events.post(Event::Fault(*event));
        }
    }

    fn set_faults(&self, finder: Finder, bits: u32) {
        if let Some(word) = self.faults.get(finder as usize) {
            word.store(bits, Ordering::Relaxed);
        }
    }

    /// What hosts have set.
    pub fn parameters(&self) -> Parameters {
        self.parameters.get()
    }

    /// A part of what hosts have set.
    #[inline(always)] // The rest of it is not copied then.
    pub fn parameter<R>(&self, look: impl FnOnce(&Parameters) -> R) -> R {
        self.parameters.0.lock(|cell| look(&cell.get()))
    }

    /// Takes other parameters: at the start, then from [`command`] alone.
    pub fn set_parameters(&self, parameters: Parameters) {
        self.parameters.set(parameters);
    }

    /// Whether a fault is active, whoever found it.
    pub fn is_active(&self, fault: Fault) -> bool {
        self.fault_bits() & (1 << fault.place()) != 0
    }

    /// All active faults, one bit for each kind.
    pub fn fault_bits(&self) -> u32 {
        let words = self.faults.iter();
        words.fold(0, |all, word| all | word.load(Ordering::Relaxed))
    }

    /// Those that others than this one found.
    pub fn fault_bits_beside(&self, finder: Finder) -> u32 {
        let words = self.faults.iter().enumerate();
        let others = words.filter(|(place, _)| *place != finder as usize);
        others.fold(0, |all, (_, word)| all | word.load(Ordering::Relaxed))
    }
}

impl<M: RawMutex> Default for Exchange<M> {
    fn default() -> Self {
        Self::new()
    }
}
