//! Entry to and return from exceptions, faults, lazy floating-point state (DDI0403E B1.5).
//!
//! Exceptions are taken between instructions; an instruction is never interrupted in the middle. A
//! fault on stacking, on unstacking or on the fetch of a vector is handled as the architecture's derived
//! exceptions are.

use crate::core::arithmetic::NZCV;
use crate::core::bus::Bus;
use crate::core::state::{Fault, LR, SP, Sleep, State, Trap};
use crate::core::system_control::{
    AUTOMATIC_STATE, BUS_FAULT, BUS_FAULT_READY, FloatAccess, HARD_FAULT, HARD_FAULT_READY,
    LAZY_ACTIVE, LAZY_STATE, MEM_MANAGE, MEM_MANAGE_READY, NMI, SystemControl, THREAD_CONTEXT,
    USAGE_FAULT, USER_CONTEXT, fault_status,
};
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
const RETURN_PROCESS_STACK: u32 = 1 << 2;

/// A frame that an exception return has read.
struct Frame {
    sp: u32,
    /// r0 to r3, r12, LR, PC, xPSR.
    words: [u32; 8],
    /// S0 to S15 and FPSCR, where they were stacked.
    float: Option<[u32; FLOAT_WORDS]>,
}

/// Why a frame cannot be returned to.
enum FrameFault {
    Bus,
    NoCoprocessor,
    /// The stacked exception number contradicts the mode that is returned to.
    Mode,
}

impl State {
    /// Current priority: of the active exceptions and the mask registers (`ExecutionPriority`).
    pub(super) fn execution_priority(&self, system: &SystemControl) -> i32 {
        let priority = self.unmasked_priority(system);
        if self.primask { priority.min(0) } else { priority }
    }

    /// Current priority without PRIMASK.
    fn unmasked_priority(&self, system: &SystemControl) -> i32 {
        let mut priority = system.active_priority();
        if self.basepri != 0 {
            priority = priority.min(system.group_priority(self.basepri as i32));
        }
        if self.faultmask { priority.min(-1) } else { priority }
    }

    /// The pending exception that preempts the current execution.
    pub(super) fn preempting(&self, system: &SystemControl) -> Option<u16> {
        let exception = system.highest_pending()?;
        let priority = system.group_priority(system.priority(exception));
        (priority < self.execution_priority(system)).then_some(exception)
    }

    /// Whether an exception is pending that ends a sleep by WFI: one that would preempt without
    /// PRIMASK.
    pub(super) fn wakes(&self, system: &SystemControl) -> bool {
        system.highest_pending().is_some_and(|exception| {
            let priority = system.group_priority(system.priority(exception));
            priority < self.unmasked_priority(system)
        })
    }

    /// Takes a synchronous exception, or HardFault where it is disabled or its priority does not
    /// suffice.
    pub(super) fn take_synchronous<B: Bus>(
        &mut self,
        bus: &mut B,
        exception: u16,
    ) -> Result<(), Stop> {
        let exception = self.escalated(bus.system(), exception)?;
        self.enter_exception(bus, exception)
    }

    /// Records a fault of the instruction at `pc` and takes its exception.
    pub(super) fn take_fault<B: Bus>(&mut self, bus: &mut B, fault: Fault) -> Result<(), Stop> {
        let exception = record(bus.system(), fault, self.fault_address);
        self.take_synchronous(bus, exception)
    }

    /// Priority escalation (B1.5.9).
    fn escalated(&self, system: &mut SystemControl, exception: u16) -> Result<u16, Stop> {
        let current = self.execution_priority(system);
        let priority = system.group_priority(system.priority(exception));
        if system.is_enabled(exception) && priority < current {
            return Ok(exception);
        }
        if current < 0 {
            return Err(self.lock_up());
        }
        system.record_hard_fault(fault_status::FORCED);
        Ok(HARD_FAULT)
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
        let mut value = RETURN;
        if !self.float_active {
            value |= RETURN_BASIC;
        }
        if !self.in_handler() {
            value |= RETURN_THREAD;
            if self.process_stack {
                value |= RETURN_PROCESS_STACK;
            }
        }
        value
    }

