//! Flash memory and its controller, RM0440 section 3: two banks of 256 KiB, pages of 2 KiB, double words with error
//! correction, option bytes, and what a cut of the supply in the middle of an operation leaves.

use stm32_metapac::flash::regs::{Cr, Optr, Sr};

use crate::peripherals::Context;
use crate::registers::registers;
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "FLASH":
    ACR = 0x00, PDKEYR = 0x04, KEYR = 0x08, OPTKEYR = 0x0C, SR = 0x10, CR = 0x14, ECCR = 0x18, OPTR = 0x20,
}

/// Where the program sees it.
pub const BASE: u32 = 0x0800_0000;
/// Bytes of the memory.
pub const SIZE: usize = 512 * 1024;
/// Bytes of a bank.
pub const BANK: usize = SIZE / 2;
// Bytes of a page, of a double word.
const PAGE: usize = 2048;
const WORD: usize = 8;
/// Programming a double word and erasing a page, typical (datasheet DS12288 table 52).
const PROGRAM: Time = Time::from_ns(81_700);
const ERASE: Time = Time::from_ns(22_020_000);
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// Option bytes as shipped (3.4.1): nSWBOOT0, nBOOT0 and nBOOT1 set, two banks.
pub const OPTIONS_AS_SHIPPED: u32 = 0xFFEF_F8AA;
/// Two wrong bits in a double word; the flag and the address of the first (3.7.7).
const ECCD: u32 = 1 << 31;
const ECCD2: u32 = 1 << 29;
/// Errors of SR that software clears, with EOP; those of programming, of which none may be left (3.3.6, 3.3.7).
const CLEARABLE: u32 = 0xC3FB;
const ERRORS: u32 = 0x03FA;

/// An operation on the memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// A page, by the offset of its first byte.
    Erase(usize),
    /// A double word, by its offset, and the value.
    Program(usize, u64),
}

/// When the supply fails: in the middle of an operation, as of now counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PowerCut {
    /// Operations that still end.
    pub after: u32,
    /// What is left of the one under way.
    pub leaves: Remains,
}

/// What an interrupted operation leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Remains {
    /// As if it had not begun: of a double word, only the lower half was stored.
    Half,
    /// As if it had ended.
    Everything,
    /// Cells between both states: double words that read with two wrong bits. Of a page, the first half.
    Unreadable,
}

/// Memory and controller.
#[derive(Clone)]
pub struct Flash {
    bytes: Vec<u8>,
    /// Offsets of double words with two wrong bits, sorted.
    unreadable: Vec<usize>,
    acr: u32,
    cr: Cr,
    sr: Sr,
    eccr: u32,
    options: u32,
    keys: usize,
    operation: Option<(Time, Operation)>,
    /// The lower half of a double word that waits for the upper.
    half: Option<(usize, u32)>,
    cut: Option<PowerCut>,
    is_power_lost: bool,
    /// Operations that have ended, with the time.
    pub log: Vec<(Time, Operation)>,
}

impl Flash {
    pub(crate) fn new() -> Self {
        let mut flash = Self {
            bytes: vec![0xFF; SIZE],
            unreadable: Vec::new(),
            acr: 0,
            cr: Cr(0),
            sr: Sr(0),
            eccr: 0,
            options: OPTIONS_AS_SHIPPED,
            keys: 0,
            operation: None,
            half: None,
            cut: None,
            is_power_lost: false,
            log: Vec::new(),
        };
        flash.reset();
        flash
    }

    /// Registers take their reset values; the memory stays as it is.
    pub(crate) fn reset(&mut self) {
        (self.acr, self.cr, self.sr, self.eccr) = (0x0004_0600, Cr(0xC000_0000), Sr(0), 0);
        (self.keys, self.operation, self.half) = (0, None, None);
    }

    /// The memory.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Writes into the memory from outside, as a debugger does.
    ///
    /// # Panics
    /// The bytes do not fit.
    pub fn load(&mut self, offset: usize, bytes: &[u8]) {
        let range = offset..offset + bytes.len();
        self.unreadable.retain(|word| !range.contains(word));
        self.bytes[range].copy_from_slice(bytes);
    }

