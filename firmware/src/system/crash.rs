//! Crash record in memory that survives a reset, read once at the next boot.
//!
//! After power-up that memory has arbitrary content. A record is valid if magic number, kind and CRC-32 are right: arbitrary
//! content passes with probability 2^-64, a partly written record with 2^-32.

use crate::checksum::CRC32;

/// Length of a record in words.
pub const RECORD_WORDS: usize = 11;
/// A record in memory.
pub type CrashRecord = [u32; RECORD_WORDS];
/// No record.
pub const EMPTY_RECORD: CrashRecord = [0; RECORD_WORDS];

/// First word of a record: 0xDEAD and the version of the layout.
const MAGIC: u32 = 0xDEAD_0002;

/// Kind of a crash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrashKind {
    /// A panic.
    Panic,
    /// An unhandled exception.
    HardFault,
    /// An exception with the stack pointer below the stack.
    StackOverflow,
    /// A task did not check in ([`crate::system::task_watchdog`]).
    Watchdog,
    /// Flash ECC error or crystal failure.
    NonMaskable,
    /// Corrupt memory of the grasp ([`crate::grip::redundant_copy`]), or at boot of what is taken once.
    Corruption,
}

impl CrashKind {
    /// Number in the record and in a [`crate::protocol::messages::FaultEvent`].
    pub const fn number(self) -> u32 {
        match self {
            Self::Panic => 1,
            Self::HardFault => 2,
            Self::StackOverflow => 3,
            Self::Watchdog => 4,
            Self::NonMaskable => 5,
            Self::Corruption => 6,
        }
    }

    const fn from_number(number: u32) -> Option<Self> {
        match number {
            1 => Some(Self::Panic),
            2 => Some(Self::HardFault),
            3 => Some(Self::StackOverflow),
            4 => Some(Self::Watchdog),
            5 => Some(Self::NonMaskable),
            6 => Some(Self::Corruption),
            _ => None,
        }
    }
}

/// One crash; unknown fields are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crash {
    /// Kind.
    pub kind: CrashKind,
    /// Program counter; for a panic, within the panic function of `core`. The debug information of the image maps it and the
    /// next addresses to file and line.
    pub pc: u32,
    /// Link register: return address.
    pub lr: u32,
    /// For a panic: the next two return addresses.
    pub callers: [u32; 2],
    /// Configurable fault status register (CFSR).
    pub status: u32,
    /// Milliseconds since boot.
    pub uptime_ms: u32,
    /// Boots since power-up, this one included.
    pub boot: u32,
    /// For the watchdog: the [`TaskId`](crate::system::task_watchdog::TaskId).
    pub task: u32,
}

impl Crash {
    /// Only the kind is known.
    pub const fn new(kind: CrashKind) -> Self {
        Self { kind, pc: 0, lr: 0, callers: [0; 2], status: 0, uptime_ms: 0, boot: 0, task: 0 }
    }

    /// Detail of a [`crate::protocol::messages::FaultEvent`]: kind and address.
    pub const fn detail(&self) -> u32 {
        (self.kind.number() << 24) | (self.address() & 0x00FF_FFFF)
    }

    /// Address of the code to inspect first.
    pub const fn address(&self) -> u32 {
        match self.kind {
            CrashKind::Panic => self.lr,
            _ => self.pc,
        }
    }

    /// Encodes the record.
    pub fn to_record(&self) -> CrashRecord {
        let [third, fourth] = self.callers;
        let fields = [
            MAGIC,
            self.kind.number(),
            self.pc,
            self.lr,
            self.status,
            self.uptime_ms,
            self.boot,
            self.task,
            third,
            fourth,
        ];
        let check = checksum(&fields);
        let mut memory = EMPTY_RECORD;
        for (slot, word) in memory.iter_mut().zip(fields.into_iter().chain([check])) {
            *slot = word;
        }
        memory
    }

    /// Decodes a record; `None` if it is invalid.
    pub fn from_record(memory: &CrashRecord) -> Option<Self> {
        let [fields @ .., check] = memory;
        let [magic, kind, pc, lr, status, uptime_ms, boot, task, third, fourth] = *fields;
        if magic != MAGIC || checksum(fields) != *check {
            return None;
        }
        Some(Self {
            kind: CrashKind::from_number(kind)?,
            pc,
            lr,
            callers: [third, fourth],
            status,
            uptime_ms,
            boot,
            task,
        })
    }
}

