//! Memories of the chip, and its bus as the core sees it.

use std::ops::Range;

use super::map::{Block, base_of};
use super::{Soc, context};
use crate::core::{Bus, BusError, SystemControl, Width};
use crate::peripherals::flash;
use crate::peripherals::syscfg::BreakSource;
use crate::time::Time;
use crate::violations::Kind;

/// SRAM1 and SRAM2, one behind the other (RM0440 2.4).
pub const SRAM: u32 = 0x2000_0000;
pub(super) const SRAM_SIZE: usize = 96 * 1024;
/// Reserved addresses directly below SRAM, behind the system memory.
const BELOW_SRAM: u32 = 0x1FFF_8000;
/// Where SRAM2 begins; it, SRAM1 and core-coupled memory are the cuts of SRAM.
const SRAM_2: u32 = SRAM + 80 * 1024;
pub(super) const ALL_CUTS: u8 = 7;
/// Core-coupled memory, where the core fetches without waiting; the system bus shows it behind SRAM2 as well.
pub(super) const CCM: u32 = 0x1000_0000;
pub(super) const CCM_SIZE: usize = 32 * 1024;
pub(super) const CCM_ALIAS: u32 = SRAM + SRAM_SIZE as u32;
/// The memory that the chip starts from is at address 0 as well (2.6).
const BOOT_SIZE: u32 = flash::SIZE as u32;
/// The region of the core's own peripherals.
const PRIVATE: u32 = 0xE000_0000;
/// The debug unit is in that region, and ST's.
const DBGMCU: u32 = 0xE004_2000;
/// Factory calibration of the temperature sensor at a reference of 3.0 V (datasheet, table 5), and typical counts: 0.76 V at
/// 30 degrees Celsius and 2.5 mV per kelvin.
const CALIBRATION_30_C: u32 = 0x1FFF_75A8;
const CALIBRATION_130_C: u32 = 0x1FFF_75CA;
/// Counts at both addresses.
pub const TEMPERATURE_CALIBRATION: [u32; 2] = [1037, 1379];

impl Soc {
    /// Bytes of memory at an address, as a debugger reads them. None outside of SRAM, CCM and flash.
    pub fn memory(&self, address: u32, length: usize) -> Option<&[u8]> {
        let within = |start: u32, bytes: &[u8]| {
            let offset = address.wrapping_sub(start) as usize;
            (offset.checked_add(length)? <= bytes.len()).then_some(offset..offset + length)
        };
        if let Some(range) = within(SRAM, &self.sram) {
            return self.sram.get(range);
        }
        if let Some(range) = within(CCM, &self.ccm) {
            return self.ccm.get(range);
        }
        within(flash::BASE, self.flash.bytes()).and_then(|range| self.flash.bytes().get(range))
    }

    /// Writes into SRAM or CCM, as a debugger does; false where neither is.
    pub fn write_memory(&mut self, address: u32, bytes: &[u8]) -> bool {
        let (start, memory) = match address {
            CCM..SRAM => (CCM, &mut self.ccm),
            _ => (SRAM, &mut self.sram),
        };
        let offset = address.wrapping_sub(start) as usize;
        let Some(place) =
            offset.checked_add(bytes.len()).and_then(|end| memory.get_mut(offset..end))
        else {
            return false;
        };
        place.copy_from_slice(bytes);
        let end = address + bytes.len() as u32;
        self.modify(address..end);
        true
    }

    /// Writes into flash, as a programmer does.
    pub fn load_flash(&mut self, offset: usize, bytes: &[u8]) {
        self.flash.load(offset, bytes);
        let start = flash::BASE + offset as u32;
        self.modify(start..start + bytes.len() as u32);
    }

    pub(super) fn modify(&mut self, range: Range<u32>) {
        self.modified = Some(match self.modified.take() {
            None => range,
            Some(known) => known.start.min(range.start)..known.end.max(range.end),
        });
    }

    /// Reading or storing in SRAM or flash failed: what the core does elsewhere.
    #[cold]
    fn read_elsewhere(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        let bytes = width.bytes();
        match address {
            // Flash, from which the chip started.
            0..BOOT_SIZE => self.read(address + flash::BASE, width),
            CCM_ALIAS..=0x2001_FFFF => {
                let bytes =
                    self.memory(address - CCM_ALIAS + CCM, bytes as usize).ok_or(BusError)?;
                Ok(little_endian(bytes))
            }
            CALIBRATION_30_C | CALIBRATION_130_C if bytes == 2 => {
                let [cold, hot] = TEMPERATURE_CALIBRATION;
                Ok(if address == CALIBRATION_30_C { cold } else { hot })
            }
            DBGMCU..=0xE004_23FF => Ok(self.dbgmcu.read(address - DBGMCU, context!(self, DBGMCU))),
            BELOW_SRAM..SRAM => self.access_gap(address).map(|()| 0),
            PRIVATE..=0xE00F_FFFF => match self.mpu.read(address).or(self.system.read(address)) {
                Some(value) => Ok(lanes(value, address, bytes)),
                None => {
                    self.violations.report(Kind::UnmodelledRegister, address, "not emulated");
                    Ok(0)
                }
            },
            0x4000_0000..0x6000_0000 => self.access(address, bytes, None).ok_or(BusError),
            _ => Err(BusError),
        }
    }

