//! A flash like the STM32G474's whose power can go at any time: words of eight bytes that are written once
//! after an erasure, pages of 2 KiB.

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

/// What a word that was being written or erased reads as afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// Erased.
    Erased,
    /// As it was meant, or was before.
    Right,
    /// A mixture of bits, always the same.
    Mixed(u64),
    /// Two errors at once: the memory says so.
    Unreadable,
    /// Every time another of these.
    Wavering,
}

/// How far the operation comes in which the power goes.
#[derive(Clone, Copy, Debug)]
pub enum Cut {
    /// It is not begun.
    Before,
    /// One word is torn, or all words of a page.
    Torn(Torn),
    /// A page is erased in its first half only, or in its second; a word is torn.
    Half(bool),
    /// It is done.
    After,
}

#[derive(Clone, Copy)]
enum Word {
    Erased,
    Written([u8; WORD]),
    Torn(Torn, [u8; WORD]),
    /// Torn, then written again: it holds until the power goes, and is anything then.
    Weak([u8; WORD]),
}

/// The memory.
#[derive(Clone)]
pub struct Memory {
    words: Vec<Word>,
    /// What they read as where that is sure, so that reading them all is a copy.
    image: Vec<u8>,
    /// Words of which it is not sure.
    odd: BTreeSet<usize>,
    /// Erasures of each page.
    pub erasures: [u32; PAGES],
    /// Words written and pages erased, begun or done.
    pub operations: u32,
    /// Words written that had been torn.
    pub rewritten: u32,
    /// The power goes in the operation of this number.
    pub cut: Option<(u32, Cut)>,
    /// Pages that cannot be erased any more.
    pub worn: [bool; PAGES],
    is_off: bool,
    seed: u64,
}

/// It failed.
#[derive(Debug)]
pub struct Failed;

impl NorFlashError for Failed {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl Memory {
    pub fn new(seed: u64) -> Self {
        Self {
            words: [Word::Erased].repeat(PAGES * PAGE / WORD),
            image: [0xFF].repeat(PAGES * PAGE),
            odd: BTreeSet::new(),
            erasures: [0; PAGES],
            operations: 0,
            rewritten: 0,
            cut: None,
            worn: [false; PAGES],
            is_off: false,
            seed,
        }
    }

    /// The power returns, and stays. Words that only held so far do so no more.
    pub fn power_on(&mut self) {
        (self.is_off, self.cut) = (false, None);
        for place in &self.odd {
            if let Word::Weak(bytes) = self.words[*place] {
                self.words[*place] = Word::Torn(Torn::Wavering, bytes);
            }
        }
    }

    /// Whether the power has gone.
    pub fn is_off(&self) -> bool {
        self.is_off
    }

    /// Turns a bit of what is written.
    pub fn flip(&mut self, byte: usize, bit: usize) {
        match &mut self.words[byte / WORD] {
            Word::Written(bytes) => bytes[byte % WORD] ^= 1 << bit,
            _ => panic!("nothing is written at {byte}"),
        }
        self.image[byte] ^= 1 << bit;
    }

    fn set(&mut self, place: usize, word: Word) {
        self.words[place] = word;
        let said = match word {
            Word::Erased => [0xFF; WORD],
            Word::Written(bytes) | Word::Torn(_, bytes) | Word::Weak(bytes) => bytes,
        };
        self.image[place * WORD..][..WORD].copy_from_slice(&said);
        match word {
            Word::Erased | Word::Written(_) => self.odd.remove(&place),
            Word::Torn(..) | Word::Weak(_) => self.odd.insert(place),
        };
    }

