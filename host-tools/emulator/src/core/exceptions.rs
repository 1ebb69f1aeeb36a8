//! Entry to and return from exceptions, faults, lazy floating-point state (DDI0403E B1.5).
//!
//! Exceptions are taken between instructions; an instruction is never interrupted in the middle. A
//! fault on stacking or unstacking is handled as the architecture's derived exceptions are; a vector that
//! cannot be read locks the core up, where the architecture takes HardFault first.

use crate::core::arithmetic::NZCV;
use crate::core::bus::Bus;
use crate::core::state::{Fault, LR, SP, Sleep, State, Trap};
use crate::core::system_control::{HARD_FAULT, NMI, SystemControl, fault_status};
use crate::core::{Stop, Width};

/// Bytes of a frame without and with floating-point registers.
const BASIC_FRAME: u32 = 0x20;
const EXTENDED_FRAME: u32 = 0x68;
/// Offset of S0 in an extended frame.
const FLOAT_OFFSET: u32 = 0x20;
/// Words of the floating-point part: S0 to S15 and FPSCR.
const FLOAT_WORDS: usize = 17;

/// Stacked xPSR bit 9: the stack pointer was moved by 4 to align the frame.
const ALIGNED: u32 = 1 << 9;
/// Stacked xPSR: number of the interrupted exception.
const EXCEPTION_NUMBER: u32 = 0x1FF;

/// EXC_RETURN bits (B1.5.8).
const RETURN: u32 = 0xFFFF_FFE1;
/// The frame is a basic one.
const RETURN_BASIC: u32 = 1 << 4;
const RETURN_THREAD: u32 = 1 << 3;

/// A frame that an exception return has read.
struct Frame {
    /// r0 to r3, r12, LR, PC, xPSR.
    words: [u32; 8],
    /// S0 to S15 and FPSCR, where they were stacked.
    float: Option<[u32; FLOAT_WORDS]>,
}

impl State {
    /// Current priority: of the active exceptions and the mask registers (`ExecutionPriority`).
    pub(super) fn execution_priority(&self, system: &SystemControl) -> i32 {
        let priority = self.unmasked_priority(system);
        if self.primask { priority.min(0) } else { priority }
    }

    /// Current priority without PRIMASK.
    fn unmasked_priority(&self, system: &SystemControl) -> i32 {
        let priority = system.active_priority();
        if self.basepri == 0 { priority } else { priority.min(self.basepri.into()) }
    }

    /// The pending exception that preempts the current execution.
    pub(super) fn preempting(&self, system: &SystemControl) -> Option<u16> {
        let exception = system.highest_pending()?;
        (system.priority(exception) < self.execution_priority(system)).then_some(exception)
    }

    /// Whether an exception is pending that ends a sleep by WFI: one that would preempt without
    /// PRIMASK.
    pub(super) fn wakes(&self, system: &SystemControl) -> bool {
        system
            .highest_pending()
            .is_some_and(|exception| system.priority(exception) < self.unmasked_priority(system))
    }

    /// Records a fault of the instruction at `pc` and takes HardFault.
    pub(super) fn take_fault<B: Bus>(&mut self, bus: &mut B, fault: Fault) -> Result<(), Stop> {
        bus.system().record_fault(status(fault));
        self.require_hard_fault(bus.system())?;
        self.enter_exception(bus, HARD_FAULT)
    }

    /// A fault at the priority of HardFault or above locks up (B1.5.15).
    fn require_hard_fault(&self, system: &SystemControl) -> Result<(), Stop> {
        if self.execution_priority(system) < 0 { Err(self.lock_up()) } else { Ok(()) }
    }

    fn lock_up(&self) -> Stop {
        Stop::LockUp { address: self.pc }
    }

    /// Entry to an exception from the current execution, which continues at `pc`.
    pub(super) fn enter_exception<B: Bus>(
        &mut self,
        bus: &mut B,
        exception: u16,
    ) -> Result<(), Stop> {
        let started = self.cycles;
        self.attribute();
        self.elapse(bus, self.model.exception_entry as u32);
        let exc_return = self.exc_return();
        let stacked = self.push_frame(bus);
        let exception =
            if stacked { exception } else { self.stacking_fault(bus.system(), exception)? };
        self.start_handler(bus, exception, exc_return, started)
    }

    fn attribute(&mut self) {
        self.recorder.attribute(self.exception, self.instructions, self.cycles);
    }

    /// EXC_RETURN value that leads back to the current execution.
    fn exc_return(&self) -> u32 {
        let basic = if self.float_active { 0 } else { RETURN_BASIC };
        let thread = if self.in_handler() { 0 } else { RETURN_THREAD };
        RETURN | basic | thread
    }

