//! Data accesses: alignment, wait states, faults, and stores into executed memory.

use crate::core::Width;
use crate::core::bus::{Bus, BusError};
use crate::core::instruction::{IndexMode, LoadKind, Register};
use crate::core::state::{Fault, PC, Span, State, Trap, executed_index};

/// Accesses from here on reach peripherals and the system region.
const DEVICES: u32 = 0x4000_0000;

/// Whether the default memory map (B3.1) declares a region for devices, where an access must be
/// aligned and nothing can be executed.
pub(in super::super) const fn is_device(address: u32) -> bool {
    matches!(address >> 29, 2 | 5 | 6 | 7)
}

impl State {
    #[inline(always)]
    pub(super) fn at(&self, n: Register, offset: i32) -> u32 {
        self.read(n).wrapping_add_signed(offset)
    }

    #[inline(always)]
    pub(super) fn indexed(&self, n: Register, m: Register, shift: u8) -> u32 {
        self.read(n).wrapping_add(self.read(m) << (shift & 3))
    }

    /// Address relative to the word-aligned PC.
    #[inline(always)]
    pub(super) fn literal(&self, offset: i32) -> u32 {
        (self.r[PC] & !3).wrapping_add_signed(offset)
    }

    /// Address of the access and the new value of the base register.
    #[inline(always)]
    pub(super) fn write_back_address(
        &self,
        n: Register,
        mode: IndexMode,
        offset: i16,
    ) -> (u32, u32) {
        let base = self.read(n);
        let moved = base.wrapping_add_signed(offset as i32);
        let address = if mode == IndexMode::PostIndexed { base } else { moved };
        (address, moved)
    }

    #[inline]
    pub(super) fn load_kind<B: Bus>(
        &mut self,
        bus: &mut B,
        kind: LoadKind,
        address: u32,
    ) -> Result<u32, Trap> {
        Ok(match kind {
            LoadKind::Word => self.load(bus, address, Width::Word)?,
            LoadKind::Half => self.load(bus, address, Width::Half)?,
            LoadKind::Byte => self.load(bus, address, Width::Byte)?,
            LoadKind::SignedHalf => self.load(bus, address, Width::Half)? as i16 as u32,
            LoadKind::SignedByte => self.load(bus, address, Width::Byte)? as i8 as u32,
        })
    }

    /// Loads of one register: unaligned accesses to memory are allowed.
    #[inline(always)]
    pub(in super::super) fn load<B: Bus>(
        &mut self,
        bus: &mut B,
        address: u32,
        width: Width,
    ) -> Result<u32, Trap> {
        if address & (width.bytes() - 1) != 0 || address >= DEVICES {
            self.check_access(bus, address, width)?;
        }
        let wait = self.model.data_wait(address);
        if wait != 0 {
            self.elapse(bus, wait);
        }
        bus.read(address, width).map_err(|BusError| Trap::Fault(Fault::DataBus))
    }

    /// Stores of one register: unaligned accesses to memory are allowed.
    #[inline(always)]
    pub(in super::super) fn store<B: Bus>(
        &mut self,
        bus: &mut B,
        address: u32,
        width: Width,
        value: u32,
    ) -> Result<(), Trap> {
        if address & (width.bytes() - 1) != 0 || address >> 29 != 1 {
            self.check_access(bus, address, width)?;
        }
        let value = match width {
            Width::Byte => value & 0xFF,
            Width::Half => value & 0xFFFF,
            Width::Word => value,
        };
        bus.write(address, width, value).map_err(|BusError| Trap::Fault(Fault::DataBus))?;
        if self.executed[executed_index(address)].contains(address) {
            self.record_code_store(bus, address, width);
        }
        Ok(())
    }

    /// A store into memory that was executed: the decoded instructions are dropped before the next one.
    #[cold]
    fn record_code_store<B: Bus>(&mut self, bus: &mut B, address: u32, width: Width) {
        let stored = self.stored_code.get_or_insert(Span::EMPTY);
        *stored = stored.extended(address, width.bytes());
        bus.system().request_recheck();
    }

    /// Accesses of several registers, exclusive accesses and those of the floating-point unit must be
    /// aligned to words in any memory (A3.2.1).
    #[inline(always)]
    pub(in super::super) fn require_alignment(
        &mut self,
        address: u32,
        width: Width,
    ) -> Result<(), Trap> {
        if address & (width.bytes() - 1) != 0 {
            return Err(Trap::Fault(Fault::Unaligned));
        }
        Ok(())
    }

    #[cold]
    fn check_access<B: Bus>(
        &mut self,
        bus: &mut B,
        address: u32,
        width: Width,
    ) -> Result<(), Trap> {
        let aligned = address & (width.bytes() - 1) == 0;
        if !aligned && is_device(address) {
            return Err(Trap::Fault(Fault::Unaligned));
        }
        bus.system().synchronise(self.cycles);
        bus.set_program_counter(self.r[PC].wrapping_sub(4));
        Ok(())
    }
}
