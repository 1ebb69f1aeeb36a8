//! Encoding of a record: all parameters in the bytes of a slot.
//!
//! | bytes | content |
//! | --- | --- |
//! | 0..4 | sequence: that of the previous record plus one |
//! | 4..6 | version of the parameter schema |
//! | 6..8 | length of the pairs |
//! | 8.. | pairs of identifier and value, postcard |
//! | next 4 | CRC-32 over all bytes before |
//! | 240..248 | [`FIRST_MARK`] |
//! | 248..256 | [`SECOND_MARK`] |
//!
//! Numbers are little-endian; other bytes stay erased.

use crate::checksum::CRC32;
use crate::parameters::Parameters;
use crate::parameters::schema::COUNT;

/// Version of the parameter schema: incremented when an identifier or a meaning changes.
pub const VERSION: u16 = 1;
/// Bytes of a slot.
pub const SLOT_BYTES: usize = 256;
/// Bytes of a slot without its marks.
pub const BODY_BYTES: usize = SLOT_BYTES - FIRST_MARK.len() - SECOND_MARK.len();
/// Written after the body was verified, and verified itself: without it the record does not count.
pub const FIRST_MARK: [u8; 8] = *b"written.";
/// Written and verified last: without it the first mark may be incomplete.
pub const SECOND_MARK: [u8; 8] = *b"the end.";
/// A byte of an erased slot.
pub const ERASED: u8 = 0xFF;

const HEADER: usize = 8;
const CRC_BYTES: usize = size_of::<u32>();
/// Longest encoding of a pair: 16 bits in three groups of seven, 32 bits in five.
const MAX_PAIR_BYTES: usize = 3 + 5;
const _: () = assert!(HEADER + COUNT * MAX_PAIR_BYTES + CRC_BYTES <= BODY_BYTES);

/// A decoded record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'b> {
    /// Sequence: that of the previous record plus one.
    pub sequence: u32,
    /// Version of the schema that it was written with.
    pub version: u16,
    pairs: &'b [u8],
}

/// Encodes a record; also returns the number of bytes that are not erased.
pub fn encode(sequence: u32, parameters: &Parameters) -> ([u8; BODY_BYTES], usize) {
    encode_as(VERSION, sequence, parameters.all())
}

/// As [`encode`] with any version and pairs; pairs beyond the capacity are omitted.
pub(super) fn encode_as(
    version: u16,
    sequence: u32,
    pairs: impl Iterator<Item = (u16, i32)>,
) -> ([u8; BODY_BYTES], usize) {
    let mut bytes = [ERASED; BODY_BYTES];
    let mut length = 0;
    if let Some(room) = bytes.get_mut(HEADER..BODY_BYTES - CRC_BYTES) {
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
    (digest.finalize() == u32::from_le_bytes(*check)).then_some(Record {
        sequence: u32::from_le_bytes([s0, s1, s2, s3]),
        version: u16::from_le_bytes([v0, v1]),
        pairs,
    })
}

impl Record<'_> {
    /// The parameters; defaults for those that are missing or outside their present range.
    pub fn parameters(&self) -> Parameters {
        let mut parameters = Parameters::DEFAULT;
        let mut rest = self.pairs;
        while let Ok(((id, value), tail)) = postcard::take_from_bytes::<(u16, i32)>(rest) {
            // Fails for removed parameters and changed ranges: the default stays.
            let _ = parameters.set(id, value);
            rest = tail;
        }
        parameters
    }
}
