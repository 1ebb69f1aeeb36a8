//! The Cortex-M4F core: ARMv7E-M with the floating-point extension FPv4-SP.
//!
//! [`Core`] executes the program that a [`Bus`] contains, [`SystemControl`] is the interrupt controller
//! and the system control block, [`CycleModel`] the execution time.
//!
//! - [`bus`]: the interface to memories, peripherals and time.
//! - `instruction`, `decode`, `code_cache`: instructions, decoded once.
//! - `execute`, `arithmetic`, `dsp`, `float`: their execution.
//! - `exceptions`: entry, return, faults, lazy floating-point state.
//! - [`system_control`]: registers of the system control space, pending and active exceptions.
//! - [`cycles`], [`statistics`]: execution time and where it goes.
//!
//! Sources: ARMv7-M Architecture Reference Manual (DDI0403E), Cortex-M4 Technical Reference Manual
//! (DDI0439), STM32 Cortex-M4 programming manual (PM0214).
//!
//! # Not modelled
//!
//! - Unprivileged mode, the process stack, FAULTMASK, subpriorities, SVCall, PendSV and SysTick, a vector table
//!   elsewhere, SEVONPEND and SLEEPONEXIT, DWT: no image uses them. Their registers are absent. Without the
//!   handlers of MemManage, BusFault and UsageFault every fault is a HardFault.
//! - The write buffer: a refused store is a precise fault at its instruction, where the chip mostly
//!   reports an imprecise one a few instructions later.
//! - The prefetch of instructions: a store into executed memory has its effect at once, other changes
//!   with [`Bus::take_modified_code`].
//! - Interruption in the middle of load and store multiple (the ICI bits are always zero).
//! - Bit-band aliases, the debugger, and BKPT as a fault: it stops the core with [`Stop::Breakpoint`].
//! - Modes and cumulative exceptions of floating point, half precision, fixed point, fused multiplication: the FPSCR
//!   has flags only.
//! - SEL and the flags GE of parallel arithmetic, its exchanging and halving forms, SSAT16, USAT16, USAD8, SMLSD,
//!   SMLALxy, SMLALD, SMLSLD, QDADD, QDSUB: no image uses them.
//! - Instructions of these, and those whose behaviour the architecture leaves unpredictable: they stop the core with
//!   [`Stop::Unsupported`].

pub mod bus;
pub mod cycles;
pub mod statistics;
pub mod system_control;

mod arithmetic;
mod code_cache;
mod decode;
mod dsp;
mod exceptions;
mod execute;
mod float;
mod instruction;
mod state;
#[cfg(test)]
mod tests;

pub use bus::{Bus, BusError, Width};
pub use cycles::CycleModel;
pub use statistics::{ExceptionStatistics, Statistics};
pub use system_control::{EXCEPTIONS, SystemControl};

use code_cache::{CodeCache, Context, is_cached_ram};
use cycles::Timing;
use instruction::Instruction;
use state::{Fault, PC, SP, Sleep, State, Trap, executed_index};

/// Bytes of the longest instruction.
const LONGEST: u32 = 4;

/// Why [`Core::run`] returned without an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pause {
    /// [`Bus::event_due`]: the caller handles the event and calls again.
    EventDue,
    /// The core sleeps (WFE, WFI, SLEEPONEXIT): the caller advances the time to the next event, handles
    /// it and calls again.
    Asleep,
}

/// Why the core cannot continue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Stop {
    /// A fault at a priority at which no fault can be taken, within HardFault or NMI, or where the vector table cannot be
    /// read. The fault status register contains the cause.
    #[error("lock-up at {address:#010x}: a fault occurred where none can be handled")]
    LockUp {
        /// Address of the instruction.
        address: u32,
    },
    /// BKPT. The program counter is behind it: [`Core::run`] continues the program.
    #[error("breakpoint {immediate:#04x} at {address:#010x}")]
    Breakpoint {
        /// Address of the instruction.
        address: u32,
        /// Number in the instruction; 0xAB is a semihosting call.
        immediate: u8,
    },
    /// An instruction whose behaviour the architecture leaves unpredictable, by its encoding or as a
    /// branch inside an IT block, or that is not modelled. It was not executed.
    #[error(
        "unpredictable or unmodelled instruction {:#06x} {:#06x} at {address:#010x}",
        halfwords[0],
        halfwords[1]
    )]
    Unsupported {
        /// Address of the instruction.
        address: u32,
        /// The instruction; the second halfword is zero after one of 16 bits.
        halfwords: [u16; 2],
    },
    /// The program requested a reset (AIRCR.SYSRESETREQ). The caller resets the chip and calls
    /// [`Core::reset`].
    #[error("system reset requested")]
    ResetRequested,
}

