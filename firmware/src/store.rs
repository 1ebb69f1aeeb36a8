//! Parameters in flash: old or new, whenever the power goes, and never a mixture.
//!
//! All parameters are one record ([`record`]) of its own sequence and checksum. Records follow each other
//! through the slots of [`PAGES`] pages, round and round. 10,000 saves without a start between them erase
//! each of four pages with 2 KiB 313 times; the first save after a start erases one page more. The chip is
//! good for 10,000 times, and so for 40,000 starts with saves.
//!
//! What a cut leaves behind is not defined: a word may read as anything, as an error of the memory, and
//! differently every time. It may read erased, take another write, read right, and be something else at the
//! next start. So nothing rests on a word that was begun before the start:
//!
//! - the first save after a start goes to a page that it erases itself, so do all that begin a page, and no
//!   slot is written twice. Words are written only where this start has seen them erased to the end;
//! - the body is written and read back, then a first mark, then a second. What has its first mark counts:
//!   all of its body was done before that was begun. What has its second mark counts for ever: the first was
//!   done. A cut in the first leaves what counts today and not tomorrow: then [`Store::load`] says that it is
//!   not settled, the caller saves again, and what was read once stays so;
//! - over what newer firmware has written nothing is saved again unasked: there a save that was cut in its
//!   first mark may begin to count at a later start. It is one that a host had asked for, whole;
//! - what has its first mark for sure always shows it, but what shows it may not have it for sure. So no page
//!   is erased with a record that shows it and is not older than the newest that shows its second. After as many
//!   cuts in first marks as there are pages nothing may be left to erase: then nothing is saved, nor lost;
//! - a record's sequence says its slot, and is greater than that of every record whose body is right,
//!   whether it counts or not: one that reads right years later is older than what was written after it.
//!
//! The well-kept library for this, `sequential-storage` (8.0.2), was run against the same cuts and is not
//! used: after an erasure that stopped halfway it found an older value, where a torn word read erased it
//! reported saves as done that were lost, and a word that the memory could not read stopped it for good.

pub mod record;

use embedded_storage_async::nor_flash::NorFlash;

use crate::parameters::Parameters;
use record::{BODY, END, ERASED, SLOT, VERSION, WRITTEN};

/// Pages that the store goes round.
pub const PAGES: u32 = 4;

/// Where parameters come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// From flash.
    Stored,
    /// From flash, by older firmware: what it did not know has its default.
    Older,
    /// Defaults: newer firmware has written what this one does not understand.
    Newer,
    /// Defaults: nothing was ever saved.
    Empty,
    /// Defaults: something is there, and no checksum is right.
    Spoilt,
}

impl Origin {
    /// For the detail of a [`crate::wire::messages::FaultEvent`]: 0 stored, 1 older, 2 newer, 3 empty, 4
    /// spoilt.
    pub const fn code(self) -> u32 {
        match self {
            Self::Stored => 0,
            Self::Older => 1,
            Self::Newer => 2,
            Self::Empty => 3,
            Self::Spoilt => 4,
        }
    }
}

/// What was found at a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loaded {
    /// The parameters.
    pub parameters: Parameters,
    /// Where they come from.
    pub origin: Origin,
    /// False where a save was cut short: the caller saves these parameters again.
    pub is_settled: bool,
}

/// Nothing was saved for sure: no slot took the record. The pages are worn out, or the memory refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotSaved;

/// The pages of the parameters.
#[derive(Debug)]
pub struct Store<F> {
    flash: F,
    /// Of the first page.
    start: u32,
    /// Sequence of the next record, where its page was erased since the start.
    next: Option<u32>,
}

/// How far the writing of a record came.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    /// Its body reads right; nobody knows for how long.
    Begun,
    /// It has its first mark, or its second alone.
    Written,
    /// It has its second.
    Finished,
}

/// A right record, without its bytes.
#[derive(Clone, Copy)]
struct Kept {
    sequence: u32,
    version: u16,
    parameters: Parameters,
    stage: Stage,
}

/// What a slot reads as.
enum Slot {
    Erased,
    Record(Kept),
    /// Nothing right, and how far its marks say that it came.
    Spoilt(Stage),
}

