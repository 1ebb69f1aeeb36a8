//! Execution statistics: where the cycles go, and how deep the stack is.

use crate::core::EXCEPTIONS;

/// Execution of one exception, or of thread mode (exception number 0).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ExceptionStatistics {
    /// Instructions executed while the exception was the current one.
    pub instructions: u64,
    /// Cycles of these instructions, of the entry and of the return.
    pub cycles: u64,
    /// Number of entries.
    pub entries: u64,
    /// Most cycles from an entry to the return, preemption included and sleep excluded.
    pub longest_cycles: u64,
    /// Most cycles from when it became pending to its entry.
    pub longest_latency_cycles: u64,
}

/// Statistics of a core since its creation or since they were cleared. A reset of the core leaves
/// them.
#[derive(Debug, Clone)]
pub struct Statistics {
    /// Indexed by exception number: 0 thread mode, 16 and above external interrupts.
    pub by_exception: [ExceptionStatistics; EXCEPTIONS],
    /// Lowest value of the stack pointer at the end of an instruction.
    pub lowest_msp: u32,
}

impl Default for Statistics {
    fn default() -> Self {
        Self { by_exception: [ExceptionStatistics::default(); EXCEPTIONS], lowest_msp: u32::MAX }
    }
}

/// Attribution of instructions and cycles to the exceptions.
///
/// The totals advance with each instruction; they are attributed when the current exception changes.
#[derive(Debug, Clone)]
pub(super) struct Recorder {
    statistics: Statistics,
    /// Totals at the last attribution.
    instructions: u64,
    cycles: u64,
    /// Total of cycles at the entry of each active exception.
    entered: [u64; EXCEPTIONS],
}

impl Recorder {
    pub(super) fn new() -> Self {
        Self {
            statistics: Statistics::default(),
            instructions: 0,
            cycles: 0,
            entered: [0; EXCEPTIONS],
        }
    }

    /// Attributes everything since the last call to an exception.
    pub(super) fn attribute(&mut self, exception: u16, instructions: u64, cycles: u64) {
        let entry = &mut self.statistics.by_exception[exception as usize % EXCEPTIONS];
        entry.instructions += instructions - self.instructions;
        entry.cycles += cycles - self.cycles;
        self.instructions = instructions;
        self.cycles = cycles;
    }

    pub(super) fn enter(&mut self, exception: u16, cycles: u64, pended: u64) {
        let number = exception as usize % EXCEPTIONS;
        let entry = &mut self.statistics.by_exception[number];
        entry.entries += 1;
        let latency = cycles.saturating_sub(pended);
        entry.longest_latency_cycles = entry.longest_latency_cycles.max(latency);
        self.entered[number] = cycles;
    }

    pub(super) fn leave(&mut self, exception: u16, cycles: u64) {
        let number = exception as usize % EXCEPTIONS;
        let entry = &mut self.statistics.by_exception[number];
        entry.longest_cycles = entry.longest_cycles.max(cycles - self.entered[number]);
    }

    pub(super) fn statistics(&mut self, lowest_msp: u32) -> &Statistics {
        self.statistics.lowest_msp = lowest_msp;
        &self.statistics
    }

    /// Clears the statistics; the entry times of active exceptions remain.
    pub(super) fn clear(&mut self) {
        self.statistics = Statistics::default();
    }
}
