//! Model of the flash of the STM32G474 with power cuts at any time: words of eight bytes that are written once after an
//! erasure, pages of 2 KiB.

use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use std::collections::BTreeSet;
use std::vec::Vec;

pub const WORD: usize = 8;
pub const PAGE: usize = 2048;
pub const PAGES: usize = super::PAGES as usize;

/// Read value of a word whose write or erasure was interrupted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// Erased.
    Erased,
    /// The intended or previous value.
    Intended,
    /// A constant mixture of bits.
    Mixed(u64),
    /// ECC error.
    Unreadable,
    /// A different one of these at each read.
    Varying,
}

/// Progress of the operation at the power cut.
#[derive(Clone, Copy, Debug)]
pub enum Cut {
    /// Not begun.
    Before,
    /// The word, or all words of the page, are torn.
    Torn(Torn),
    /// Only the first (true) or second half of the page is erased; a word is torn.
    Half(bool),
    /// Complete.
    After,
}

#[derive(Clone, Copy)]
enum Word {
    Erased,
    Written([u8; WORD]),
    Torn(Torn, [u8; WORD]),
    /// Torn, then written again: valid until the next power cut, then undefined.
    Weak([u8; WORD]),
}

/// The flash: pages, and bytes of a page, which simulations may choose smaller than those of the chip.
#[derive(Clone)]
pub struct FlashModel<const COUNT: usize = PAGES, const PAGE_BYTES: usize = PAGE> {
    words: Vec<Word>,
    /// Read values of the defined words, for a fast copy.
    image: Vec<u8>,
    /// Words with undefined read values.
    undefined: BTreeSet<usize>,
    /// Erasures of each page.
    pub erasures: [u32; COUNT],
    /// Words written and pages erased, begun or done.
    pub operations: u32,
    /// Writes to torn words.
    pub rewritten: u32,
    /// Number of the operation with a power cut, and its kind.
    pub cut: Option<(u32, Cut)>,
    /// Pages that cannot be erased.
    pub worn: [bool; COUNT],
    is_off: bool,
    seed: u64,
}

/// Error of an operation.
#[derive(Debug)]
pub struct Failed;

impl NorFlashError for Failed {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl<const COUNT: usize, const PAGE_BYTES: usize> FlashModel<COUNT, PAGE_BYTES> {
    pub fn new(seed: u64) -> Self {
        Self {
            words: [Word::Erased].repeat(COUNT * PAGE_BYTES / WORD),
            image: [0xFF].repeat(COUNT * PAGE_BYTES),
            undefined: BTreeSet::new(),
            erasures: [0; COUNT],
            operations: 0,
            rewritten: 0,
            cut: None,
            worn: [false; COUNT],
            is_off: false,
            seed,
        }
    }

    /// Restores the power. Weak words become undefined.
    pub fn power_on(&mut self) {
        (self.is_off, self.cut) = (false, None);
        for index in &self.undefined {
            if let Word::Weak(bytes) = self.words[*index] {
                self.words[*index] = Word::Torn(Torn::Varying, bytes);
            }
        }
    }

    /// Whether the power is off.
    pub fn is_off(&self) -> bool {
        self.is_off
    }

    /// Flips a bit of an erased or a written word.
    pub fn flip(&mut self, byte: usize, bit: usize) {
        let mut bytes = match self.words[byte / WORD] {
            Word::Erased => [0xFF; WORD],
            Word::Written(bytes) => bytes,
            _ => panic!("the word at {byte} is undefined"),
        };
        bytes[byte % WORD] ^= 1 << bit;
        self.set(byte / WORD, Word::Written(bytes));
    }

    /// Makes a word unreadable: two of its bits are wrong.
    pub fn damage(&mut self, byte: usize) {
        let bytes = match self.words[byte / WORD] {
            Word::Erased => [0xFF; WORD],
            Word::Written(bytes) | Word::Torn(_, bytes) | Word::Weak(bytes) => bytes,
        };
        self.set(byte / WORD, Word::Torn(Torn::Unreadable, bytes));
    }

    fn set(&mut self, index: usize, word: Word) {
        self.words[index] = word;
        let value = match word {
            Word::Erased => [0xFF; WORD],
            Word::Written(bytes) | Word::Torn(_, bytes) | Word::Weak(bytes) => bytes,
        };
        self.image[index * WORD..][..WORD].copy_from_slice(&value);
        match word {
            Word::Erased | Word::Written(_) => self.undefined.remove(&index),
            Word::Torn(..) | Word::Weak(_) => self.undefined.insert(index),
        };
    }

