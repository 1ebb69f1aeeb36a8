//! Encoding of a record: all parameters and the key of the hosts in the bytes of a slot.
//!
//! | bytes | content |
//! | --- | --- |
//! | 0..4 | sequence: that of the previous record plus one |
//! | 4..6 | version of the parameter schema |
//! | 6..8 | length of the pairs |
//! | 8.. | pairs of identifier and value, postcard; the key is four of them ([`KEY`]) |
//! | next 4 | CRC-32 over all bytes before |
//! | 232..236 | number of the save: sequence of its first record |
//! | 236..240 | CRC-32 of that number; both are erased in records of earlier firmware |
//! | 240..248 | [`FIRST_MARK`] |
//! | 248..256 | [`SECOND_MARK`] |
//!
//! Numbers are little-endian; other bytes stay erased.

use crate::checksum::CRC32;
use crate::parameters::Parameters;
use crate::parameters::schema::{COUNT, PARAMETERS};
use crate::protocol::authentication::{KEY_BYTES, Key};

/// Version of the parameter schema: incremented when an identifier or a meaning changes.
pub const VERSION: u16 = 1;
/// Bytes of a slot.
pub const SLOT_BYTES: usize = 256;
/// Bytes of a slot without its marks.
pub const BODY_BYTES: usize = SLOT_BYTES - FIRST_MARK.len() - SECOND_MARK.len();
/// Bytes of the number of the save and its checksum, the last ones of the body: they date a record whose other bytes are
/// damaged.
pub const SAVE_BYTES: usize = 8;
/// Where they begin.
pub const SAVE_AT: usize = BODY_BYTES - SAVE_BYTES;
/// Written after the body was verified, and verified itself: without it the record does not count.
pub const FIRST_MARK: [u8; 8] = *b"written.";
/// Written and verified last: without it the first mark may be incomplete.
pub const SECOND_MARK: [u8; 8] = *b"the end.";
/// A byte of an erased slot.
pub const ERASED: u8 = 0xFF;

const HEADER: usize = 8;
const CRC_BYTES: usize = size_of::<u32>();
/// Identifier of the first four bytes of the key, as a little-endian number; the others follow. No parameter: it cannot be
/// read by a host.
pub const KEY: u16 = 0x70;
/// Pairs of the key.
const KEY_PAIRS: usize = KEY_BYTES / size_of::<i32>();
/// Longest encoding of a pair: an identifier below 128, and 32 bits in five groups of seven.
const MAX_PAIR_BYTES: usize = 1 + 5;
const _: () = assert!(HEADER + (COUNT + KEY_PAIRS) * MAX_PAIR_BYTES + CRC_BYTES <= SAVE_AT);
const _: () = {
    let mut rest: &[crate::parameters::schema::Parameter] = &PARAMETERS;
    while let Some((row, others)) = rest.split_first() {
        assert!(row.id < KEY, "identifiers of the key follow those of the parameters");
        rest = others;
    }
};

/// A decoded record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'b> {
    /// Sequence: that of the previous record plus one.
    pub sequence: u32,
    /// Version of the schema that it was written with.
    pub version: u16,
    /// Number of the save: sequence of its first record.
    pub save: u32,
    pairs: &'b [u8],
}

/// Encodes a record of the save with this number; also returns the number of bytes before the erased ones.
pub fn encode(
    (sequence, save): (u32, u32),
    parameters: &Parameters,
    key: Key,
) -> ([u8; BODY_BYTES], usize) {
    let (parts, _) = key.0.as_chunks::<4>();
    let parts = parts.iter().map(|part| i32::from_le_bytes(*part));
    let key = (KEY..).zip(parts).filter(|_| key != Key::NONE);
    let (mut body, used) = encode_as(VERSION, sequence, parameters.all().chain(key));
    let fields = [save.to_le_bytes(), save_check(save).to_le_bytes()];
    for (to, from) in body.iter_mut().skip(SAVE_AT).zip(fields.as_flattened()) {
        *to = *from;
    }
    (body, used)
}

