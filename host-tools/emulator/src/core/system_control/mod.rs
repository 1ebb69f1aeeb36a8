//! System control space: interrupt controller, system control block, floating-point context control,
//! cycle counter.
//!
//! - this file: the registers (DDI0403E B3.2, B3.4, C1.8; Cortex-M4 TRM chapter 4).
//! - `interrupts`: exceptions and their priorities.
//! - [`fault_status`]: bits of the fault status registers.
//!
//! Not modelled: SysTick (the exception exists, its timer does not), the memory protection unit, the
//! debug registers apart from the enable bit of the trace, and the comparators and event counters of
//! the DWT. [`SystemControl::read`] and [`SystemControl::write`] report them as absent. VECTRESET and
//! VECTCLRACTIVE of the AIRCR, which only a debugger may use, are ignored.

pub mod fault_status;
mod interrupts;

pub(super) use interrupts::PRIORITY_MASK;
pub use interrupts::{
    BUS_FAULT, EXCEPTIONS, FIRST_INTERRUPT, HARD_FAULT, INTERRUPTS, MEM_MANAGE, NMI, PEND_SV,
    SV_CALL, SYS_TICK, USAGE_FAULT,
};

use crate::core::Width;

// Data watchpoint and trace unit.
const DWT_CTRL: u32 = 0xE000_1000;
const DWT_CYCCNT: u32 = 0xE000_1004;
// Interrupt controller.
const ICTR: u32 = 0xE000_E004;
const ACTLR: u32 = 0xE000_E008;
const ISER: u32 = 0xE000_E100;
const ICER: u32 = 0xE000_E180;
const ISPR: u32 = 0xE000_E200;
const ICPR: u32 = 0xE000_E280;
const IABR: u32 = 0xE000_E300;
const IPR: u32 = 0xE000_E400;
/// End of the priorities of the 496 interrupts that the architecture has room for.
const IPR_END: u32 = 0xE000_E5F0;
const STIR: u32 = 0xE000_EF00;
// System control block.
const CPUID: u32 = 0xE000_ED00;
const ICSR: u32 = 0xE000_ED04;
const VTOR: u32 = 0xE000_ED08;
const AIRCR: u32 = 0xE000_ED0C;
const SCR: u32 = 0xE000_ED10;
const CCR: u32 = 0xE000_ED14;
const SHPR1: u32 = 0xE000_ED18;
const SHPR3: u32 = 0xE000_ED20;
const SHCSR: u32 = 0xE000_ED24;
const CFSR: u32 = 0xE000_ED28;
const HFSR: u32 = 0xE000_ED2C;
const DFSR: u32 = 0xE000_ED30;
const BFAR: u32 = 0xE000_ED38;
const ID_PFR0: u32 = 0xE000_ED40;
const ID_ISAR4: u32 = 0xE000_ED70;
const CPACR: u32 = 0xE000_ED88;
const DHCSR: u32 = 0xE000_EDF0;
const DEMCR: u32 = 0xE000_EDFC;
// Floating-point extension.
const FPCCR: u32 = 0xE000_EF34;
const FPCAR: u32 = 0xE000_EF38;
const MVFR0: u32 = 0xE000_EF40;
const MVFR1: u32 = 0xE000_EF44;

/// Identification registers from ID_PFR0 to ID_ISAR4 (Cortex-M4 TRM table 4-1).
const IDENTIFICATION: [u32; 13] = [
    0x0000_0030,
    0x0000_0200,
    0x0010_0000,
    0x0000_0000,
    0x0010_0030,
    0x0000_0000,
    0x0100_0000,
    0x0000_0000,
    0x0110_1110,
    0x0211_2000,
    0x2023_2231,
    0x0111_1131,
    0x0131_0132,
];

