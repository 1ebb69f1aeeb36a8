//! System configuration controller, RM0440 section 10, and the debug unit's control register (section 47).

use crate::peripherals::{Context, Words, bit};
use crate::registers::registers;

registers! { "SYSCFG":
    MEMRMP = 0x00, CFGR1 = 0x04, EXTICR0 = 0x08, EXTICR3 = 0x14, SCSR = 0x18, CFGR2 = 0x1C, SWPR = 0x20, SKR = 0x24,
}

/// Internal sources of the timers' break (10.2.8), as bits of CFGR2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BreakSource {
    /// The core has locked up.
    LockUp = 0,
    /// A parity error in SRAM: none occurs here, as chips are shipped with its check off (option SRAM_PE = 1).
    Parity = 1,
    /// The supply is below the detector's threshold.
    Supply = 2,
    /// Two wrong bits in flash.
    FlashEcc = 3,
}

/// The peripheral.
#[derive(Clone, Default)]
pub struct Syscfg {
    words: Words<10>,
}

impl Syscfg {
    /// Whether an internal source switches the timers' outputs off. Once set, it stays until a reset.
    pub(crate) fn breaks_on(&self, source: BreakSource) -> bool {
        bit(self.words[CFGR2], source as u32)
    }

    /// Pads of an I2C peripheral (1 to 3) drive 20 mA, as 1 MHz needs.
    pub(crate) fn fast_mode_plus(&self, number: u32) -> bool {
        bit(self.words[CFGR1], 19 + number)
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            MEMRMP..=SKR if offset.is_multiple_of(4) => self.words[offset],
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        let word = match offset {
            MEMRMP..=SKR if offset.is_multiple_of(4) => &mut self.words[offset],
            _ => {
                context.unmodelled_write(offset);
                return;
            }
        };
        match offset {
            // Lock bits are set once.
            CFGR2 => *word |= value & 0xF,
            MEMRMP if value & 0x107 != 0 => {
                context.unmodelled_setting(offset, "another memory or bank at address 0")
            }
            CFGR1 => *word = value,
            EXTICR0..=EXTICR3 | SCSR | SWPR | SKR => {
                context.unmodelled_setting(offset, "external interrupts; erasing or protecting CCM")
            }
            _ => {}
        }
    }
}

/// The debug unit's registers (47.16): control, and what stops while a debugger halts the core.
#[derive(Clone, Default)]
pub struct Dbgmcu {
    words: Words<5>,
}

impl Dbgmcu {
    /// STM32G474, revision 2.
    const IDCODE: u32 = 0x2003_6469;
    const APB2FZR: u32 = 0x10;

    /// DBG_TIM1_STOP.
    pub(crate) fn stops_motor_timer(&self) -> bool {
        bit(self.words[Self::APB2FZR], 11)
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            0 => Self::IDCODE,
            4..=Self::APB2FZR => self.words[offset],
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            4..=Self::APB2FZR => self.words[offset] = value,
            _ => context.unmodelled_write(offset),
        }
    }
}
