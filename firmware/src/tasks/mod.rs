//! The portable bodies of the tasks: each awaits its input, calls synchronous code, and publishes the result. They are
//! generic over clock and buses: the board wraps them as tasks, a simulation polls them in virtual time.
//!
//! | task | input | level | deadline | if missed |
//! | --- | --- | --- | --- | --- |
//! | [`sense`] | each millisecond | interrupt executor, above the next two | [`SENSE_LIMIT_US`](crate::config::constants::SENSE_LIMIT_US) after the tick began | the tick is skipped and counted |
//! | [`inertial`](fn@inertial::inertial) | each millisecond | interrupt executor, above the next two | 10 ms | acceleration and tilt are missing, the estimates are flagged |
//! | [`estimate`] with [`GripLoop::step`] | first readings, sensed frame | interrupt executor | the next tick; from sample to set-point within 1 ms | the older frame is lost, the number of the next tick is larger; the motor keeps its set-point until the watchdog resets |
//! | [`transmit`] | estimates, grip, events, replies | thread | 1 ms from sample to frame | the next estimate is sent |
//! | [`transmit_serial`] | estimates | thread | 1 ms | ticks wait; beyond eight one is missing on the line, visible by its time |
//! | [`receive_can`], [`receive_serial`] | frames, bytes | thread | three frames in the controller's memory, 141 us | the controller drops frames |
//! | [`host_service`] | received frames | thread | 1 ms | as a silent host |
//! | [`temperatures`](fn@temperatures::temperatures) | each 50 ms | thread | none | the motor is de-rated later |
//! | [`scrub`] | each 5 ms | thread | none | corruption of a table is detected later |

pub mod calibration;
pub mod covariates;
mod estimate;
mod grip;
mod host_service;
pub mod inertial;
mod receive;
mod scrub;
mod sense;
pub mod temperatures;
mod transmit;

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;

pub use estimate::{ForceSample, estimate};
pub use grip::{GripInputs, GripLoop, GripSummary, HostStatus, PendingRequests, Supply};
pub use host_service::{HostService, host_service, load_parameters};
pub use receive::{RxFrame, receive_can, receive_serial};
pub use scrub::scrub;
pub use sense::{FIRST_TICK_US, FirstReadings, SensedFrame, sense};
pub use transmit::{transmit, transmit_serial};

use crate::clock::Timed;
use crate::config::constants::TICK_US;
use crate::estimator::tare::TareProgress;
use crate::motor::calibration::CalibrationOutcome;
use crate::parameters::Parameters;
use crate::parameters::schema::counter;
use crate::protocol::messages::{FaultEvent, Message};
use crate::protocol::serial::{Packet, Tick};
use crate::protocol::session::DueCounters;
use crate::system::crash::Crash;
use crate::system::faults::{Event, EventQueue, Fault, FaultSet};
use crate::system::task_watchdog::TaskProgress;
use crate::tasks::covariates::HostMotion;
use crate::tasks::inertial::InertialSample;
use crate::tasks::temperatures::BoardTemperatures;

/// Tasks that report faults, each in a word of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum FaultReporter {
    /// [`sense`].
    Sense,
    /// [`estimate`].
    Estimate,
    /// [`transmit`].
    Transmit,
    /// [`host_service`].
    HostService,
    /// [`receive_can`].
    ReceiveCan,
    /// [`receive_serial`].
    ReceiveSerial,
    /// [`scrub`].
    Scrub,
    /// Boot, for the crash before it.
    Crash,
    /// [`GripLoop`], for grasp and motor.
    Grip,
}

const REPORTERS: usize = 9;
/// Ticks that wait for the serial line while thread mode is busy.
const QUEUED_TICKS: usize = 8;

/// The latest value, written by one task and read by others.
pub struct LatestValue<M: RawMutex, T>(Mutex<M, Cell<T>>);

impl<M: RawMutex, T: Copy> LatestValue<M, T> {
    const fn new(value: T) -> Self {
        Self(Mutex::new(Cell::new(value)))
    }

    /// A copy.
    pub fn get(&self) -> T {
        self.0.lock(Cell::get)
    }

    /// Replaces the value and returns the previous one.
    pub fn set(&self, value: T) -> T {
        self.0.lock(|cell| cell.replace(value))
    }

    /// Modifies the value in place.
    pub fn modify(&self, modify: impl FnOnce(&mut T)) {
        self.0.lock(|cell| {
            let mut value = cell.get();
            modify(&mut value);
            cell.set(value);
        });
    }
}