/// Cortex-M4 r0p1.
const CPUID_VALUE: u32 = 0x410F_C241;
const MVFR0_VALUE: u32 = 0x1011_0021;
const MVFR1_VALUE: u32 = 0x1100_0011;
/// Four comparators, as the implementation reports; they are not modelled.
const DWT_COMPARATORS: u32 = 4 << 28;

/// Bits of the CCR that can be written.
const CCR_BITS: u32 = 0x31B;
const CCR_NON_BASE_THREAD: u32 = 1 << 0;
const CCR_USER_TRIGGER: u32 = 1 << 1;
const CCR_UNALIGNED_TRAP: u32 = 1 << 3;
const CCR_DIVISION_TRAP: u32 = 1 << 4;
const CCR_IGNORE_BUS_FAULTS: u32 = 1 << 8;
const CCR_STACK_ALIGNMENT: u32 = 1 << 9;

const SCR_BITS: u32 = 0x16;
const SCR_SLEEP_ON_EXIT: u32 = 1 << 1;
const SCR_EVENT_ON_PENDING: u32 = 1 << 4;

const AIRCR_KEY: u32 = 0x05FA;
const AIRCR_KEY_READ: u32 = 0xFA05;
const AIRCR_SYSTEM_RESET: u32 = 1 << 2;

const ICSR_PEND_NMI: u32 = 1 << 31;
const ICSR_PEND_SV: u32 = 1 << 28;
const ICSR_CLEAR_SV: u32 = 1 << 27;
const ICSR_PEND_TICK: u32 = 1 << 26;
const ICSR_CLEAR_TICK: u32 = 1 << 25;

/// Bits of the ACTLR without an effect on this model: DISMCYCINT, DISDEFWBUF, DISFOLD.
const ACTLR_BITS: u32 = 0x7;

const TRACE_ENABLE: u32 = 1 << 24;
const COUNTER_ENABLE: u32 = 1;

/// FPCCR bits.
pub(super) const AUTOMATIC_STATE: u32 = 1 << 31;
pub(super) const LAZY_STATE: u32 = 1 << 30;
const MONITOR_READY: u32 = 1 << 8;
pub(super) const BUS_FAULT_READY: u32 = 1 << 6;
pub(super) const MEM_MANAGE_READY: u32 = 1 << 5;
pub(super) const HARD_FAULT_READY: u32 = 1 << 4;
pub(super) const THREAD_CONTEXT: u32 = 1 << 3;
pub(super) const USER_CONTEXT: u32 = 1 << 1;
pub(super) const LAZY_ACTIVE: u32 = 1 << 0;
const FPCCR_BITS: u32 = AUTOMATIC_STATE
    | LAZY_STATE
    | MONITOR_READY
    | BUS_FAULT_READY
    | MEM_MANAGE_READY
    | HARD_FAULT_READY
    | THREAD_CONTEXT
    | USER_CONTEXT
    | LAZY_ACTIVE;

/// Access of the coprocessors 10 and 11.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FloatAccess {
    Denied,
    Privileged,
    Full,
}

/// Interrupt controller, system control block and the other registers of the system control space.
///
/// The emulated chip owns it, forwards the program's accesses to [`read`](Self::read) and
/// [`write`](Self::write), and drives the interrupt lines with [`set_line`](Self::set_line).
#[derive(Debug, Clone)]
pub struct SystemControl {
    /// Something changed that the core must consider before the next instruction.
    recheck: bool,
    /// Event register of WFE.
    event: bool,
    reset_requested: bool,

    enabled: [u32; 4],
    pending: [u32; 4],
    active: [u32; 4],
    lines: [u32; 4],
    interrupt_priority: [u8; INTERRUPTS],
    /// Indexed by exception number; 4 to 15 are used.
    system_priority: [u8; 16],
    /// Bits by exception number, 2 to 15.
    system_pending: u16,
    system_active: u16,
    current: u16,

