//! Registers and internal state of the processor.

use std::ops::Range;

use crate::core::arithmetic::{CARRY, NEGATIVE, NZCV, ZERO};
use crate::core::bus::Bus;
use crate::core::cycles::CycleModel;
use crate::core::instruction::{LogicalFlags, Register};
use crate::core::statistics::Recorder;

/// Index of the main stack pointer.
pub(super) const SP: usize = 13;
/// Index of the link register.
pub(super) const LR: usize = 14;
/// Index of the program counter.
pub(super) const PC: usize = 15;

/// Bits of the APSR that are modelled.
const APSR: u32 = 0xF800_0000;
/// xPSR bit 24: Thumb state.
const THUMB: u32 = 1 << 24;

/// Why the core executes nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sleep {
    Awake,
    /// WFE: until the event register is set.
    Event,
    /// WFI: until an enabled interrupt is pending.
    Interrupt,
}

/// Fault of an instruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// Execution from a region that the default memory map declares execute never.
    ExecuteNever,
    InstructionBus,
    DataBus,
    Undefined,
    InvalidState,
    NoCoprocessor,
    Unaligned,
}

/// Why an instruction does not end with the next one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trap {
    Fault(Fault),
    /// A pending exception must be taken before the instruction is executed again.
    Retry,
    /// Branch to the EXC_RETURN value in [`State::exception_return`].
    ExceptionReturn,
    Breakpoint(u8),
    Unsupported,
}

/// A contiguous range of addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Span {
    start: u32,
    /// Length in bytes.
    length: u32,
}

impl Span {
    pub(super) const EMPTY: Self = Self { start: 0, length: 0 };

    pub(super) fn range(self) -> Range<u32> {
        self.start..self.start.saturating_add(self.length)
    }

    #[inline(always)]
    pub(super) const fn contains(self, address: u32) -> bool {
        address.wrapping_sub(self.start) < self.length
    }

    /// The span with `length` bytes from an address on added.
    pub(super) fn extended(self, address: u32, length: u32) -> Self {
        if self.length == 0 {
            return Self { start: address, length };
        }
        let start = self.start.min(address);
        let end = (self.start + self.length).max(address + length);
        Self { start, length: end - start }
    }
}

/// Index of the span of executed addresses that an address may be in: the two memories differ in this
/// bit.
#[inline(always)]
pub(super) const fn executed_index(address: u32) -> usize {
    (address >> 29 & 1) as usize
}

/// Registers, special registers, and what the execution keeps between instructions.
#[derive(Debug, Clone)]
pub(super) struct State {
    /// Core registers. `r[13]` is the main stack pointer; `r[15]` reads as the address of the
    /// executing instruction plus 4.
    pub(super) r: [u32; 16],
    /// Address of the next instruction.
    pub(super) pc: u32,
    /// N, Z, C, V and Q at their places in the APSR.
    pub(super) apsr: u32,
    /// ITSTATE of the next instruction.
    pub(super) itstate: u8,
    /// IPSR: number of the current exception, 0 in thread mode.
    pub(super) exception: u16,
    /// EPSR.T. Clear only between a branch to an even address and the fault that it causes.
    pub(super) thumb: bool,
    pub(super) primask: bool,
    pub(super) basepri: u8,
    /// CONTROL.FPCA: the floating-point context is active.
    pub(super) float_active: bool,
    /// FPCAR while FPCCR.LSPACT is set: where the floating-point registers of the interrupted program go before the handler
    /// uses the unit.
    pub(super) lazy_frame: Option<u32>,
    /// Single-precision registers.
    pub(super) s: [u32; 32],
    pub(super) fpscr: u32,
    /// Local exclusive monitor.
    pub(super) exclusive: bool,
    /// Floating-point instructions need no check of access, lazy stacking and context activation.
    pub(super) float_ready: bool,
    pub(super) sleep: Sleep,

    /// EXC_RETURN value of the last [`Trap::ExceptionReturn`].
    pub(super) exception_return: u32,

    /// Addresses from which instructions were executed, in the CCM SRAM and in the SRAM: stores into
    /// them may change decoded instructions.
    pub(super) executed: [Span; 2],
    /// Stores of the last instruction into such a span.
    pub(super) stored_code: Option<Span>,
    /// Instruction barrier executed: the bus is asked for modified code.
    pub(super) barrier: bool,

