//! Transmits messages on the CAN bus and on the serial line, and every tick on the serial line.
//!
//! A tick takes at most half of the time of the line ([`crate::protocol::serial::BAUD_RATE`]) and has priority. Messages
//! wait in a queue; those that find it full are dropped and counted.

use core::mem::swap;
use core::sync::atomic::Ordering;

use embassy_futures::join::join;
use embassy_futures::select::{Either, Either6, select, select6};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::Write;

use crate::clock::{Clock, with_timeout_us};
use crate::parameters::Parameters;
use crate::protocol::can::{CanError, CanFrame, CanSender};
use crate::protocol::messages::{self, HallRaw, Heartbeat, Message, Power, Timing};
use crate::protocol::serial::{MAX_PACKET_BYTES, Packet, encode};
use crate::protocol::{self, PROTOCOL_VERSION, TEMPERATURE_UNKNOWN, frame_id};
use crate::sensors::hall;
use crate::system::faults::{Event, Fault, FaultSet};
use crate::system::task_watchdog::TaskId;
use crate::tasks::{FaultReporter, ForceSample, SharedState};

/// Time-out of a frame without acknowledge.
const FRAME_TIMEOUT_US: u64 = 2000;
/// Waiting times before the controller rejoins the bus after bus-off; the last one repeats.
const REJOIN_US: [u64; 3] = [10_000, 100_000, 1_000_000];
/// The recovery takes 128 times eleven recessive bits (ISO 11898-1, 12.1.4.4), 1.41 ms at 1 Mbit/s, and longer on a busy
/// bus. The controller sends nothing before.
const RECOVERY_US: u64 = 3000;
const HEARTBEAT_US: u64 = Heartbeat::LAYOUT.period_ms as u64 * 1000;
/// Heartbeats for each [`Timing`] message.
const HEARTBEATS_PER_TIMING: u16 = Timing::LAYOUT.period_ms / Heartbeat::LAYOUT.period_ms;

/// Transmits all messages; `log` receives every event.
pub async fn transmit<S: CanSender, C: Clock, M: RawMutex>(
    can: S,
    (node, version): (u16, messages::Version),
    mut log: impl FnMut(Event),
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let mut port = TxPort {
        can,
        node,
        bus_off: None,
        recovers_us: None,
        faults: FaultSet::default(),
        clock,
        shared,
    };
    let mut counters = Counters::default();
    let mut heartbeat_us = clock.now_us();
    port.send(0, Message::Version(version)).await;
    loop {
        let next = select6(
            // First: the forces have the shortest deadline, and a frame takes longer than their estimate.
            shared.force_sample.wait(),
            shared.replies.receive(),
            shared.grip_messages.receive(),
            shared.events.next(),
            clock.until(heartbeat_us),
            shared.bus_off.wait(),
        );
        let next = next.await;
        shared.progress.check_in(TaskId::Transmit);
        match next {
            Either6::First(sample) => {
                let readings = sample.readings.iter().flatten();
                let warmest = readings.map(|reading| reading.temperature).max();
                counters.warmest = warmest.map(hall::celsius);
                port.send_forces(&sample, &mut counters).await;
            }
            Either6::Second(message) | Either6::Third(message) => port.send(0, message).await,
            Either6::Fourth(event) => {
                log(event);
                if let Event::Fault(fault) = event {
                    port.send(0, Message::FaultEvent(fault)).await;
                }
            }
            Either6::Fifth(()) => {
                heartbeat_us = heartbeat_us.saturating_add(HEARTBEAT_US);
                port.send_heartbeat(&mut counters).await;
            }
            // Signalled every millisecond during bus-off.
            Either6::Sixth(()) => {
                if port.bus_off.is_none() {
                    port.on_bus_off();
                }
            }
        }
    }
}

/// Transmits ticks and messages on the serial line, ticks first. The next packet is encoded while one is on the line: at
/// the longest both together take more than a millisecond.
pub async fn transmit_serial<W: Write, M: RawMutex>(mut line: W, shared: &SharedState<M>) -> ! {
    let (mut first, mut second) = ([0; MAX_PACKET_BYTES], [0; MAX_PACKET_BYTES]);
    let (mut sending, mut next) = (&mut first, &mut second);
    let mut length = 0;
    loop {
        let write = async {
            match sending.get(..length) {
                Some([]) | None => true,
                Some(bytes) => write_all(&mut line, bytes).await,
            }
        };
        let (is_sent, encoded) = join(write, encode_next(shared, next)).await;
        let lost = u32::from(!is_sent) + u32::from(encoded.is_none());
        shared.counts.packets_unsent.fetch_add(lost, Ordering::Relaxed);
        length = encoded.unwrap_or(0);
        swap(&mut sending, &mut next);
    }
}

