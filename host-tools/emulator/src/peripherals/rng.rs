//! The random number generator, RM0440 section 26: a repeatable sequence in the place of noise.

use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};

registers! { "RNG": CR = 0x00, SR = 0x04, DR = 0x08 }
/// Not in the metadata: the health test's thresholds (26.7.4).
const HTCR: u32 = 0x10;

/// A number takes 412 cycles of its clock (26.6); the first takes as long as the conditioning.
const NUMBER_CYCLES: u64 = 412;
const FIRST_CYCLES: u64 = 2 * NUMBER_CYCLES;

/// The peripheral.
#[derive(Clone)]
pub struct Rng {
    control: u32,
    thresholds: u32,
    state: u64,
    ready: Time,
}

impl Rng {
    pub(crate) fn new(seed: u64) -> Self {
        Self { control: 0x0080_0D00, thresholds: 0x0000_72AC, state: seed, ready: Time::NEVER }
    }

    /// Registers take their reset values; the sequence goes on.
    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.state);
    }

    fn is_ready(&self, now: Time) -> bool {
        bit(self.control, 2) && !bit(self.control, 30) && self.ready <= now
    }

    pub(crate) fn next_event(&self) -> Time {
        if bit(self.control, 3) { self.ready } else { Time::NEVER }
    }

    /// Level of its interrupt.
    pub(crate) fn interrupt(&self, now: Time) -> bool {
        bit(self.control, 3) && self.is_ready(now)
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CR => self.control,
            SR => u32::from(self.is_ready(context.now)),
            DR if !self.is_ready(context.now) => {
                context.misconfigured(offset, "no number is ready");
                0
            }
            DR => {
                self.ready = context.now + context.clocks.rng.cycles(NUMBER_CYCLES);
                // A linear congruential generator (Knuth's MMIX) and its upper half.
                self.state = self
                    .state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (self.state >> 32) as u32
            }
            HTCR => self.thresholds,
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            CR => {
                if bit(value, 2) && context.clocks.rng == Frequency(0) {
                    context.misconfigured(offset, "no clock of 48 MHz");
                }
                let was_off = !bit(self.control, 2) || bit(self.control, 30);
                if bit(value, 2) && was_off {
                    self.ready = context.now + context.clocks.rng.cycles(FIRST_CYCLES);
                }
                self.control = value;
            }
            HTCR => self.thresholds = value,
            SR => {}
            _ => context.unmodelled_write(offset),
        }
    }
}