    /// `PushStack`. Gives whether all words could be written; the stack pointer moves in any case.
    fn push_frame<B: Bus>(&mut self, bus: &mut B) -> bool {
        let size = if self.float_active { EXTENDED_FRAME } else { BASIC_FRAME };
        let moved = self.r[SP] & 4 != 0;
        let frame = self.r[SP].wrapping_sub(size) & !7;
        self.r[SP] = frame;
        self.lowest_sp = self.lowest_sp.min(frame);
        let xpsr = self.xpsr() | if moved { ALIGNED } else { 0 };
        let r = &self.r;
        let words = [r[0], r[1], r[2], r[3], r[12], r[LR], self.pc, xpsr];
        let written = self.write_words(bus, frame, &words);
        if self.float_active {
            // `UpdateFPCCR`: the registers are written into the frame when the handler uses them.
            self.lazy_frame = Some(frame.wrapping_add(FLOAT_OFFSET));
        }
        written
    }

    /// Writes consecutive words through the core's own store path; gives whether all succeeded.
    fn write_words<B: Bus>(&mut self, bus: &mut B, start: u32, words: &[u32]) -> bool {
        words.iter().zip((0..).step_by(4)).fold(true, |written, (&word, offset)| {
            let address = start.wrapping_add(offset);
            written & self.store(bus, address, Width::Word, word).is_ok()
        })
    }

    /// The frame of an exception could not be written: the exception that is entered first. The other
    /// one remains pending.
    fn stacking_fault(&self, system: &mut SystemControl, exception: u16) -> Result<u16, Stop> {
        system.record_fault(fault_status::STACKING);
        if exception == HARD_FAULT {
            return Ok(exception);
        }
        self.require_hard_fault(system)?;
        let (first, second) = match exception {
            NMI => (NMI, HARD_FAULT),
            _ => (HARD_FAULT, exception),
        };
        system.pend(second);
        Ok(first)
    }

    /// `ExceptionTaken`: fetch of the vector and start of the handler, with the frame in place.
    fn start_handler<B: Bus>(
        &mut self,
        bus: &mut B,
        exception: u16,
        exc_return: u32,
        started: u64,
    ) -> Result<(), Stop> {
        let vector = bus.read(4 * exception as u32, Width::Word).map_err(|_| self.lock_up())?;
        self.elapse(bus, self.model.fetch_wait(vector));
        let pended = bus.system().pended_at(exception).unwrap_or(started);
        self.recorder.enter(exception, started, pended);
        self.exception = exception;
        self.attribute();
        self.r[LR] = exc_return;
        self.pc = vector & !1;
        self.thumb = vector & 1 != 0;
        self.itstate = 0;
        self.float_active = false;
        self.synchronise_context();
        let system = bus.system();
        system.activate(exception);
        system.signal_event();
        Ok(())
    }

    /// Effects of every entry and return apart from the registers.
    fn synchronise_context(&mut self) {
        self.exclusive = false;
        self.float_ready = false;
        self.sleep = Sleep::Awake;
    }

    /// `ExceptionReturn` with the value of [`State::exception_return`].
    pub(super) fn return_from_exception<B: Bus>(&mut self, bus: &mut B) -> Result<(), Stop> {
        let exc_return = self.exception_return | 0xF000_0000;
        let returning = self.exception;
        let system = bus.system();
        let nested = system.active_count() > 1;
        let was_active = system.is_active(returning);
        system.deactivate(returning);
        let valid = was_active
            && match exc_return | RETURN_BASIC {
                0xFFFF_FFF1 => true,
                0xFFFF_FFF9 => !nested,
                _ => false,
            };
        if !valid {
            return self.return_fault(bus, returning, exc_return, fault_status::INVALID_RETURN);
        }
        // A pending exception is entered on the frame that is in place.
        if let Some(next) = self.preempting(bus.system()) {
            return self.chain(bus, returning, exc_return, next);
        }
        let frame = match self.read_frame(bus, exc_return) {
            Ok(frame) => frame,
            Err(status) => return self.return_fault(bus, returning, exc_return, status),
        };
        self.apply_frame(exc_return, &frame);
        let resumed = std::mem::replace(&mut self.exception, returning);
        self.elapse(bus, self.model.exception_return as u32 + self.model.fetch_wait(self.pc));
        self.attribute();
        self.recorder.leave(returning, self.cycles);
        self.exception = resumed;
        self.synchronise_context();
        bus.system().signal_event();
        Ok(())
    }

    /// Fault of a return: HardFault is entered on the frame that is in place.
    fn return_fault<B: Bus>(
        &mut self,
        bus: &mut B,
        returning: u16,
        exc_return: u32,
        status: u32,
    ) -> Result<(), Stop> {
        bus.system().record_fault(status);
        self.require_hard_fault(bus.system())?;
        self.chain(bus, returning, exc_return, HARD_FAULT)
    }