/// Writes all bytes; false if the line fails. That of `embedded-io-async` panics where a line takes no byte.
async fn write_all<W: Write>(line: &mut W, mut bytes: &[u8]) -> bool {
    while !bytes.is_empty() {
        match line.write(bytes).await {
            Ok(count @ 1..) => bytes = bytes.get(count..).unwrap_or_default(),
            Ok(0) | Err(_) => return false,
        }
    }
    true
}

/// Encodes the next tick, if telemetry is enabled, or message; returns the length of the packet.
async fn encode_next<M: RawMutex>(
    shared: &SharedState<M>,
    buffer: &mut [u8; MAX_PACKET_BYTES],
) -> Option<usize> {
    loop {
        let next = select(shared.ticks.receive(), shared.serial_packets.receive()).await;
        let packet = match next {
            Either::First(tick) if shared.parameter(Parameters::telemetry) => Packet::Tick(tick),
            Either::First(_) => continue,
            Either::Second(packet) => packet,
        };
        return encode(&packet, buffer).map(<[u8]>::len);
    }
}

/// Message counters.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    force: u8,
    heartbeat: u8,
    timing: u8,
    /// Temperature of the warmest Hall sensor in the last tick, in degrees Celsius.
    warmest: Option<f32>,
}

struct TxPort<'s, S, C, M: RawMutex> {
    can: S,
    node: u16,
    /// During bus-off: end of the waiting time, and index into [`REJOIN_US`].
    bus_off: Option<(u64, usize)>,
    /// During a recovery: its end.
    recovers_us: Option<u64>,
    faults: FaultSet,
    clock: &'s C,
    shared: &'s SharedState<M>,
}

