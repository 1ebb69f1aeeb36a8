//! Non-volatile storage of the parameters, safe against power loss at any time: a load gives the old or the new values,
//! never a mixture.
//!
//! All parameters and the key of the hosts are one record ([`record`]) with a sequence number and a checksum. A save writes
//! it twice. Records follow each other through the slots of [`PAGES`] pages in a ring. 10,000 saves without a reboot erase
//! each of four pages of 2 KiB 625 times; the first save after a boot erases one page more. The chip is specified for 10,000
//! erasures, hence 40,000 boots with saves.
//!
//! The store fails closed: a revoked key must not come back, nor a key become none, because of damaged bytes. One damaged
//! record of a save is replaced by the other. If both are damaged, the values before them are loaded as
//! [`ParameterOrigin::Previous`], without any valid record the defaults as [`ParameterOrigin::Corrupt`]. Neither is saved
//! again before a person has accepted it ([`crate::tasks::host_service`]), and meanwhile nothing moves. A damaged record is
//! dated by its sequence and by the number of its save, which has a checksum of its own: the remains of an interrupted erasure have
//! older ones.
//!
//! The state of a word after a power cut is undefined: it may read as any value, as an ECC error, and differently every
//! time. It may read as erased, accept another write, read correctly, and change at the next boot. Therefore no word
//! whose write began before the boot is relied on:
//!
//! - the first save after a boot begins at a page that it erases itself, as does every save that begins a page, and no slot
//!   is written twice. Words are written only after an erasure that completed since the boot;
//! - the body is written and read back, then a first mark, then a second. A record with its first mark counts: its body was
//!   complete before. A record with its second mark counts for ever: its first mark was complete. A power cut in the first
//!   mark leaves a record that counts now but perhaps not at the next boot: then [`ParameterStore::load`] reports it as not
//!   settled, the caller saves again, and the loaded values stay;
//! - records of newer firmware are not overwritten without a request: there, a save interrupted in its first mark may begin
//!   to count at a later boot. It is complete, and a host had requested it;
//! - a completed first mark always reads as such, but a mark that reads as such may be incomplete. So no page is erased that
//!   has a record with a first mark which is not older than the newest with a second mark. After as many power cuts in first
//!   marks as there are pages, no page may be left to erase: then nothing is saved, and nothing is lost;
//! - the sequence number determines the slot and exceeds that of every record with a valid body, counted or not: a record
//!   that becomes readable years later is older than those written after it.
//!
//! The crate `sequential-storage` (8.0.2) fails the same power-cut tests, as a map with one key on the same flash model. With
//! a save at every boot and unreadable words read as zeros, 196 of 11,580 cuts fail: the marker of a page or the header of an
//! item, torn so that it reads as erased, is written again; then a later save is reported as done and lost (80), or loads and
//! saves end with `Corrupted` (54). With unreadable words as errors of the driver, its repair is not reached: 4,508 cuts
//! fail, most of them in every later load. Its queue also gives an older value after an erasure that cleared only the second
//! half of a page.

pub mod calibration;
pub mod record;

use embedded_storage_async::nor_flash::NorFlash;

use crate::parameters::Parameters;
use crate::protocol::authentication::Key;
use record::{BODY_BYTES, ERASED, FIRST_MARK, SAVE_AT, SECOND_MARK, SLOT_BYTES, VERSION, save_of};

/// Pages of the ring.
pub const PAGES: u32 = 4;
/// Records of a save.
const COPIES: u32 = 2;

/// Origin of loaded parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterOrigin {
    /// From flash.
    Stored,
    /// From flash, saved by older firmware: parameters unknown to it have defaults.
    Older,
    /// Defaults: saved by newer firmware in an unknown format.
    Newer,
    /// Defaults: nothing was ever saved.
    Empty,
    /// Defaults: no record has a valid checksum.
    Corrupt,
    /// From flash, but a later save is damaged: values and key may have been replaced.
    Previous,
}

