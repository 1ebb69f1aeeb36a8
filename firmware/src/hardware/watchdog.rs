//! The independent watchdog, fed while every loop moves on.

use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, peripherals};
use embassy_time::Instant;

use super::crash;
use crate::crash::{Crash, Kind};
use crate::progress::{Guard, Progress, WATCHDOG_MS};

/// The watchdog; nothing stops it once it runs.
pub struct Watchdog {
    watchdog: IndependentWatchdog<'static, peripherals::IWDG>,
    guard: Guard,
    is_noted: bool,
}

impl Watchdog {
    /// Starts it: from here on the loops have their patience to begin.
    pub fn start(peripheral: Peri<'static, peripherals::IWDG>) -> Self {
        let mut watchdog = IndependentWatchdog::new(peripheral, 1000 * WATCHDOG_MS);
        watchdog.unleash();
        Self {
            watchdog,
            guard: Guard::new(now_ms()),
            is_noted: false,
        }
    }

    /// Feeds it if every loop has moved on, else writes down who has not. Call it every
    /// [`crate::progress::FED_EVERY_MS`].
    pub fn feed(&mut self, progress: &Progress) {
        match self.guard.may_feed(now_ms(), progress) {
            Ok(()) => self.watchdog.pet(),
            Err(hangs) if !self.is_noted => {
                self.is_noted = true;
                crash::note(Crash {
                    place: hangs as u32,
                    ..Crash::new(Kind::Watchdog)
                });
            }
            Err(_) => {}
        }
    }
}

fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}