    pub(super) model: CycleModel,
    /// Cycles of this core awake.
    pub(super) cycles: u64,
    pub(super) instructions: u64,
    pub(super) lowest_sp: u32,
    pub(super) recorder: Recorder,
}

impl State {
    pub(super) fn new(model: CycleModel) -> Self {
        Self {
            r: [0; 16],
            pc: 0,
            apsr: 0,
            itstate: 0,
            exception: 0,
            thumb: true,
            primask: false,
            basepri: 0,
            float_active: false,
            lazy_frame: None,
            s: [0; 32],
            fpscr: 0,
            exclusive: false,
            float_ready: false,
            sleep: Sleep::Awake,
            exception_return: 0,
            executed: [Span::EMPTY; 2],
            stored_code: None,
            barrier: false,
            model,
            cycles: 0,
            instructions: 0,
            lowest_sp: u32::MAX,
            recorder: Recorder::new(),
        }
    }

    /// Values after a reset, apart from the stack pointer and the program counter, which the vector
    /// table gives. Statistics and the span of executed RAM remain.
    pub(super) fn reset(&mut self) {
        let attributed = (self.exception, self.instructions, self.cycles);
        self.recorder.attribute(attributed.0, attributed.1, attributed.2);
        *self = Self {
            executed: self.executed,
            cycles: self.cycles,
            instructions: self.instructions,
            lowest_sp: self.lowest_sp,
            recorder: self.recorder.clone(),
            ..Self::new(self.model)
        };
        self.r[LR] = u32::MAX;
    }

    #[inline(always)]
    pub(super) fn read(&self, register: Register) -> u32 {
        self.r[register.index()]
    }

    /// Writes a register that is not the stack pointer.
    #[inline(always)]
    pub(super) fn write(&mut self, register: Register, value: u32) {
        self.r[register.index()] = value;
    }

    /// Writes any register; the two lowest bits of the stack pointer are always zero (B1.4.1).
    #[inline(always)]
    pub(super) fn write_any(&mut self, register: Register, value: u32) {
        let mask = if register == Register::SP { !3 } else { !0 };
        self.r[register.index()] = value & mask;
    }

    #[inline(always)]
    pub(super) fn carry(&self) -> bool {
        self.apsr & CARRY != 0
    }

    #[inline(always)]
    pub(super) fn set_nz(&mut self, result: u32) {
        self.apsr =
            self.apsr & !(NEGATIVE | ZERO) | result & NEGATIVE | ((result == 0) as u32) << 30;
    }

    #[inline(always)]
    pub(super) fn set_nzc(&mut self, result: u32, carry: bool) {
        self.set_nz(result);
        self.apsr = self.apsr & !CARRY | (carry as u32) << 29;
    }

    #[inline(always)]
    pub(super) fn set_nzcv(&mut self, flags: u32) {
        self.apsr = self.apsr & !NZCV | flags;
    }

    #[inline(always)]
    pub(super) fn set_logical(&mut self, result: u32, flags: LogicalFlags) {
        if flags.sets_nz() {
            self.set_nz(result);
            if let Some(carry) = flags.carry() {
                self.apsr = self.apsr & !CARRY | (carry as u32) << 29;
            }
        }
    }

    /// xPSR as it is stacked, apart from the alignment bit.
    pub(super) fn xpsr(&self) -> u32 {
        let it = self.itstate as u32;
        let it = (it & 3) << 25 | (it >> 2) << 10;
        let thumb = if self.thumb { THUMB } else { 0 };
        self.apsr | thumb | it | self.exception as u32
    }

    /// Takes over all fields of an xPSR.
    pub(super) fn set_xpsr(&mut self, xpsr: u32) {
        self.apsr = xpsr & APSR;
        self.thumb = xpsr & THUMB != 0;
        self.itstate = (xpsr >> 25 & 3 | xpsr >> 8 & 0xFC) as u8;
        self.exception = (xpsr & 0x1FF) as u16;
    }

    pub(super) fn in_handler(&self) -> bool {
        self.exception != 0
    }

    /// Passes time.
    #[inline(always)]
    pub(super) fn elapse(&mut self, bus: &mut impl Bus, cycles: u32) {
        self.cycles += cycles as u64;
        bus.elapse(cycles);
    }
}
