//! Receives frames and packets of hosts, limits their rate, and queues them.

use core::sync::atomic::Ordering;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_can::Frame;
use embedded_io_async::Read;

use crate::clock::{Clock, delay_us, with_timeout_us};
use crate::config::limits::DetectionLimits;
use crate::parameters::Parameters;
use crate::protocol::can::{CanError, CanFrame, CanReceiver};
use crate::protocol::messages::{Authentication, is_from_host};
use crate::protocol::rate_limiter::RateLimiter;
use crate::protocol::serial::{Packet, PacketDecoder};
use crate::protocol::session::{DueCounters, is_stop};
use crate::protocol::{CAN, SERIAL, frame_id};
use crate::system::faults::{Fault, FaultSet};
use crate::tasks::{FaultReporter, SharedState};

/// Pause after an error: the driver would return the same error at once and starve the other tasks.
const ERROR_PAUSE_US: u64 = 1000;
/// Without traffic, the end of a flood is checked at this interval.
const CHECK_US: u64 = 20_000;
/// Places of the queue that only frames of an owner take: its authentication, its request, and one forged between them.
const RESERVED: usize = 3;

/// A frame of a host.
#[derive(Clone, Copy, Debug)]
pub struct RxFrame {
    /// [`CAN`] or [`SERIAL`].
    pub source: u8,
    /// The frame; for the serial line, the equivalent frame on the bus.
    pub frame: CanFrame,
}

/// The common part of both receivers.
struct RxPort<'s, M: RawMutex> {
    source: u8,
    /// Separate limits for messages of hosts and for all else, which must not displace them.
    limiters: [RateLimiter; 2],
    /// Requests that are admitted after an authentication with a counter that is due.
    granted: u8,
    faults: FaultSet,
    shared: &'s SharedState<M>,
}

impl<'s, M: RawMutex> RxPort<'s, M> {
    fn new(source: u8, limits: &DetectionLimits, shared: &'s SharedState<M>) -> Self {
        Self {
            source,
            limiters: [RateLimiter::new(limits); 2],
            granted: 0,
            faults: FaultSet::default(),
            shared,
        }
    }

    fn push(&mut self, frame: CanFrame, now_us: u64) {
        if is_stop(self.shared.parameter(Parameters::node), frame.identifier()) {
            // Neither a flood nor a full queue may delay a stop.
            self.shared.requests.modify(|requests| requests.stop = true);
            return self.update_fault(now_us);
        }
        let is_of_owner = self.is_of_owner(&frame);
        let [of_hosts, of_others] = &mut self.limiters;
        let limiter =
            if is_from_host((frame.identifier() & 0x1F) as u8) { of_hosts } else { of_others };
        // A flood must not drop what its owner sends meanwhile.
        if limiter.admit(now_us) || is_of_owner {
            let source = self.source;
            let has_place = is_of_owner || self.shared.rx_frames.free_capacity() > RESERVED;
            if !has_place || self.shared.rx_frames.try_send(RxFrame { source, frame }).is_err() {
                let overrun = &self.shared.counts.receive_overrun;
                overrun.fetch_add(1, Ordering::Relaxed);
            }
        }
        self.update_fault(now_us);
    }

    /// Whether a frame is an authentication with a counter that is due, or one of the requests that may belong to it.
    fn is_of_owner(&mut self, frame: &CanFrame) -> bool {
        let number = (frame.identifier() & 0x1F) as u8;
        if number == const { Authentication::LAYOUT.number } {
            // Its lowest 24 bits.
            let counter = match *frame.data() {
                [c0, c1, c2, ..] => u32::from_le_bytes([c0, c1, c2, 0]),
                _ => return false,
            };
            let is_due = self.shared.due_counters.get().contains(counter);
            if is_due {
                self.granted = DueCounters::REQUESTS;
            }
            return is_due;
        }
        let is_granted = self.granted > 0 && is_from_host(number);
        self.granted = self.granted.saturating_sub(u8::from(is_granted));
        is_granted
    }

    fn update_fault(&mut self, now_us: u64) {
        let flooded =
            self.limiters.each_mut().map(|limiter| limiter.is_flooded(now_us)) != [false; 2];
        let reporter = if self.source == CAN {
            FaultReporter::ReceiveCan
        } else {
            FaultReporter::ReceiveSerial
        };
        let [of_hosts, of_others] = &self.limiters;
        let dropped = of_hosts.dropped().saturating_add(of_others.dropped());
        let fault = (Fault::Flooded, self.source);
        self.shared.update_fault(reporter, &mut self.faults, fault, flooded, dropped);
    }
}

/// Receives frames of the CAN bus.
pub async fn receive_can<R: CanReceiver, C: Clock, M: RawMutex>(
    mut can: R,
    limits: &DetectionLimits,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let mut port = RxPort::new(CAN, limits, shared);
    loop {
        match with_timeout_us(clock, CHECK_US, can.receive()).await {
            None => port.update_fault(clock.now_us()),
            Some(Ok(frame)) => port.push(frame, clock.now_us()),
            Some(Err(error)) => {
                if error == CanError::BusOff {
                    shared.bus_off.signal(());
                }
                delay_us(clock, ERROR_PAUSE_US).await;
            }
        }
    }
}

/// Receives packets of the serial line. Lost bytes invalidate the packet that they belong to.
pub async fn receive_serial<R: Read, C: Clock, M: RawMutex>(
    mut line: R,
    node: u16,
    limits: &DetectionLimits,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let mut port = RxPort::new(SERIAL, limits, shared);
    let mut decoder = PacketDecoder::default();
    let mut bytes = [0; 32];
    loop {
        let count = match with_timeout_us(clock, CHECK_US, line.read(&mut bytes)).await {
            None => 0,
            Some(Ok(count)) => count,
            Some(Err(_)) => {
                decoder.discard();
                delay_us(clock, ERROR_PAUSE_US).await;
                0
            }
        };
        for byte in bytes.iter().take(count) {
            if let Some(Packet::Message { copy, message }) = decoder.push(*byte) {
                let number = message.number().saturating_add(copy);
                let frame = CanFrame::from_bytes(frame_id(node, number), message.to_bytes());
                port.push(frame, clock.now_us());
            }
        }
        let broken = &shared.counts.packets_broken;
        broken.store(decoder.broken, Ordering::Relaxed);
        port.update_fault(clock.now_us());
    }
}