/// What all slots hold.
#[derive(Default)]
struct Found {
    /// The newest record that counts.
    newest: Option<Kept>,
    /// Sequence of the newest that is finished.
    finished: Option<u32>,
    /// In each page the newest that has its first mark.
    written: [Option<u32>; PAGES as usize],
    /// Sequence of the newest of all, begun or more.
    last: Option<u32>,
    /// Some slot holds what does not count.
    is_spoilt: bool,
}

impl<F: NorFlash> Store<F> {
    const SLOTS_OF_PAGE: u32 = {
        assert!(F::ERASE_SIZE.is_multiple_of(SLOT) && F::ERASE_SIZE >= SLOT);
        assert!(WRITTEN.len().is_multiple_of(F::WRITE_SIZE) && END.len() == WRITTEN.len());
        assert!(SLOT.is_multiple_of(F::READ_SIZE));
        (F::ERASE_SIZE / SLOT) as u32
    };
    const SLOTS: u32 = PAGES * Self::SLOTS_OF_PAGE;

    /// The store whose first page begins at `start`, on a page's border.
    pub const fn new(flash: F, start: u32) -> Self {
        Self {
            flash,
            start,
            next: None,
        }
    }

    /// The newest parameters.
    pub async fn load(&mut self) -> Loaded {
        let found = self.scan().await;
        let mut is_settled = found.last == found.finished;
        // Where the one after it would be.
        let following = found.last.map_or(0, |last| last.wrapping_add(1));
        for next in [following, Self::page_behind(found.last)] {
            is_settled &= match self.slot(next % Self::SLOTS).await {
                Slot::Erased => true,
                // From the round before.
                Slot::Record(record) => record.sequence < next,
                // Its save was never done.
                Slot::Spoilt(Stage::Begun) => true,
                // It was done, or nearly, and may read right again.
                Slot::Spoilt(_) => false,
            };
        }
        let (parameters, origin) = match found.newest {
            Some(newest) if newest.version == VERSION => (newest.parameters, Origin::Stored),
            Some(newest) if newest.version < VERSION => (newest.parameters, Origin::Older),
            Some(_) => (Parameters::DEFAULT, Origin::Newer),
            None if found.is_spoilt => (Parameters::DEFAULT, Origin::Spoilt),
            None => (Parameters::DEFAULT, Origin::Empty),
        };
        Loaded {
            parameters,
            origin,
            // What newer firmware has written stays for it until the host asks to save.
            is_settled: is_settled && origin != Origin::Spoilt || origin == Origin::Newer,
        }
    }

    /// Saves all parameters. Takes some 2 ms, and 25 ms more where a page is erased, by the data sheet.
    ///
    /// # Errors
    /// No slot took the record; what was saved before still counts.
    pub async fn save(&mut self, parameters: &Parameters) -> Result<(), NotSaved> {
        let found = self.scan().await;
        // What is sure to count is one of these.
        let may_count = |sequence: Option<u32>| sequence.is_some() && sequence >= found.finished;
        let kept = found.written.map(may_count);
        // As many saves as a sequence has numbers are far beyond the life of the flash.
        let first = self.next.take();
        let mut sequence = first.unwrap_or_else(|| Self::page_behind(found.last));
        for _ in 0..Self::SLOTS {
            if sequence.is_multiple_of(Self::SLOTS_OF_PAGE) {
                let page = Self::page(sequence);
                let is_kept = kept.get(page as usize).copied().unwrap_or(true);
                if is_kept || self.erase(page).await.is_err() {
                    sequence = sequence.wrapping_add(Self::SLOTS_OF_PAGE);
                    continue;
                }
            }
            let place = sequence % Self::SLOTS;
            // Whatever comes of this slot, it is used up.
            sequence = sequence.wrapping_add(1);
            self.next = Some(sequence);
            if matches!(self.slot(place).await, Slot::Erased)
                && self
                    .write(place, sequence.wrapping_sub(1), parameters)
                    .await
                    .is_some()
            {
                return Ok(());
            }
        }
        Err(NotSaved)
    }

