//! Power control, RM0440 section 6: voltage ranges and the limits of the clock in each, and the detector of a low supply.
//! The detector's hysteresis, its interrupt line and the monitors of the analog supply are not modelled.

use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::Frequency;

registers! { "PWR":
    CR1 = 0x00, CR2 = 0x04, CR3 = 0x08, CR4 = 0x0C, SR1 = 0x10, SR2 = 0x14, SCR = 0x18, CR5 = 0x80,
}

/// CR5.R1MODE: 0 is range 1 boost. By ST's header and RM0440 6.4.21 it is bit 8; `stm32-metapac` 21.0.0 has it at bit 0.
const R1MODE: u32 = 8;
/// Limits of the system clock in MHz (6.1.5): range 1 boost, range 1 normal, range 2.
const LIMITS_HZ: [u32; 3] = [170_000_000, 150_000_000, 26_000_000];

/// CR2.PVDE, and SR2.PVDO (6.4.2, 6.4.6).
const DETECTOR: u32 = 0;
const SUPPLY_IS_LOW: u32 = 1 << 11;
/// Thresholds of the detector in millivolts, by CR2.PLS (6.4.2); setting 7 compares an external voltage.
const THRESHOLDS_MV: [u32; 7] = [2000, 2200, 2400, 2500, 2600, 2800, 2900];
/// Supply of the reference board in millivolts.
const SUPPLY_MV: u32 = 3300;

/// The peripheral.
#[derive(Clone)]
pub struct Pwr {
    cr: [u32; 4],
    cr5: u32,
    /// VDD.
    supply_mv: u32,
}

impl Pwr {
    pub(crate) fn new() -> Self {
        Self { cr: [0x0200, 0, 0x8000, 0], cr5: 1 << R1MODE, supply_mv: SUPPLY_MV }
    }

    /// Registers take their reset values; the supply stays as it is.
    pub(crate) fn reset(&mut self) {
        *self = Self { supply_mv: self.supply_mv, ..Self::new() };
    }

    /// Changes the supply (VDD).
    pub(crate) fn set_supply(&mut self, millivolts: u32) {
        self.supply_mv = millivolts;
    }

    /// VDD in millivolts.
    pub(crate) fn supply_mv(&self) -> u32 {
        self.supply_mv
    }

    /// Output of the detector: it is on, and the supply is below its threshold.
    pub(crate) fn is_supply_low(&self) -> bool {
        let [_, cr2, ..] = self.cr;
        let threshold_mv = THRESHOLDS_MV.get((cr2 >> 1 & 7) as usize);
        bit(cr2, DETECTOR)
            && threshold_mv.is_some_and(|threshold_mv| self.supply_mv < *threshold_mv)
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
            SR1 => 0,
            SR2 => u32::from(self.is_supply_low()) * SUPPLY_IS_LOW,
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            CR1 => {
                if value & 7 != 0 {
                    context.unmodelled_setting(offset, "a low-power mode");
                }
                self.cr[0] = value;
            }
            CR2 | CR3 | CR4 => self.cr[offset as usize / 4] = value,
            CR5 => {
                if value & !(1 << R1MODE) != 0 {
                    context.misconfigured(offset, "a reserved bit is set");
                }
                self.cr5 = value & 1 << R1MODE;
            }
            SCR | SR1 | SR2 => {}
            _ => context.unmodelled_write(offset),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn supply_below_the_threshold_is_low_while_the_detector_is_on() {
        let mut pwr = Pwr::new();
        pwr.set_supply(2799);
        assert!(!pwr.is_supply_low());
        // PVDE, PLS 5.
        pwr.cr[1] = 1 | 5 << 1;
        assert!(pwr.is_supply_low());
        pwr.set_supply(2800);
        assert!(!pwr.is_supply_low());
        pwr.set_supply(2000);
        pwr.reset();
        assert!(!pwr.is_supply_low());
        assert_eq!(pwr.supply_mv(), 2000);
    }
}