impl<S: CanSender, C: Clock, M: RawMutex> TxPort<'_, S, C, M> {
    /// Sends forces and raw readings when they are due.
    async fn send_forces(&mut self, sample: &ForceSample, counters: &mut Counters) {
        let period = self.shared.parameter(Parameters::force_period);
        if !period.is_some_and(|period| sample.tick.is_multiple_of(period)) {
            return;
        }
        for (sensor, estimate) in (0_u8..).zip(&sample.estimates) {
            let message = protocol::force_message(estimate, counters.force);
            self.send(sensor, Message::Force(message)).await;
        }
        counters.force = counters.force.wrapping_add(1);
        if self.shared.parameter(Parameters::raw) {
            self.send_raw(sample).await;
        }
    }

    async fn send_raw(&mut self, sample: &ForceSample) {
        for (sensor, reading) in (0_u8..).zip(sample.readings) {
            let Some(reading) = reading else { continue };
            let [x, y, z] = reading.field;
            let temperature = reading.temperature;
            let raw = HallRaw { sensor, x, y, z, temperature };
            self.send(0, Message::HallRaw(raw)).await;
        }
    }

    /// Sends the heartbeat, and once a second the timing.
    async fn send_heartbeat(&mut self, counters: &mut Counters) {
        let counts = &self.shared.counts;
        let grip = self.shared.grip_summary.get();
        let heartbeat = Heartbeat {
            state: grip.state,
            stopped: grip.is_stopped,
            object: grip.object,
            faults: self.shared.fault_bits(),
            command_alive: counts.command_alive.load(Ordering::Relaxed) != 0,
            sensors_ok: counts.sensors_ok.load(Ordering::Relaxed) as u8,
            unprotected: self.shared.host_status.get().is_unprotected,
            protocol_major: PROTOCOL_VERSION.0,
            counter: counters.heartbeat,
        };
        self.send(0, Message::Heartbeat(heartbeat)).await;
        self.send(0, Message::Power(self.power(counters))).await;
        counters.heartbeat = counters.heartbeat.wrapping_add(1);
        if u16::from(counters.heartbeat).is_multiple_of(HEARTBEATS_PER_TIMING) {
            let word = |count: u32| count.min(u16::MAX.into()) as u16;
            let timing = Timing {
                worst_loop: word(counts.worst_tick_us.swap(0, Ordering::Relaxed)),
                worst_inference: word(counts.worst_estimate_us.swap(0, Ordering::Relaxed)),
                i2c_errors: word(counts.transfers_failed.load(Ordering::Relaxed)),
                missed_ticks: counts.ticks_missed.load(Ordering::Relaxed).min(255) as u8,
                counter: counters.timing,
            };
            self.send(0, Message::Timing(timing)).await;
            counters.timing = counters.timing.wrapping_add(1);
        }
    }

    /// Supply and temperatures.
    fn power(&self, counters: &Counters) -> Power {
        const COUNTS: f32 = 100.0;
        let supply = self.shared.supply.get();
        let temperatures = self.shared.temperatures.get();
        // The casts saturate.
        let degrees = |celsius: Option<f32>| {
            let Some(celsius) = celsius else { return TEMPERATURE_UNKNOWN };
            let rounded = celsius + if celsius < 0.0 { -0.5 } else { 0.5 };
            (rounded as i8).max(TEMPERATURE_UNKNOWN + 1)
        };
        Power {
            bus: (supply.bus_v * COUNTS) as u16,
            current: (supply.current_a * COUNTS) as i16,
            mcu: degrees(temperatures.mcu),
            motor: degrees(temperatures.motor.motor),
            sensor: degrees(counters.warmest),
            counter: counters.heartbeat,
        }
    }

    /// Sends a message on both interfaces; bus-off does not affect the serial line. Raw readings are contained in the ticks
    /// and not repeated on the line, which has no capacity for both.
    async fn send(&mut self, copy: u8, message: Message) {
        let packet = Packet::Message { copy, message };
        let raw = matches!(message, Message::HallRaw(_));
        let in_ticks = raw && self.shared.parameter(Parameters::telemetry);
        if !in_ticks && self.shared.serial_packets.try_send(packet).is_err() {
            let unsent = &self.shared.counts.packets_unsent;
            unsent.fetch_add(1, Ordering::Relaxed);
        }
        if !self.may_send() {
            return;
        }
        let number = message.number().saturating_add(copy);
        let frame = CanFrame::from_bytes(frame_id(self.node, number), message.to_bytes());
        match with_timeout_us(self.clock, FRAME_TIMEOUT_US, self.can.send(&frame)).await {
            Some(Ok(())) => (self.bus_off, self.recovers_us) = (None, None),
            Some(Err(CanError::BusOff)) => {
                self.on_bus_off();
                return;
            }
            Some(Err(CanError::Transient)) | None => {
                let unsent = &self.shared.counts.frames_unsent;
                unsent.fetch_add(1, Ordering::Relaxed);
            }
        }
        self.update_fault();
    }

    /// Whether the controller is on the bus. After bus-off it rejoins at the end of the waiting time, and may send after
    /// the recovery.
    fn may_send(&mut self) -> bool {
        let now_us = self.clock.now_us();
        match (self.bus_off, self.recovers_us) {
            (None, _) => true,
            (Some((until_us, _)), None) if now_us < until_us => false,
            (Some(_), None) => {
                self.can.rejoin();
                self.recovers_us = Some(now_us.saturating_add(RECOVERY_US));
                false
            }
            (Some(_), Some(recovers_us)) => now_us >= recovers_us,
        }
    }

    /// Starts the waiting time, longer after each bus-off in a row.
    fn on_bus_off(&mut self) {
        let now_us = self.clock.now_us();
        let times = self.bus_off.map_or(0, |(_, times)| times + 1);
        let [.., last] = REJOIN_US;
        let wait_us = REJOIN_US.get(times).copied().unwrap_or(last);
        let until_us = now_us.saturating_add(wait_us);
        self.bus_off = Some((until_us, times.min(REJOIN_US.len())));
        self.recovers_us = None;
        self.update_fault();
    }

    fn update_fault(&mut self) {
        let fault = (Fault::BusOff, 0);
        let is_active = self.bus_off.is_some();
        let shared = self.shared;
        shared.update_fault(FaultReporter::Transmit, &mut self.faults, fault, is_active, 0);
    }
}
