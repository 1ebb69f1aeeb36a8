//! The pages of flash that keep parameters: the last four of the second bank (`memory.x`).
//!
//! The core runs from the first bank, which goes on being read while the second is written or erased, as
//! long as the image is below 256 KiB. A word in which two bits are wrong, as a cut of the power leaves it,
//! raises the non-maskable interrupt: here it becomes an error of that read. None of this has run on
//! hardware.
#![allow(unsafe_code)] // Where the linker script has put the pages.

use core::sync::atomic::{AtomicBool, Ordering, compiler_fence};

use embassy_stm32::flash::{self, Async, FLASH_BASE, Flash, MAX_ERASE_SIZE, WRITE_SIZE};
use embassy_stm32::{Peri, bind_interrupts, pac, peripherals};
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

use crate::store::Store;

bind_interrupts!(struct Interrupts {
    FLASH => flash::InterruptHandler;
});

/// Set while a page is read: only then is a word in it allowed to be unreadable.
static READING: AtomicBool = AtomicBool::new(false);
/// Set by the interrupt.
static UNREADABLE: AtomicBool = AtomicBool::new(false);

unsafe extern "C" {
    /// The first page; `memory.x`.
    static _parameters: u32;
}

/// The pages behind the driver.
pub struct Pages(Flash<'static, Async>);

/// Why the memory refused.
#[derive(Debug)]
pub enum Refused {
    /// The driver's reason.
    Driver(flash::Error),
    /// Two bits of a word are wrong.
    Unreadable,
}

/// The store of parameters.
pub fn store(flash: Peri<'static, peripherals::FLASH>) -> Store<Pages> {
    let start = (&raw const _parameters as usize).saturating_sub(FLASH_BASE);
    Store::new(Pages(Flash::new(flash, Interrupts)), start as u32)
}

/// For the non-maskable interrupt: whether it was a word of these pages while they were read. The error is
/// then dealt with.
pub(super) fn was_unreadable() -> bool {
    if !pac::FLASH.eccr().read().eccd() || !READING.load(Ordering::Relaxed) {
        return false;
    }
    // Written, the flag is cleared.
    pac::FLASH.eccr().modify(|w| w.set_eccd(true));
    UNREADABLE.store(true, Ordering::Relaxed);
    true
}

impl NorFlashError for Refused {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Driver(error) => error.kind(),
            Self::Unreadable => NorFlashErrorKind::Other,
        }
    }
}

impl ErrorType for Pages {
    type Error = Refused;
}

impl ReadNorFlash for Pages {
    const READ_SIZE: usize = flash::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Refused> {
        UNREADABLE.store(false, Ordering::Relaxed);
        READING.store(true, Ordering::Relaxed);
        compiler_fence(Ordering::SeqCst);
        let read = self.0.blocking_read(offset, bytes);
        // The interrupt of the last word comes before the next instruction but one.
        cortex_m::asm::dsb();
        compiler_fence(Ordering::SeqCst);
        READING.store(false, Ordering::Relaxed);
        match UNREADABLE.load(Ordering::Relaxed) {
            true => Err(Refused::Unreadable),
            false => read.map_err(Refused::Driver),
        }
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.0)
    }
}

impl NorFlash for Pages {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = MAX_ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Refused> {
        self.0.erase(from, to).await.map_err(Refused::Driver)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Refused> {
        self.0.write(offset, bytes).await.map_err(Refused::Driver)
    }
}
