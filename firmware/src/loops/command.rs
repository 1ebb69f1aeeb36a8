//! Answers hosts: arming, commands, services.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_can::Frame;

use super::{Exchange, Finder};
use crate::clock::Clock;
use crate::session::{Heard as Meant, Session};
use crate::status::{Fault, Faults};
use crate::wire::messages::Message;

/// How often a host's silence is looked for.
const LOOK_US: u64 = 1000;

/// Hears hosts and answers them, for ever. `random` gives a new number with every call; without sound
/// tables (`may_arm`) nobody arms.
pub async fn command<C: Clock, M: RawMutex>(
    mut session: Session,
    mut random: impl FnMut() -> u16,
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut faults = Faults::default();
    let mut look_us = clock.now_us();
    loop {
        let heard = select(exchange.heard.receive(), clock.until(look_us)).await;
        let now_us = clock.now_us();
        let now_ms = (now_us / 1000) as u32;
        match heard {
            Either::First(heard) => {
                let frame = heard.frame;
                let meant = session.hear(now_ms, frame.identifier(), frame.data(), random());
                if let Meant::Reply { reply, .. } = meant {
                    // A host that asks faster than the bus can answer asks again.
                    let _ = exchange.replies.try_send(Message::ServiceReply(reply));
                }
            }
            Either::Second(()) => look_us = now_us.saturating_add(LOOK_US),
        }
        let alive = u32::from(session.is_alive(now_ms));
        exchange
            .counts
            .command_alive
            .store(alive, Ordering::Relaxed);
        let dropped = session.dropped().all();
        exchange.counts.dropped.store(dropped, Ordering::Relaxed);
        for (fault, active, detail) in [
            (Fault::HostSilent, session.is_silent(now_ms), 0),
            (Fault::StrangeFrames, session.is_flooded(now_ms), dropped),
        ] {
            exchange.note(Finder::Command, &mut faults, (fault, 0), active, detail);
        }
    }
}
