//! Loads and stores of several registers, and exclusive accesses.
//!
//! All words of a load are read before a register changes, so that an instruction that faults can be
//! executed again (the restart of DDI0403E B1.5.10; the continuation by the ICI bits is not modelled).

use crate::core::Width;
use crate::core::bus::Bus;
use crate::core::instruction::{MultipleMode, Register};
use crate::core::state::{State, Trap};

impl State {
    pub(super) fn load_dual<B: Bus>(
        &mut self,
        bus: &mut B,
        t: Register,
        t2: Register,
        address: u32,
    ) -> Result<(), Trap> {
        self.require_alignment(address, Width::Word)?;
        let first = self.load(bus, address, Width::Word)?;
        let second = self.load(bus, address.wrapping_add(4), Width::Word)?;
        self.write(t, first);
        self.write(t2, second);
        Ok(())
    }

    pub(super) fn store_dual<B: Bus>(
        &mut self,
        bus: &mut B,
        t: Register,
        t2: Register,
        address: u32,
    ) -> Result<(), Trap> {
        self.require_alignment(address, Width::Word)?;
        self.store(bus, address, Width::Word, self.read(t))?;
        self.store(bus, address.wrapping_add(4), Width::Word, self.read(t2))
    }

    /// Gives the value for the PC where it is in the list.
    pub(super) fn load_multiple<B: Bus>(
        &mut self,
        bus: &mut B,
        n: Register,
        mode: MultipleMode,
        list: u16,
    ) -> Result<Option<u32>, Trap> {
        let (start, base) = self.block(n, mode, list);
        let target = self.load_list(bus, start, list)?;
        if mode.write_back {
            self.write_any(n, base);
        }
        Ok(target)
    }

    pub(super) fn store_multiple<B: Bus>(
        &mut self,
        bus: &mut B,
        n: Register,
        mode: MultipleMode,
        list: u16,
    ) -> Result<(), Trap> {
        let (start, base) = self.block(n, mode, list);
        self.store_list(bus, start, list)?;
        if mode.write_back {
            self.write_any(n, base);
        }
        Ok(())
    }

    /// Lowest address of the block and the base register after it.
    fn block(&self, n: Register, mode: MultipleMode, list: u16) -> (u32, u32) {
        let (base, length) = (self.read(n), 4 * list.count_ones());
        if mode.decrement {
            let start = base.wrapping_sub(length);
            (start, start)
        } else {
            (base, base.wrapping_add(length))
        }
    }

    /// Loads the registers of the list from ascending addresses; the value for the PC is returned.
    #[inline]
    pub(super) fn load_list<B: Bus>(
        &mut self,
        bus: &mut B,
        start: u32,
        list: u16,
    ) -> Result<Option<u32>, Trap> {
        self.require_alignment(start, Width::Word)?;
        let loads_pc = list & Register::PC.list_bit() != 0;
        if loads_pc {
            self.require_last_in_it_block()?;
        }
        let mut values = [0; 16];
        let mut address = start;
        let mut remaining = list;
        while remaining != 0 {
            let index = remaining.trailing_zeros() as usize & 15;
            remaining &= remaining - 1;
            values[index] = self.load(bus, address, Width::Word)?;
            address = address.wrapping_add(4);
        }
        let mut remaining = list & !Register::PC.list_bit();
        while remaining != 0 {
            let index = remaining.trailing_zeros() as usize & 15;
            remaining &= remaining - 1;
            self.r[index] = values[index];
        }
        Ok(loads_pc.then_some(values[Register::PC.index()]))
    }

    /// Stores the registers of the list to ascending addresses.
    #[inline]
    pub(super) fn store_list<B: Bus>(
        &mut self,
        bus: &mut B,
        start: u32,
        list: u16,
    ) -> Result<(), Trap> {
        self.require_alignment(start, Width::Word)?;
        let mut address = start;
        let mut remaining = list;
        while remaining != 0 {
            let index = remaining.trailing_zeros() as usize & 15;
            remaining &= remaining - 1;
            self.store(bus, address, Width::Word, self.r[index])?;
            address = address.wrapping_add(4);
        }
        Ok(())
    }

    pub(super) fn load_exclusive<B: Bus>(
        &mut self,
        bus: &mut B,
        width: Width,
        t: Register,
        address: u32,
    ) -> Result<(), Trap> {
        self.require_alignment(address, width)?;
        let value = self.load(bus, address, width)?;
        self.exclusive = true;
        self.write(t, value);
        Ok(())
    }

    /// The monitor does not compare addresses: its granule is the whole memory, as on this core.
    pub(super) fn store_exclusive<B: Bus>(
        &mut self,
        bus: &mut B,
        width: Width,
        d: Register,
        t: Register,
        address: u32,
    ) -> Result<(), Trap> {
        self.require_alignment(address, width)?;
        if self.exclusive {
            self.store(bus, address, width, self.read(t))?;
            self.write(d, 0);
        } else {
            self.write(d, 1);
        }
        self.exclusive = false;
        Ok(())
    }
}
