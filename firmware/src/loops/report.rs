//! Tells forces, the grasp, faults, and answers on the CAN bus, and hands them on to the serial line.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either6, select6};
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{Exchange, Finder, Told};
use crate::clock::{Clock, within};
use crate::events::Event;
use crate::parameters::Parameters;
use crate::progress::Loop;
use crate::status::{Fault, Faults};
use crate::wire::can::{CanError, CanFrame, CanSender};
use crate::wire::messages::{self, HallRaw, Heartbeat, Message, Timing};
use crate::wire::serial::Packet;
use crate::wire::{self, PROTOCOL, identifier};

/// A frame that nobody acknowledges is given up after this.
const PATIENCE_US: u64 = 2000;
/// Waits before the controller joins the bus again, the last one for ever.
const REJOIN_US: [u64; 3] = [10_000, 100_000, 1_000_000];
/// A controller that joins again waits for 128 times eleven recessive bits (ISO 11898-1, 12.1.4.4), 1.41 ms at 1 Mbit/s:
/// it sends nothing before, and a busy bus makes it wait longer.
const RECOVERY_US: u64 = 3000;
/// Between two heartbeats.
const BEAT_US: u64 = Heartbeat::LAYOUT.period_ms as u64 * 1000;
/// Heartbeats to each message of times.
const BEATS: u16 = Timing::LAYOUT.period_ms / Heartbeat::LAYOUT.period_ms;
/// Milliseconds in a tick of sensing.
const TICK_MS: u32 = (crate::params::TICK_US / 1000) as u32;

/// Sends everything, for ever; `log` is told every event too.
pub async fn report<S: CanSender, C: Clock, M: RawMutex>(
    can: S,
    (node, version): (u16, messages::Version),
    mut log: impl FnMut(Event),
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut mouth = Mouth {
        can,
        node,
        off: None,
        recovers_us: None,
        faults: Faults::default(),
        clock,
        exchange,
    };
    let mut counters = Counters::default();
    let mut beat_us = clock.now_us();
    mouth.say(0, Message::Version(version)).await;
    loop {
        let next = select6(
            exchange.replies.receive(),
            exchange.grasp.receive(),
            exchange.told.wait(),
            exchange.events.next(),
            clock.until(beat_us),
            exchange.bus_off.wait(),
        );
        let next = next.await;
        exchange.progress.check_in(Loop::Report);
        match next {
            Either6::First(message) | Either6::Second(message) => mouth.say(0, message).await,
            Either6::Third(told) => mouth.forces(&told, &mut counters).await,
            Either6::Fourth(event) => {
                log(event);
                if let Event::Fault(fault) = event {
                    mouth.say(0, Message::FaultEvent(fault)).await;
                }
            }
            Either6::Fifth(()) => {
                beat_us = beat_us.saturating_add(BEAT_US);
                mouth.heartbeat(&mut counters).await;
            }
            // Told every millisecond while it is off.
            Either6::Sixth(()) if mouth.off.is_none() => mouth.leave(),
            Either6::Sixth(()) => {}
        }
    }
}

/// Counters of messages.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    force: u8,
    heartbeat: u8,
    timing: u8,
}

/// The way out.
struct Mouth<'x, S, C, M: RawMutex> {
    can: S,
    node: u16,
    /// The controller has left the bus: until when to wait, and how often it has in a row.
    off: Option<(u64, usize)>,
    /// The controller is joining again: until when it gets its time.
    recovers_us: Option<u64>,
    faults: Faults,
    clock: &'x C,
    exchange: &'x Exchange<M>,
}

