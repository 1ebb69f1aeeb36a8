//! What flash holds, into the store of parameters: any bytes, and saves that the power cuts short.

use std::collections::BTreeMap;

use embedded_storage_async::nor_flash::NorFlash;
use firmware::parameters::Parameters;
use firmware::parameters::schema::PARAMETERS;
use firmware::protocol::authentication::Key;
use firmware::system::nv_storage::record::{
    BODY_BYTES, FIRST_MARK, SECOND_MARK, SLOT_BYTES, VERSION, encode,
};
use firmware::system::nv_storage::{LoadedParameters, PAGES, ParameterOrigin, ParameterStore};

use super::bytes::Bytes;
use super::check::crc32;

/// The flash of the store's own tests: its power goes at any operation, and what it leaves is anything.
#[allow(dead_code)]
#[path = "../../../firmware/src/system/nv_storage/flash_model.rs"]
pub(super) mod memory;

use memory::{Cut, FlashModel, PAGE, Torn, WORD, block};

/// The smallest page that has more than one slot. Most stories use it: a start reads a quarter of the slots, and a story
/// reaches every page.
const SMALL_PAGE: usize = 2 * SLOT_BYTES;
/// Most saves of a story.
const SAVES: u32 = 16;
/// Operations in which the power may go: those of a few saves.
pub(super) const OPERATIONS: u32 = 50;

/// What a story came to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Starts that found parameters.
    pub found: u32,
    /// Saves that were cut short.
    pub cut: u32,
    /// Saves that were done.
    pub saved: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<3> {
        [("found", self.found), ("cut", self.cut), ("saved", self.saved)]
    }
}

/// A flash that holds anything, then saves: in one of eight stories with the pages of the chip.
pub fn keep(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let seed = u64::from_le_bytes(bytes.array());
    match seed & 7 {
        7 => keep_in(FlashModel::<_, PAGE>::new(seed), bytes),
        _ => keep_in(FlashModel::<_, SMALL_PAGE>::new(seed), bytes),
    }
}

/// The flash of the store with pages of so many bytes.
type Flash<const PAGE_BYTES: usize> = FlashModel<{ PAGES as usize }, PAGE_BYTES>;

fn keep_in<const PAGE_BYTES: usize>(mut memory: Flash<PAGE_BYTES>, mut bytes: Bytes) -> Tally {
    let Content { newest, last, is_damaged } = fill(&mut memory, &mut bytes);
    let mut tally = Tally::default();
    let loaded = load(&mut memory);
    found_rightly(&loaded, newest, is_damaged);
    tally.found += u32::from(newest.is_some());
    // Sequences do not come to their end in the life of a flash.
    if last.is_some_and(|sequence| sequence > u32::MAX / 2) {
        return tally;
    }
    // What a start may find: what was there for sure, and what was begun since.
    let mut possible = vec![loaded.parameters];
    let mut loaded = loaded;
    while tally.saved + tally.cut < SAVES && !bytes.is_empty() {
        // What newer firmware wrote, or a damaged save may have replaced, is left as it is: a save over it that was cut short
        // may count later.
        let is_left = loaded.origin == ParameterOrigin::Newer || loaded.origin.is_doubtful();
        if loaded.is_settled && !is_left {
            possible = vec![loaded.parameters];
        }
        let is_saved = session(&mut memory, &mut bytes, &loaded, &mut possible, &mut tally);
        loaded = load(&mut memory);
        assert!(possible.contains(&loaded.parameters), "{loaded:?}");
        assert!(!is_saved || loaded.origin == ParameterOrigin::Stored);
        assert_eq!(memory.rewritten, 0, "nobody knows whether these words hold");
    }
    tally
}

/// Saves without a start between them, until the power goes or the host has enough; tells whether the last
/// was done.
fn session<const PAGE_BYTES: usize>(
    memory: &mut Flash<PAGE_BYTES>,
    bytes: &mut Bytes,
    loaded: &LoadedParameters,
    possible: &mut Vec<Parameters>,
    tally: &mut Tally,
) -> bool {
    let mut parameters = loaded.parameters;
    memory.cut = cut(bytes, memory.operations, OPERATIONS);
    let mut store = ParameterStore::new(&mut *memory, 0);
    // As each start does.
    block(store.load());
    let mut is_saved = true;
    for number in 0..=bytes.byte() % 4 {
        // What is not settled is saved as it is.
        if loaded.is_settled || number > 0 {
            let row = PARAMETERS[usize::from(bytes.byte()) % PARAMETERS.len()];
            // A value beyond its range changes nothing.
            let _ = parameters.set(row.id, i32::from_le_bytes(bytes.array()));
            possible.push(parameters);
        }
        is_saved = block(store.save(&parameters)).is_ok();
        if !is_saved {
            tally.cut += 1;
            break;
        }
        tally.saved += 1;
        *possible = vec![parameters];
    }
    memory.power_on();
    is_saved
}

/// What a flash holds at the beginning.
struct Content {
    /// Sequence and version of the newest record that counts.
    newest: Option<(u32, u16)>,
    /// The newest sequence of all records.
    last: Option<u32>,
    /// A slot has no record, but something in the place of its marks.
    is_damaged: bool,
}