    /// Splitmix64.
    fn draw(&mut self) -> u64 {
        self.seed = self.seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.seed ^ (self.seed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// What stops the next operation on the way, if anything does.
    fn begin(&mut self) -> Option<Cut> {
        if self.is_off {
            return Some(Cut::Before);
        }
        let cut = self.cut.filter(|(at, _)| *at == self.operations);
        self.operations += 1;
        self.is_off = cut.is_some();
        cut.map(|(_, cut)| cut)
    }

    fn write_word(&mut self, place: usize, bytes: [u8; WORD]) -> Result<(), Failed> {
        let cut = self.begin();
        if matches!(cut, Some(Cut::Before)) {
            return Err(Failed);
        }
        let was = self.words[place];
        self.rewritten += u32::from(matches!(was, Word::Torn(..) | Word::Weak(_)));
        let is = match (was, cut) {
            (Word::Erased, None | Some(Cut::After)) => Word::Written(bytes),
            (Word::Erased, Some(Cut::Torn(torn))) => Word::Torn(torn, bytes),
            (Word::Erased, Some(_)) => Word::Torn(Torn::Wavering, bytes),
            (Word::Written(_), _) => panic!("word {place} is written twice"),
            // Nobody can know that it was torn where it read erased.
            (Word::Torn(..) | Word::Weak(_), None | Some(Cut::After)) => Word::Weak(bytes),
            (Word::Torn(..) | Word::Weak(_), Some(_)) => Word::Torn(Torn::Wavering, bytes),
        };
        self.set(place, is);
        cut.map_or(Ok(()), |_| Err(Failed))
    }

    fn read_word(&mut self, place: usize) -> Result<[u8; WORD], Failed> {
        let (torn, bytes) = match self.words[place] {
            Word::Erased => (Torn::Erased, [0; WORD]),
            Word::Written(bytes) | Word::Weak(bytes) => (Torn::Right, bytes),
            Word::Torn(Torn::Wavering, bytes) => {
                let mix = self.draw();
                let ways = [
                    Torn::Erased,
                    Torn::Right,
                    Torn::Mixed(mix),
                    Torn::Unreadable,
                ];
                (ways[(mix >> 62) as usize], bytes)
            }
            Word::Torn(torn, bytes) => (torn, bytes),
        };
        match torn {
            Torn::Erased => Ok([0xFF; WORD]),
            Torn::Right => Ok(bytes),
            Torn::Mixed(mix) => Ok((u64::from_le_bytes(bytes) | mix).to_le_bytes()),
            Torn::Unreadable | Torn::Wavering => Err(Failed),
        }
    }

    fn erase_page(&mut self, page: usize) -> Result<(), Failed> {
        let cut = self.begin();
        if self.worn[page] || matches!(cut, Some(Cut::Before)) {
            return Err(Failed);
        }
        self.erasures[page] += 1;
        let words = PAGE / WORD;
        for (number, place) in (page * words..).take(words).enumerate() {
            let was = match self.words[place] {
                Word::Erased => [0xFF; WORD],
                Word::Written(bytes) | Word::Torn(_, bytes) | Word::Weak(bytes) => bytes,
            };
            match cut {
                Some(Cut::Torn(torn)) => self.set(place, Word::Torn(torn, was)),
                Some(Cut::Half(first)) if first != (number < words / 2) => {}
                _ => self.set(place, Word::Erased),
            }
        }
        cut.map_or(Ok(()), |_| Err(Failed))
    }
}

impl ErrorType for Memory {
    type Error = Failed;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failed> {
        let offset = offset as usize;
        if self.is_off || !offset.is_multiple_of(WORD) {
            return Err(Failed);
        }
        let end = offset + bytes.len();
        bytes.copy_from_slice(&self.image[offset..end]);
        let odd: Vec<usize> = self
            .odd
            .range(offset / WORD..end.div_ceil(WORD))
            .copied()
            .collect();
        for place in odd {
            let word = self.read_word(place)?;
            let rest = &mut bytes[place * WORD - offset..];
            let length = rest.len().min(WORD);
            rest[..length].copy_from_slice(&word[..length]);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        PAGES * PAGE
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Failed> {
        let (from, to) = (from as usize, to as usize);
        assert!(from.is_multiple_of(PAGE) && to.is_multiple_of(PAGE));
        (from / PAGE..to / PAGE).try_for_each(|page| self.erase_page(page))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failed> {
        let offset = offset as usize;
        assert!(offset.is_multiple_of(WORD) && bytes.len().is_multiple_of(WORD));
        let mut words = (offset / WORD..).zip(bytes.as_chunks::<WORD>().0);
        words.try_for_each(|(place, bytes)| self.write_word(place, *bytes))
    }
}

/// The end of a future that never waits.
pub fn now<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("the memory lets nobody wait"),
    }
}
