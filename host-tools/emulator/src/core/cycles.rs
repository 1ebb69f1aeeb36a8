//! Execution time of instructions and exceptions in cycles of the core's clock.
//!
//! Source: Cortex-M4 Technical Reference Manual (DDI0439), 3.3.1 and 7.2.3 (instruction timings), and
//! RM0440, 3.3.3 (wait states of the flash memory). This is a model in classes: it adds the time of each
//! instruction and contains neither the prefetch buffer, nor the write buffer, nor contention on the buses.

use crate::core::instruction::{FloatArithmetic, FloatUnary, Instruction};

/// Addresses of the flash memory and its aliases of other sizes, on which wait states apply.
const FLASH: std::ops::Range<u32> = 0x0800_0000..0x0810_0000;

/// Execution times by class of instruction, in cycles.
///
/// An instruction without a class of its own (data processing, multiplication of the integer core,
/// addition and multiplication in floating point, moves, hints) takes [`CycleModel::base`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleModel {
    /// Any instruction that has no other class, one that fails its condition, and a branch that is
    /// not taken.
    pub base: u8,
    /// Load of one register. The manual states 2, and 1 for each but the first of several single
    /// loads and stores in a row, whose address and data phases overlap.
    pub load: u8,
    /// Whether single loads that directly follow a single load or store take a cycle less.
    pub pipelined_loads: bool,
    /// Store of one register; 1 where the write buffer accepts it.
    pub store: u8,
    /// Load or store of two registers (LDRD, STRD, VLDR and VSTR of a double word).
    pub dual: u8,
    /// Load or store of multiple registers: this, and one cycle for each word.
    pub multiple: u8,
    /// Refill of the pipeline by a taken branch, on top of the instruction: 1 to 3, depending on
    /// alignment and width of the target instruction.
    pub refill: u8,
    /// TBB and TBH, on top of the refill.
    pub table_branch: u8,
    /// MLA and MLS: 1, and 2 in the manual of the core's first revision. All other multiplications with
    /// accumulation (SMLAL, SMLAD, SMLABB, SMMLA, ...) take one cycle in every revision.
    pub multiply_accumulate: u8,
    /// SDIV and UDIV: 2 to 12, depending on the operands.
    pub divide: u8,
    /// Load and store of one floating-point register.
    pub float_transfer: u8,
    /// VMLA and the like.
    pub float_multiply_add: u8,
    /// VDIV and VSQRT.
    pub float_divide: u8,
    /// VMOV of two registers from or to the core.
    pub float_pair: u8,
    /// DSB, DMB and ISB.
    pub barrier: u8,
    /// MRS and MSR.
    pub special_register: u8,
    /// Entry of an exception: stacking of eight words and fetch of the vector at the same time.
    pub exception_entry: u8,
    /// Return from an exception to the interrupted program.
    pub exception_return: u8,
    /// Change from one exception to the next without unstacking.
    pub tail_chain: u8,
    /// Stacking or unstacking of S0 to S15 and FPSCR, whenever it takes place.
    pub float_stacking: u8,
    /// Wait states of a taken branch, an exception entry or an exception return to an address in flash.
    pub flash_branch_wait: u8,
    /// Wait states of a data access to flash, for each access (literals included).
    pub flash_data_wait: u8,
}

impl CycleModel {
    /// Lower limit: the shortest times of the manual; caches of the flash interface always hit.
    pub const FAST: Self = Self {
        base: 1,
        load: 2,
        pipelined_loads: true,
        store: 1,
        dual: 3,
        multiple: 1,
        refill: 1,
        table_branch: 2,
        multiply_accumulate: 1,
        divide: 2,
        float_transfer: 2,
        float_multiply_add: 3,
        float_divide: 14,
        float_pair: 2,
        barrier: 1,
        special_register: 1,
        exception_entry: 12,
        exception_return: 10,
        tail_chain: 6,
        float_stacking: 17,
        flash_branch_wait: 0,
        flash_data_wait: 0,
    };

    /// Middle of the ranges. The average waits of 1 cycle assume that the caches of the flash interface
    /// serve three of four accesses at 4 wait states; no measurement supports the share.
    pub const TYPICAL: Self = Self {
        refill: 2,
        divide: 7,
        barrier: 3,
        special_register: 2,
        flash_branch_wait: 1,
        flash_data_wait: 1,
        ..Self::FAST
    };

    /// Upper limit: the longest times of the manual, and 4 wait states (170 MHz, RM0440 table 29) at
    /// every taken branch to flash and every data access to flash. Sequential fetches are assumed to
    /// be covered by the prefetch buffer.
    pub const SLOW: Self = Self {
        pipelined_loads: false,
        store: 2,
        refill: 3,
        multiply_accumulate: 2,
        divide: 12,
        barrier: 4,
        special_register: 2,
        flash_branch_wait: 4,
        flash_data_wait: 4,
        ..Self::FAST
    };

