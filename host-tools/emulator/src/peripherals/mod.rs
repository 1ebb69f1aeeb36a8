//! The chip's peripherals, each a state machine of its registers: `read` and `write` by byte offset, `next_event` and
//! `advance` for what happens by itself, and the levels of its interrupt and DMA request lines.
//! [`crate::soc`] connects them.
//!
//! What a peripheral does is taken from ST's reference manual RM0440 (revision 8); sections are named there. The models
//! cover what drivers of this firmware's kind use; everything else is reported as a
//! [`Violation`](crate::violations::Violation), never ignored.

pub mod adc;
pub mod clocks;
pub mod dma;
pub mod exti;
pub mod fdcan;
pub mod flash;
pub mod gpio;
pub mod i2c;
pub mod motor_timer;
pub mod power;
pub mod rng;
pub mod spi;
pub mod syscfg;
pub mod timer;
pub mod usart;
pub mod watchdog;

use crate::time::Time;
use crate::violations::{Kind, Violations};
use clocks::Clocks;

/// What every access and event needs.
pub struct Context<'a> {
    /// The time of it.
    pub now: Time,
    /// Frequencies of all clocks.
    pub clocks: &'a Clocks,
    /// Where misuse is reported.
    pub violations: &'a mut Violations,
    /// Base address of the peripheral.
    pub base: u32,
}

impl Context<'_> {
    /// Reports misuse of the register at this offset.
    pub fn report(&mut self, kind: Kind, offset: u32, detail: &'static str) {
        self.violations.report(kind, self.base.wrapping_add(offset), detail);
    }

    /// Reports that the register at this offset has no model; reads as zero.
    pub fn unmodelled(&mut self, offset: u32) -> u32 {
        self.report(Kind::UnmodelledRegister, offset, "not emulated");
        0
    }
}

/// One bit of a word.
pub(crate) const fn bit(word: u32, place: u32) -> bool {
    word >> place & 1 != 0
}
