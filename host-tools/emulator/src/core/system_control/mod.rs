//! System control space: interrupt controller and system control block.
//!
//! - this file: the registers (DDI0403E B3.2, B3.4; Cortex-M4 TRM chapter 4).
//! - `interrupts`: exceptions and their priorities.
//! - [`fault_status`]: bits of the fault status register.
//!
//! Modelled is what the firmware uses: enables, pending bits and priorities of the interrupts, CPACR, AIRCR with
//! SYSRESETREQ, CFSR. [`SystemControl::read`] and [`SystemControl::write`] report every other register as absent. Without
//! them the vector table is at address 0, priorities have no subpriority, and only the non-maskable interrupt, HardFault
//! and the interrupts occur.

pub mod fault_status;
mod interrupts;

pub(super) use interrupts::PRIORITY_MASK;
pub use interrupts::{EXCEPTIONS, FIRST_INTERRUPT, HARD_FAULT, INTERRUPTS, NMI};

use crate::core::Width;

// Interrupt controller.
const ISER: u32 = 0xE000_E100;
const ICER: u32 = 0xE000_E180;
const ISPR: u32 = 0xE000_E200;
const ICPR: u32 = 0xE000_E280;
const IPR: u32 = 0xE000_E400;
/// End of the priorities of the 496 interrupts that the architecture has room for.
const IPR_END: u32 = 0xE000_E5F0;
/// Software trigger, by which the executor makes its interrupts pending.
const STIR: u32 = 0xE000_EF00;
// System control block.
const AIRCR: u32 = 0xE000_ED0C;
const CFSR: u32 = 0xE000_ED28;
const CPACR: u32 = 0xE000_ED88;

const AIRCR_KEY: u32 = 0x05FA;
const AIRCR_KEY_READ: u32 = 0xFA05;
const AIRCR_SYSTEM_RESET: u32 = 1 << 2;
const AIRCR_PRIORITY_GROUP: u32 = 0x700;

/// CPACR: full access to the coprocessors 10 and 11, the floating-point unit.
const FLOAT_ACCESS: u32 = 0xF << 20;

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
    /// Bits by exception number: the non-maskable interrupt and HardFault.
    system_pending: u16,
    system_active: u16,

    cfsr: u32,
    cpacr: u32,

    /// Cycles of the core when each exception became pending.
    pended: [u64; EXCEPTIONS],
    /// Cycles of the core when it last synchronised.
    cycles: u64,
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
            system_pending: 0,
            system_active: 0,
            cfsr: 0,
            cpacr: 0,
            pended: [0; EXCEPTIONS],
            cycles: 0,
        }
    }

    /// Resets every register; [`Core::reset`](super::Core::reset) calls it. The peripherals drive the
    /// interrupt lines, which keep their levels; those that are high become pending.
    pub fn reset(&mut self) {
        let (lines, cycles) = (self.lines, self.cycles);
        *self = Self { lines, pending: lines, cycles, ..Self::new() };
    }

    /// Value of the register word that contains the address, or `None` where no such register is
    /// modelled. The caller selects the bytes of a narrower access.
    pub fn read(&self, address: u32) -> Option<u32> {
        let address = address & !3;
        let word = (address >> 2 & 3) as usize;
        Some(match address {
            _ if is_bank(address, ISER) || is_bank(address, ICER) => self.enabled[word],
            _ if is_bank(address, ISPR) || is_bank(address, ICPR) => self.pending[word],
            _ if (IPR..IPR + INTERRUPTS as u32).contains(&address) => {
                let first = (address - IPR) as usize;
                (0..4).map(|k| u32::from(self.interrupt_priority[first + k]) << (8 * k)).sum()
            }
            // Priorities of interrupts that the chip does not have: read as zero.
            _ if (IPR..IPR_END).contains(&address) => 0,
            AIRCR => AIRCR_KEY_READ << 16,
            CFSR => self.cfsr,
            CPACR => self.cpacr,
            _ => return None,
        })
    }

    /// Writes a register, or gives `false` where no such register is modelled, it does not accept the
    /// width, or the value selects a function that is not modelled. A refused write has no effect.
    ///
    /// Priorities accept any width, all others words.
    pub fn write(&mut self, address: u32, width: Width, value: u32) -> bool {
        let accepted = match address {
            _ if (IPR..IPR + INTERRUPTS as u32).contains(&address) => {
                let bytes = value.to_le_bytes().into_iter().take(width.bytes() as usize);
                let places = self.interrupt_priority.iter_mut().skip((address - IPR) as usize);
                places.zip(bytes).for_each(|(place, byte)| *place = byte & PRIORITY_MASK);
                true
            }
            // Ignored where there is no such interrupt.
            _ if (IPR..IPR_END).contains(&address) => true,
            _ => width == Width::Word && self.write_word(address, value),
        };
        self.request_recheck();
        accepted
    }

    fn write_word(&mut self, address: u32, value: u32) -> bool {
        let word = (address >> 2 & 3) as usize;
        let first = FIRST_INTERRUPT + 32 * word as u16;
        let selected = (0..32)
            .filter(|bit| value >> bit & 1 != 0)
            .map(|bit| first + bit)
            .filter(|&exception| usize::from(exception) < EXCEPTIONS);
        match address {
            _ if is_bank(address, ISER) => self.enabled[word] |= value & implemented(word),
            _ if is_bank(address, ICER) => self.enabled[word] &= !value,
            _ if is_bank(address, ISPR) => selected.for_each(|exception| self.pend(exception)),
            _ if is_bank(address, ICPR) => {
                selected.for_each(|exception| self.clear_pending(exception));
            }
            STIR => {
                let exception = FIRST_INTERRUPT + (value & 0x1FF) as u16;
                if usize::from(exception) < EXCEPTIONS {
                    self.pend(exception);
                }
            }
            // Without the key the register is not written.
            AIRCR if value >> 16 != AIRCR_KEY => {}
            AIRCR if value & AIRCR_PRIORITY_GROUP == 0 => {
                self.reset_requested |= value & AIRCR_SYSTEM_RESET != 0;
            }
            CPACR => self.cpacr = value & FLOAT_ACCESS,
            _ => return false,
        }
        true
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

    /// Sets the event register, which ends or prevents a sleep by WFE.
    pub(super) fn signal_event(&mut self) {
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

    /// Takes over the core's count of cycles awake.
    pub(super) fn synchronise(&mut self, cycles: u64) {
        self.cycles = cycles;
    }

    pub(super) fn record_fault(&mut self, status: u32) {
        self.cfsr |= status;
    }

    pub(super) fn allows_float(&self) -> bool {
        self.cpacr == FLOAT_ACCESS
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