    /// Splitmix64.
    fn draw(&mut self) -> u64 {
        self.seed = self.seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.seed ^ (self.seed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// The power cut in the next operation, if any.
    fn begin(&mut self) -> Option<Cut> {
        if self.is_off {
            return Some(Cut::Before);
        }
        let cut = self.cut.filter(|(at, _)| *at == self.operations);
        self.operations += 1;
        self.is_off = cut.is_some();
        cut.map(|(_, cut)| cut)
    }

    fn write_word(&mut self, index: usize, bytes: [u8; WORD]) -> Result<(), Failed> {
        let cut = self.begin();
        if matches!(cut, Some(Cut::Before)) {
            return Err(Failed);
        }
        let was = self.words[index];
        self.rewritten += u32::from(matches!(was, Word::Torn(..) | Word::Weak(_)));
        let is = match (was, cut) {
            (Word::Erased, None | Some(Cut::After)) => Word::Written(bytes),
            (Word::Erased, Some(Cut::Torn(torn))) => Word::Torn(torn, bytes),
            (Word::Erased, Some(_)) => Word::Torn(Torn::Varying, bytes),
            (Word::Written(_), _) => panic!("word {index} is written twice"),
            // A torn word that reads as erased cannot be recognised.
            (Word::Torn(..) | Word::Weak(_), None | Some(Cut::After)) => Word::Weak(bytes),
            (Word::Torn(..) | Word::Weak(_), Some(_)) => Word::Torn(Torn::Varying, bytes),
        };
        self.set(index, is);
        cut.map_or(Ok(()), |_| Err(Failed))
    }

    fn read_word(&mut self, index: usize) -> Result<[u8; WORD], Failed> {
        let (torn, bytes) = match self.words[index] {
            Word::Erased => (Torn::Erased, [0; WORD]),
            Word::Written(bytes) | Word::Weak(bytes) => (Torn::Intended, bytes),
            Word::Torn(Torn::Varying, bytes) => {
                let mix = self.draw();
                let ways = [Torn::Erased, Torn::Intended, Torn::Mixed(mix), Torn::Unreadable];
                (ways[(mix >> 62) as usize], bytes)
            }
            Word::Torn(torn, bytes) => (torn, bytes),
        };
        match torn {
            Torn::Erased => Ok([0xFF; WORD]),
            Torn::Intended => Ok(bytes),
            Torn::Mixed(mix) => Ok((u64::from_le_bytes(bytes) | mix).to_le_bytes()),
            Torn::Unreadable | Torn::Varying => Err(Failed),
        }
    }

    fn erase_page(&mut self, page: usize) -> Result<(), Failed> {
        let cut = self.begin();
        if self.worn[page] || matches!(cut, Some(Cut::Before)) {
            return Err(Failed);
        }
        self.erasures[page] += 1;
        let words = PAGE_BYTES / WORD;
        for (number, index) in (page * words..).take(words).enumerate() {
            let was = match self.words[index] {
                Word::Erased => [0xFF; WORD],
                Word::Written(bytes) | Word::Torn(_, bytes) | Word::Weak(bytes) => bytes,
            };
            match cut {
                Some(Cut::Torn(torn)) => self.set(index, Word::Torn(torn, was)),
                Some(Cut::Half(first)) if first != (number < words / 2) => {}
                _ => self.set(index, Word::Erased),
            }
        }
        cut.map_or(Ok(()), |_| Err(Failed))
    }
}

impl<const COUNT: usize, const PAGE_BYTES: usize> ErrorType for FlashModel<COUNT, PAGE_BYTES> {
    type Error = Failed;
}

impl<const COUNT: usize, const PAGE_BYTES: usize> ReadNorFlash for FlashModel<COUNT, PAGE_BYTES> {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failed> {
        let offset = offset as usize;
        if self.is_off || !offset.is_multiple_of(WORD) {
            return Err(Failed);
        }
        let end = offset + bytes.len();
        bytes.copy_from_slice(&self.image[offset..end]);
        if self.undefined.is_empty() {
            return Ok(());
        }
        let undefined: Vec<usize> =
            self.undefined.range(offset / WORD..end.div_ceil(WORD)).copied().collect();
        for index in undefined {
            let word = self.read_word(index)?;
            let rest = &mut bytes[index * WORD - offset..];
            let length = rest.len().min(WORD);
            rest[..length].copy_from_slice(&word[..length]);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        COUNT * PAGE_BYTES
    }
}

impl<const COUNT: usize, const PAGE_BYTES: usize> NorFlash for FlashModel<COUNT, PAGE_BYTES> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failed> {
        let (from, to) = (from as usize, to as usize);
        assert!(from.is_multiple_of(PAGE_BYTES) && to.is_multiple_of(PAGE_BYTES));
        (from / PAGE_BYTES..to / PAGE_BYTES).try_for_each(|page| self.erase_page(page))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failed> {
        let offset = offset as usize;
        assert!(offset.is_multiple_of(WORD) && bytes.len().is_multiple_of(WORD));
        let mut words = (offset / WORD..).zip(bytes.as_chunks::<WORD>().0);
        words.try_for_each(|(index, bytes)| self.write_word(index, *bytes))
    }
}

/// Output of a future that is ready at once.
pub fn block<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("a flash operation is pending"),
    }
}