    vector_table: u32,
    priority_group: u32,
    scr: u32,
    ccr: u32,
    /// Bits 0 to 2: MemManage, BusFault, UsageFault.
    fault_enable: u32,
    cfsr: u32,
    hfsr: u32,
    bfar: u32,
    cpacr: u32,
    actlr: u32,
    pub(super) fpccr: u32,
    pub(super) fpcar: u32,

    demcr: u32,
    dwt_ctrl: u32,
    /// Cycles of the core when each exception became pending.
    pended: [u64; EXCEPTIONS],
    /// Cycles of the core when it last synchronised.
    cycles: u64,
    /// Counter value at `counter_base`.
    counter: u32,
    counter_base: u64,
}

impl Default for SystemControl {
    fn default() -> Self {
        Self::new()
    }
}

impl SystemControl {
    /// Registers after a reset, all interrupt lines low.
    pub fn new() -> Self {
        Self {
            recheck: true,
            event: false,
            reset_requested: false,
            enabled: [0; 4],
            pending: [0; 4],
            active: [0; 4],
            lines: [0; 4],
            interrupt_priority: [0; INTERRUPTS],
            system_priority: [0; 16],
            system_pending: 0,
            system_active: 0,
            current: 0,
            vector_table: 0,
            priority_group: 0,
            scr: 0,
            ccr: CCR_STACK_ALIGNMENT,
            fault_enable: 0,
            cfsr: 0,
            hfsr: 0,
            bfar: 0,
            cpacr: 0,
            actlr: 0,
            fpccr: AUTOMATIC_STATE | LAZY_STATE,
            fpcar: 0,
            demcr: 0,
            dwt_ctrl: 0,
            pended: [0; EXCEPTIONS],
            cycles: 0,
            counter: 0,
            counter_base: 0,
        }
    }

    /// Resets every register; [`Core::reset`](super::Core::reset) calls it. The peripherals drive the
    /// interrupt lines, which keep their levels; those that are high become pending.
    pub fn reset(&mut self) {
        let (lines, cycles) = (self.lines, self.cycles);
        *self = Self { lines, pending: lines, cycles, counter_base: cycles, ..Self::new() };
    }

    /// Value of the register word that contains the address, or `None` where no such register is
    /// modelled. The caller selects the bytes of a narrower access.
    pub fn read(&self, address: u32) -> Option<u32> {
        let address = address & !3;
        let word = (address >> 2 & 3) as usize;
        Some(match address {
            DWT_CTRL => self.dwt_ctrl | DWT_COMPARATORS,
            DWT_CYCCNT => self.cycle_count(),
            ICTR => (INTERRUPTS as u32).div_ceil(32) - 1,
            ACTLR => self.actlr,
            _ if is_bank(address, ISER) || is_bank(address, ICER) => self.enabled[word],
            _ if is_bank(address, ISPR) || is_bank(address, ICPR) => self.pending[word],
            _ if is_bank(address, IABR) => self.active[word],
            _ if (IPR..IPR + INTERRUPTS as u32).contains(&address) => {
                priorities(&self.interrupt_priority, (address - IPR) as usize)
            }
            // Priorities of interrupts that the chip does not have: read as zero.
            _ if (IPR..IPR_END).contains(&address) => 0,
            CPUID => CPUID_VALUE,
            ICSR => self.interrupt_status(),
            VTOR => self.vector_table,
            AIRCR => AIRCR_KEY_READ << 16 | self.priority_group << 8,
            SCR => self.scr,
            CCR => self.ccr,
            SHPR1..=SHPR3 => priorities(&self.system_priority, (address - SHPR1) as usize + 4),
            SHCSR => self.handler_status(),
            CFSR => self.cfsr,
            HFSR => self.hfsr,
            // No debugger is attached and no debug event occurs.
            DFSR | DHCSR => 0,
            BFAR => self.bfar,
            ID_PFR0..=ID_ISAR4 => IDENTIFICATION[((address - ID_PFR0) / 4) as usize],
            CPACR => self.cpacr,
            DEMCR => self.demcr,
            FPCCR => self.fpccr,
            FPCAR => self.fpcar,
            MVFR0 => MVFR0_VALUE,
            MVFR1 => MVFR1_VALUE,
            _ => return None,
        })
    }