    /// The option bytes (OPTR).
    pub fn options(&self) -> u32 {
        self.options
    }

    /// Sets the option bytes from outside.
    pub fn set_options(&mut self, options: u32) {
        self.options = options;
    }

    /// With a single bank (DBANK = 0) pages have twice the size, and BKER does not count (3.3.1).
    fn page_bytes(&self) -> usize {
        if Optr(self.options).dbank() { PAGE } else { 2 * PAGE }
    }

    /// Whether the program runs from the bank with this offset.
    fn runs_from(&self, offset: usize) -> bool {
        offset < BANK || !Optr(self.options).dbank()
    }

    /// Supply in millivolts below which the chip is held in reset, by BOR_LEV (3.7.8); falling, without the hysteresis.
    pub(crate) fn brown_out_mv(&self) -> u32 {
        const LEVELS_MV: [u32; 5] = [1700, 2000, 2200, 2500, 2800];
        let level = usize::from(Optr(self.options).bor_lev());
        LEVELS_MV.get(level).copied().unwrap_or(2800)
    }

    /// Whether the chip starts from this memory: BOOT0 is the pin PB8 or nBOOT0, by nSWBOOT0 (2.6.1). Where it is high,
    /// nBOOT1 = 1 selects the boot loader and 0 SRAM.
    pub(crate) fn boots(&self, boot0_pin: bool) -> bool {
        let options = Optr(self.options);
        let boot0 = if options.n_swboot0() { boot0_pin } else { !options.n_boot0() };
        !boot0
    }

    /// Flips two bits of the double word at an offset: an uncorrectable ECC error.
    pub fn corrupt(&mut self, offset: usize) {
        let word = offset / WORD * WORD;
        if let Err(place) = self.unreadable.binary_search(&word) {
            self.unreadable.insert(place, word);
        }
    }

    /// Lets the supply fail.
    pub fn cut_power(&mut self, cut: PowerCut) {
        self.cut = Some(cut);
    }

    /// Whether the supply has failed.
    pub(crate) fn take_power_loss(&mut self) -> bool {
        std::mem::take(&mut self.is_power_lost)
    }

    /// Bytes at an offset; none where they are outside. Reading an unreadable word sets the flag whose interrupt cannot be
    /// masked.
    #[inline]
    pub(crate) fn read(&mut self, offset: usize, length: usize) -> Option<&[u8]> {
        if !self.unreadable.is_empty() {
            self.check(offset);
        }
        self.bytes.get(offset..offset + length)
    }

    #[cold]
    fn check(&mut self, offset: usize) {
        let word = offset / WORD * WORD;
        if self.eccr & ECCD == 0 && self.unreadable.binary_search(&word).is_ok() {
            let (bank, place) = (word / BANK, word % BANK);
            self.eccr =
                self.eccr & !0x007F_FFFF | ECCD | (bank as u32) << 21 | place as u32 & 0x7_FFFF;
        }
    }

    /// Two wrong bits were read: the core gets its non-maskable interrupt.
    pub(crate) fn has_failed(&self) -> bool {
        self.eccr & (ECCD | ECCD2) != 0
    }

    /// Wait states that the program has set.
    pub(crate) fn wait_states(&self) -> u32 {
        self.acr & 0xF
    }

    /// Wait states that a clock needs in range 1 boost and normal (3.3.3).
    pub(crate) fn needed_wait_states(core: Frequency, is_boosted: bool) -> u32 {
        let step = if is_boosted { 34_000_000 } else { 30_000_000 };
        (core.0.saturating_sub(1) / step).min(8)
    }