/// Writes what a story begins with.
fn fill<const PAGE_BYTES: usize>(memory: &mut Flash<PAGE_BYTES>, bytes: &mut Bytes) -> Content {
    let slot_count = PAGES * (PAGE_BYTES / SLOT_BYTES) as u32;
    let mut slots = BTreeMap::new();
    for _ in 0..bytes.byte() % 8 {
        let kind = bytes.byte();
        let sequence = match kind & 1 {
            0 => u32::from(bytes.byte()),
            _ => u32::from_le_bytes(bytes.array()),
        };
        let mut slot = [0xFF; SLOT_BYTES];
        match kind & 6 {
            // Anything.
            0 => {
                let some = bytes.some(SLOT_BYTES);
                slot[..some.len()].copy_from_slice(some);
            }
            // Any pairs of any version, well checked.
            2 => {
                let some = bytes.some(BODY_BYTES / 2);
                let mut said = sequence.to_le_bytes().to_vec();
                said.extend_from_slice(&(VERSION + u16::from(kind >> 6) - 1).to_le_bytes());
                said.extend_from_slice(&(some.len() as u16).to_le_bytes());
                said.extend_from_slice(some);
                said.extend_from_slice(&crc32(&said).to_le_bytes());
                slot[..said.len()].copy_from_slice(&said);
            }
            _ => slot[..BODY_BYTES]
                .copy_from_slice(&encode((sequence, sequence), &Parameters::DEFAULT, Key::NONE).0),
        }
        let marks = &mut slot[BODY_BYTES..];
        if kind & 32 == 0 {
            marks[..FIRST_MARK.len()].copy_from_slice(&FIRST_MARK);
        }
        if kind & 8 != 0 {
            marks[FIRST_MARK.len()..].copy_from_slice(&SECOND_MARK);
        }
        let place = match kind & 16 {
            0 => sequence % slot_count,
            _ => u32::from(bytes.byte()) % slot_count,
        };
        slots.entry(place).or_insert(slot);
    }
    for (place, slot) in &slots {
        let words = slot.chunks(WORD).enumerate();
        // A word that reads erased has not been written.
        for (number, word) in words.filter(|(_, word)| word.iter().any(|byte| *byte != 0xFF)) {
            let at = *place as usize * SLOT_BYTES + number * WORD;
            let _ = block(memory.write(at as u32, word));
        }
    }
    let is_damaged = slots.iter().any(|(place, slot)| {
        let is_right = record(slot).is_some_and(|(sequence, _)| sequence % slot_count == *place);
        !is_right && slot[BODY_BYTES..].iter().any(|byte| *byte != 0xFF)
    });
    let right = slots.iter().filter_map(|(place, slot)| {
        let (sequence, version) = record(slot)?;
        let (written, end) = slot[BODY_BYTES..].split_at(FIRST_MARK.len());
        let counts = written == FIRST_MARK || end == SECOND_MARK;
        (sequence % slot_count == *place).then_some((sequence, version, counts))
    });
    let right: Vec<_> = right.collect();
    let newest = right.iter().filter(|(.., counts)| *counts).max();
    let last = right.iter().map(|(sequence, ..)| *sequence).max();
    let newest = newest.map(|(sequence, version, _)| (*sequence, *version));
    Content { newest, last, is_damaged }
}

/// Sequence and version of the record in a slot, if its checksum is right.
fn record(slot: &[u8; SLOT_BYTES]) -> Option<(u32, u16)> {
    let length = usize::from(u16::from_le_bytes([slot[6], slot[7]]));
    let (said, behind) = slot[..BODY_BYTES].split_at_checked(8 + length)?;
    let check = u32::from_le_bytes(*behind.first_chunk()?);
    let sequence = u32::from_le_bytes(*slot.first_chunk()?);
    let version = u16::from_le_bytes([slot[4], slot[5]]);
    (check == crc32(said)).then_some((sequence, version))
}

fn found_rightly(loaded: &LoadedParameters, newest: Option<(u32, u16)>, is_damaged: bool) {
    assert!(is_damaged || !loaded.origin.is_doubtful(), "{loaded:?}");
    match (newest, loaded.origin) {
        (Some((_, VERSION)), ParameterOrigin::Stored) => {}
        (Some((_, version)), ParameterOrigin::Older) => assert!(version < VERSION),
        (Some((_, version)), ParameterOrigin::Newer) => assert!(version > VERSION),
        (Some(_), ParameterOrigin::Previous) => {}
        (None, ParameterOrigin::Empty | ParameterOrigin::Corrupt) => {}
        other => panic!("found otherwise than written: {other:?}"),
    }
    let are_defaults = [ParameterOrigin::Newer, ParameterOrigin::Empty, ParameterOrigin::Corrupt];
    if are_defaults.contains(&loaded.origin) {
        assert_eq!(loaded.parameters, Parameters::DEFAULT);
    }
}

/// A start. Whatever it finds is within its range.
fn load<const PAGE_BYTES: usize>(memory: &mut Flash<PAGE_BYTES>) -> LoadedParameters {
    let loaded = block(ParameterStore::new(memory, 0).load());
    for row in PARAMETERS {
        let value = loaded.parameters.get(row.id);
        assert!(value.is_some_and(|value| row.range.contains(value)), "{row:?}");
    }
    loaded
}

/// Operation and kind of the next power cut, one of the next `count` operations.
pub(super) fn cut(bytes: &mut Bytes, from: u32, count: u32) -> Option<(u32, Cut)> {
    let kind = bytes.byte();
    let at = from + u32::from(bytes.byte()) % count;
    let cut = match kind % 11 {
        0 | 1 => return None,
        2 => Cut::Before,
        3 => Cut::Half(kind > 127),
        4 => Cut::Torn(Torn::Erased),
        5 => Cut::Torn(Torn::Intended),
        6 => Cut::Torn(Torn::Mixed(u64::from_le_bytes(bytes.array()))),
        7 => Cut::Torn(Torn::Unreadable),
        8 | 9 => Cut::Torn(Torn::Varying),
        _ => Cut::After,
    };
    Some((at, cut))
}