/// A Cortex-M4F core.
///
/// The registers, the decoded instructions and the statistics; the memories and [`SystemControl`]
/// are parts of the [`Bus`] that is passed to each call. The same bus must be passed every time.
#[derive(Debug, Clone)]
pub struct Core {
    state: State,
    code: CodeCache,
    /// Timing of the last instruction.
    previous: Timing,
}

impl Core {
    /// A core before its first [`Core::reset`], with the execution times of a model.
    pub fn new(model: CycleModel) -> Self {
        Self { state: State::new(model), code: CodeCache::new(&model), previous: Timing::NONE }
    }

    /// Reset (`TakeReset`, B1.5.5): resets the [`SystemControl`] of the bus and loads the main stack
    /// pointer and the program counter from the vector table at address 0, where the bus maps the
    /// boot memory. Statistics remain.
    ///
    /// # Errors
    /// [`Stop::LockUp`] where the vector table cannot be read.
    pub fn reset<B: Bus>(&mut self, bus: &mut B) -> Result<(), Stop> {
        bus.system().reset();
        self.state.reset();
        self.previous = Timing::NONE;
        let read = |bus: &mut B, address| {
            bus.read(address, Width::Word).map_err(|BusError| Stop::LockUp { address })
        };
        let sp = read(bus, 0)?;
        let entry = read(bus, 4)?;
        self.state.r[SP] = sp & !3;
        self.state.pc = entry & !1;
        self.state.thumb = entry & 1 != 0;
        Ok(())
    }

    /// Executes instructions until [`Bus::event_due`], or until the core sleeps. Pending exceptions are
    /// taken before an instruction.
    ///
    /// Returns at once while an event is due.
    ///
    /// # Errors
    /// [`Stop`] where the program cannot continue.
    pub fn run<B: Bus>(&mut self, bus: &mut B) -> Result<Pause, Stop> {
        self.drop_modified_code(bus);
        let result = self.run_loop(bus);
        bus.system().synchronise(self.state.cycles);
        result
    }

    #[inline(always)]
    fn run_loop<B: Bus>(&mut self, bus: &mut B) -> Result<Pause, Stop> {
        // In a local variable because each instruction depends on it; the state has it while anything
        // else needs it.
        let mut pc = self.state.pc;
        loop {
            if bus.event_due() {
                self.state.pc = pc;
                return Ok(Pause::EventDue);
            }
            if bus.system().recheck_requested() {
                self.state.pc = pc;
                if let Some(pause) = self.check_state(bus)? {
                    return Ok(pause);
                }
                pc = self.state.pc;
            }
            pc = self.execute_at(bus, pc)?;
        }
    }

    /// What may change the flow between two instructions: reset, exceptions, sleep, modified code.
    #[cold]
    fn check_state<B: Bus>(&mut self, bus: &mut B) -> Result<Option<Pause>, Stop> {
        if bus.system().reset_requested() {
            return Err(Stop::ResetRequested);
        }
        self.state.float_ready = false;
        if let Some(stored) = self.state.stored_code.take() {
            self.code.invalidate(stored.range());
        }
        if std::mem::take(&mut self.state.barrier) {
            self.drop_modified_code(bus);
        }
        if let Some(exception) = self.state.preempting(bus.system()) {
            self.state.enter_exception(bus, exception)?;
            self.previous = Timing::NONE;
        }
        let awake = match self.state.sleep {
            Sleep::Awake => true,
            Sleep::Event => bus.system().take_event(),
            Sleep::Interrupt => self.state.wakes(bus.system()),
        };
        if !awake {
            return Ok(Some(Pause::Asleep));
        }
        self.state.sleep = Sleep::Awake;
        bus.system().clear_recheck();
        if !self.state.thumb {
            self.state.take_fault(bus, Fault::InvalidState)?;
        }
        Ok(None)
    }

    fn drop_modified_code<B: Bus>(&mut self, bus: &mut B) {
        if let Some(range) = bus.take_modified_code() {
            self.code.invalidate(range);
        }
    }

