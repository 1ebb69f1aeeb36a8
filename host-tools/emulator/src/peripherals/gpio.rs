//! General-purpose pins, RM0440 section 9: modes, outputs, inputs, alternate functions.

use crate::peripherals::{Context, Words};
use crate::registers::registers;

registers! { "GPIOA":
    MODER = 0x00, OTYPER = 0x04, OSPEEDR = 0x08, PUPDR = 0x0C, IDR = 0x10, ODR = 0x14, BSRR = 0x18, LCKR = 0x1C,
    AFR0 = 0x20, AFR1 = 0x24,
}
/// Not in the metadata: 9.4.11.
const BRR: u32 = 0x28;

/// A pin of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pin {
    /// A is 0.
    pub port: usize,
    /// 0 to 15.
    pub number: usize,
}

impl Pin {
    /// A pin by its name in the datasheet, as `PA15`.
    ///
    /// # Panics
    /// There is no such pin.
    pub const fn named(name: &str) -> Self {
        let bytes = name.as_bytes();
        assert!(bytes.len() >= 3 && bytes[0] == b'P' && bytes[1] >= b'A' && bytes[1] <= b'G');
        let mut number = 0;
        let mut place = 2;
        while place < bytes.len() {
            number = 10 * number + (bytes[place] - b'0') as usize;
            place += 1;
        }
        assert!(number < 16);
        Self { port: (bytes[1] - b'A') as usize, number }
    }

    /// Its name in the datasheet.
    pub fn name(self) -> String {
        format!("P{}{}", char::from(b'A' + self.port as u8), self.number)
    }
}

/// What a pin is connected to inside the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Digital input.
    Input,
    /// Output that the program sets.
    Output,
    /// A peripheral's, by the number of its alternate function.
    Alternate(u8),
    /// Analog.
    Analog,
}

/// A port of 16 pins.
#[derive(Clone)]
pub struct Gpio {
    words: Words<10>,
    /// What is outside of each pin: driven low or high, or nothing.
    external: [Option<bool>; 16],
}

impl Gpio {
    /// Reset values (9.4): analog, but for the debug port on A and B.
    pub(crate) fn new(port: usize) -> Self {
        let (moder, ospeedr, pupdr) = match port {
            0 => (0xABFF_FFFF, 0x0C00_0000, 0x6400_0000),
            1 => (0xFFFF_FEBF, 0x0000_0000, 0x0000_0100),
            _ => (0xFFFF_FFFF, 0, 0),
        };
        let words = Words::new(&[(MODER, moder), (OSPEEDR, ospeedr), (PUPDR, pupdr)]);
        Self { words, external: [None; 16] }
    }

    /// Sets registers to their reset values; what is outside stays.
    pub(crate) fn reset(&mut self, port: usize) {
        *self = Self { external: self.external, ..Self::new(port) };
    }

    /// What a pin is connected to.
    pub fn mode(&self, pin: usize) -> Mode {
        match self.words[MODER] >> (2 * pin) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => Mode::Alternate(
                (self.words[AFR0 + 4 * (pin as u32 / 8)] >> (4 * (pin % 8)) & 0xF) as u8,
            ),
            _ => Mode::Analog,
        }
    }

    /// Whether a pin's output only pulls low.
    pub fn is_open_drain(&self, pin: usize) -> bool {
        self.words[OTYPER] >> pin & 1 != 0
    }

    /// The level that the program drives; none where it does not drive the pin.
    pub fn driven(&self, pin: usize) -> Option<bool> {
        let is_high = self.words[ODR] >> pin & 1 != 0;
        (self.mode(pin) == Mode::Output && !(is_high && self.is_open_drain(pin))).then_some(is_high)
    }

    /// Connects a pin to a level, or to nothing.
    pub(crate) fn drive_externally(&mut self, pin: usize, level: Option<bool>) {
        if let Some(place) = self.external.get_mut(pin) {
            *place = level;
        }
    }

    /// The level at a pin: low wins over high on a line with a pull-up; without either, the pull resistor decides.
    pub fn level(&self, pin: usize) -> bool {
        let external = self.external.get(pin).copied().flatten();
        match (self.driven(pin), external) {
            (Some(level), None) | (None, Some(level)) => level,
            (Some(inside), Some(outside)) => inside && outside,
            (None, None) => self.words[PUPDR] >> (2 * pin) & 3 == 1,
        }
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            // An analog pin reads 0 (9.3.12).
            IDR => (0..16)
                .map(|pin| u32::from(self.mode(pin) != Mode::Analog && self.level(pin)) << pin)
                .sum(),
            MODER | OTYPER | OSPEEDR | PUPDR | ODR | LCKR | AFR0 | AFR1 => self.words[offset],
            BSRR | BRR => 0,
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            // Where a bit is set and reset at once, setting wins (9.4.7).
            BSRR => self.words[ODR] = self.words[ODR] & !(value >> 16) | value & 0xFFFF,
            BRR => self.words[ODR] &= !(value & 0xFFFF),
            MODER | OTYPER | OSPEEDR | PUPDR | ODR | AFR0 | AFR1 => self.words[offset] = value,
            IDR => {}
            LCKR => context.unmodelled_setting(offset, "a pin's configuration is locked"),
            _ => context.unmodelled_write(offset),
        }
    }
}