/// Reads and clears the record.
pub fn take_record(memory: &mut CrashRecord) -> Option<Crash> {
    let crash = Crash::from_record(memory);
    *memory = EMPTY_RECORD;
    crash
}

fn checksum(fields: &[u32]) -> u32 {
    let mut digest = CRC32.digest();
    for field in fields {
        digest.update(&field.to_le_bytes());
    }
    digest.finalize()
}

/// Boots since power-up, in memory that survives a reset: the count and its complement.
pub type BootCounter = [u32; 2];

/// Counts a boot; 1 after power-up, when the memory has no valid count.
pub fn count_boot(counter: &mut BootCounter) -> u32 {
    let [before, complement] = *counter;
    let now = if before == !complement { before.saturating_add(1) } else { 1 };
    *counter = [now, !now];
    now
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRASH: Crash = Crash {
        kind: CrashKind::HardFault,
        pc: 0x0800_1234,
        lr: 0x0800_4321,
        callers: [0x0801_0203, 0x0801_0405],
        status: 0x0000_8200,
        uptime_ms: 123_456,
        boot: 3,
        task: 0xCAFE_F00D,
    };

    #[test]
    fn crash_record_is_read_once() {
        let mut memory = CRASH.to_record();
        assert_eq!(take_record(&mut memory), Some(CRASH));
        assert_eq!(memory, EMPTY_RECORD);
        assert_eq!(take_record(&mut memory), None);
    }

    #[test]
    fn crash_kinds_round_trip_and_other_numbers_are_invalid() {
        let kinds = (0..1000).filter_map(CrashKind::from_number);
        let mut count = 0;
        for kind in kinds {
            let crash = Crash { kind, ..CRASH };
            assert_eq!(Crash::from_record(&crash.to_record()), Some(crash));
            count += 1;
        }
        assert_eq!(count, 6);
        let mut memory = CRASH.to_record();
        memory[1] = 7;
        memory[RECORD_WORDS - 1] = checksum(&memory[..RECORD_WORDS - 1]);
        assert_eq!(Crash::from_record(&memory), None);
    }

    #[test]
    fn record_with_bit_error_or_partly_written_is_invalid() {
        let memory = CRASH.to_record();
        for bit in 0..32 * RECORD_WORDS {
            let mut corrupt = memory;
            corrupt[bit / 32] ^= 1 << (bit % 32);
            assert_eq!(take_record(&mut corrupt), None, "bit {bit}");
        }
        let before = Crash { uptime_ms: 1, ..CRASH };
        for written in 1..RECORD_WORDS {
            let mut half = before.to_record();
            half[..written].copy_from_slice(&memory[..written]);
            let found = Crash::from_record(&half);
            // Only uptime and checksum differ.
            assert!(found.is_none() || written <= 5, "{written}: {found:?}");
        }
    }

    #[test]
    fn random_memory_is_not_a_valid_record() {
        let mut seed = 1_u64;
        let mut random = || {
            // Splitmix64.
            seed = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mixed = (seed ^ (seed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            (mixed ^ (mixed >> 31)) as u32
        };
        for _ in 0..300_000 {
            let mut memory: CrashRecord = core::array::from_fn(|_| random());
            assert_eq!(Crash::from_record(&memory), None);
            // Also with the first two words valid.
            memory[..2].copy_from_slice(&[MAGIC, 1]);
            assert_eq!(Crash::from_record(&memory), None);
        }
        assert_eq!(Crash::from_record(&[u32::MAX; RECORD_WORDS]), None);
        assert_eq!(Crash::from_record(&EMPTY_RECORD), None);
    }

    #[test]
    fn boots_are_counted_from_power_up() {
        let mut starts = [0x1234_5678, 0x9ABC_DEF0];
        let counted: [u32; 3] = core::array::from_fn(|_| count_boot(&mut starts));
        assert_eq!(counted, [1, 2, 3]);
        assert_eq!(count_boot(&mut [0, 0]), 1);
        assert_eq!(count_boot(&mut [u32::MAX, 0]), u32::MAX);
    }
}
