//! Flash of parameters and calibrations: pages of 2 KiB, double words that are written once after an erase.

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use firmware::system::nv_storage::PAGES;
use firmware::system::nv_storage::calibration::{SLOT_BYTES, SLOTS};
use std::cell::RefCell;
use std::rc::Rc;

const PAGE: usize = 2048;
const WORD: usize = 8;

/// Offset of the parameters.
pub const PARAMETERS: u32 = 0;
/// Offset of the calibrations.
pub const CALIBRATIONS: u32 = PARAMETERS + PAGES * PAGE as u32;

/// The memory; clones share it.
#[derive(Clone)]
pub struct Flash(Rc<RefCell<Vec<u8>>>);

impl Default for Flash {
    fn default() -> Self {
        let bytes = CALIBRATIONS + SLOTS * SLOT_BYTES;
        Self(Rc::new(RefCell::new(vec![0xFF; bytes as usize])))
    }
}

impl Flash {
    /// All bytes.
    pub fn bytes(&self) -> Vec<u8> {
        self.0.borrow().clone()
    }

    /// Flips a bit.
    pub fn flip(&self, byte: usize, bit: u32) {
        if let Some(byte) = self.0.borrow_mut().get_mut(byte) {
            *byte ^= 1 << bit;
        }
    }

    fn with<T>(
        &mut self,
        offset: u32,
        length: usize,
        access: impl FnOnce(&mut [u8]) -> Result<T, NorFlashErrorKind>,
    ) -> Result<T, NorFlashErrorKind> {
        let mut bytes = self.0.borrow_mut();
        let range = bytes.get_mut(offset as usize..).and_then(|rest| rest.get_mut(..length));
        range.ok_or(NorFlashErrorKind::OutOfBounds).and_then(access)
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.with(offset, bytes.len(), |stored| {
            bytes.copy_from_slice(stored);
            Ok(())
        })
    }

    fn capacity(&self) -> usize {
        self.0.borrow().len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.with(from, to.saturating_sub(from) as usize, |stored| {
            stored.fill(0xFF);
            Ok(())
        })
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        self.with(offset, bytes.len(), |stored| {
            if stored.iter().any(|byte| *byte != 0xFF) {
                return Err(NorFlashErrorKind::Other);
            }
            stored.copy_from_slice(bytes);
            Ok(())
        })
    }
}
