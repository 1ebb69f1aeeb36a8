//! Random numbers for challenges, from the RNG. The driver of embassy-stm32 is not used: it restarts a failing noise source by
//! calling itself, without a limit.

use embassy_stm32::{Peri, pac, peripherals, rcc};

/// Polls for a number, each of at least ten cycles of the core: more than ten times the 412 cycles of 48 MHz that one takes, and
/// the twofold of the first (RM0440 26.6).
const POLLS: u32 = 4000;

/// The random number generator.
pub struct RandomNumbers {
    /// The first number after a start is discarded.
    has_started: bool,
}

impl RandomNumbers {
    /// Starts the noise source.
    pub fn new(_peripheral: Peri<'static, peripherals::RNG>) -> Self {
        rcc::enable_and_reset::<peripherals::RNG>();
        pac::RNG.cr().modify(|w| w.set_rngen(true));
        Self { has_started: true }
    }

    /// A random number; none while the noise source or its clock fails, which restarts it.
    pub fn next_u64(&mut self) -> Option<u64> {
        if self.has_started {
            let _ = self.next_u32()?;
            self.has_started = false;
        }
        Some(u64::from(self.next_u32()?) << u32::BITS | u64::from(self.next_u32()?))
    }

    fn next_u32(&mut self) -> Option<u32> {
        for _ in 0..POLLS {
            let status = pac::RNG.sr().read();
            if status.seis() || status.ceis() {
                self.restart();
                return None;
            }
            if status.drdy() {
                return Some(pac::RNG.dr().read());
            }
        }
        None
    }

    /// Clears the errors and starts the noise source again.
    fn restart(&mut self) {
        pac::RNG.cr().modify(|w| w.set_rngen(false));
        pac::RNG.sr().modify(|w| {
            w.set_seis(false);
            w.set_ceis(false);
        });
        pac::RNG.cr().modify(|w| w.set_rngen(true));
        self.has_started = true;
    }
}
