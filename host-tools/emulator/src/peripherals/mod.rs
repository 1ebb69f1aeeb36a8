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

use std::ops::{Index, IndexMut};

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

    /// Reports a value without a model.
    pub fn unmodelled_setting(&mut self, offset: u32, detail: &'static str) {
        self.report(Kind::UnmodelledSetting, offset, detail);
    }

    /// Reports a configuration in which the peripheral does not work.
    pub fn misconfigured(&mut self, offset: u32, detail: &'static str) {
        self.report(Kind::Misconfigured, offset, detail);
    }

    /// Reports a write that the peripheral's state does not allow.
    pub fn write_protected(&mut self, offset: u32, detail: &'static str) {
        self.report(Kind::WriteProtected, offset, detail);
    }

    /// Reports a write to a register without a model.
    pub fn unmodelled_write(&mut self, offset: u32) {
        self.report(Kind::UnmodelledRegister, offset, "not emulated");
    }

    /// Reports a read of a register without a model, which gives zero.
    pub fn unmodelled(&mut self, offset: u32) -> u32 {
        self.unmodelled_write(offset);
        0
    }
}

/// Registers of a block by their byte offsets.
#[derive(Clone)]
pub(crate) struct Words<const N: usize>([u32; N]);

impl<const N: usize> Words<N> {
    /// All zero but for these values.
    pub(crate) fn new(values: &[(u32, u32)]) -> Self {
        let mut words = Self::default();
        for (offset, value) in values {
            words[*offset] = *value;
        }
        words
    }
}

impl<const N: usize> Default for Words<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

impl<const N: usize> Index<u32> for Words<N> {
    type Output = u32;

    fn index(&self, offset: u32) -> &u32 {
        &self.0[offset as usize / 4]
    }
}

impl<const N: usize> IndexMut<u32> for Words<N> {
    fn index_mut(&mut self, offset: u32) -> &mut u32 {
        &mut self.0[offset as usize / 4]
    }
}

/// One bit of a word.
pub(crate) const fn bit(word: u32, place: u32) -> bool {
    word >> place & 1 != 0
}