    /// Writes a register, or gives `false` where no such register is modelled, it does not accept the
    /// width, or the value selects a function that is not modelled. A refused write has no effect.
    ///
    /// Priorities and fault status registers accept any width, all others words.
    pub fn write(&mut self, address: u32, width: Width, value: u32) -> bool {
        let accepted = match address {
            _ if (IPR..IPR + INTERRUPTS as u32).contains(&address) => {
                let first = (address - IPR) as usize;
                set_priorities(&mut self.interrupt_priority, first, width, value);
                true
            }
            // Ignored where there is no such interrupt.
            _ if (IPR..IPR_END).contains(&address) => true,
            SHPR1..0xE000_ED24 => {
                let first = (address - SHPR1) as usize + 4;
                set_priorities(&mut self.system_priority, first, width, value);
                true
            }
            CFSR..HFSR => {
                self.cfsr &= !(value << (8 * (address & 3)));
                true
            }
            _ => width == Width::Word && self.write_word(address, value),
        };
        self.request_recheck();
        accepted
    }

    fn write_word(&mut self, address: u32, value: u32) -> bool {
        let word = (address >> 2 & 3) as usize;
        let first = FIRST_INTERRUPT + 32 * word as u16;
        let selected = (0..32).filter(|bit| value >> bit & 1 != 0).map(|bit| first + bit);
        match address {
            DWT_CTRL if value & !DWT_COMPARATORS & !COUNTER_ENABLE == 0 => {
                self.set_trace(self.demcr, value & COUNTER_ENABLE);
            }
            DWT_CYCCNT => {
                self.counter = value;
                self.counter_base = self.cycles;
            }
            DEMCR if value & !TRACE_ENABLE == 0 => self.set_trace(value, self.dwt_ctrl),
            ACTLR if value & !ACTLR_BITS == 0 => self.actlr = value,
            _ if is_bank(address, ISER) => self.enabled[word] |= value & implemented(word),
            _ if is_bank(address, ICER) => self.enabled[word] &= !value,
            _ if is_bank(address, ISPR) => selected
                .filter(|&exception| (exception as usize) < EXCEPTIONS)
                .for_each(|exception| self.pend(exception)),
            _ if is_bank(address, ICPR) => selected
                .filter(|&exception| (exception as usize) < EXCEPTIONS)
                .for_each(|exception| self.clear_pending(exception)),
            STIR => {
                let irq = value & 0x1FF;
                if (irq as usize) < INTERRUPTS {
                    self.pend(FIRST_INTERRUPT + irq as u16);
                }
            }
            ICSR => self.write_interrupt_control(value),
            VTOR => self.vector_table = value & !0x7F,
            // Without the key the register is not written.
            AIRCR if value >> 16 == AIRCR_KEY => {
                self.priority_group = value >> 8 & 7;
                self.reset_requested |= value & AIRCR_SYSTEM_RESET != 0;
            }
            AIRCR => {}
            SCR => self.scr = value & SCR_BITS,
            CCR => self.ccr = value & CCR_BITS,
            SHCSR => self.write_handler_status(value),
            HFSR => self.hfsr &= !value,
            DFSR => {}
            BFAR => self.bfar = value,
            CPACR => self.cpacr = value & 0x00F0_0000,
            FPCCR => self.fpccr = value & FPCCR_BITS,
            FPCAR => self.fpcar = value & !7,
            _ => return false,
        }
        true
    }

