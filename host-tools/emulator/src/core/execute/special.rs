//! Special registers: MRS, MSR and CPS (DDI0403E B5.2).

use crate::core::bus::Bus;
use crate::core::state::{APSR, GE, State};
use crate::core::system_control::PRIORITY_MASK;

/// Numbers of the special registers (B5.1.1). 0 to 7 select parts of the xPSR by their bits.
const IPSR: u8 = 1 << 0;
const NO_APSR: u8 = 1 << 2;
const MSP: u8 = 8;
const PSP: u8 = 9;
const PRIMASK: u8 = 16;
const BASEPRI: u8 = 17;
const BASEPRI_MAX: u8 = 18;
const FAULTMASK: u8 = 19;
const CONTROL: u8 = 20;

impl State {
    /// CONTROL: privilege, stack selection, floating-point context.
    pub(in super::super) fn control(&self) -> u32 {
        self.unprivileged as u32
            | (self.process_stack as u32) << 1
            | (self.float_active as u32) << 2
    }

    /// The parts of the EPSR read as zero. Unprivileged code reads zero from everything but the APSR
    /// and CONTROL.
    pub(super) fn read_special(&self, special: u8) -> u32 {
        let privileged = self.privileged();
        match special {
            0..=7 => {
                let mut value = 0;
                if special & IPSR != 0 && privileged {
                    value |= self.exception as u32;
                }
                if special & NO_APSR == 0 {
                    value |= self.apsr;
                }
                value
            }
            CONTROL => self.control(),
            _ if !privileged => 0,
            MSP => self.main_sp(),
            PSP => self.process_sp(),
            PRIMASK => self.primask as u32,
            BASEPRI | BASEPRI_MAX => self.basepri as u32,
            FAULTMASK => self.faultmask as u32,
            _ => 0,
        }
    }

    /// `mask` bit 1 writes the flags, bit 0 the GE bits of the APSR. Unprivileged code writes the APSR
    /// only.
    pub(super) fn write_special<B: Bus>(&mut self, bus: &mut B, special: u8, mask: u8, value: u32) {
        if special & !0x3 == 0 {
            let fields =
                if mask & 2 != 0 { APSR & !GE } else { 0 } | if mask & 1 != 0 { GE } else { 0 };
            self.apsr = self.apsr & !fields | value & fields;
            return;
        }
        if !self.privileged() {
            return;
        }
        let priority = value as u8 & PRIORITY_MASK;
        match special {
            MSP => self.set_main_sp(value),
            PSP => self.set_process_sp(value),
            PRIMASK => self.primask = value & 1 != 0,
            BASEPRI => self.basepri = priority,
            // Raises the priority only.
            BASEPRI_MAX if priority != 0 && (priority < self.basepri || self.basepri == 0) => {
                self.basepri = priority;
            }
            FAULTMASK if self.execution_priority(bus.system()) > -1 => {
                self.faultmask = value & 1 != 0;
            }
            CONTROL => {
                self.unprivileged = value & 1 != 0;
                self.float_active = value & 4 != 0;
                if !self.in_handler() {
                    self.select_process_stack(value & 2 != 0);
                }
            }
            _ => {}
        }
        // Masked exceptions may have become possible, and the floating-point context may have changed.
        bus.system().request_recheck();
    }

    /// CPSIE and CPSID.
    pub(super) fn change_state<B: Bus>(
        &mut self,
        bus: &mut B,
        disable: bool,
        primask: bool,
        faultmask: bool,
    ) {
        if !self.privileged() {
            return;
        }
        if primask {
            self.primask = disable;
        }
        if faultmask && (!disable || self.execution_priority(bus.system()) > -1) {
            self.faultmask = disable;
        }
        bus.system().request_recheck();
    }
}