/// State shared by the tasks. Each field names its one writer and its reader.
pub struct SharedState<M: RawMutex> {
    /// From [`sense`]: beginning of the first tick in microseconds since boot.
    first_tick_us: LatestValue<M, u64>,
    /// From [`sense`] to [`estimate`], before [`Self::sensed`] in each tick.
    pub first_readings: Signal<M, FirstReadings>,
    /// From [`sense`] to [`estimate`].
    pub sensed: Signal<M, SensedFrame>,
    /// From [`estimate`] to [`transmit`].
    pub force_sample: Signal<M, ForceSample>,
    /// From [`estimate`] to [`transmit_serial`], which may be late by a few: every tick is sent.
    pub ticks: Channel<M, Tick, QUEUED_TICKS>,
    /// From [`host_service`] to [`GripLoop`]: state of the session, updated before each request.
    pub host_status: LatestValue<M, HostStatus>,
    /// From [`inertial`](fn@inertial::inertial) to [`estimate`]; none while the sensor is absent.
    pub inertial: LatestValue<M, Option<Timed<InertialSample>>>,
    /// From [`temperatures`](fn@temperatures::temperatures) to [`GripLoop`] and [`transmit`].
    pub temperatures: LatestValue<M, BoardTemperatures>,
    /// From [`GripLoop`] to [`transmit`].
    pub supply: LatestValue<M, Supply>,
    /// From [`host_service`] to [`estimate`] and [`inertial`](fn@inertial::inertial): motion of the gripper as a host reports it.
    pub host_motion: LatestValue<M, HostMotion>,
    /// From [`host_service`] to [`GripLoop`], which empties it in each tick.
    pub requests: LatestValue<M, PendingRequests>,
    /// From [`GripLoop`] to [`host_service`] and [`transmit`].
    pub grip_summary: LatestValue<M, GripSummary>,
    /// From [`GripLoop`] to [`transmit`]: grip status, ground contact, rejected commands.
    pub grip_messages: Channel<M, Message, 4>,
    /// From [`receive_can`] and [`receive_serial`] to [`host_service`].
    pub rx_frames: Channel<M, RxFrame, 12>,
    /// From [`host_service`] to [`receive_can`] and [`receive_serial`]: which authentications must not be dropped.
    pub due_counters: LatestValue<M, DueCounters>,
    /// From [`host_service`] to [`transmit`].
    pub replies: Channel<M, Message, 8>,
    /// From [`host_service`] to [`estimate`]: starts a tare.
    pub tare_request: Signal<M, ()>,
    /// From [`estimate`] to [`host_service`]: its result.
    pub tare_result: Signal<M, TareProgress>,
    /// From [`GripLoop`] to [`host_service`]: result of a calibration.
    pub calibration_result: Signal<M, CalibrationOutcome>,
    /// From [`scrub`] to [`host_service`]: tables and networks have been checked once.
    pub tables_checked: Signal<M, ()>,
    /// From [`receive_can`] to [`transmit`]: the controller is bus-off.
    pub bus_off: Signal<M, ()>,
    /// From [`transmit`] to [`transmit_serial`].
    pub serial_packets: Channel<M, Packet, 8>,
    /// From all tasks to [`transmit`].
    pub events: EventQueue<M>,
    /// Check-ins of the tasks.
    pub progress: TaskProgress,
    /// Counters since boot.
    pub counts: Counts,
    /// Written at boot, then by [`host_service`] alone.
    parameters: LatestValue<M, Parameters>,
    /// Bits of the active faults, one word for each reporter.
    faults: [AtomicU32; REPORTERS],
}

