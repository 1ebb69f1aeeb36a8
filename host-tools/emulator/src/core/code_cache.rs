//! Decoded instructions by address, so that each is decoded once.

use std::ops::Range;

use crate::core::bus::{Bus, BusError};
use crate::core::cycles::{CycleModel, Timing};
use crate::core::decode::{decode_narrow, decode_wide, is_wide};
use crate::core::execute::memory::is_device;
use crate::core::instruction::Instruction;
use crate::core::state::Fault;

/// Memories whose instructions are kept: first address and length in bytes. Instructions elsewhere are
/// decoded at each execution.
const WINDOWS: [Range<u32>; 3] = [
    0x0800_0000..0x0808_0000, // flash, 512 KiB
    0x1000_0000..0x1000_8000, // CCM SRAM, 32 KiB
    0x2000_0000..0x2002_0000, // SRAM, 128 KiB
];
/// Slots before those of each window.
const FIRST: [usize; 3] = [0, slots(0), slots(0) + slots(1)];
const CACHED: usize = slots(0) + slots(1) + slots(2);
/// Slot of an instruction outside the windows.
const UNCACHED: usize = CACHED;
/// Slots of an instruction whose condition fails: of two and of four bytes.
const SKIPPED: usize = CACHED + 1;

const fn slots(window: usize) -> usize {
    ((WINDOWS[window].end - WINDOWS[window].start) / 2) as usize
}

/// Where an instruction was decoded for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Context(u8);

impl Context {
    pub(super) const OUTSIDE_IT: Self = Self(0);
    pub(super) const INSIDE_IT: Self = Self(1);
    const EMPTY: Self = Self(2);

    /// Context of an ITSTATE.
    pub(super) const fn of(itstate: u8) -> Self {
        if itstate == 0 { Self::OUTSIDE_IT } else { Self::INSIDE_IT }
    }

    /// Whether the context is outside an IT block and the state is as well.
    #[inline(always)]
    pub(super) const fn is_plain(self, itstate: u8) -> bool {
        self.0 | itstate == 0
    }
}

/// A decoded instruction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slot {
    pub(super) instruction: Instruction,
    /// Bytes: 2 or 4.
    pub(super) size: u8,
    pub(super) context: Context,
    pub(super) timing: Timing,
}

const _: () = assert!(size_of::<Slot>() <= 16);

const EMPTY: Slot =
    Slot { instruction: Instruction::Nop, size: 2, context: Context::EMPTY, timing: Timing::NONE };

#[derive(Debug, Clone)]
pub(super) struct CodeCache {
    /// A constant length saves loading it with each instruction.
    slots: Box<[Slot; CACHED + 3]>,
}

impl CodeCache {
    pub(super) fn new(model: &CycleModel) -> Self {
        let mut slots = vec![EMPTY; CACHED + 3];
        for (slot, size) in [(SKIPPED, 2), (SKIPPED + 1, 4)] {
            let instruction = Instruction::Nop;
            let timing = model.timing(&instruction);
            slots[slot] = Slot { instruction, size, context: Context::INSIDE_IT, timing };
        }
        let Ok(slots) = slots.into_boxed_slice().try_into() else {
            unreachable!("the length is that of the array");
        };
        Self { slots }
    }

    /// Slot of an address in a window. Written out: a loop over the windows would be the largest part
    /// of the cost of an instruction.
    #[inline(always)]
    const fn index(address: u32) -> Option<usize> {
        let flash = address.wrapping_sub(WINDOWS[0].start);
        if flash < WINDOWS[0].end - WINDOWS[0].start {
            return Some(FIRST[0] + (flash / 2) as usize);
        }
        let ccm = address.wrapping_sub(WINDOWS[1].start);
        if ccm < WINDOWS[1].end - WINDOWS[1].start {
            return Some(FIRST[1] + (ccm / 2) as usize);
        }
        let sram = address.wrapping_sub(WINDOWS[2].start);
        if sram < WINDOWS[2].end - WINDOWS[2].start {
            return Some(FIRST[2] + (sram / 2) as usize);
        }
        None
    }

    /// Slot of an address, decoded or not. Addresses outside the windows share an empty one.
    #[inline(always)]
    pub(super) fn slot(&self, address: u32) -> &Slot {
        let index = Self::index(address).unwrap_or(UNCACHED);
        self.slots.get(index).unwrap_or(&EMPTY)
    }

    /// Slot of an index that another function gave.
    #[inline(always)]
    pub(super) fn at(&self, index: usize) -> &Slot {
        self.slots.get(index).unwrap_or(&EMPTY)
    }

    /// Slot of an instruction that is not executed.
    pub(super) fn skipped(&self, size: u8) -> usize {
        SKIPPED + (size == 4) as usize
    }

    /// Index of the instruction at an address where it is decoded for the context.
    #[inline]
    pub(super) fn find(&self, address: u32, context: Context) -> Option<usize> {
        Self::index(address).filter(|&index| self.slots[index].context == context)
    }

    /// Decodes the instruction at an address for the context and gives its index.
    #[inline(never)]
    pub(super) fn decode<B: Bus>(
        &mut self,
        bus: &mut B,
        address: u32,
        context: Context,
        model: &CycleModel,
    ) -> Result<usize, Fault> {
        let slot = decode(bus, address, context, model)?;
        let Some(index) = Self::index(address) else {
            // Valid for this execution only.
            self.slots[UNCACHED] = Slot { context: Context::EMPTY, ..slot };
            return Ok(UNCACHED);
        };
        self.slots[index] = slot;
        Ok(index)
    }

    /// Drops the instructions that overlap a range of addresses.
    pub(super) fn invalidate(&mut self, range: Range<u32>) {
        for (window, first) in WINDOWS.iter().zip(FIRST) {
            // An instruction of four bytes may start one slot before the range.
            let start = range.start.saturating_sub(2).max(window.start);
            let end = range.end.min(window.end);
            if start < end {
                let slot = |address: u32| first + ((address - window.start) / 2) as usize;
                self.slots[slot(start)..=slot(end - 1)].fill(EMPTY);
            }
        }
    }
}

/// Whether stores of the core to an address may change instructions that are kept.
pub(super) fn is_cached_ram(address: u32) -> bool {
    WINDOWS[1..].iter().any(|window| window.contains(&address))
}

fn decode<B: Bus>(
    bus: &mut B,
    address: u32,
    context: Context,
    model: &CycleModel,
) -> Result<Slot, Fault> {
    let first = fetch(bus, address)?;
    let inside_it_block = context == Context::INSIDE_IT;
    let (instruction, size) = if is_wide(first) {
        let second = fetch(bus, address.wrapping_add(2))?;
        (decode_wide(first, second, inside_it_block), 4)
    } else {
        (decode_narrow(first, inside_it_block), 2)
    };
    Ok(Slot { instruction, size, context, timing: model.timing(&instruction) })
}

fn fetch<B: Bus>(bus: &mut B, address: u32) -> Result<u16, Fault> {
    if is_device(address) {
        return Err(Fault::ExecuteNever);
    }
    bus.fetch(address).map_err(|BusError| Fault::InstructionBus)
}