    #[cold]
    fn write_elsewhere(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        let bytes = width.bytes();
        match address {
            CCM_ALIAS..=0x2001_FFFF => {
                let stored = self.write_memory(
                    address - CCM_ALIAS + CCM,
                    &value.to_le_bytes()[..bytes as usize],
                );
                if stored { Ok(()) } else { Err(BusError) }
            }
            DBGMCU..=0xE004_23FF => {
                self.dbgmcu.write(address - DBGMCU, value, context!(self, DBGMCU));
                Ok(())
            }
            BELOW_SRAM..SRAM => self.access_gap(address),
            PRIVATE..=0xE00F_FFFF => {
                if !self.mpu.write(address, value) && !self.system.write(address, width, value) {
                    self.violations.report(Kind::UnmodelledRegister, address, "not emulated");
                }
                Ok(())
            }
            0x4000_0000..0x6000_0000 => {
                self.access(address, bytes, Some(value)).map(|_| ()).ok_or(BusError)
            }
            flash::BASE..0x0808_0000 => {
                let flash_base = base_of(&self.entries, Block::Flash);
                self.flash.store(
                    (address - flash::BASE) as usize,
                    value,
                    bytes,
                    context!(self, flash_base),
                );
                self.refresh(Block::Flash);
                self.plan();
                Ok(())
            }
            _ => Err(BusError),
        }
    }

    /// Nothing is there, and whether an access faults is not stated: here a store is lost, and a load gives zero.
    fn access_gap(&mut self, address: u32) -> Result<(), BusError> {
        if self.mpu.forbids(address) {
            return Err(BusError);
        }
        self.violations.report(
            Kind::UnmodelledRegister,
            BELOW_SRAM,
            "reserved addresses below SRAM",
        );
        Ok(())
    }

    /// The first access to a cut of SRAM after a reset: a write is lost (ES0430 2.2.7). Whether this is one.
    #[cold]
    fn touch(&mut self, address: u32) -> bool {
        let cut = match address {
            SRAM..SRAM_2 => 1,
            SRAM_2..CCM_ALIAS => 2,
            CCM_ALIAS..=0x2001_FFFF | CCM..=0x1000_7FFF => 4,
            _ => 0,
        };
        let is_first = self.untouched & cut != 0;
        self.untouched &= !cut;
        is_first
    }

    /// A word with two wrong bits was read.
    #[cold]
    fn fail_flash(&mut self) {
        self.system.pend_nmi();
        if self.syscfg.breaks_on(BreakSource::FlashEcc) {
            self.tim1.system_break(Some(BreakSource::FlashEcc), self.now);
        }
    }
}

impl Bus for Soc {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        let bytes = self.memory(address, 2).ok_or(BusError)?;
        Ok(little_endian(bytes) as u16)
    }

    #[inline]
    fn read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        let length = width.bytes() as usize;
        if self.untouched != 0 {
            self.touch(address);
        }
        let offset = address.wrapping_sub(SRAM) as usize;
        if let Some(bytes) = self.sram.get(offset..offset.wrapping_add(length)) {
            return Ok(little_endian(bytes));
        }
        let offset = address.wrapping_sub(flash::BASE) as usize;
        if offset < flash::SIZE {
            let had_failed = self.flash.has_failed();
            let value = self.flash.read(offset, length).map(little_endian).ok_or(BusError);
            if self.flash.has_failed() && !had_failed {
                self.fail_flash();
            }
            return value;
        }
        let offset = address.wrapping_sub(CCM) as usize;
        if let Some(bytes) = self.ccm.get(offset..offset.wrapping_add(length)) {
            return Ok(little_endian(bytes));
        }
        self.read_elsewhere(address, width)
    }

    #[inline]
    fn write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        let length = width.bytes() as usize;
        if self.untouched != 0 && self.touch(address) {
            return Ok(());
        }
        for (start, memory) in [(SRAM, &mut self.sram), (CCM, &mut self.ccm)] {
            let offset = address.wrapping_sub(start) as usize;
            if let Some(place) = memory.get_mut(offset..offset.wrapping_add(length)) {
                place.copy_from_slice(&value.to_le_bytes()[..length]);
                return Ok(());
            }
        }
        self.write_elsewhere(address, width, value)
    }

    fn set_program_counter(&mut self, pc: u32) {
        self.violations.pc = pc;
    }

    #[inline]
    fn system(&mut self) -> &mut SystemControl {
        &mut self.system
    }

    #[inline]
    fn elapse(&mut self, cycles: u32) {
        self.now += Time::from_ps(u64::from(cycles) * self.cycle.ps());
    }

    #[inline]
    fn event_due(&self) -> bool {
        self.now >= self.pause_at
    }

    fn take_modified_code(&mut self) -> Option<Range<u32>> {
        self.modified.take()
    }
}

/// The bytes of a register's word that an access to an address within it reads.
pub(super) const fn lanes(word: u32, address: u32, bytes: u32) -> u32 {
    let shifted = word >> (8 * (address & 3));
    match bytes {
        4 => shifted,
        _ => shifted & ((1 << (8 * bytes)) - 1),
    }
}

fn little_endian(bytes: &[u8]) -> u32 {
    match *bytes {
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        [a, b] => u16::from_le_bytes([a, b]).into(),
        [a] => a.into(),
        _ => 0,
    }
}

/// RAM contents at power-on (pseudo-random).
pub(super) fn noise(length: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    let next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    std::iter::repeat_with(next).take(length).collect()
}