    /// Cycles of an instruction, without what depends on the state: taken branches and wait states.
    pub(super) fn timing(&self, instruction: &Instruction) -> Timing {
        use {FloatArithmetic as F, Instruction as I};
        match *instruction {
            I::LoadWord(..)
            | I::Load(..)
            | I::LoadIndexed(..)
            | I::LoadWriteBack(..)
            | I::LoadLiteral(..) => self.single_transfer(self.load, true),
            I::StoreWord(..) | I::Store(..) | I::StoreIndexed(..) | I::StoreWriteBack(..) => {
                self.single_transfer(self.store, false)
            }
            I::LoadToPc(..)
            | I::LoadToPcIndexed(..)
            | I::LoadToPcLiteral(..)
            | I::LoadExclusive(..)
            | I::StoreExclusive(..) => Timing::new(self.load),
            I::LoadDual(..) | I::StoreDual(..) | I::LoadDualLiteral(..) => Timing::new(self.dual),
            I::LoadMultiple(_, _, list)
            | I::StoreMultiple(_, _, list)
            | I::Push(list)
            | I::Pop(list) => Timing::new(self.multiple + list.count_ones() as u8),
            I::TableBranch(..) => Timing::new(self.table_branch),
            I::MultiplyAccumulate(..) | I::MultiplySubtract(..) => {
                Timing::new(self.multiply_accumulate)
            }
            I::DivideSigned(..) | I::DivideUnsigned(..) => Timing::new(self.divide),
            I::DataBarrier | I::SynchronisationBarrier => Timing::new(self.barrier),
            I::ReadSpecial(..) | I::WriteSpecial(..) => Timing::new(self.special_register),
            I::FloatLoad(_, _, true, _) | I::FloatStore(_, _, true, _) => Timing::new(self.dual),
            I::FloatLoad(..) | I::FloatStore(..) => Timing::new(self.float_transfer),
            I::FloatLoadMultiple(_, words, _, _, _) | I::FloatStoreMultiple(_, words, _, _, _) => {
                Timing::new(self.multiple + words)
            }
            I::FloatArithmetic(
                F::MultiplyAdd
                | F::MultiplySubtract
                | F::NegatedMultiplyAdd
                | F::NegatedMultiplySubtract,
                ..,
            ) => Timing::new(self.float_multiply_add),
            I::FloatArithmetic(F::Divide, ..) | I::FloatUnary(FloatUnary::SquareRoot, ..) => {
                Timing::new(self.float_divide)
            }
            I::FloatPairFromCore(..) | I::FloatPairToCore(..) => Timing::new(self.float_pair),
            _ => Timing::new(self.base),
        }
    }

    fn single_transfer(&self, cycles: u8, is_load: bool) -> Timing {
        let mut timing = Timing::new(cycles).0;
        if self.pipelined_loads {
            timing |= Timing::TRANSFER;
            if is_load && cycles > 1 {
                timing |= Timing::OVERLAPS;
            }
        }
        Timing(timing)
    }

    /// Additional cycles of a taken branch to an address.
    #[inline(always)]
    pub(super) fn branch(&self, target: u32) -> u32 {
        self.refill as u32 + self.flash_wait(target, self.flash_branch_wait)
    }

    /// Additional cycles of the first fetch from an address that an exception goes to.
    #[inline]
    pub(super) fn fetch_wait(&self, target: u32) -> u32 {
        self.flash_wait(target, self.flash_branch_wait)
    }

    /// Additional cycles of a data access.
    #[inline(always)]
    pub(super) fn data_wait(&self, address: u32) -> u32 {
        self.flash_wait(address, self.flash_data_wait)
    }

    #[inline(always)]
    fn flash_wait(&self, address: u32, wait: u8) -> u32 {
        let in_flash = address.wrapping_sub(FLASH.start) < FLASH.end - FLASH.start;
        if in_flash { wait as u32 } else { 0 }
    }
}

/// Cycles of an instruction with its place in a sequence of single loads and stores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Timing(u8);

impl Timing {
    /// A single load or store: a following load overlaps with it.
    const TRANSFER: u8 = 0x80;
    /// A load that takes a cycle less after such an instruction.
    const OVERLAPS: u8 = 0x40;

    pub(super) const NONE: Self = Self(0);

    const fn new(cycles: u8) -> Self {
        assert!(cycles < Self::OVERLAPS);
        Self(cycles)
    }

    /// Cycles of the instruction after one with the other timing.
    #[inline(always)]
    pub(super) const fn cycles_after(self, previous: Timing) -> u32 {
        let overlap = self.0 & previous.0 >> 1 & Self::OVERLAPS;
        (self.0 & 0x3F) as u32 - (overlap >> 6) as u32
    }
}