/// Counters since boot, and what the board is.
#[derive(Debug, Default)]
pub struct Counts {
    /// Failed transfers from sensors ([`sense`]).
    pub transfers_failed: AtomicU32,
    /// Skipped ticks ([`sense`]).
    pub ticks_missed: AtomicU32,
    /// Longest time from the beginning of a tick to its estimate since the last [`Timing`](crate::protocol::messages::Timing)
    /// message, in microseconds ([`estimate`]).
    pub worst_tick_us: AtomicU32,
    /// Longest estimate of a whole frame, or of the rest of it, since then, in microseconds ([`estimate`]).
    pub worst_estimate_us: AtomicU32,
    /// 1 while commands arrive in time, else 0 ([`host_service`]).
    pub command_alive: AtomicU32,
    /// Sensors with valid readings, one bit each ([`estimate`]).
    pub sensors_ok: AtomicU32,
    /// Rejected frames for this node ([`host_service`]).
    pub dropped: AtomicU32,
    /// Packets on the serial line that could not be decoded ([`receive_serial`]).
    pub packets_broken: AtomicU32,
    /// Frames dropped because the receive queue was full ([`receive_can`], [`receive_serial`]).
    pub receive_overrun: AtomicU32,
    /// Frames without acknowledge ([`transmit`]).
    pub frames_unsent: AtomicU32,
    /// Packets dropped by a queue or by the line ([`estimate`], [`transmit`], [`transmit_serial`]).
    pub packets_unsent: AtomicU32,
    /// See [`counter::BUS_ANSWERS`] ([`sense`]).
    pub bus_answers: AtomicU32,
    /// See [`counter::REPEATED_READINGS`] ([`sense`]).
    pub repeated_readings: AtomicU32,
    /// See [`counter::CONFIGURATIONS`] ([`sense`]).
    pub configurations: AtomicU32,
    /// See [`counter::ROTOR_SENSOR`]; this and all below are written by the board.
    pub rotor_sensor: AtomicU32,
    /// See [`counter::BREAK_INPUT`].
    pub break_input: AtomicU32,
    /// See [`counter::CHIP`].
    pub chip: AtomicU32,
    /// See [`counter::OPTION_BYTES`].
    pub option_bytes: AtomicU32,
    /// See [`counter::RESET_CAUSE`].
    pub reset_cause: AtomicU32,
    /// See [`counter::REPEATED_ANGLES`].
    pub repeated_angles: AtomicU32,
    /// See [`counter::LOW_SUPPLY`].
    pub low_supply: AtomicU32,
}

impl Counts {
    /// The counter with this identifier.
    pub fn counter(&self, id: u16) -> Option<u32> {
        let count = match id {
            counter::TRANSFERS_FAILED => &self.transfers_failed,
            counter::TICKS_MISSED => &self.ticks_missed,
            counter::FRAMES_REFUSED => &self.dropped,
            counter::PACKETS_BROKEN => &self.packets_broken,
            counter::RECEIVE_OVERRUN => &self.receive_overrun,
            counter::FRAMES_UNSENT => &self.frames_unsent,
            counter::PACKETS_UNSENT => &self.packets_unsent,
            counter::BUS_ANSWERS => &self.bus_answers,
            counter::ROTOR_SENSOR => &self.rotor_sensor,
            counter::BREAK_INPUT => &self.break_input,
            counter::CHIP => &self.chip,
            counter::OPTION_BYTES => &self.option_bytes,
            counter::RESET_CAUSE => &self.reset_cause,
            counter::REPEATED_READINGS => &self.repeated_readings,
            counter::REPEATED_ANGLES => &self.repeated_angles,
            counter::CONFIGURATIONS => &self.configurations,
            counter::LOW_SUPPLY => &self.low_supply,
            _ => return None,
        };
        Some(count.load(Ordering::Relaxed))
    }
}

impl<M: RawMutex> SharedState<M> {
    /// All queues empty, default parameters, no faults.
    pub const fn new() -> Self {
        Self {
            first_tick_us: LatestValue::new(0),
            first_readings: Signal::new(),
            sensed: Signal::new(),
            force_sample: Signal::new(),
            ticks: Channel::new(),
            host_status: LatestValue::new(HostStatus::NONE),
            inertial: LatestValue::new(None),
            temperatures: LatestValue::new(BoardTemperatures::UNKNOWN),
            supply: LatestValue::new(Supply::UNKNOWN),
            host_motion: LatestValue::new(HostMotion::NONE),
            requests: LatestValue::new(PendingRequests::NONE),
            grip_summary: LatestValue::new(GripSummary::INITIAL),
            grip_messages: Channel::new(),
            rx_frames: Channel::new(),
            due_counters: LatestValue::new(DueCounters::NONE),
            replies: Channel::new(),
            tare_request: Signal::new(),
            tare_result: Signal::new(),
            calibration_result: Signal::new(),
            tables_checked: Signal::new(),
            bus_off: Signal::new(),
            serial_packets: Channel::new(),
            events: EventQueue::new(),
            progress: TaskProgress::new(),
            counts: Counts {
                transfers_failed: AtomicU32::new(0),
                ticks_missed: AtomicU32::new(0),
                worst_tick_us: AtomicU32::new(0),
                worst_estimate_us: AtomicU32::new(0),
                command_alive: AtomicU32::new(0),
                sensors_ok: AtomicU32::new(0),
                dropped: AtomicU32::new(0),
                packets_broken: AtomicU32::new(0),
                receive_overrun: AtomicU32::new(0),
                frames_unsent: AtomicU32::new(0),
                packets_unsent: AtomicU32::new(0),
                bus_answers: AtomicU32::new(0),
                rotor_sensor: AtomicU32::new(0),
                break_input: AtomicU32::new(0),
                chip: AtomicU32::new(0),
                option_bytes: AtomicU32::new(0),
                reset_cause: AtomicU32::new(0),
                repeated_readings: AtomicU32::new(0),
                configurations: AtomicU32::new(0),
                repeated_angles: AtomicU32::new(0),
                low_supply: AtomicU32::new(0),
            },
            parameters: LatestValue::new(Parameters::DEFAULT),
            faults: [const { AtomicU32::new(0) }; REPORTERS],
        }
    }

