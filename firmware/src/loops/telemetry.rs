//! Every tick, raw and estimated, and every message, over the serial line.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::Write;

use super::Exchange;
use crate::parameters::Parameters;
use crate::wire::serial::{LONGEST, Packet, encode};

/// Sends what there is, for ever. While a packet is under way the newest tick waits; an older one is lost.
pub async fn telemetry<W: Write, M: RawMutex>(mut line: W, exchange: &Exchange<M>) -> ! {
    let mut buffer = [0; LONGEST];
    loop {
        let next = select(exchange.lines.receive(), exchange.ticks.wait()).await;
        let packet = match next {
            Either::First(packet) => packet,
            Either::Second(tick) if exchange.parameter(Parameters::telemetry) => Packet::Tick(tick),
            Either::Second(_) => continue,
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