impl ParameterOrigin {
    /// Detail of a [`crate::protocol::messages::FaultEvent`]: 0 stored, 1 older, 2 newer, 3 empty, 4 corrupt, 5 previous.
    pub const fn code(self) -> u32 {
        match self {
            Self::Stored => 0,
            Self::Older => 1,
            Self::Newer => 2,
            Self::Empty => 3,
            Self::Corrupt => 4,
            Self::Previous => 5,
        }
    }

    /// Whether the loaded key is not the one that was stored last. A person must accept it, or store another.
    pub const fn is_doubtful(self) -> bool {
        matches!(self, Self::Corrupt | Self::Previous)
    }
}

/// Result of a load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadedParameters {
    /// The values.
    pub parameters: Parameters,
    /// The key; [`Key::NONE`] if none is stored.
    pub key: Key,
    /// Their origin.
    pub origin: ParameterOrigin,
    /// False after an interrupted save, or if only one record has these values: the caller must save them again.
    pub is_settled: bool,
}

/// The save failed in every slot: the pages are worn out, or the memory returns errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SaveError;

/// Store of the parameters.
#[derive(Debug)]
pub struct ParameterStore<F> {
    flash: F,
    /// Offset of the first page in bytes.
    start: u32,
    /// Sequence of the next record, if its page was erased since the boot.
    next: Option<u32>,
    /// The key of the newest record, which the next one repeats.
    key: Key,
    /// Sequence that the next save exceeds because of damaged records.
    damaged: Option<u32>,
}

/// Progress of the write of a record.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    /// No marks; the body may be incomplete.
    Begun,
    /// The first mark reads as complete.
    Marked,
    /// The second mark reads as complete.
    Finished,
}

/// A record with a valid checksum.
#[derive(Clone, Copy)]
struct ValidRecord {
    sequence: u32,
    /// Number of its save.
    save: u32,
    version: u16,
    parameters: Parameters,
    key: Key,
    stage: Stage,
}

/// Content of a slot.
enum Slot {
    Erased,
    Record(ValidRecord),
    /// No valid record, and no mark: an interrupted save.
    Unfinished,
    /// No valid record where something is in the place of its marks.
    Damaged(DamagedRecord),
}

/// A damaged record, or what an interrupted erasure has left of an old one.
#[derive(Clone, Copy)]
struct DamagedRecord {
    /// By its marks.
    stage: Stage,
    /// Not covered by a valid checksum.
    sequence: Option<u32>,
    save: Option<u32>,
}

/// Content of all slots.
#[derive(Default)]
struct Scan {
    /// The newest record that counts.
    newest: Option<ValidRecord>,
    /// Sequence of the newest finished record.
    finished: Option<u32>,
    /// In each page, sequence of the newest record with a first mark.
    marked: [Option<u32>; PAGES as usize],
    /// Sequence of the newest valid record, in any stage.
    last: Option<u32>,
}

impl<F: NorFlash> ParameterStore<F> {
    const SLOTS_OF_PAGE: u32 = {
        assert!(F::ERASE_SIZE.is_multiple_of(SLOT_BYTES) && F::ERASE_SIZE >= SLOT_BYTES);
        assert!(
            FIRST_MARK.len().is_multiple_of(F::WRITE_SIZE) && SECOND_MARK.len() == FIRST_MARK.len()
        );
        assert!(SLOT_BYTES.is_multiple_of(F::READ_SIZE));
        (F::ERASE_SIZE / SLOT_BYTES) as u32
    };
    const SLOTS: u32 = PAGES * Self::SLOTS_OF_PAGE;

    /// The store whose first page begins at `start`, aligned to a page.
    pub const fn new(flash: F, start: u32) -> Self {
        Self { flash, start, next: None, key: Key::NONE, damaged: None }
    }

    /// The flash, for other stores in it.
    pub fn flash(&mut self) -> &mut F {
        &mut self.flash
    }