impl<S: CanSender, C: Clock, M: RawMutex> Mouth<'_, S, C, M> {
    /// The forces where they are due.
    async fn forces(&mut self, told: &Told, counters: &mut Counters) {
        let rate_hz = self.exchange.parameter(Parameters::force_rate_hz);
        let period = 1000_u32.checked_div(rate_hz * TICK_MS);
        if !period.is_some_and(|period| told.tick.is_multiple_of(period)) {
            return;
        }
        for (sensor, estimate) in (0_u8..).zip(&told.estimates) {
            let message = wire::force(estimate, counters.force);
            self.say(sensor, Message::Force(message)).await;
        }
        counters.force = counters.force.wrapping_add(1);
        if self.exchange.parameter(Parameters::raw) {
            self.raw(told).await;
        }
    }

    /// What the sensors read.
    async fn raw(&mut self, told: &Told) {
        for (sensor, reading) in (0_u8..).zip(told.readings) {
            let Some(reading) = reading else { continue };
            let [x, y, z] = reading.field;
            let temperature = reading.temperature;
            let raw = HallRaw {
                sensor,
                x,
                y,
                z,
                temperature,
            };
            self.say(0, Message::HallRaw(raw)).await;
        }
    }

    /// The heartbeat, and once a second how busy the gripper is.
    async fn heartbeat(&mut self, counters: &mut Counters) {
        let counts = &self.exchange.counts;
        let stands = self.exchange.stands.get();
        let beat = Heartbeat {
            state: stands.state,
            object: stands.object,
            faults: self.exchange.fault_bits(),
            command_alive: counts.command_alive.load(Ordering::Relaxed) != 0,
            sensors_ok: counts.sensors_ok.load(Ordering::Relaxed) as u8,
            protocol_major: PROTOCOL.0,
            counter: counters.heartbeat,
        };
        self.say(0, Message::Heartbeat(beat)).await;
        counters.heartbeat = counters.heartbeat.wrapping_add(1);
        if u16::from(counters.heartbeat).is_multiple_of(BEATS) {
            let word = |count: u32| count.min(u16::MAX.into()) as u16;
            let timing = Timing {
                worst_loop: word(counts.worst_tick_us.swap(0, Ordering::Relaxed)),
                worst_inference: word(counts.worst_estimate_us.swap(0, Ordering::Relaxed)),
                i2c_errors: word(counts.transfers_failed.load(Ordering::Relaxed)),
                missed_ticks: counts.ticks_missed.load(Ordering::Relaxed).min(255) as u8,
                counter: counters.timing,
            };
            self.say(0, Message::Timing(timing)).await;
            counters.timing = counters.timing.wrapping_add(1);
        }
    }

    /// Sends a message on both ways; a bus that is off does not keep it from the line. What every tick on
    /// the line tells is not said there twice: both together are more than it carries.
    async fn say(&mut self, copy: u8, message: Message) {
        let packet = Packet::Message { copy, message };
        let raw = matches!(message, Message::HallRaw(_));
        let in_ticks = raw && self.exchange.parameter(Parameters::telemetry);
        if !in_ticks && self.exchange.lines.try_send(packet).is_err() {
            let unsent = &self.exchange.counts.packets_unsent;
            unsent.fetch_add(1, Ordering::Relaxed);
        }
        if !self.may_send() {
            return;
        }
        let number = message.number().saturating_add(copy);
        let frame = CanFrame::of(identifier(self.node, number), message.to_bytes());
        match within(self.clock, PATIENCE_US, self.can.send(&frame)).await {
            Some(Ok(())) => (self.off, self.recovers_us) = (None, None),
            Some(Err(CanError::BusOff)) => {
                self.leave();
                return;
            }
            Some(Err(CanError::Passing)) | None => {
                let unsent = &self.exchange.counts.frames_unsent;
                unsent.fetch_add(1, Ordering::Relaxed);
            }
        }
        self.note();
    }

    /// Whether the controller is on the bus, as far as is known. Off it, it joins again once it has waited, and may send
    /// after the time of its recovery.
    fn may_send(&mut self) -> bool {
        let now_us = self.clock.now_us();
        match (self.off, self.recovers_us) {
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

    /// The controller has left the bus: it joins again after a while, longer each time.
    fn leave(&mut self) {
        let now_us = self.clock.now_us();
        let times = self.off.map_or(0, |(_, times)| times + 1);
        let [.., last] = REJOIN_US;
        let wait_us = REJOIN_US.get(times).copied().unwrap_or(last);
        let until_us = now_us.saturating_add(wait_us);
        self.off = Some((until_us, times.min(REJOIN_US.len())));
        self.recovers_us = None;
        self.note();
    }

    fn note(&mut self) {
        let off = (Fault::BusOff, 0);
        let is_off = self.off.is_some();
        let exchange = self.exchange;
        exchange.note(Finder::Report, &mut self.faults, off, is_off, 0);
    }
}