    /// Tail-chaining: from the end of a handler to the start of another.
    fn chain<B: Bus>(
        &mut self,
        bus: &mut B,
        returning: u16,
        exc_return: u32,
        next: u16,
    ) -> Result<(), Stop> {
        self.attribute();
        self.recorder.leave(returning, self.cycles);
        let started = self.cycles;
        self.elapse(bus, self.model.tail_chain as u32);
        self.start_handler(bus, next, exc_return, started)
    }

    /// First half of `PopStack`: reads and checks the frame; no register changes. The error is its fault status.
    fn read_frame<B: Bus>(&mut self, bus: &mut B, exc_return: u32) -> Result<Frame, u32> {
        let sp = self.r[SP];
        let mut frame = Frame { words: [0; 8], float: None };
        self.read_words(bus, sp, &mut frame.words)?;
        // With lazy state the registers were not used and still have their values.
        if exc_return & RETURN_BASIC == 0 && self.lazy_frame.is_none() {
            if !bus.system().allows_float() {
                return Err(fault_status::NO_COPROCESSOR);
            }
            self.elapse(bus, self.model.float_stacking as u32);
            let mut words = [0; FLOAT_WORDS];
            self.read_words(bus, sp.wrapping_add(FLOAT_OFFSET), &mut words)?;
            frame.float = Some(words);
        }
        let resumes_thread = frame.words[7] & EXCEPTION_NUMBER == 0;
        if resumes_thread != (exc_return & RETURN_THREAD != 0) {
            return Err(fault_status::INVALID_RETURN);
        }
        Ok(frame)
    }

    fn read_words<B: Bus>(
        &mut self,
        bus: &mut B,
        start: u32,
        words: &mut [u32],
    ) -> Result<(), u32> {
        for (word, offset) in words.iter_mut().zip((0..).step_by(4)) {
            let loaded = self.load(bus, start.wrapping_add(offset), Width::Word);
            *word = loaded.map_err(|_| fault_status::UNSTACKING)?;
        }
        Ok(())
    }

    /// Second half of `PopStack`.
    fn apply_frame(&mut self, exc_return: u32, frame: &Frame) {
        let [r0, r1, r2, r3, r12, lr, pc, xpsr] = frame.words;
        let extended = exc_return & RETURN_BASIC == 0;
        if let Some(float) = frame.float {
            self.s[..16].copy_from_slice(&float[..16]);
            self.fpscr = float[16] & NZCV;
        } else if extended {
            self.lazy_frame = None;
        }
        self.float_active = extended;
        self.r[..4].copy_from_slice(&[r0, r1, r2, r3]);
        self.r[12] = r12;
        self.r[LR] = lr;
        self.pc = pc & !1;
        self.set_xpsr(xpsr);
        let size = if extended { EXTENDED_FRAME } else { BASIC_FRAME };
        let moved = if xpsr & ALIGNED != 0 { 4 } else { 0 };
        self.r[SP] = self.r[SP].wrapping_add(size) | moved;
    }

    /// `ExecuteFPCheck`: access, preservation of the interrupted context, activation of a new one.
    #[cold]
    pub(super) fn prepare_float<B: Bus>(&mut self, bus: &mut B) -> Result<(), Trap> {
        if !bus.system().allows_float() {
            return Err(Trap::Fault(Fault::NoCoprocessor));
        }
        if let Some(frame) = self.lazy_frame {
            self.preserve_float_state(bus, frame)?;
        }
        self.float_active = true;
        self.float_ready = true;
        Ok(())
    }

    /// `PreserveFPState`: writes S0 to S15 and FPSCR into the frame that was reserved for them.
    fn preserve_float_state<B: Bus>(&mut self, bus: &mut B, frame: u32) -> Result<(), Trap> {
        self.elapse(bus, self.model.float_stacking as u32);
        let mut words = [0; FLOAT_WORDS];
        words[..16].copy_from_slice(&self.s[..16]);
        words[16] = self.fpscr;
        if !self.write_words(bus, frame, &words) {
            let system = bus.system();
            system.record_fault(fault_status::LAZY_STACKING);
            system.pend(HARD_FAULT);
            // A fault that can be taken precedes the instruction, which is then executed again.
            if self.preempting(system).is_some() {
                return Err(Trap::Retry);
            }
        }
        self.lazy_frame = None;
        Ok(())
    }
}

/// Bits of CFSR.
const fn status(fault: Fault) -> u32 {
    match fault {
        Fault::ExecuteNever => fault_status::INSTRUCTION_ACCESS,
        Fault::InstructionBus => fault_status::INSTRUCTION_BUS,
        Fault::DataBus => fault_status::PRECISE | fault_status::BFAR_VALID,
        Fault::Undefined => fault_status::UNDEFINED,
        Fault::InvalidState => fault_status::INVALID_STATE,
        Fault::NoCoprocessor => fault_status::NO_COPROCESSOR,
        Fault::Unaligned => fault_status::UNALIGNED,
    }
}