    /// The newest parameters.
    pub async fn load(&mut self) -> LoadedParameters {
        let found = self.scan().await;
        // The slots that the next save would use.
        let following = found.last.map_or(0, |last| last.wrapping_add(1));
        let next = [following, Self::next_page(found.last)].map(|next| next % Self::SLOTS);
        let (mut copies, mut is_damaged, mut has_damaged) = (0, false, false);
        self.damaged = None;
        let mut is_settled = found.last == found.finished;
        for slot in 0..Self::SLOTS {
            match self.slot(slot).await {
                Slot::Erased | Slot::Unfinished => {}
                Slot::Record(record) => {
                    let is_copy = found.newest.is_some_and(|newest| newest.save == record.save);
                    copies += u32::from(is_copy && record.stage == Stage::Finished);
                }
                Slot::Damaged(record) => {
                    // A complete or nearly complete save, which may become readable again.
                    is_settled &= !next.contains(&slot) || record.stage == Stage::Begun;
                    let is_later = |newest| Self::is_later(slot, &record, &newest);
                    // An interrupted erasure before the first save leaves no marks.
                    let is_lost = record.stage > Stage::Begun || found.last.is_none();
                    is_damaged |= found.newest.map_or(is_lost, is_later);
                    has_damaged = true;
                }
            }
        }
        if has_damaged {
            self.damaged = self.last_damaged(found.last).await;
        }
        let (parameters, origin) = match found.newest {
            Some(newest) if is_damaged && newest.version <= VERSION => {
                (newest.parameters, ParameterOrigin::Previous)
            }
            Some(_) if is_damaged => (Parameters::DEFAULT, ParameterOrigin::Previous),
            Some(newest) if newest.version == VERSION => {
                (newest.parameters, ParameterOrigin::Stored)
            }
            Some(newest) if newest.version < VERSION => (newest.parameters, ParameterOrigin::Older),
            Some(_) => (Parameters::DEFAULT, ParameterOrigin::Newer),
            None if is_damaged => (Parameters::DEFAULT, ParameterOrigin::Corrupt),
            None => (Parameters::DEFAULT, ParameterOrigin::Empty),
        };
        self.key = found.newest.map_or(Key::NONE, |newest| newest.key);
        let is_settled = match origin {
            // Records of newer firmware, and doubtful ones, stay until somebody requests a save.
            ParameterOrigin::Newer | ParameterOrigin::Corrupt | ParameterOrigin::Previous => true,
            ParameterOrigin::Stored => is_settled && copies >= COPIES,
            ParameterOrigin::Older | ParameterOrigin::Empty => is_settled,
        };
        LoadedParameters { parameters, key: self.key, origin, is_settled }
    }

    /// Sequence of the newest of the damaged records that follow `last`, that of the valid ones, and each other so closely that one
    /// would be later than the next save. Also those of the newest save: next to another one they are later.
    async fn last_damaged(&mut self, mut last: Option<u32>) -> Option<u32> {
        for _ in 0..Self::SLOTS {
            let before = last;
            for slot in 0..Self::SLOTS {
                let Slot::Damaged(record) = self.slot(slot).await else { continue };
                let sequence = Self::sequence_of(slot, &record);
                // The next save may skip pages.
                if last.is_none_or(|last| Self::is_ahead(sequence, last, 2)) {
                    last = last.max(sequence);
                }
            }
            if last == before {
                break;
            }
        }
        last
    }

    /// Whether a damaged record was written after the newest valid one, by another save.
    fn is_later(slot: u32, damaged: &DamagedRecord, newest: &ValidRecord) -> bool {
        if damaged.save == Some(newest.save) {
            return false;
        }
        // A page is written from its beginning.
        let is_behind = Self::page(slot) == Self::page(newest.sequence)
            && slot > newest.sequence % Self::SLOTS
            && damaged.stage > Stage::Begun;
        is_behind || Self::is_ahead(Self::sequence_of(slot, damaged), newest.sequence, 1)
    }

    /// Whether a sequence follows `last` within a few turns of the ring, or so many times as many.
    fn is_ahead(sequence: Option<u32>, last: u32, times: u32) -> bool {
        let ahead = sequence.map(|sequence| sequence.wrapping_sub(last));
        ahead.is_some_and(|ahead| (1..=times * PAGES * Self::SLOTS).contains(&ahead))
    }