    async fn scan(&mut self) -> Found {
        let mut found = Found::default();
        for place in 0..Self::SLOTS {
            let record = match self.slot(place).await {
                Slot::Erased => continue,
                Slot::Spoilt(_) => {
                    found.is_spoilt = true;
                    continue;
                }
                Slot::Record(record) => record,
            };
            found.last = found.last.max(Some(record.sequence));
            match record.stage {
                Stage::Begun => {
                    found.is_spoilt = true;
                    continue;
                }
                Stage::Written => {}
                Stage::Finished => found.finished = found.finished.max(Some(record.sequence)),
            }
            if let Some(newest) = found.written.get_mut(Self::page(record.sequence) as usize) {
                *newest = (*newest).max(Some(record.sequence));
            }
            if found
                .newest
                .is_none_or(|newest| newest.sequence < record.sequence)
            {
                found.newest = Some(record);
            }
        }
        found
    }

    async fn slot(&mut self, place: u32) -> Slot {
        let mut body = [0; BODY];
        let at = self.address(place);
        let is_read = self.flash.read(at, &mut body).await.is_ok();
        let marks = [
            self.mark(at + BODY as u32).await,
            self.mark(at + (BODY + WRITTEN.len()) as u32).await,
        ];
        let stage = match marks {
            [_, Some(END)] => Stage::Finished,
            [Some(WRITTEN), _] => Stage::Written,
            _ => Stage::Begun,
        };
        if !is_read {
            return Slot::Spoilt(stage);
        }
        const BLANK: Option<[u8; WRITTEN.len()]> = Some([ERASED; WRITTEN.len()]);
        if marks == [BLANK; 2] && is_erased(&body) {
            return Slot::Erased;
        }
        match record::decode(&body) {
            Some(record) if record.sequence % Self::SLOTS == place => Slot::Record(Kept {
                sequence: record.sequence,
                version: record.version,
                parameters: record.parameters(),
                stage,
            }),
            _ => Slot::Spoilt(stage),
        }
    }

    /// What stands where a mark may stand; nothing where it cannot be read.
    async fn mark(&mut self, at: u32) -> Option<[u8; WRITTEN.len()]> {
        let mut mark = [0; WRITTEN.len()];
        self.flash.read(at, &mut mark).await.ok()?;
        Some(mark)
    }

    async fn erase(&mut self, page: u32) -> Result<(), F::Error> {
        let from = self.address(page * Self::SLOTS_OF_PAGE);
        self.flash.erase(from, from + F::ERASE_SIZE as u32).await
    }

    /// Writes a record, then its marks; reads each back before the next.
    async fn write(&mut self, place: u32, sequence: u32, parameters: &Parameters) -> Option<()> {
        let (body, used) = record::encode(sequence, parameters);
        let words = body.get(..used.next_multiple_of(F::WRITE_SIZE))?;
        let mut at = self.address(place);
        self.flash.write(at, words).await.ok()?;
        let mut read = [0; BODY];
        self.flash.read(at, &mut read).await.ok()?;
        if read != body {
            return None;
        }
        at += BODY as u32;
        for mark in [WRITTEN, END] {
            self.flash.write(at, &mark).await.ok()?;
            if self.mark(at).await? != mark {
                return None;
            }
            at += mark.len() as u32;
        }
        Some(())
    }

    /// First sequence of the page behind that of the newest record.
    fn page_behind(last: Option<u32>) -> u32 {
        last.map_or(0, |last| {
            (last - last % Self::SLOTS_OF_PAGE).wrapping_add(Self::SLOTS_OF_PAGE)
        })
    }

    /// The page that a sequence lies in.
    fn page(sequence: u32) -> u32 {
        sequence % Self::SLOTS / Self::SLOTS_OF_PAGE
    }

    fn address(&self, place: u32) -> u32 {
        self.start + place * SLOT as u32
    }
}

/// Sixteen bytes at once: all slots are looked at in each save.
fn is_erased(body: &[u8; BODY]) -> bool {
    let (chunks, rest) = body.as_chunks::<16>();
    chunks.iter().all(|chunk| *chunk == [ERASED; 16]) && rest.iter().all(|byte| *byte == ERASED)
}

#[cfg(test)]
mod memory;
#[cfg(test)]
mod tests;