    /// A store of the program into the memory.
    pub(crate) fn store(&mut self, offset: usize, value: u32, bytes: u32, context: &mut Context) {
        let address = BASE.wrapping_sub(context.base) + offset as u32;
        if self.is_power_lost {
            return;
        }
        if self.cr.lock() || !self.cr.pg() || bytes != 4 || self.operation.is_some() {
            context.report(
                Kind::FlashProgramming,
                address,
                "a store into flash that is not open for it",
            );
            self.sr.set_pgserr(true);
            return;
        }
        match self.half.take() {
            None if offset.is_multiple_of(WORD) => {
                self.half = Some((offset, value));
                let cut = PowerCut { after: 0, leaves: Remains::Half };
                self.is_power_lost = self.cut.take_if(|planned| *planned == cut).is_some();
            }
            Some((first, lower)) if offset == first + 4 => {
                self.program(first, u64::from(value) << 32 | u64::from(lower), context)
            }
            _ => {
                context.report(
                    Kind::FlashProgramming,
                    address,
                    "not a double word from its lower half on",
                );
                self.sr.set_pgaerr(true);
            }
        }
    }

    fn program(&mut self, offset: usize, value: u64, context: &mut Context) {
        let address = BASE.wrapping_sub(context.base) + offset as u32;
        if self.has_old_errors(address, context) {
            return;
        }
        let is_erased = self.bytes[offset..offset + WORD].iter().all(|byte| *byte == 0xFF);
        // All zeros may be written over anything (3.3.7).
        if !is_erased && value != 0 {
            context.report(Kind::FlashProgramming, address, "a double word that is not erased");
            self.sr.set_progerr(true);
            return;
        }
        if self.runs_from(offset) {
            context.report(
                Kind::FlashProgramming,
                address,
                "a write into the bank that the program runs from",
            );
        }
        self.begin(Operation::Program(offset, value), context.now + PROGRAM);
    }

    /// Errors of a previous operation prevent the next (3.3.6, 3.3.7).
    fn has_old_errors(&mut self, address: u32, context: &mut Context) -> bool {
        let has_errors = self.sr.0 & ERRORS != 0;
        if has_errors {
            let detail = "an operation with errors of a previous one";
            context.report(Kind::FlashProgramming, address, detail);
            self.sr.set_pgserr(true);
        }
        has_errors
    }

    /// Sets errors of SR, as a disturbed operation does.
    pub(crate) fn set_errors(&mut self, errors: u32) {
        self.sr.0 |= errors & ERRORS;
    }

    fn begin(&mut self, operation: Operation, ends: Time) {
        self.sr.set_bsy(true);
        self.operation = Some((ends, operation));
    }

    pub(crate) fn next_event(&self) -> Time {
        self.operation.map_or(Time::NEVER, |(time, _)| time)
    }

    /// The end of an operation; the range of the memory that it changed.
    pub(crate) fn advance(&mut self, now: Time) -> Option<std::ops::Range<usize>> {
        let (_, operation) = self.operation.take_if(|(time, _)| *time <= now)?;
        self.sr.set_bsy(false);
        if self.cr.eopie() {
            self.sr.set_eop(true);
        }
        self.log.push((now, operation));
        let remains = match &mut self.cut {
            Some(cut) if cut.after == 0 => {
                let leaves = cut.leaves;
                (self.cut, self.is_power_lost) = (None, true);
                leaves
            }
            Some(cut) => {
                cut.after -= 1;
                Remains::Everything
            }
            None => Remains::Everything,
        };
        let range = match operation {
            Operation::Erase(page) => page..page + self.page_bytes(),
            Operation::Program(word, _) => word..word + WORD,
        };
        match remains {
            Remains::Half => {}
            Remains::Everything => {
                self.unreadable.retain(|word| !range.contains(word));
                match operation {
                    Operation::Erase(_) => self.bytes[range.clone()].fill(0xFF),
                    Operation::Program(_, value) => self.load(range.start, &value.to_le_bytes()),
                }
            }
            Remains::Unreadable => {
                let half = range.start..range.start + range.len().div_ceil(2 * WORD) * WORD;
                half.step_by(WORD).for_each(|word| self.corrupt(word));
            }
        }
        Some(range)
    }

    /// Level of the interrupt.
    pub(crate) fn interrupt(&self) -> bool {
        self.cr.eopie() && self.sr.eop() || self.cr.errie() && self.sr.0 & 0x3FA != 0
    }