    /// Sequence of a damaged record: by its save, which has a checksum, else as it reads.
    fn sequence_of(slot: u32, damaged: &DamagedRecord) -> Option<u32> {
        // The first sequence of this slot from there.
        let sequence_from = |save: u32| save.wrapping_add(slot.wrapping_sub(save) % Self::SLOTS);
        // Without marks it is what an interrupted erasure has left, and may read as any value.
        let as_read = damaged.sequence.filter(|_| damaged.stage > Stage::Begun);
        let sequence = damaged.save.map(sequence_from).or(as_read)?;
        // Beyond the life of the flash it is none.
        (sequence % Self::SLOTS == slot && sequence < u32::MAX / 2).then_some(sequence)
    }

    /// Saves a key, or its absence, with the parameters as they were saved last.
    ///
    /// # Errors
    /// As [`Self::save`]; the previous key still counts.
    pub async fn save_key(&mut self, key: Key) -> Result<(), SaveError> {
        let parameters = self.scan().await.newest.map(|newest| newest.parameters);
        let previous = core::mem::replace(&mut self.key, key);
        let saved = self.save(&parameters.unwrap_or(Parameters::DEFAULT)).await;
        if saved.is_err() {
            self.key = previous;
        }
        saved
    }

    /// Saves all parameters, twice if two slots can be written, after a [`Self::load`]. Takes about 4 ms, and 25 ms more for the erasure of a page
    /// (data sheet).
    ///
    /// # Errors
    /// No slot could be written; the previous record still counts.
    pub async fn save(&mut self, parameters: &Parameters) -> Result<(), SaveError> {
        let found = self.scan().await;
        // The record that certainly counts is one of these.
        let may_count = |sequence: Option<u32>| sequence.is_some() && sequence >= found.finished;
        let mut protected = found.marked.map(may_count);
        // The sequence cannot overflow within the life of the flash.
        let first = self.next.take();
        let mut sequence = first.unwrap_or_else(|| Self::next_page(found.last.max(self.damaged)));
        let mut save = None;
        for _ in 0..Self::SLOTS {
            if sequence.is_multiple_of(Self::SLOTS_OF_PAGE) {
                let page = Self::page(sequence);
                let is_protected = protected.get(page as usize).copied().unwrap_or(true);
                if is_protected || self.erase(page).await.is_err() {
                    sequence = sequence.wrapping_add(Self::SLOTS_OF_PAGE);
                    continue;
                }
            }
            let present = sequence;
            // Successful or not, this slot is used up.
            sequence = sequence.wrapping_add(1);
            self.next = Some(sequence);
            let number = save.unwrap_or(present);
            if present.wrapping_sub(number) >= Self::SLOTS {
                break;
            }
            if !matches!(self.slot(present % Self::SLOTS).await, Slot::Erased)
                || self.write((present, number), parameters).await.is_none()
            {
                continue;
            }
            if save.is_some() {
                return Ok(());
            }
            save = Some(present);
            if let Some(page) = protected.get_mut(Self::page(present) as usize) {
                *page = true;
            }
        }
        save.map(|_| ()).ok_or(SaveError)
    }

    async fn scan(&mut self) -> Scan {
        let mut found = Scan::default();
        for slot in 0..Self::SLOTS {
            let record = match self.slot(slot).await {
                Slot::Record(record) => record,
                Slot::Erased | Slot::Unfinished | Slot::Damaged(_) => continue,
            };
            found.last = found.last.max(Some(record.sequence));
            match record.stage {
                Stage::Begun => continue,
                Stage::Marked => {}
                Stage::Finished => found.finished = found.finished.max(Some(record.sequence)),
            }
            if let Some(newest) = found.marked.get_mut(Self::page(record.sequence) as usize) {
                *newest = (*newest).max(Some(record.sequence));
            }
            if found.newest.is_none_or(|newest| newest.sequence < record.sequence) {
                found.newest = Some(record);
            }
        }
        found
    }

