//! What is left of a crash: a record in memory that a reset does not touch, read once at the next start.
//!
//! After a power-up that memory holds anything. A record counts where its first word, its kind and its
//! CRC-32 are right: anything passes once in 2^64, and half a record (the power went while it was written)
//! once in 2^32.

use crate::checksum::CRC32;

/// Words of a record.
pub const WORDS: usize = 11;
/// A record in memory.
pub type Memory = [u32; WORDS];
/// Nothing is recorded.
pub const NOTHING: Memory = [0; WORDS];

/// First word of a record: "DEAD" on a hexadecimal page, then the version of the layout.
const MAGIC: u32 = 0xDEAD_0002;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A panic.
    Panic,
    /// An exception that nobody handles.
    HardFault,
    /// An exception with the stack pointer below the stack.
    StackOverflow,
    /// A loop did not check in ([`crate::progress`]).
    Watchdog,
    /// An error of memory, or the crystal failed.
    NonMaskable,
    /// A word of the grasp's memory is not what it was ([`crate::grip::kept`]).
    Corruption,
}

impl Kind {
    /// Its number, in the record and in a [`crate::wire::messages::FaultEvent`].
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

    const fn of(number: u32) -> Option<Self> {
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

/// One crash. What is not known is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crash {
    /// What happened.
    pub kind: Kind,
    /// Address of the instruction; of a panic in the library's function for its kind. The image's debug
    /// information tells file and line of this and the next.
    pub pc: u32,
    /// Where its function would have returned to.
    pub lr: u32,
    /// Of a panic: where that one would have, and its caller.
    pub callers: [u32; 2],
    /// The core's configurable fault status register (CFSR).
    pub status: u32,
    /// Milliseconds since the start.
    pub tick_ms: u32,
    /// Starts since the power came, this one included.
    pub boot: u32,
    /// Of the watchdog: which loop.
    pub place: u32,
}

impl Crash {
    /// Nothing is known but what happened.
    pub const fn new(kind: Kind) -> Self {
        Self {
            kind,
            pc: 0,
            lr: 0,
            callers: [0; 2],
            status: 0,
            tick_ms: 0,
            boot: 0,
            place: 0,
        }
    }

    /// For [`crate::wire::messages::FaultEvent`]: what happened, and where to look first.
    pub const fn detail(&self) -> u32 {
        (self.kind.number() << 24) | (self.address() & 0x00FF_FFFF)
    }

    /// Where to look first.
    pub const fn address(&self) -> u32 {
        match self.kind {
            Kind::Panic => self.lr,
            _ => self.pc,
        }
    }

    /// The record.
    pub fn to_memory(&self) -> Memory {
        let [third, fourth] = self.callers;
        let fields = [
            MAGIC,
            self.kind.number(),
            self.pc,
            self.lr,
            self.status,
            self.tick_ms,
            self.boot,
            self.place,
            third,
            fourth,
        ];
        let check = checksum(&fields);
        let mut memory = NOTHING;
        for (place, word) in memory.iter_mut().zip(fields.into_iter().chain([check])) {
            *place = word;
        }
        memory
    }

    /// The crash in a record, if it is one.
    pub fn of_memory(memory: &Memory) -> Option<Self> {
        let [fields @ .., check] = memory;
        let [
            magic,
            kind,
            pc,
            lr,
            status,
            tick_ms,
            boot,
            place,
            third,
            fourth,
        ] = *fields;
        if magic != MAGIC || checksum(fields) != *check {
            return None;
        }
        Some(Self {
            kind: Kind::of(kind)?,
            pc,
            lr,
            callers: [third, fourth],
            status,
            tick_ms,
            boot,
            place,
        })
    }
}

/// Reads the record and clears it: what happened is told once.
pub fn take(memory: &mut Memory) -> Option<Crash> {
    let crash = Crash::of_memory(memory);
    *memory = NOTHING;
    crash
}

fn checksum(fields: &[u32]) -> u32 {
    let mut digest = CRC32.digest();
    for field in fields {
        digest.update(&field.to_le_bytes());
    }
    digest.finalize()
}

/// Starts since the power came, in memory that a reset does not touch: the number and its complement.
pub type Starts = [u32; 2];

/// Counts a start; 1 where the memory holds no count, as after a power-up.
pub fn count_start(starts: &mut Starts) -> u32 {
    let [before, complement] = *starts;
    let now = match before == !complement {
        true => before.saturating_add(1),
        false => 1,
    };
    *starts = [now, !now];
    now
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRASH: Crash = Crash {
        kind: Kind::HardFault,
        pc: 0x0800_1234,
        lr: 0x0800_4321,
        callers: [0x0801_0203, 0x0801_0405],
        status: 0x0000_8200,
        tick_ms: 123_456,
        boot: 3,
        place: 0xCAFE_F00D,
    };

    #[test]
    fn a_crash_is_told_once() {
        let mut memory = CRASH.to_memory();
        assert_eq!(take(&mut memory), Some(CRASH));
        assert_eq!(memory, NOTHING);
        assert_eq!(take(&mut memory), None);
    }

    #[test]
    fn every_kind_comes_back_and_no_other_number_is_one() {
        let kinds = (0..1000).filter_map(Kind::of);
        let mut count = 0;
        for kind in kinds {
            let crash = Crash { kind, ..CRASH };
            assert_eq!(Crash::of_memory(&crash.to_memory()), Some(crash));
            count += 1;
        }
        assert_eq!(count, 6);
        let mut memory = CRASH.to_memory();
        memory[1] = 7;
        memory[WORDS - 1] = checksum(&memory[..WORDS - 1]);
        assert_eq!(Crash::of_memory(&memory), None);
    }

    #[test]
    fn a_record_with_any_bit_turned_or_half_written_is_none() {
        let memory = CRASH.to_memory();
        for bit in 0..32 * WORDS {
            let mut spoilt = memory;
            spoilt[bit / 32] ^= 1 << (bit % 32);
            assert_eq!(take(&mut spoilt), None, "bit {bit}");
        }
        let before = Crash {
            tick_ms: 1,
            ..CRASH
        };
        for written in 1..WORDS {
            let mut half = before.to_memory();
            half[..written].copy_from_slice(&memory[..written]);
            let found = Crash::of_memory(&half);
            // The words that differ are the tick's and the checksum's.
            assert!(found.is_none() || written <= 5, "{written}: {found:?}");
        }
    }

    #[test]
    fn memory_after_a_power_up_is_never_taken_for_a_record() {
        let mut seed = 1_u64;
        let mut random = || {
            // Splitmix64.
            seed = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mixed = (seed ^ (seed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            (mixed ^ (mixed >> 31)) as u32
        };
        for _ in 0..300_000 {
            let mut memory: Memory = core::array::from_fn(|_| random());
            assert_eq!(Crash::of_memory(&memory), None);
            // Even where chance has made the first two words right.
            memory[..2].copy_from_slice(&[MAGIC, 1]);
            assert_eq!(Crash::of_memory(&memory), None);
        }
        assert_eq!(Crash::of_memory(&[u32::MAX; WORDS]), None);
        assert_eq!(Crash::of_memory(&NOTHING), None);
    }

    #[test]
    fn starts_are_counted_from_the_power_up_on() {
        let mut starts = [0x1234_5678, 0x9ABC_DEF0];
        let counted: [u32; 3] = core::array::from_fn(|_| count_start(&mut starts));
        assert_eq!(counted, [1, 2, 3]);
        assert_eq!(count_start(&mut [0, 0]), 1);
        assert_eq!(count_start(&mut [u32::MAX, 0]), u32::MAX);
    }
}