    fn interrupt_status(&self) -> u32 {
        let bit = |condition: bool, position: u32| (condition as u32) << position;
        let interrupt_pending =
            self.pending.iter().zip(self.enabled).any(|(pending, enabled)| pending & enabled != 0);
        let only_active = self.active_count() <= self.is_active(self.current) as u32;
        self.current as u32
            | bit(only_active, 11)
            | (self.highest_pending().unwrap_or(0) as u32) << 12
            | bit(interrupt_pending, 22)
            | bit(self.is_pending(SYS_TICK), 26)
            | bit(self.is_pending(PEND_SV), 28)
            | bit(self.is_pending(NMI), 31)
    }

    fn write_interrupt_control(&mut self, value: u32) {
        for (bit, exception) in
            [(ICSR_PEND_NMI, NMI), (ICSR_PEND_SV, PEND_SV), (ICSR_PEND_TICK, SYS_TICK)]
        {
            if value & bit != 0 {
                self.pend(exception);
            }
        }
        for (bit, exception) in [(ICSR_CLEAR_SV, PEND_SV), (ICSR_CLEAR_TICK, SYS_TICK)] {
            if value & bit != 0 {
                self.clear_pending(exception);
            }
        }
    }

    /// Bits of the SHCSR with the exceptions whose active state they show.
    const ACTIVE_BITS: [(u32, u16); 7] = [
        (0, MEM_MANAGE),
        (1, BUS_FAULT),
        (3, USAGE_FAULT),
        (7, SV_CALL),
        (8, 12),
        (10, PEND_SV),
        (11, SYS_TICK),
    ];
    /// Bits of the SHCSR with the exceptions whose pending state they show.
    const PENDING_BITS: [(u32, u16); 4] =
        [(12, USAGE_FAULT), (13, MEM_MANAGE), (14, BUS_FAULT), (15, SV_CALL)];

    fn handler_status(&self) -> u32 {
        let active = Self::ACTIVE_BITS
            .iter()
            .map(|&(position, exception)| (self.is_active(exception) as u32) << position);
        let pending = Self::PENDING_BITS
            .iter()
            .map(|&(position, exception)| (self.is_pending(exception) as u32) << position);
        active.chain(pending).sum::<u32>() | self.fault_enable << 16
    }

    fn write_handler_status(&mut self, value: u32) {
        let set = |word: &mut u16, position: u32, exception: u16| {
            let bit = 1 << exception;
            *word = if value >> position & 1 != 0 { *word | bit } else { *word & !bit };
        };
        for (position, exception) in Self::ACTIVE_BITS {
            set(&mut self.system_active, position, exception);
        }
        for (position, exception) in Self::PENDING_BITS {
            set(&mut self.system_pending, position, exception);
        }
        self.fault_enable = value >> 16 & 7;
    }

    /// Whether the core must consider this state before the next instruction.
    #[inline(always)]
    pub(super) fn recheck_requested(&self) -> bool {
        self.recheck
    }

    #[inline]
    pub(super) fn request_recheck(&mut self) {
        self.recheck = true;
    }

    pub(super) fn clear_recheck(&mut self) {
        self.recheck = false;
    }

    /// Sets the event register, which ends or prevents a sleep by WFE: an external event (EXTI line in
    /// event mode).
    pub fn signal_event(&mut self) {
        self.event = true;
        self.request_recheck();
    }

    /// Clears the event register and gives what it was.
    pub(super) fn take_event(&mut self) -> bool {
        std::mem::take(&mut self.event)
    }

    /// Whether the program requested a reset of the system (AIRCR.SYSRESETREQ).
    pub fn reset_requested(&self) -> bool {
        self.reset_requested
    }

    /// Address of the vector table. After a reset it is 0, where the chip maps its boot memory.
    pub fn vector_table(&self) -> u32 {
        self.vector_table
    }

    /// Configurable fault status register; its bits are in [`fault_status`].
    pub fn cfsr(&self) -> u32 {
        self.cfsr
    }

    /// HardFault status register; its bits are in [`fault_status`].
    pub fn hfsr(&self) -> u32 {
        self.hfsr
    }

