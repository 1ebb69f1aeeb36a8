//! Power control, RM0440 section 6: voltage ranges and the limits of the clock in each.

use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::Frequency;
use crate::violations::Kind;

registers! { "PWR":
    CR1 = 0x00, CR2 = 0x04, CR3 = 0x08, CR4 = 0x0C, SR1 = 0x10, SR2 = 0x14, SCR = 0x18, CR5 = 0x80,
}

/// CR5.R1MODE: 0 is range 1 boost. By ST's header and RM0440 6.4.21 it is bit 8; `stm32-metapac` 21.0.0 has it at bit 0.
const R1MODE: u32 = 8;
/// Limits of the system clock in MHz (6.1.5): range 1 boost, range 1 normal, range 2.
const LIMITS_HZ: [u32; 3] = [170_000_000, 150_000_000, 26_000_000];

/// The peripheral.
pub struct Pwr {
    cr: [u32; 4],
    cr5: u32,
}

impl Pwr {
    pub(crate) fn new() -> Self {
        Self { cr: [0x0200, 0, 0x8000, 0], cr5: 1 << R1MODE }
    }

    /// The highest system clock in the range that is selected.
    pub(crate) fn limit(&self) -> Frequency {
        let is_range_1 = self.cr[0] >> 9 & 3 == 1;
        let [boost, normal, range_2] = LIMITS_HZ;
        Frequency(match (is_range_1, bit(self.cr5, R1MODE)) {
            (true, false) => boost,
            (true, true) => normal,
            (false, _) => range_2,
        })
    }

    pub(crate) fn read(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            CR1 | CR2 | CR3 | CR4 => self.cr[offset as usize / 4],
            CR5 => self.cr5,
            // No wake-up flags; the regulator is ready and the voltage has settled.
            SR1 | SR2 => 0,
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            CR1 => {
                if value & 7 != 0 {
                    context.report(Kind::UnmodelledSetting, offset, "a low-power mode");
                }
                self.cr[0] = value;
            }
            CR2 | CR3 | CR4 => self.cr[offset as usize / 4] = value,
            CR5 => {
                if value & !(1 << R1MODE) != 0 {
                    context.report(Kind::Misconfigured, offset, "a reserved bit is set");
                }
                self.cr5 = value & 1 << R1MODE;
            }
            SCR | SR1 | SR2 => {}
            _ => {
                context.unmodelled(offset);
            }
        }
    }
}
