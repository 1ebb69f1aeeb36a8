//! External interrupts, RM0440 section 15: lines 0 to 15, of the pins that SYSCFG selects.

use crate::peripherals::{Context, Words, bit};
use crate::registers::{interrupt, registers};

registers! { "EXTI":
    IMR0 = 0x00, EMR0 = 0x04, RTSR0 = 0x08, FTSR0 = 0x0C, SWIER0 = 0x10, PR0 = 0x14,
    IMR1 = 0x20, EMR1 = 0x24, RTSR1 = 0x28, FTSR1 = 0x2C, SWIER1 = 0x30, PR1 = 0x34,
}

/// Lines of pins.
const PINS: u32 = 0xFFFF;

/// The peripheral.
#[derive(Clone)]
pub struct Exti {
    words: Words<14>,
}

impl Exti {
    pub(crate) fn new() -> Self {
        Self { words: Words::new(&[(IMR0, 0x1F84_0000), (IMR1, 0x0000_0034)]) }
    }

    /// A pin that drives a line changes its level.
    pub(crate) fn edge(&mut self, line: usize, is_high: bool) {
        let edges = if is_high { RTSR0 } else { FTSR0 };
        if bit(self.words[edges], line as u32) {
            self.words[PR0] |= 1 << line;
        }
    }

    /// The levels of the interrupts: number and level of each.
    pub(crate) fn interrupts(&self) -> impl Iterator<Item = (usize, bool)> {
        const LINES: [(&str, u32); 7] = [
            ("EXTI0", 0x0001),
            ("EXTI1", 0x0002),
            ("EXTI2", 0x0004),
            ("EXTI3", 0x0008),
            ("EXTI4", 0x0010),
            ("EXTI9_5", 0x03E0),
            ("EXTI15_10", 0xFC00),
        ];
        let pending = self.words[PR0] & self.words[IMR0];
        LINES.into_iter().map(move |(name, lines)| (interrupt(name), pending & lines != 0))
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            IMR0..=PR0 | IMR1..=PR1 => self.words[offset],
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            PR0 | PR1 => self.words[offset] &= !value,
            SWIER0 => self.words[PR0] |= value & PINS,
            EMR0 | EMR1 | IMR1 | RTSR1 | FTSR1 | SWIER1 => {
                if offset != IMR1 && value != 0 {
                    context.unmodelled_setting(offset, "an event or a line that is no pin's");
                }
                self.words[offset] = value;
            }
            IMR0 | RTSR0 | FTSR0 => self.words[offset] = value,
            _ => context.unmodelled_write(offset),
        }
    }
}