/// As [`encode`] with any version and pairs, without the number of the save; pairs beyond the capacity are omitted.
pub(super) fn encode_as(
    version: u16,
    sequence: u32,
    pairs: impl Iterator<Item = (u16, i32)>,
) -> ([u8; BODY_BYTES], usize) {
    let mut bytes = [ERASED; BODY_BYTES];
    let mut length = 0;
    if let Some(room) = bytes.get_mut(HEADER..SAVE_AT - CRC_BYTES) {
        for pair in pairs {
            let free = room.get_mut(length..).unwrap_or_default();
            length += postcard::to_slice(&pair, free).map_or(0, |used| used.len());
        }
    }
    let fields =
        [&sequence.to_le_bytes()[..], &version.to_le_bytes(), &(length as u16).to_le_bytes()];
    for (to, from) in bytes.iter_mut().zip(fields.into_iter().flatten()) {
        *to = *from;
    }
    let used = HEADER + length;
    let check = CRC32.checksum(bytes.get(..used).unwrap_or_default());
    for (to, from) in bytes.iter_mut().skip(used).zip(check.to_le_bytes()) {
        *to = from;
    }
    (bytes, used + CRC_BYTES)
}

/// Decodes a record; `None` if its checksum is wrong.
pub fn decode(bytes: &[u8; BODY_BYTES]) -> Option<Record<'_>> {
    let (head, tail) = bytes.split_first_chunk::<HEADER>()?;
    let [s0, s1, s2, s3, v0, v1, l0, l1] = *head;
    let length = usize::from(u16::from_le_bytes([l0, l1]));
    let (pairs, tail) = tail.split_at_checked(length)?;
    let (check, _) = tail.split_first_chunk::<CRC_BYTES>()?;
    let mut digest = CRC32.digest();
    digest.update(head);
    digest.update(pairs);
    let sequence = u32::from_le_bytes([s0, s1, s2, s3]);
    (digest.finalize() == u32::from_le_bytes(*check)).then_some(Record {
        sequence,
        version: u16::from_le_bytes([v0, v1]),
        save: bytes.last_chunk().and_then(save_of).unwrap_or(sequence),
        pairs,
    })
}

/// The number of the save in the last bytes of a body; `None` if its checksum is wrong.
pub fn save_of(bytes: &[u8; SAVE_BYTES]) -> Option<u32> {
    let [o0, o1, o2, o3, c0, c1, c2, c3] = *bytes;
    let save = u32::from_le_bytes([o0, o1, o2, o3]);
    (save_check(save) == u32::from_le_bytes([c0, c1, c2, c3])).then_some(save)
}

/// CRC-32 of the number of a save. It begins with a label, because that of erased bytes alone is erased bytes.
fn save_check(save: u32) -> u32 {
    let mut digest = CRC32.digest();
    digest.update(b"save");
    digest.update(&save.to_le_bytes());
    digest.finalize()
}

impl Record<'_> {
    /// The parameters; defaults for those that are missing or outside their present range.
    pub fn parameters(&self) -> Parameters {
        let mut parameters = Parameters::DEFAULT;
        for (id, value) in self.pairs() {
            // Fails for removed parameters and changed ranges: the default stays.
            let _ = parameters.set(id, value);
        }
        parameters
    }

    /// The key; [`Key::NONE`] without one.
    pub fn key(&self) -> Key {
        let mut key = Key::NONE;
        let (parts, _) = key.0.as_chunks_mut::<4>();
        for (id, value) in self.pairs() {
            let index = id.checked_sub(KEY).map(usize::from);
            if let Some(part) = index.and_then(|index| parts.get_mut(index)) {
                *part = value.to_le_bytes();
            }
        }
        key
    }

    fn pairs(&self) -> impl Iterator<Item = (u16, i32)> {
        let mut rest = self.pairs;
        core::iter::from_fn(move || {
            let (pair, tail) = postcard::take_from_bytes(rest).ok()?;
            rest = tail;
            Some(pair)
        })
    }
}
