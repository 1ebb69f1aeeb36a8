//! The independent watchdog, RM0440 section 42.

use crate::peripherals::Context;
use crate::registers::registers;
use crate::time::Time;

registers! { "IWDG": KR = 0x00, PR = 0x04, RLR = 0x08, SR = 0x0C, WINR = 0x10 }

/// Values of the key register (42.4.1).
const OPEN: u32 = 0x5555;
const FEED: u32 = 0xAAAA;
const START: u32 = 0xCCCC;
/// A new prescaler or reload value takes five cycles of its clock to arrive (42.4.4).
const ARRIVES: u64 = 5;

/// When the watchdog was fed since the last reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Feeds {
    /// How often.
    pub count: u64,
    /// From its start to the first.
    pub first_after: Option<Time>,
    /// The longest time without, from the first on.
    pub longest_gap: Time,
    last: Time,
}

/// The peripheral.
#[derive(Clone)]
pub struct Watchdog {
    prescaler: u32,
    reload: u32,
    is_open: bool,
    started: Option<Time>,
    resets_at: Time,
    /// Until when PVU and RVU are set.
    arrives: [Time; 2],
    feeds: Feeds,
}

impl Feeds {
    fn record(&mut self, started: Time, now: Time) {
        match self.first_after {
            None => self.first_after = Some(now.since(started)),
            Some(_) => self.longest_gap = self.longest_gap.max(now.since(self.last)),
        }
        self.count += 1;
        self.last = now;
    }
}

impl Watchdog {
    pub(crate) fn new() -> Self {
        Self {
            prescaler: 0,
            reload: 0xFFF,
            is_open: false,
            started: None,
            resets_at: Time::NEVER,
            arrives: [Time::ZERO; 2],
            feeds: Feeds::default(),
        }
    }

    /// When it was started.
    pub fn started(&self) -> Option<Time> {
        self.started
    }

    /// When it was fed.
    pub fn feeds(&self) -> &Feeds {
        &self.feeds
    }

    /// Reset, at this time if nobody feeds it.
    pub(crate) fn next_event(&self) -> Time {
        self.resets_at
    }

    fn timeout(&self, context: &Context) -> Time {
        let cycles = (u64::from(self.reload) + 1) * (4 << self.prescaler.min(6));
        context.clocks.lsi.cycles(cycles)
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            KR => 0,
            PR => self.prescaler,
            RLR => self.reload,
            SR => {
                let [prescaler, reload] = self.arrives.map(|time| u32::from(time > context.now));
                prescaler | reload << 1
            }
            WINR => 0xFFF,
            _ => context.unmodelled(offset),
        }
    }

    /// True where it starts, with its oscillator.
    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) -> bool {
        let now = context.now;
        let arrives = now + context.clocks.lsi.cycles(ARRIVES);
        match offset {
            KR => match value & 0xFFFF {
                OPEN => self.is_open = true,
                FEED => {
                    self.is_open = false;
                    if let Some(started) = self.started {
                        self.feeds.record(started, now);
                        self.resets_at = now + self.timeout(context);
                    }
                }
                START => {
                    let is_first = self.started.is_none();
                    self.started = self.started.or(Some(now));
                    self.resets_at = now + self.timeout(context);
                    return is_first;
                }
                _ => self.is_open = false,
            },
            PR | RLR | WINR if !self.is_open => {
                context.write_protected(offset, "the watchdog's registers are locked")
            }
            PR => (self.prescaler, self.arrives[0]) = (value & 7, arrives),
            RLR => (self.reload, self.arrives[1]) = (value & 0xFFF, arrives),
            WINR if value & 0xFFF != 0xFFF => context.unmodelled_setting(offset, "a window"),
            _ => context.unmodelled_write(offset),
        }
        false
    }
}
