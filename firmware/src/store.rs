//! Parameters in flash: old or new, whenever the power goes, and never a mixture.
//!
//! All parameters are one record ([`record`]) of its own sequence and checksum. Records follow each other
//! through the slots of [`PAGES`] pages, round and round: the newest right one counts. A page is erased
//! before its first slot is written, so never the page with the newest record, and no word is written
//! twice. 10,000 saves erase each of four pages with 2 KiB 313 times; the chip is good for 10,000 times.
//!
//! What a cut leaves behind is not defined: a word may read as anything, as an error of the memory, and
//! differently every time. So:
//!
//! - a slot that cannot be read is skipped, and one is written only where all of it reads erased;
//! - what was written is read back, then an end mark is written behind it. At the start [`Store::load`] says
//!   whether the newest record lacks its mark, or something that was begun lies behind it: then the caller
//!   saves again, and what was read once stays so;
//! - a record's sequence says its slot. One that was torn and reads right years later is older than what was
//!   written behind it.
//!
//! The well-kept library for this, `sequential-storage` (8.0.2), was run against the same cuts and is not
//! used: after an erasure that stopped halfway it found an older value, where a torn word read erased it
//! reported saves as done that were lost, and a word that the memory could not read stopped it for good.

pub mod record;

use embedded_storage_async::nor_flash::NorFlash;

use crate::parameters::Parameters;
use record::{BODY, END, ERASED, SLOT, VERSION};

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
}

/// The newest record, without its bytes.
#[derive(Clone, Copy)]
struct Newest {
    sequence: u32,
    version: u16,
    parameters: Parameters,
    is_finished: bool,
}

/// What a slot reads as.
enum Slot {
    Erased,
    Record(Newest),
    Spoilt,
}

impl<F: NorFlash> Store<F> {
    const SLOTS_OF_PAGE: u32 = {
        assert!(F::ERASE_SIZE.is_multiple_of(SLOT) && F::ERASE_SIZE >= SLOT);
        assert!(END.len().is_multiple_of(F::WRITE_SIZE) && SLOT.is_multiple_of(F::READ_SIZE));
        (F::ERASE_SIZE / SLOT) as u32
    };
    const SLOTS: u32 = PAGES * Self::SLOTS_OF_PAGE;

    /// The store whose first page begins at `start`, on a page's border.
    pub const fn new(flash: F, start: u32) -> Self {
        Self { flash, start }
    }

    /// The newest parameters.
    pub async fn load(&mut self) -> Loaded {
        let (newest, is_spoilt) = self.newest().await;
        let next = newest.map_or(0, |newest| newest.sequence.wrapping_add(1));
        let is_clean = match self.slot(next % Self::SLOTS).await {
            Slot::Erased => true,
            // From the round before; the next itself was torn and reads right only now.
            Slot::Record(record) => record.sequence < next,
            Slot::Spoilt => false,
        };
        let (parameters, origin) = match newest {
            Some(newest) if newest.version == VERSION => (newest.parameters, Origin::Stored),
            Some(newest) if newest.version < VERSION => (newest.parameters, Origin::Older),
            Some(_) => (Parameters::DEFAULT, Origin::Newer),
            None if is_spoilt => (Parameters::DEFAULT, Origin::Spoilt),
            None => (Parameters::DEFAULT, Origin::Empty),
        };
        let is_settled = is_clean && newest.is_none_or(|newest| newest.is_finished);
        Loaded {
            parameters,
            origin,
            // What newer firmware has written stays for it until the host asks to save.
            is_settled: is_settled || origin == Origin::Newer,
        }
    }

    /// Saves all parameters. Takes some 2 ms, and 25 ms more where a page is erased, by the data sheet.
    ///
    /// # Errors
    /// No slot took the record; what was saved before still counts.
    pub async fn save(&mut self, parameters: &Parameters) -> Result<(), NotSaved> {
        let newest = self.newest().await.0.map(|newest| newest.sequence);
        let kept = newest.map(|newest| newest % Self::SLOTS / Self::SLOTS_OF_PAGE);
        // As many saves as a sequence has numbers are far beyond the life of the flash.
        let first = newest.map_or(0, |newest| newest.wrapping_add(1));
        for sequence in (0..Self::SLOTS).map(|step| first.wrapping_add(step)) {
            let place = sequence % Self::SLOTS;
            if place.is_multiple_of(Self::SLOTS_OF_PAGE) {
                let page = place / Self::SLOTS_OF_PAGE;
                if Some(page) == kept {
                    break;
                }
                // Where it fails the slots are not erased.
                let _ = self.erase(page).await;
            }
            if matches!(self.slot(place).await, Slot::Erased)
                && self.write(place, sequence, parameters).await.is_some()
            {
                return Ok(());
            }
        }
        Err(NotSaved)
    }

    /// The newest right record, and whether any slot holds what is none.
    async fn newest(&mut self) -> (Option<Newest>, bool) {
        let (mut found, mut is_spoilt) = (None::<Newest>, false);
        for place in 0..Self::SLOTS {
            match self.slot(place).await {
                Slot::Erased => {}
                Slot::Spoilt => is_spoilt = true,
                Slot::Record(record) if found.is_none_or(|f| f.sequence < record.sequence) => {
                    found = Some(record);
                }
                Slot::Record(_) => {}
            }
        }
        (found, is_spoilt)
    }

    async fn slot(&mut self, place: u32) -> Slot {
        let mut body = [0; BODY];
        let mut end = [0; END.len()];
        let at = self.address(place);
        if self.flash.read(at, &mut body).await.is_err() {
            return Slot::Spoilt;
        }
        // An end that cannot be read is one that is absent.
        let end_read = self.flash.read(at + BODY as u32, &mut end).await.is_ok();
        if end_read && body.iter().chain(&end).all(|byte| *byte == ERASED) {
            return Slot::Erased;
        }
        match record::decode(&body) {
            Some(record) if record.sequence % Self::SLOTS == place => Slot::Record(Newest {
                sequence: record.sequence,
                version: record.version,
                parameters: record.parameters(),
                is_finished: end_read && end == END,
            }),
            _ => Slot::Spoilt,
        }
    }

    async fn erase(&mut self, page: u32) -> Result<(), F::Error> {
        let from = self.address(page * Self::SLOTS_OF_PAGE);
        self.flash.erase(from, from + F::ERASE_SIZE as u32).await
    }

    /// Writes a record and reads it back; then its end, and reads that.
    async fn write(&mut self, place: u32, sequence: u32, parameters: &Parameters) -> Option<()> {
        let (body, used) = record::encode(sequence, parameters);
        let words = body.get(..used.next_multiple_of(F::WRITE_SIZE))?;
        let at = self.address(place);
        self.flash.write(at, words).await.ok()?;
        let mut read = [0; BODY];
        self.flash.read(at, &mut read).await.ok()?;
        if read != body {
            return None;
        }
        let (at, mut read) = (at + BODY as u32, [0; END.len()]);
        self.flash.write(at, &END).await.ok()?;
        self.flash.read(at, &mut read).await.ok()?;
        (read == END).then_some(())
    }

    fn address(&self, place: u32) -> u32 {
        self.start + place * SLOT as u32
    }
}

#[cfg(test)]
mod memory;
#[cfg(test)]
mod tests;