    /// Executes the instruction at `pc` and gives the address of the next one. On an error the state
    /// contains the address.
    #[inline(always)]
    fn execute_at<B: Bus>(&mut self, bus: &mut B, pc: u32) -> Result<u32, Stop> {
        let itstate = self.state.itstate;
        let mut slot = self.code.slot(pc);
        if !slot.context.is_plain(itstate) {
            match self.prepare(bus, pc) {
                Ok(index) => slot = self.code.at(index),
                Err(fault) => return self.handle_trap(bus, Trap::Fault(fault), itstate, pc, pc),
            }
        }
        let state = &mut self.state;
        state.instructions += 1;
        state.r[PC] = pc.wrapping_add(4);
        let next = pc.wrapping_add(slot.size as u32);
        let cycles = slot.timing.cycles_after(self.previous);
        self.previous = slot.timing;
        state.elapse(bus, cycles);
        match state.execute(bus, &slot.instruction, next) {
            Ok(next) => {
                if state.r[SP] < state.lowest_sp {
                    state.lowest_sp = state.r[SP];
                }
                Ok(next)
            }
            Err(trap) => self.handle_trap(bus, trap, itstate, pc, next),
        }
    }

    /// Decodes the next instruction and, in an IT block, evaluates its condition and advances ITSTATE.
    /// Gives the index of the slot to execute.
    #[inline(never)]
    fn prepare<B: Bus>(&mut self, bus: &mut B, pc: u32) -> Result<usize, Fault> {
        let state = &mut self.state;
        let itstate = state.itstate;
        let context = Context::of(itstate);
        let index = match self.code.find(pc, context) {
            Some(index) => index,
            None => {
                if is_cached_ram(pc) {
                    let executed = &mut state.executed[executed_index(pc)];
                    *executed = executed.extended(pc, LONGEST);
                }
                self.code.decode(bus, pc, context, &state.model)?
            }
        };
        if itstate == 0 {
            return Ok(index);
        }
        state.itstate = if itstate & 7 == 0 { 0 } else { itstate & 0xE0 | itstate << 1 & 0x1F };
        let slot = self.code.at(index);
        let condition = arithmetic::Condition::new((itstate >> 4) as u32);
        // BKPT is executed whatever the condition (A7.7.17).
        if condition.is_met(state.apsr) || matches!(slot.instruction, Instruction::Breakpoint(_)) {
            Ok(index)
        } else {
            Ok(self.code.skipped(slot.size))
        }
    }

    /// An instruction at `pc` that does not end with the next one; `itstate` is the state before it.
    /// Gives the address to continue at.
    #[cold]
    #[inline(never)]
    fn handle_trap<B: Bus>(
        &mut self,
        bus: &mut B,
        trap: Trap,
        itstate: u8,
        pc: u32,
        next: u32,
    ) -> Result<u32, Stop> {
        self.previous = Timing::NONE;
        let state = &mut self.state;
        state.pc = pc;
        match trap {
            Trap::ExceptionReturn => state.return_from_exception(bus)?,
            Trap::Breakpoint(immediate) => {
                state.pc = next;
                return Err(Stop::Breakpoint { address: pc, immediate });
            }
            Trap::Fault(fault) => {
                state.itstate = itstate;
                state.take_fault(bus, fault)?;
            }
            Trap::Retry => state.itstate = itstate,
            Trap::Unsupported => {
                state.itstate = itstate;
                let first = bus.fetch(pc).unwrap_or(0);
                let second =
                    if decode::is_wide(first) { bus.fetch(pc + 2).unwrap_or(0) } else { 0 };
                return Err(Stop::Unsupported { address: pc, halfwords: [first, second] });
            }
        }
        Ok(self.state.pc)
    }

    /// Address of the next instruction.
    pub fn pc(&self) -> u32 {
        self.state.pc
    }

    /// Continues at another address; bit 0 is ignored. An IT block ends.
    pub fn set_pc(&mut self, address: u32) {
        self.state.pc = address & !1;
        self.state.itstate = 0;
    }

    /// Number of the exception whose handler executes, 0 in thread mode.
    pub fn current_exception(&self) -> u16 {
        self.state.exception
    }

    /// Statistics up to now.
    pub fn statistics(&mut self) -> &Statistics {
        let state = &mut self.state;
        state.recorder.attribute(state.exception, state.instructions, state.cycles);
        state.recorder.statistics(state.lowest_sp)
    }

    /// Starts the statistics again.
    pub fn clear_statistics(&mut self) {
        self.statistics();
        self.state.recorder.clear();
        self.state.lowest_sp = u32::MAX;
    }
}
