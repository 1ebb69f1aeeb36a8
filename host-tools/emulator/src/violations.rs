//! Accesses that indicate a firmware bug: collected with the place in the program of the first one, never corrected.
//!
//! A test fails on any of them unless it lists the kind with a reason. On the chip most of these go unnoticed until
//! something else fails: a register behind a closed clock gate reads zero, a core above the limit of its voltage
//! range computes wrong now and then.

use std::collections::BTreeMap;
use std::fmt;

use crate::registers;
use crate::time::Time;

/// Kinds of violation. Sections are of ST's reference manual RM0440.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Access to a register of which the emulator has no model: its effect is not emulated.
    UnmodelledRegister,
    /// A value whose effect is not emulated is written to a modelled register.
    UnmodelledSetting,
    /// Access to a peripheral whose clock is off in RCC (7.2.16): reads give 0, writes are lost.
    ClockGated,
    /// A clock above the limit of the voltage range (6.1.5), or fewer wait states of flash than it needs (3.3.3).
    ClockLimit,
    /// A register is written while its peripheral does not allow it.
    WriteProtected,
    /// A peripheral is started in a configuration in which it does not work.
    Misconfigured,
    /// Data were lost because nobody fetched them in time.
    Overrun,
    /// A peripheral is used whose pins are not connected to it.
    PinNotConnected,
    /// DMA accesses an address that it cannot reach.
    DmaAddress,
    /// A store into flash that is not open for it, is not erased, or is not a whole double word.
    FlashProgramming,
    /// Both switches of a half bridge, or a bridge with pins that are not the timer's, are driven.
    UnsafeBridge,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::UnmodelledRegister => "register without a model",
            Self::UnmodelledSetting => "setting without a model",
            Self::ClockGated => "access to a peripheral without a clock",
            Self::ClockLimit => "clock above its limit",
            Self::WriteProtected => "write to a protected register",
            Self::Misconfigured => "peripheral started in a wrong configuration",
            Self::Overrun => "data lost by an overrun",
            Self::PinNotConnected => "pin not connected to its peripheral",
            Self::DmaAddress => "address out of reach of DMA",
            Self::FlashProgramming => "wrong programming of flash",
            Self::UnsafeBridge => "half bridge in an unsafe state",
        })
    }
}

/// One kind at one address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// What kind.
    pub kind: Kind,
    /// The register.
    pub address: u32,
    /// What is wrong, in words.
    pub detail: &'static str,
    /// How often it happened.
    pub count: u64,
    /// Program counter of the first time.
    pub pc: u32,
    /// When it was.
    pub time: Time,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} at {} ({:#010x}), {} times, first at {:.3} ms by pc {:#010x}",
            self.kind,
            self.detail,
            registers::name(self.address),
            self.address,
            self.count,
            self.time.as_ms(),
            self.pc
        )
    }
}

/// All violations since power-on.
#[derive(Clone, Debug, Default)]
pub struct Violations {
    found: BTreeMap<(Kind, u32, &'static str), Violation>,
    /// The instruction that runs, and when.
    pub(crate) pc: u32,
    pub(crate) now: Time,
}

impl Violations {
    /// Counts one.
    pub fn report(&mut self, kind: Kind, address: u32, detail: &'static str) {
        let first = Violation { kind, address, detail, count: 0, pc: self.pc, time: self.now };
        let violation = self.found.entry((kind, address, detail)).or_insert(first);
        violation.count += 1;
    }

    /// Each kind at each address, once.
    pub fn iter(&self) -> impl Iterator<Item = &Violation> {
        self.found.values()
    }
}
