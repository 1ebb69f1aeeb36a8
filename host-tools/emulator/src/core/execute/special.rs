//! Special registers: MRS, MSR and CPS (DDI0403E B5.2).

use crate::core::bus::Bus;
use crate::core::instruction::SpecialRegister;
use crate::core::state::{SP, State};
use crate::core::system_control::PRIORITY_MASK;

impl State {
    pub(super) fn read_special(&self, special: SpecialRegister) -> u32 {
        match special {
            SpecialRegister::Msp => self.r[SP],
            SpecialRegister::Primask => self.primask.into(),
            SpecialRegister::Basepri | SpecialRegister::BasepriMax => self.basepri.into(),
        }
    }

    pub(super) fn write_special<B: Bus>(
        &mut self,
        bus: &mut B,
        special: SpecialRegister,
        value: u32,
    ) {
        let priority = value as u8 & PRIORITY_MASK;
        match special {
            SpecialRegister::Msp => self.r[SP] = value & !3,
            SpecialRegister::Primask => self.primask = value & 1 != 0,
            SpecialRegister::Basepri => self.basepri = priority,
            // Raises the priority only.
            SpecialRegister::BasepriMax => {
                if priority != 0 && (priority < self.basepri || self.basepri == 0) {
                    self.basepri = priority;
                }
            }
        }
        // Masked exceptions may have become possible.
        bus.system().request_recheck();
    }

    /// CPSID i and CPSIE i.
    pub(super) fn change_state<B: Bus>(&mut self, bus: &mut B, masked: bool) {
        self.primask = masked;
        bus.system().request_recheck();
    }
}
