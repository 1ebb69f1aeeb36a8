//! Takes frames and packets of hosts, drops what is too much, and hands the rest on.

use core::sync::atomic::Ordering;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::Read;

use super::{Exchange, Finder};
use crate::clock::{Clock, pause, within};
use crate::limits::Limits;
use crate::status::{Fault, Faults};
use crate::throttle::Throttle;
use crate::wire::can::{CanError, CanFrame, CanReceiver};
use crate::wire::messages::is_from_host;
use crate::wire::serial::{Packet, Receiver};
use crate::wire::{STOP_ALL, identifier};

/// Where a frame came from, as the source of a fault.
pub const CAN: u8 = 0;
/// Likewise.
pub const SERIAL: u8 = 1;
/// A bus or line in trouble is asked again after this: it would answer at once with the same, and keep
/// the other loops from their turn.
const TROUBLE_US: u64 = 1000;
/// Where nothing arrives, how often the end of a flood is looked for.
const LOOK_US: u64 = 20_000;

/// A frame of a host.
#[derive(Clone, Copy, Debug)]
pub struct Heard {
    /// [`CAN`] or [`SERIAL`].
    pub source: u8,
    /// The frame; of the serial line, the one that would say the same on the bus.
    pub frame: CanFrame,
}

/// What both listeners share.
struct Ear<'x, M: RawMutex> {
    source: u8,
    /// Of a host's messages, and of anything else: what nobody understands takes no host's place.
    throttles: [Throttle; 2],
    faults: Faults,
    exchange: &'x Exchange<M>,
}

impl<'x, M: RawMutex> Ear<'x, M> {
    fn new(source: u8, limits: &Limits, exchange: &'x Exchange<M>) -> Self {
        Self {
            source,
            throttles: [Throttle::new(limits); 2],
            faults: Faults::default(),
            exchange,
        }
    }

    fn take(&mut self, frame: CanFrame, now_us: u64) {
        let [of_host, of_others] = &mut self.throttles;
        let throttle = match is_from_host((frame.identifier() & 0x1F) as u8) {
            true => of_host,
            false => of_others,
        };
        // A stop is heard in any flood.
        if throttle.admit(now_us) || frame.identifier() == STOP_ALL {
            let source = self.source;
            let full = self.exchange.heard.try_send(Heard { source, frame });
            if full.is_err() {
                let unheard = &self.exchange.counts.unheard;
                unheard.fetch_add(1, Ordering::Relaxed);
            }
        }
        self.judge(now_us);
    }

    fn judge(&mut self, now_us: u64) {
        let flooded = self
            .throttles
            .each_mut()
            .map(|throttle| throttle.is_flooded(now_us))
            != [false; 2];
        let (finder, fault) = match self.source {
            CAN => (Finder::Listen, (Fault::Flooded, CAN)),
            _ => (Finder::ListenSerial, (Fault::Flooded, SERIAL)),
        };
        let [of_host, of_others] = &self.throttles;
        let dropped = of_host.dropped().saturating_add(of_others.dropped());
        self.exchange
            .note(finder, &mut self.faults, fault, flooded, dropped);
    }
}

/// Hears the CAN bus, for ever.
pub async fn listen<R: CanReceiver, C: Clock, M: RawMutex>(
    mut can: R,
    limits: &Limits,
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut ear = Ear::new(CAN, limits, exchange);
    loop {
        match within(clock, LOOK_US, can.receive()).await {
            None => ear.judge(clock.now_us()),
            Some(Ok(frame)) => ear.take(frame, clock.now_us()),
            Some(Err(error)) => {
                if error == CanError::BusOff {
                    exchange.bus_off.signal(());
                }
                pause(clock, TROUBLE_US).await;
            }
        }
    }
}

/// Hears the serial line, for ever. Bytes that the line lost cost the packet that they belonged to.
pub async fn listen_serial<R: Read, C: Clock, M: RawMutex>(
    mut line: R,
    node: u16,
    limits: &Limits,
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut ear = Ear::new(SERIAL, limits, exchange);
    let mut receiver = Receiver::default();
    let mut bytes = [0; 32];
    loop {
        let count = match within(clock, LOOK_US, line.read(&mut bytes)).await {
            None => 0,
            Some(Ok(count)) => count,
            Some(Err(_)) => {
                receiver.lost();
                pause(clock, TROUBLE_US).await;
                0
            }
        };
        for byte in bytes.iter().take(count) {
            if let Some(Packet::Message { copy, message }) = receiver.take(*byte) {
                let number = message.number().saturating_add(copy);
                let frame = CanFrame::of(identifier(node, number), message.to_bytes());
                ear.take(frame, clock.now_us());
            }
        }
        let broken = &exchange.counts.packets_broken;
        broken.store(receiver.broken, Ordering::Relaxed);
        ear.judge(clock.now_us());
    }
}
