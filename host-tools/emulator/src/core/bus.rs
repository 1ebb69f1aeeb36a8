//! The interface between the core and the rest of the chip.

use std::ops::Range;

use crate::core::SystemControl;

/// Width of a data access.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Half,
    /// 32 bits.
    Word,
}

impl Width {
    /// Number of bytes: 1, 2 or 4.
    #[inline(always)]
    pub const fn bytes(self) -> u32 {
        match self {
            Width::Byte => 1,
            Width::Half => 2,
            Width::Word => 4,
        }
    }
}

/// No memory or peripheral responds at the address, or it refuses the access.
///
/// The core takes HardFault, with `PRECISERR` in the CFSR for data, `IBUSERR` for an instruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no memory or peripheral accepts the access")]
pub struct BusError;

/// Memories, peripherals and time, as the core accesses them.
///
/// The functions are called for every instruction: implement them `#[inline]`, with the memories
/// first. Accesses to the system control space (0xE000_0000 to 0xE00F_FFFF) arrive here too; the
/// implementor forwards them to [`SystemControl::read`] and [`SystemControl::write`].
pub trait Bus {
    /// Instruction halfword at an even address. Called once for each halfword that is decoded, not
    /// for each execution.
    ///
    /// # Errors
    /// [`BusError`] where no instruction can be fetched.
    fn fetch(&mut self, address: u32) -> Result<u16, BusError>;

    /// Data at the address, extended with zeros.
    ///
    /// Accesses to memories (below 0x4000_0000 and from 0x6000_0000 to 0x9FFF_FFFF) may be
    /// unaligned; all others are aligned.
    ///
    /// # Errors
    /// [`BusError`] where nothing responds or the access is refused.
    fn read(&mut self, address: u32, width: Width) -> Result<u32, BusError>;

    /// Stores the low bits of `value`; the bits above `width` are zero. Alignment as in
    /// [`Bus::read`].
    ///
    /// # Errors
    /// [`BusError`] where nothing responds or the access is refused.
    fn write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError>;

    /// Address of the instruction whose access to a device, or store into flash, follows: for reports.
    fn set_program_counter(&mut self, _pc: u32) {}

    /// Interrupt controller and system control block of this core.
    fn system(&mut self) -> &mut SystemControl;

    /// Advances the time by cycles of the core's clock.
    fn elapse(&mut self, cycles: u32);

    /// Whether the time has reached the next event of a peripheral: [`Core::run`](super::Core::run)
    /// then returns. Called before each instruction.
    fn event_due(&self) -> bool;

    /// Addresses whose instructions may have changed since the last call other than by a store of the
    /// core to the address from which it executes: flash programmed or erased, memory written by DMA
    /// or through an alias, an image loaded.
    ///
    /// Called at the start of [`Core::run`](super::Core::run)
    /// and by the instruction `ISB`. Stores of the core itself need no report. Where the changes are
    /// scattered, a range that contains them all is sufficient; it only costs decoding again.
    fn take_modified_code(&mut self) -> Option<Range<u32>> {
        None
    }
}
