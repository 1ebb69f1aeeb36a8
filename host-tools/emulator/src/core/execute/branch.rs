//! Branches and changes of state (DDI0403E B1.4.7), hints.

use crate::core::bus::Bus;
use crate::core::instruction::Hint;
use crate::core::state::{PC, Sleep, State, Trap};

impl State {
    /// A branch inside an IT block is unpredictable unless it is the last instruction. ITSTATE is that
    /// behind the instruction. Called first where the instruction changes more than the PC.
    #[inline(always)]
    pub(super) fn require_last_in_it_block(&self) -> Result<(), Trap> {
        if self.itstate != 0 {
            return Err(Trap::Unsupported);
        }
        Ok(())
    }

    /// Branch within the Thumb state; bit 0 of the target is ignored.
    #[inline(always)]
    pub(super) fn branch<B: Bus>(&mut self, bus: &mut B, target: u32) -> Result<u32, Trap> {
        self.require_last_in_it_block()?;
        let target = target & !1;
        self.elapse(bus, self.model.branch(target));
        Ok(target)
    }

    #[inline(always)]
    pub(super) fn branch_by<B: Bus>(&mut self, bus: &mut B, offset: i32) -> Result<u32, Trap> {
        self.branch(bus, self.r[PC].wrapping_add_signed(offset))
    }

    /// `BXWritePC` (B1.4.7): return from an exception or branch with a change of state.
    #[inline(always)]
    pub(super) fn branch_exchange<B: Bus>(
        &mut self,
        bus: &mut B,
        target: u32,
    ) -> Result<u32, Trap> {
        if target >= 0xF000_0000 && self.in_handler() {
            self.exception_return = target;
            return Err(Trap::ExceptionReturn);
        }
        self.branch_with_state(bus, target)
    }

    /// Branch to the state of bit 0. The other state does not exist: the instruction at the target
    /// causes a fault.
    #[inline(always)]
    pub(super) fn branch_with_state<B: Bus>(
        &mut self,
        bus: &mut B,
        target: u32,
    ) -> Result<u32, Trap> {
        if target & 1 == 0 {
            self.thumb = false;
            bus.system().request_recheck();
        }
        self.branch(bus, target)
    }

    pub(super) fn hint<B: Bus>(&mut self, bus: &mut B, hint: Hint) {
        let system = bus.system();
        match hint {
            Hint::SendEvent => system.signal_event(),
            Hint::WaitForEvent => {
                if !system.take_event() {
                    self.sleep = Sleep::Event;
                    system.request_recheck();
                }
            }
            Hint::WaitForInterrupt => {
                self.sleep = Sleep::Interrupt;
                system.request_recheck();
            }
        }
    }
}