    pub(crate) fn read_register(&mut self, offset: u32, context: &mut Context) -> u32 {
        match offset {
            ACR => self.acr,
            SR => self.sr.0,
            CR => self.cr.0,
            ECCR => self.eccr,
            OPTR => self.options,
            KEYR | OPTKEYR | PDKEYR => 0,
            _ => context.unmodelled(offset),
        }
    }

    pub(crate) fn write_register(&mut self, offset: u32, value: u32, context: &mut Context) {
        match offset {
            ACR => self.acr = value,
            KEYR => {
                self.keys = match self.keys {
                    keys if KEYS.get(keys) == Some(&value) => keys + 1,
                    _ => {
                        context.write_protected(
                            offset,
                            "a wrong key: flash stays locked until a reset",
                        );
                        usize::MAX
                    }
                };
                if self.keys == KEYS.len() {
                    self.keys = 0;
                    self.cr.set_lock(false);
                }
            }
            SR => self.sr.0 &= !(value & CLEARABLE),
            CR => self.write_cr(value, context),
            // Flags are cleared by writing them.
            ECCR => self.eccr = self.eccr & !(value & 0xF000_0000) & !(1 << 24) | value & 1 << 24,
            OPTKEYR | PDKEYR | OPTR => {
                context.unmodelled_setting(offset, "option bytes or power-down")
            }
            _ => context.unmodelled_write(offset),
        }
    }

    fn write_cr(&mut self, value: u32, context: &mut Context) {
        let next = Cr(value);
        if self.cr.lock() {
            if !next.lock() {
                context.write_protected(CR, "flash is locked");
            }
            return;
        }
        if self.operation.is_some() {
            context.write_protected(CR, "flash is busy");
            return;
        }
        if next.mer1() || next.mer2() || next.fstpg() || next.optstrt() || next.obl_launch() {
            context.unmodelled_setting(CR, "mass erase, fast programming, option bytes");
        }
        self.cr = next;
        self.cr.set_strt(false);
        if next.strt() && !self.has_old_errors(CR, context) {
            if next.per() {
                let size = self.page_bytes();
                let bank = if next.bker() && size == PAGE { BANK } else { 0 };
                let page = bank + usize::from(next.pnb()) * size;
                if self.runs_from(page) {
                    let detail = "a page of the bank that the program runs from";
                    context.report(Kind::FlashProgramming, CR, detail);
                }
                self.begin(Operation::Erase(page), context.now + ERASE);
            } else {
                context.report(Kind::FlashProgramming, CR, "started without a page to erase")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boot0_is_the_pin_as_shipped_and_an_option_else() {
        let mut flash = Flash::new();
        assert!(flash.boots(false));
        assert!(!flash.boots(true));
        // nSWBOOT0 = 0: the pin does not count; nBOOT0 = 1 starts from flash.
        flash.set_options(OPTIONS_AS_SHIPPED & !(1 << 26));
        assert!(flash.boots(true));
        flash.set_options(OPTIONS_AS_SHIPPED & !(1 << 26) & !(1 << 27));
        assert!(!flash.boots(false));
    }

    #[test]
    fn wait_states_of_the_reference_manual() {
        // RM0440 table 29.
        for (mhz, boosted, states) in [
            (170, true, 4),
            (136, true, 3),
            (137, true, 4),
            (16, true, 0),
            (150, false, 4),
            (60, false, 1),
        ] {
            let core = Frequency(mhz * 1_000_000);
            assert_eq!(Flash::needed_wait_states(core, boosted), states, "{mhz}");
        }
    }

    #[test]
    fn an_interrupted_erasure_leaves_words_that_cannot_be_read() {
        let mut flash = Flash::new();
        flash.load(BANK, &[0; PAGE]);
        flash.cut_power(PowerCut { after: 0, leaves: Remains::Unreadable });
        flash.begin(Operation::Erase(BANK), Time::from_ms(22));
        assert_eq!(flash.advance(Time::from_ms(21)), None);
        assert_eq!(flash.advance(Time::from_ms(22)), Some(BANK..BANK + PAGE));
        assert!(flash.take_power_loss());
        flash.read(BANK + PAGE / 2, 4);
        assert!(!flash.has_failed());
        flash.read(BANK + 12, 4);
        assert!(flash.has_failed());
    }
}