    async fn slot(&mut self, slot: u32) -> Slot {
        let mut body = [0; BODY_BYTES];
        let at = self.address(slot);
        let is_read = self.flash.read(at, &mut body).await.is_ok();
        let marks = [
            self.word(at + BODY_BYTES as u32).await,
            self.word(at + (BODY_BYTES + FIRST_MARK.len()) as u32).await,
        ];
        let stage = match marks {
            [_, Some(SECOND_MARK)] => Stage::Finished,
            [Some(FIRST_MARK), _] => Stage::Marked,
            _ => Stage::Begun,
        };
        const BLANK: Option<[u8; FIRST_MARK.len()]> = Some([ERASED; FIRST_MARK.len()]);
        let is_unmarked = marks == [BLANK; 2];
        if is_read && is_unmarked && is_erased(&body) {
            return Slot::Erased;
        }
        match record::decode(&body)
            .filter(|record| is_read && record.sequence % Self::SLOTS == slot)
        {
            Some(record) => Slot::Record(ValidRecord {
                sequence: record.sequence,
                save: record.save,
                version: record.version,
                parameters: record.parameters(),
                key: record.key(),
                stage,
            }),
            None if is_unmarked => Slot::Unfinished,
            // Word by word, as others may be unreadable.
            None => Slot::Damaged(DamagedRecord {
                stage,
                sequence: self
                    .word(at)
                    .await
                    .and_then(|word| word.first_chunk().copied())
                    .map(u32::from_le_bytes),
                save: self.word(at + SAVE_AT as u32).await.and_then(|word| save_of(&word)),
            }),
        }
    }

    /// Content of eight bytes, such as a mark; `None` if they are unreadable.
    async fn word(&mut self, at: u32) -> Option<[u8; FIRST_MARK.len()]> {
        let mut word = [0; FIRST_MARK.len()];
        self.flash.read(at, &mut word).await.ok()?;
        Some(word)
    }

    async fn erase(&mut self, page: u32) -> Result<(), F::Error> {
        let from = self.address(page * Self::SLOTS_OF_PAGE);
        self.flash.erase(from, from + F::ERASE_SIZE as u32).await
    }

    /// Writes the record with this sequence of the save with this number, then its marks; verifies each before the next.
    async fn write(&mut self, (sequence, save): (u32, u32), parameters: &Parameters) -> Option<()> {
        let (body, used) = record::encode((sequence, save), parameters, self.key);
        let words = body.get(..used.next_multiple_of(F::WRITE_SIZE))?;
        let mut at = self.address(sequence % Self::SLOTS);
        self.flash.write(at, words).await.ok()?;
        self.flash.write(at + SAVE_AT as u32, body.get(SAVE_AT..)?).await.ok()?;
        let mut read = [0; BODY_BYTES];
        self.flash.read(at, &mut read).await.ok()?;
        if read != body {
            return None;
        }
        at += BODY_BYTES as u32;
        for mark in [FIRST_MARK, SECOND_MARK] {
            self.flash.write(at, &mark).await.ok()?;
            if self.word(at).await? != mark {
                return None;
            }
            at += mark.len() as u32;
        }
        Some(())
    }

    /// First sequence of the page after that of the newest record.
    fn next_page(last: Option<u32>) -> u32 {
        last.map_or(0, |last| (last - last % Self::SLOTS_OF_PAGE).wrapping_add(Self::SLOTS_OF_PAGE))
    }

    /// Page of a sequence.
    fn page(sequence: u32) -> u32 {
        sequence % Self::SLOTS / Self::SLOTS_OF_PAGE
    }

    fn address(&self, slot: u32) -> u32 {
        self.start + slot * SLOT_BYTES as u32
    }
}

/// Compares sixteen bytes at once, because each save scans all slots.
fn is_erased(body: &[u8; BODY_BYTES]) -> bool {
    const { assert!(BODY_BYTES.is_multiple_of(16)) };
    let (chunks, _) = body.as_chunks::<16>();
    chunks.iter().all(|chunk| *chunk == [ERASED; 16])
}

#[cfg(test)]
mod flash_model;
#[cfg(test)]
mod tests;