    /// Sets or clears a fault in the reporter's set, and posts a change as an event.
    #[inline(always)] // Mostly unchanged: a few instructions then.
    pub fn update_fault(
        &self,
        reporter: FaultReporter,
        faults: &mut FaultSet,
        (fault, source): (Fault, u8),
        active: bool,
        detail: u32,
    ) {
        if faults.has(fault, source) != active {
            self.change_fault(reporter, faults, (fault, source), active, detail);
        }
    }

    #[cold]
    fn change_fault(
        &self,
        reporter: FaultReporter,
        faults: &mut FaultSet,
        (fault, source): (Fault, u8),
        active: bool,
        detail: u32,
    ) {
        if let Some(event) = faults.update(fault, source, active, detail) {
            self.events.post(Event::Fault(event));
            self.set_faults(reporter, faults.bits());
        }
    }

    /// Reports the crash of the previous run.
    pub fn record_crash(&self, crash: &Crash) {
        let crashed = (Fault::Crashed, 0);
        let mut faults = FaultSet::default();
        self.update_fault(FaultReporter::Crash, &mut faults, crashed, true, crash.detail());
    }

    /// Publishes the faults of a reporter with a set of its own, and posts their changes.
    pub fn publish_faults(&self, reporter: FaultReporter, bits: u32, changes: &[FaultEvent]) {
        self.set_faults(reporter, bits);
        for event in changes {
            self.events.post(Event::Fault(*event));
        }
    }

    fn set_faults(&self, reporter: FaultReporter, bits: u32) {
        if let Some(word) = self.faults.get(reporter as usize) {
            word.store(bits, Ordering::Relaxed);
        }
    }

    /// Beginning of the first tick of [`sense`] after a time, both in microseconds since boot.
    pub fn next_tick_us(&self, time_us: u64) -> u64 {
        let first_us = self.first_tick_us.get();
        let ticks = time_us.saturating_sub(first_us) / TICK_US;
        first_us.saturating_add(ticks.saturating_add(1).saturating_mul(TICK_US))
    }

    /// A copy of the parameters.
    pub fn parameters(&self) -> Parameters {
        self.parameters.get()
    }

    /// One parameter.
    #[inline(always)] // Avoids the copy of all others.
    pub fn parameter<R>(&self, read: impl FnOnce(&Parameters) -> R) -> R {
        self.parameters.0.lock(|cell| read(&cell.get()))
    }

    /// Replaces the parameters: at boot, then from [`host_service`] alone.
    pub fn set_parameters(&self, parameters: Parameters) {
        self.parameters.set(parameters);
    }

    /// Whether any task reports a fault.
    pub fn is_active(&self, fault: Fault) -> bool {
        self.fault_bits() & (1 << fault.index()) != 0
    }

    /// Active faults of all tasks, one bit for each kind.
    pub fn fault_bits(&self) -> u32 {
        let words = self.faults.iter();
        words.fold(0, |all, word| all | word.load(Ordering::Relaxed))
    }

    /// Active faults of all other tasks.
    pub fn fault_bits_except(&self, reporter: FaultReporter) -> u32 {
        let words = self.faults.iter().enumerate();
        let others = words.filter(|(index, _)| *index != reporter as usize);
        others.fold(0, |all, (_, word)| all | word.load(Ordering::Relaxed))
    }
}

impl<M: RawMutex> Default for SharedState<M> {
    fn default() -> Self {
        Self::new()
    }
}