    /// `PushStack`. Gives whether all words could be written; the stack pointer moves in any case.
    fn push_frame<B: Bus>(&mut self, bus: &mut B) -> bool {
        let extended = self.float_active;
        let size = if extended { EXTENDED_FRAME } else { BASIC_FRAME };
        let align = extended || bus.system().aligns_stack();
        let moved = align && self.r[SP] & 4 != 0;
        let mut frame = self.r[SP].wrapping_sub(size);
        if align {
            frame &= !7;
        }
        self.r[SP] = frame;
        self.lowest_sp = self.lowest_sp.min(frame);
        let xpsr = self.xpsr() | if moved { ALIGNED } else { 0 };
        let r = &self.r;
        let words = [r[0], r[1], r[2], r[3], r[12], r[LR], self.pc, xpsr];
        let mut written = self.write_words(bus, frame, &words);
        if extended {
            if bus.system().fpccr & LAZY_STATE != 0 {
                self.reserve_float_state(bus.system(), frame);
            } else {
                self.elapse(bus, self.model.float_stacking as u32);
                written &= self.write_float_state(bus, frame.wrapping_add(FLOAT_OFFSET));
            }
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

    fn write_float_state<B: Bus>(&mut self, bus: &mut B, start: u32) -> bool {
        let mut words = [0; FLOAT_WORDS];
        words[..16].copy_from_slice(&self.s[..16]);
        words[16] = self.fpscr;
        self.write_words(bus, start, &words)
    }

    /// `UpdateFPCCR`: the floating-point registers will be written into the frame when the handler uses
    /// them.
    fn reserve_float_state(&self, system: &mut SystemControl, frame: u32) {
        let priority = self.execution_priority(system);
        let ready = |exception: u16| {
            system.is_enabled(exception)
                && system.group_priority(system.priority(exception)) < priority
        };
        let mut control = system.fpccr & (AUTOMATIC_STATE | LAZY_STATE) | LAZY_ACTIVE;
        for (condition, bit) in [
            (!self.privileged(), USER_CONTEXT),
            (!self.in_handler(), THREAD_CONTEXT),
            (priority > -1, HARD_FAULT_READY),
            (ready(BUS_FAULT), BUS_FAULT_READY),
            (ready(MEM_MANAGE), MEM_MANAGE_READY),
        ] {
            if condition {
                control |= bit;
            }
        }
        system.fpccr = control;
        system.fpcar = frame.wrapping_add(FLOAT_OFFSET);
    }

    /// The frame of an exception could not be written: the exception that is entered first. The other
    /// one remains pending.
    fn stacking_fault(&self, system: &mut SystemControl, exception: u16) -> Result<u16, Stop> {
        system.record_bus_fault(fault_status::STACKING, None);
        let derived =
            if exception == HARD_FAULT { HARD_FAULT } else { self.escalated(system, BUS_FAULT)? };
        if derived == exception {
            return Ok(exception);
        }
        let (first, second) = if system.priority(derived) < system.priority(exception) {
            (derived, exception)
        } else {
            (exception, derived)
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
        let mut exception = exception;
        let mut vector = self.read_vector(bus, exception);
        if vector.is_none() && exception != HARD_FAULT && exception != NMI {
            let system = bus.system();
            system.record_hard_fault(fault_status::VECTOR_TABLE);
            if self.execution_priority(system) < 0 {
                return Err(self.lock_up());
            }
            system.pend(exception);
            exception = HARD_FAULT;
            vector = self.read_vector(bus, exception);
        }
        let Some(vector) = vector else {
            bus.system().record_hard_fault(fault_status::VECTOR_TABLE);
            return Err(self.lock_up());
        };
        self.elapse(bus, self.model.fetch_wait(vector));
        let pended = bus.system().pended_at(exception).unwrap_or(started);
        self.recorder.enter(exception, started, pended);
        self.exception = exception;
        self.attribute();
        self.r[LR] = exc_return;
        self.pc = vector & !1;
        self.thumb = vector & 1 != 0;
        self.itstate = 0;
        self.select_process_stack(false);
        self.float_active = false;
        self.synchronise_context();
        let system = bus.system();
        system.activate(exception);
        system.signal_event();
        Ok(())
    }

    fn read_vector<B: Bus>(&mut self, bus: &mut B, exception: u16) -> Option<u32> {
        let address = bus.system().vector_table().wrapping_add(4 * exception as u32);
        bus.read(address, Width::Word).ok()
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
        // FAULTMASK ends with every exception but the NMI.
        if returning != NMI {
            self.faultmask = false;
        }
        let valid = was_active
            && match exc_return | RETURN_BASIC {
                0xFFFF_FFF1 => true,
                0xFFFF_FFF9 | 0xFFFF_FFFD => !nested || system.allows_nested_thread(),
                _ => false,
            };
        if !valid {
            system.record_fault(fault_status::INVALID_RETURN);
            return self.chain_fault(bus, returning, exc_return, USAGE_FAULT);
        }
        // A pending exception is entered on the frame that is in place.
        if let Some(next) = self.preempting(bus.system()) {
            return self.chain(bus, returning, exc_return, next);
        }
        let frame = match self.read_frame(bus, exc_return) {
            Ok(frame) => frame,
            Err(fault) => {
                let exception = match fault {
                    FrameFault::Bus => {
                        bus.system().record_bus_fault(fault_status::UNSTACKING, None);
                        BUS_FAULT
                    }
                    FrameFault::NoCoprocessor => {
                        bus.system().record_fault(fault_status::NO_COPROCESSOR);
                        USAGE_FAULT
                    }
                    FrameFault::Mode => {
                        bus.system().record_fault(fault_status::INVALID_RETURN);
                        USAGE_FAULT
                    }
                };
                return self.chain_fault(bus, returning, exc_return, exception);
            }
        };
        let to_thread = exc_return & RETURN_THREAD != 0;
        self.apply_frame(bus.system(), exc_return, &frame);
        let resumed = std::mem::replace(&mut self.exception, returning);
        self.elapse(bus, self.model.exception_return as u32 + self.model.fetch_wait(self.pc));
        self.attribute();
        self.recorder.leave(returning, self.cycles);
        self.exception = resumed;
        self.synchronise_context();
        let system = bus.system();
        system.set_current(resumed);
        system.signal_event();
        if to_thread && !nested && system.sleeps_on_exit() {
            self.sleep = Sleep::Interrupt;
        }
        Ok(())
    }

    /// Fault of a return: its exception is entered on the frame that is in place.
    fn chain_fault<B: Bus>(
        &mut self,
        bus: &mut B,
        returning: u16,
        exc_return: u32,
        exception: u16,
    ) -> Result<(), Stop> {
        let exception = self.escalated(bus.system(), exception)?;
        self.chain(bus, returning, exc_return, exception)
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

    /// First half of `PopStack`: reads and checks the frame; no register changes.
    fn read_frame<B: Bus>(&mut self, bus: &mut B, exc_return: u32) -> Result<Frame, FrameFault> {
        let sp = match exc_return & RETURN_PROCESS_STACK {
            0 => self.main_sp(),
            _ => self.process_sp(),
        };
        let mut frame = Frame { sp, words: [0; 8], float: None };
        self.read_words(bus, sp, &mut frame.words)?;
        // With lazy state the registers were not used and still have their values.
        if exc_return & RETURN_BASIC == 0 && bus.system().fpccr & LAZY_ACTIVE == 0 {
            if self.require_float_access(bus.system()).is_err() {
                return Err(FrameFault::NoCoprocessor);
            }
            self.elapse(bus, self.model.float_stacking as u32);
            let mut words = [0; FLOAT_WORDS];
            self.read_words(bus, sp.wrapping_add(FLOAT_OFFSET), &mut words)?;
            frame.float = Some(words);
        }
        let resumes_thread = frame.words[7] & EXCEPTION_NUMBER == 0;
        if resumes_thread != (exc_return & RETURN_THREAD != 0) {
            return Err(FrameFault::Mode);
        }
        Ok(frame)
    }

    fn read_words<B: Bus>(
        &mut self,
        bus: &mut B,
        start: u32,
        words: &mut [u32],
    ) -> Result<(), FrameFault> {
        for (word, offset) in words.iter_mut().zip((0..).step_by(4)) {
            let address = start.wrapping_add(offset);
            *word = self.load(bus, address, Width::Word).map_err(|_| FrameFault::Bus)?;
        }
        Ok(())
    }

    /// Second half of `PopStack`.
    fn apply_frame(&mut self, system: &mut SystemControl, exc_return: u32, frame: &Frame) {
        let [r0, r1, r2, r3, r12, lr, pc, xpsr] = frame.words;
        let extended = exc_return & RETURN_BASIC == 0;
        if let Some(float) = frame.float {
            self.s[..16].copy_from_slice(&float[..16]);
            self.fpscr = float[16] & NZCV;
        } else if extended {
            system.fpccr &= !LAZY_ACTIVE;
        }
        self.float_active = extended;
        self.select_process_stack(exc_return & RETURN_PROCESS_STACK != 0);
        self.r[..4].copy_from_slice(&[r0, r1, r2, r3]);
        self.r[12] = r12;
        self.r[LR] = lr;
        self.pc = pc & !1;
        self.set_xpsr(xpsr);
        let size = if extended { EXTENDED_FRAME } else { BASIC_FRAME };
        let align = extended || system.aligns_stack();
        let moved = if align && xpsr & ALIGNED != 0 { 4 } else { 0 };
        self.r[SP] = frame.sp.wrapping_add(size) | moved;
    }

    fn require_float_access(&self, system: &SystemControl) -> Result<(), Trap> {
        match system.float_access() {
            FloatAccess::Full => Ok(()),
            FloatAccess::Privileged if self.privileged() => Ok(()),
            _ => Err(Trap::Fault(Fault::NoCoprocessor)),
        }
    }

    /// `ExecuteFPCheck`: access, preservation of the interrupted context, activation of a new one.
    #[cold]
    pub(super) fn prepare_float<B: Bus>(&mut self, bus: &mut B) -> Result<(), Trap> {
        self.require_float_access(bus.system())?;
        if bus.system().fpccr & LAZY_ACTIVE != 0 {
            self.preserve_float_state(bus)?;
        }
        let system = bus.system();
        if system.fpccr & AUTOMATIC_STATE != 0 && !self.float_active {
            self.float_active = true;
        }
        self.float_ready = true;
        Ok(())
    }

    /// `PreserveFPState`: writes S0 to S15 and FPSCR into the frame that was reserved for them.
    fn preserve_float_state<B: Bus>(&mut self, bus: &mut B) -> Result<(), Trap> {
        self.elapse(bus, self.model.float_stacking as u32);
        let address = bus.system().fpcar;
        if !self.write_float_state(bus, address) {
            let system = bus.system();
            system.record_bus_fault(fault_status::LAZY_STACKING, None);
            // The priorities at the reservation decide which fault it is.
            let ready = system.fpccr & BUS_FAULT_READY != 0;
            if !ready {
                system.record_hard_fault(fault_status::FORCED);
            }
            system.pend(if ready { BUS_FAULT } else { HARD_FAULT });
            // A fault that can be taken precedes the instruction, which is then executed again.
            if self.preempting(system).is_some() {
                return Err(Trap::Retry);
            }
        }
        bus.system().fpccr &= !LAZY_ACTIVE;
        Ok(())
    }
}

/// Records the status of a fault; gives the number of its exception.
fn record(system: &mut SystemControl, fault: Fault, address: u32) -> u16 {
    let usage = match fault {
        Fault::ExecuteNever => {
            system.record_fault(fault_status::INSTRUCTION_ACCESS);
            return MEM_MANAGE;
        }
        Fault::InstructionBus => {
            system.record_bus_fault(fault_status::INSTRUCTION_BUS, None);
            return BUS_FAULT;
        }
        Fault::DataBus => {
            system.record_bus_fault(fault_status::PRECISE, Some(address));
            return BUS_FAULT;
        }
        Fault::Undefined => fault_status::UNDEFINED,
        Fault::InvalidState => fault_status::INVALID_STATE,
        Fault::NoCoprocessor => fault_status::NO_COPROCESSOR,
        Fault::Unaligned => fault_status::UNALIGNED,
        Fault::DivideByZero => fault_status::DIVISION_BY_ZERO,
    };
    system.record_fault(usage);
    USAGE_FAULT
}