    /// Address of the last precise bus fault.
    pub fn bfar(&self) -> u32 {
        self.bfar
    }

    /// Cycle counter of the DWT, which pauses while the core sleeps, at the last access of the core to the system control space, or at the
    /// end of [`Core::run`](super::Core::run).
    pub fn cycle_count(&self) -> u32 {
        let counted = if self.counts() { self.cycles - self.counter_base } else { 0 };
        self.counter.wrapping_add(counted as u32)
    }

    /// Takes over the core's count of cycles awake.
    pub(super) fn synchronise(&mut self, cycles: u64) {
        self.cycles = cycles;
    }

    fn counts(&self) -> bool {
        self.demcr & TRACE_ENABLE != 0 && self.dwt_ctrl & COUNTER_ENABLE != 0
    }

    fn set_trace(&mut self, demcr: u32, dwt_ctrl: u32) {
        self.counter = self.cycle_count();
        self.counter_base = self.cycles;
        self.demcr = demcr;
        self.dwt_ctrl = dwt_ctrl;
    }

    pub(super) fn record_fault(&mut self, status: u32) {
        self.cfsr |= status;
    }

    /// Records a bus fault and, where the chip reports it, its address.
    pub(super) fn record_bus_fault(&mut self, status: u32, address: Option<u32>) {
        self.cfsr |= status;
        if let Some(address) = address {
            self.cfsr |= fault_status::BFAR_VALID;
            self.bfar = address;
        }
    }

    pub(super) fn record_hard_fault(&mut self, status: u32) {
        self.hfsr |= status;
    }

    pub(super) fn traps_unaligned(&self) -> bool {
        self.ccr & CCR_UNALIGNED_TRAP != 0
    }

    pub(super) fn traps_division_by_zero(&self) -> bool {
        self.ccr & CCR_DIVISION_TRAP != 0
    }

    pub(super) fn ignores_bus_faults(&self) -> bool {
        self.ccr & CCR_IGNORE_BUS_FAULTS != 0
    }

    pub(super) fn aligns_stack(&self) -> bool {
        self.ccr & CCR_STACK_ALIGNMENT != 0
    }

    pub(super) fn allows_unprivileged_trigger(&self) -> bool {
        self.ccr & CCR_USER_TRIGGER != 0
    }

    pub(super) fn allows_nested_thread(&self) -> bool {
        self.ccr & CCR_NON_BASE_THREAD != 0
    }

    pub(super) fn sleeps_on_exit(&self) -> bool {
        self.scr & SCR_SLEEP_ON_EXIT != 0
    }

    fn events_on_pending(&self) -> bool {
        self.scr & SCR_EVENT_ON_PENDING != 0
    }

    pub(super) fn float_access(&self) -> FloatAccess {
        match self.cpacr >> 20 & 0xF {
            0b1111 => FloatAccess::Full,
            0b0101 => FloatAccess::Privileged,
            _ => FloatAccess::Denied,
        }
    }
}

/// Whether the address is one of the four words of a register bank.
const fn is_bank(address: u32, base: u32) -> bool {
    address & !0xF == base
}

/// Interrupts that exist in a word of the controller's registers.
const fn implemented(word: usize) -> u32 {
    if word < INTERRUPTS / 32 { u32::MAX } else { (1 << (INTERRUPTS % 32)) - 1 }
}

/// Four priorities from index `first`.
fn priorities(table: &[u8], first: usize) -> u32 {
    let bytes = (0..4).map(|k| (table[first + k] as u32) << (8 * k));
    bytes.sum()
}

fn set_priorities(table: &mut [u8], first: usize, width: Width, value: u32) {
    for byte in 0..width.bytes() as usize {
        if let Some(priority) = table.get_mut(first + byte) {
            *priority = (value >> (8 * byte)) as u8 & PRIORITY_MASK;
        }
    }
}
