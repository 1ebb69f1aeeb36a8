//! Flash of parameters and calibrations: the last pages of the second bank (`memory.x`).
//!
//! The core runs from the first bank, which can be read while the second is written or erased, as long as the image is
//! below 256 KiB. A word with two wrong bits, as a power cut leaves it, raises the non-maskable interrupt, which becomes an
//! error of that read here. Not tested on hardware.
#![allow(unsafe_code)] // A symbol of the linker script.

use core::sync::atomic::{AtomicBool, Ordering, compiler_fence};

use embassy_stm32::flash::{self, Async, FLASH_BASE, Flash, MAX_ERASE_SIZE, WRITE_SIZE};
use embassy_stm32::{Peri, bind_interrupts, pac, peripherals};
use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

use crate::board::FlashOffsets;

bind_interrupts!(struct Interrupts {
    FLASH => flash::InterruptHandler;
});

/// Set while a page is read: only then an ECC error is tolerated.
static READING: AtomicBool = AtomicBool::new(false);
/// Set by the interrupt.
static ECC_ERROR: AtomicBool = AtomicBool::new(false);

unsafe extern "C" {
    /// First page of the parameters (`memory.x`).
    static _parameters: u32;
    /// First page of the calibrations (`memory.x`).
    static _calibrations: u32;
}

/// Driver of these pages.
pub struct SettingsFlash(Flash<'static, Async>);

/// Why an access failed.
#[derive(Debug)]
pub enum FlashError {
    /// Error of the driver.
    Driver(flash::Error),
    /// Two bits of a word are wrong.
    Ecc,
    /// The option bytes select a single bank (DBANK = 0): another page than the one meant would be erased, one of the image.
    SingleBank,
}

/// The driver, and where parameters and calibrations are.
pub fn settings_flash(flash: Peri<'static, peripherals::FLASH>) -> (SettingsFlash, FlashOffsets) {
    let offset = |page: *const u32| (page as usize).saturating_sub(FLASH_BASE) as u32;
    let offsets = FlashOffsets {
        parameters: offset(&raw const _parameters),
        calibrations: offset(&raw const _calibrations),
    };
    (SettingsFlash(Flash::new(flash, Interrupts)), offsets)
}

/// Called by the non-maskable interrupt: clears an ECC error of a read of these pages; false for any other cause.
pub(super) fn handle_ecc_error() -> bool {
    if !pac::FLASH.eccr().read().eccd() || !READING.load(Ordering::Relaxed) {
        return false;
    }
    // The flag is cleared by writing one.
    pac::FLASH.eccr().modify(|w| w.set_eccd(true));
    ECC_ERROR.store(true, Ordering::Relaxed);
    true
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Driver(error) => error.kind(),
            Self::Ecc | Self::SingleBank => NorFlashErrorKind::Other,
        }
    }
}

impl ErrorType for SettingsFlash {
    type Error = FlashError;
}

impl ReadNorFlash for SettingsFlash {
    const READ_SIZE: usize = flash::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        ECC_ERROR.store(false, Ordering::Relaxed);
        READING.store(true, Ordering::Relaxed);
        compiler_fence(Ordering::SeqCst);
        let read = self.0.blocking_read(offset, bytes);
        // An interrupt due to the last word is taken before the next instruction but one.
        cortex_m::asm::dsb();
        compiler_fence(Ordering::SeqCst);
        READING.store(false, Ordering::Relaxed);
        if ECC_ERROR.load(Ordering::Relaxed) {
            Err(FlashError::Ecc)
        } else {
            read.map_err(FlashError::Driver)
        }
    }

    fn capacity(&self) -> usize {
        ReadNorFlash::capacity(&self.0)
    }
}

/// Pages have the size and number of this driver only with two banks (RM0440 3.3.1).
fn check_banks() -> Result<(), FlashError> {
    let has_two = pac::FLASH.optr().read().dbank();
    if has_two { Ok(()) } else { Err(FlashError::SingleBank) }
}

/// embassy-stm32 0.6.0 reports success always (`firmware/UPSTREAM.md`): what is written must be read back, as
/// [`crate::system::nv_storage`] does.
impl NorFlash for SettingsFlash {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = MAX_ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check_banks()?;
        self.0.erase(from, to).await.map_err(FlashError::Driver)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check_banks()?;
        self.0.write(offset, bytes).await.map_err(FlashError::Driver)
    }
}
