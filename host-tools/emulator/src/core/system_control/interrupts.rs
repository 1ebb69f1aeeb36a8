//! Exceptions and their priorities: enabled, pending and active (DDI0403E B1.5.4, B3.4; PM0214 4.3).

use crate::core::system_control::SystemControl;

/// Number of external interrupts. The STM32G474 uses the first 102 (RM0440 table 97).
pub const INTERRUPTS: usize = 112;
/// Number of exceptions, including number 0 for thread mode.
pub const EXCEPTIONS: usize = FIRST_INTERRUPT as usize + INTERRUPTS;

/// Exception number of the non-maskable interrupt.
pub const NMI: u16 = 2;
/// Exception number of HardFault.
pub const HARD_FAULT: u16 = 3;
/// Exception number of external interrupt 0.
pub const FIRST_INTERRUPT: u16 = 16;

/// Implemented bits of a priority: four, the upper ones.
pub const PRIORITY_MASK: u8 = 0xF0;

/// Priority of thread mode without an active exception.
const IDLE_PRIORITY: i32 = 256;

/// Word and bit of an external interrupt in the controller's registers.
const fn place(irq: usize) -> (usize, u32) {
    (irq / 32 % 4, 1 << (irq % 32))
}

/// External interrupt of an exception number.
const fn irq(exception: u16) -> Option<usize> {
    if exception >= FIRST_INTERRUPT && (exception as usize) < EXCEPTIONS {
        Some((exception - FIRST_INTERRUPT) as usize)
    } else {
        None
    }
}

impl SystemControl {
    /// Sets the level of an interrupt line. A rising line makes the interrupt pending; a line that is
    /// still high when the handler returns does so again.
    ///
    /// # Panics
    /// If `irq` is not below [`INTERRUPTS`].
    #[inline]
    pub fn set_line(&mut self, irq: usize, high: bool) {
        assert!(irq < INTERRUPTS, "interrupt {irq} does not exist");
        let (word, bit) = place(irq);
        if high == (self.lines[word] & bit != 0) {
            return;
        }
        self.lines[word] ^= bit;
        if high {
            self.pend(FIRST_INTERRUPT + irq as u16);
        }
    }

    /// Makes the non-maskable interrupt pending.
    pub fn pend_nmi(&mut self) {
        self.pend(NMI);
    }

    /// Makes an exception pending.
    pub(in super::super) fn pend(&mut self, exception: u16) {
        if !self.is_pending(exception) {
            self.pended[exception as usize % EXCEPTIONS] = self.cycles;
        }
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                self.pending[word] |= bit;
            }
            None => self.system_pending |= 1 << (exception & 15),
        }
        self.request_recheck();
    }

    /// The core's count of cycles when an interrupt became pending; none of an exception that is taken at once.
    pub(in super::super) fn pended_at(&self, exception: u16) -> Option<u64> {
        (exception >= FIRST_INTERRUPT && self.is_pending(exception))
            .then(|| self.pended[exception as usize % EXCEPTIONS])
    }

    /// Withdraws a pending exception. An interrupt whose line is high remains pending unless it is
    /// active.
    pub(super) fn clear_pending(&mut self, exception: u16) {
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                let asserted = self.lines[word] & !self.active[word] & bit;
                self.pending[word] = self.pending[word] & !bit | asserted;
            }
            None => self.system_pending &= !(1 << (exception & 15)),
        }
    }

    /// Whether an exception is pending.
    pub fn is_pending(&self, exception: u16) -> bool {
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                self.pending[word] & bit != 0
            }
            None => exception < FIRST_INTERRUPT && self.system_pending >> exception & 1 != 0,
        }
    }

    /// Whether an exception is active: its handler was entered and has not returned.
    pub fn is_active(&self, exception: u16) -> bool {
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                self.active[word] & bit != 0
            }
            None => exception < FIRST_INTERRUPT && self.system_active >> exception & 1 != 0,
        }
    }

    /// Whether an exception can be entered: interrupts by the ISER, all others always.
    pub fn is_enabled(&self, exception: u16) -> bool {
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                self.enabled[word] & bit != 0
            }
            None => true,
        }
    }

    /// Priority of an exception as software wrote it: 0 (highest) to 240; -1 for HardFault, -2 for the
    /// NMI, -3 for reset, 256 for thread mode and for numbers that do not exist.
    pub fn priority(&self, exception: u16) -> i32 {
        match (irq(exception), exception) {
            (Some(irq), _) => self.interrupt_priority[irq] as i32,
            (None, 1..=3) => exception as i32 - 4,
            _ => IDLE_PRIORITY,
        }
    }

    /// Priority of the active exceptions (`ExecutionPriority` without the mask registers, B1.5.4).
    pub(in super::super) fn active_priority(&self) -> i32 {
        let mut highest = IDLE_PRIORITY;
        let mut consider = |exception| highest = highest.min(self.priority(exception));
        set_bits(self.system_active as u32).for_each(|exception| consider(exception as u16));
        for (word, &active) in self.active.iter().enumerate() {
            for bit in set_bits(active) {
                consider(FIRST_INTERRUPT + (word * 32) as u16 + bit as u16);
            }
        }
        highest
    }

    /// Number of active exceptions.
    pub(in super::super) fn active_count(&self) -> u32 {
        let interrupts: u32 = self.active.iter().map(|word| word.count_ones()).sum();
        self.system_active.count_ones() + interrupts
    }

    /// The pending, enabled exception with the highest priority: the lowest value, then the lowest
    /// number.
    pub(in super::super) fn highest_pending(&self) -> Option<u16> {
        let mut highest: Option<(i32, u16)> = None;
        let mut consider = |exception: u16| {
            if self.is_enabled(exception) {
                let candidate = (self.priority(exception), exception);
                if highest.is_none_or(|highest| candidate < highest) {
                    highest = Some(candidate);
                }
            }
        };
        set_bits(self.system_pending as u32).for_each(|exception| consider(exception as u16));
        for word in 0..self.pending.len() {
            for bit in set_bits(self.pending[word] & self.enabled[word]) {
                consider(FIRST_INTERRUPT + (word * 32) as u16 + bit as u16);
            }
        }
        highest.map(|(_, exception)| exception)
    }

    /// Entry to an exception: it is active and no longer pending.
    pub(in super::super) fn activate(&mut self, exception: u16) {
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                self.active[word] |= bit;
            }
            None => self.system_active |= 1 << (exception & 15),
        }
        self.clear_pending(exception);
    }

    /// Return from an exception: it is no longer active, and pending again where its line is high.
    pub(in super::super) fn deactivate(&mut self, exception: u16) {
        match irq(exception) {
            Some(irq) => {
                let (word, bit) = place(irq);
                self.active[word] &= !bit;
                if self.lines[word] & bit != 0 {
                    self.pend(exception);
                }
            }
            None => self.system_active &= !(1 << (exception & 15)),
        }
    }
}

/// Positions of the bits that are set, ascending.
fn set_bits(mut word: u32) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let position = (word != 0).then(|| word.trailing_zeros());
        word &= word.wrapping_sub(1);
        position
    })
}
