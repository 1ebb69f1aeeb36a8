//! What happened, for those below: the upper loops write it down and go on, the report loop tells it.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::channel::Channel;

use crate::wire::messages::FaultEvent;

/// Events that wait at most; further ones are dropped and counted.
const WAITING: usize = 32;

/// Something that happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Which of the part's addresses answered on a bus at boot, one bit each.
    Found {
        /// Which bus.
        bus: u8,
        /// One bit for each address, in the order of the part's.
        answers: u8,
    },
    /// A bus was cleared by nine clocks and a stop.
    Cleared {
        /// Which bus.
        bus: u8,
        /// Both lines are high since.
        free: bool,
    },
    /// A fault came or went.
    Fault(FaultEvent),
}

/// The ring.
pub struct Events<M: RawMutex> {
    ring: Channel<M, Event, WAITING>,
    dropped: AtomicU32,
}

impl<M: RawMutex> Events<M> {
    /// Nothing has happened.
    pub const fn new() -> Self {
        Self {
            ring: Channel::new(),
            dropped: AtomicU32::new(0),
        }
    }

    /// Writes an event down. Never waits.
    pub fn post(&self, event: Event) {
        if self.ring.try_send(event).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The next event, oldest first.
    pub async fn next(&self) -> Event {
        self.ring.receive().await
    }

    /// How many were dropped since boot.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl<M: RawMutex> Default for Events<M> {
    fn default() -> Self {
        Self::new()
    }
}
