//! Every tick, raw and estimated, and every message, over the serial line.
//!
//! A tick takes half of the line's time at the most ([`crate::wire::serial::BAUD`]), and it goes first: messages share what
//! is left, and wait for it in a queue that drops and counts what it has no place for.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::Write;

use super::Exchange;
use crate::parameters::Parameters;
use crate::wire::serial::{LONGEST, Packet, encode};

/// Sends ticks and messages, for ever. While a packet is under way the newest tick waits; an older one is lost, which
/// takes a packet of more than a millisecond.
pub async fn telemetry<W: Write, M: RawMutex>(mut line: W, exchange: &Exchange<M>) -> ! {
    let mut buffer = [0; LONGEST];
    loop {
        let next = select(exchange.ticks.wait(), exchange.lines.receive()).await;
        let packet = match next {
            Either::First(tick) if exchange.parameter(Parameters::telemetry) => Packet::Tick(tick),
            Either::First(_) => continue,
            Either::Second(packet) => packet,
        };
        let sent = match encode(&packet, &mut buffer) {
            Some(bytes) => line.write_all(bytes).await.is_ok(),
            None => false,
        };
        if !sent {
            let unsent = &exchange.counts.packets_unsent;
            unsent.fetch_add(1, Ordering::Relaxed);
        }
    }
}
