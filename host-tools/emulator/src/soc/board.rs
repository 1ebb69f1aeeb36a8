//! Faults, supply and conditions that reach the chip from outside.

use super::Soc;
use super::map::Block;
use crate::peripherals::clocks::ResetCause;
use crate::peripherals::flash::PowerCut;
use crate::peripherals::syscfg::BreakSource;
use crate::time::Time;

/// Frames on the CAN bus that a program has not seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnseenFrames {
    /// No filter lets them in.
    pub refused: u64,
    /// Their FIFO was full.
    pub lost: u64,
}

impl Soc {
    /// The gate drivers report a fault, or no more: their output is low where they do.
    pub fn set_gate_fault(&mut self, is_active: bool) {
        self.gate_fault = is_active;
        self.connect_gate_drivers();
        self.update_connections();
        self.plan();
    }

    /// The wire between gate drivers and break input opens, or is connected again: the level of an open one is that of the
    /// chip's own pull resistor, low without any.
    pub fn set_break_wire_open(&mut self, is_open: bool) {
        self.is_break_wire_open = is_open;
        self.connect_gate_drivers();
        self.update_connections();
        self.plan();
    }

    /// Disconnects (or reconnects) the PWM trigger of the ADC; PWM keeps running.
    pub fn set_motor_trigger(&mut self, reaches_converter: bool) {
        self.has_motor_trigger = reaches_converter;
    }

    /// Duties of the motor's half bridges in use, as shares of the period; none where all switches are off.
    pub fn motor_duties(&self) -> Option<[f64; 3]> {
        self.tim1.duties()
    }

    /// Changes the supply (VDD), 3300 millivolts at first: below the threshold of its detector, and below the brown-out level
    /// of the option bytes, where the chip is held in reset (6.2).
    pub fn set_supply(&mut self, millivolts: u32) {
        self.pwr.set_supply(millivolts);
        self.update_supply_break();
        if self.is_browned_out() {
            self.request_reset(ResetCause::PowerOn);
        }
        self.plan();
    }

    /// The supply is too low for the chip.
    pub(crate) fn is_browned_out(&self) -> bool {
        self.pwr.supply_mv() < self.flash.brown_out_mv()
    }

    /// The option bytes (OPTR).
    pub fn option_bytes(&self) -> u32 {
        self.flash.options()
    }

    /// Programs the option bytes (OPTR) as a debugger does; the chip loads them at its next start.
    pub fn set_option_bytes(&mut self, options: u32) {
        self.flash.set_options(options);
    }

    /// The crystal stops.
    pub fn fail_crystal(&mut self) {
        if self.rcc.fail_crystal() {
            self.system.pend_nmi();
            self.tim1.system_break(None, self.now);
        }
        self.update_clocks();
        self.plan();
    }

    /// It oscillates again.
    pub fn restore_crystal(&mut self) {
        self.rcc.restore_crystal(self.options.wiring.crystal);
        self.update_clocks();
        self.plan();
    }

    /// The core has locked up: a break of the outputs where the program has enabled it.
    pub(crate) fn lock_up(&mut self) {
        if self.syscfg.breaks_on(BreakSource::LockUp) {
            self.tim1.system_break(Some(BreakSource::LockUp), self.now);
        }
    }

    /// A debugger halts the core, or lets it run again.
    pub(crate) fn set_halted(&mut self, is_halted: bool) {
        self.tim1.set_stopped(is_halted && self.dbgmcu.stops_motor_timer(), self.now);
    }

    /// Takes the supply away in the middle of an operation of the flash memory: [`crate::chip::Halt::PowerLost`].
    pub fn cut_power(&mut self, cut: PowerCut) {
        self.flash.cut_power(cut);
    }

    /// Sets error flags of the flash controller (FLASH_SR).
    pub fn set_flash_errors(&mut self, errors: u32) {
        self.flash.set_errors(errors);
        self.refresh(Block::Flash);
    }

    /// Number of the I2C peripheral at a sensor bus.
    fn i2c_at(&self, bus: usize) -> Option<usize> {
        self.buses.iter().position(|connected| *connected == Some(bus))
    }

    /// Lets stops on a sensor bus come late, until a reset of its peripheral.
    pub fn delay_stops(&mut self, bus: usize, delay: Time) {
        let number = self.i2c_at(bus);
        if let Some(number) = number {
            self.i2c[number].delay_stops(delay);
        }
    }

    /// Flips two bits of the double word at an offset in flash: an uncorrectable ECC error.
    pub fn corrupt_flash(&mut self, offset: usize) {
        self.flash.corrupt(offset);
    }

    /// Frames on the CAN bus that the program has not seen since the last reset.
    pub fn unseen_frames(&self) -> UnseenFrames {
        UnseenFrames { refused: self.fdcan.refused, lost: self.fdcan.lost }
    }

    /// Leaves a byte in the data register of the I2C peripheral at a sensor bus, as an aborted transfer does; false where
    /// none is at it.
    pub fn leave_received_byte(&mut self, bus: usize, byte: u8) -> bool {
        let number = self.i2c_at(bus);
        if let Some(number) = number {
            self.i2c[number].leave_byte(byte);
            self.refresh(Block::I2c(number));
        }
        number.is_some()
    }

    /// Detects a bus error during a transfer on a sensor bus, though there is none; false where no peripheral is at it.
    pub fn raise_bus_error(&mut self, bus: usize) -> bool {
        let number = self.i2c_at(bus);
        if let Some(number) = number {
            self.i2c[number].raise_bus_error();
            self.refresh(Block::I2c(number));
        }
        number.is_some()
    }
}
