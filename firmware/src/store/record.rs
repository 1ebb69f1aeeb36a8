//! One record: all parameters, in the bytes of a slot.
//!
//! | bytes | what |
//! | --- | --- |
//! | 0..4 | sequence: one more than that of the record before |
//! | 4..6 | version of the table of parameters |
//! | 6..8 | length of the pairs |
//! | 8.. | pairs of identifier and value, postcard |
//! | behind | CRC-32 over all before |
//! | 240..248 | [`WRITTEN`] |
//! | 248..256 | [`END`] |
//!
//! Numbers are little-endian; what is between stays erased.

use crate::checksum::CRC32;
use crate::parameters::Parameters;
use crate::parameters::table::COUNT;

/// Version of the table of parameters: goes up when an identifier or a meaning changes.
pub const VERSION: u16 = 1;
/// Bytes of a slot.
pub const SLOT: usize = 256;
/// Bytes of a slot before its marks.
pub const BODY: usize = SLOT - WRITTEN.len() - END.len();
/// Written once the record was read back, and read back itself: without it the record does not count.
pub const WRITTEN: [u8; 8] = *b"written.";
/// Written and read back last: without it nobody knows whether [`WRITTEN`] will read so again.
pub const END: [u8; 8] = *b"the end.";
/// A byte of an erased slot.
pub const ERASED: u8 = 0xFF;

const HEAD: usize = 8;
const CHECK: usize = size_of::<u32>();
/// Most bytes of a pair: 16 bits in three groups of seven, 32 bits in five.
const PAIR: usize = 3 + 5;
const _: () = assert!(HEAD + COUNT * PAIR + CHECK <= BODY);

/// What a slot holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'b> {
    /// One more than that of the record before.
    pub sequence: u32,
    /// Version of the table that it was written with.
    pub version: u16,
    pairs: &'b [u8],
}

/// The bytes of a record, and how many of them are not erased.
pub fn encode(sequence: u32, parameters: &Parameters) -> ([u8; BODY], usize) {
    encode_as(VERSION, sequence, parameters.all())
}

/// The same with any version and pairs; pairs that do not fit are left out, which no table's are.
pub(super) fn encode_as(
    version: u16,
    sequence: u32,
    pairs: impl Iterator<Item = (u16, i32)>,
) -> ([u8; BODY], usize) {
    let mut bytes = [ERASED; BODY];
    let mut length = 0;
    if let Some(room) = bytes.get_mut(HEAD..BODY - CHECK) {
        for pair in pairs {
            let free = room.get_mut(length..).unwrap_or_default();
            length += postcard::to_slice(&pair, free).map_or(0, |used| used.len());
        }
    }
    let fields = [
        &sequence.to_le_bytes()[..],
        &version.to_le_bytes(),
        &(length as u16).to_le_bytes(),
    ];
    for (to, from) in bytes.iter_mut().zip(fields.into_iter().flatten()) {
        *to = *from;
    }
    let used = HEAD + length;
    let check = CRC32.checksum(bytes.get(..used).unwrap_or_default());
    for (to, from) in bytes.iter_mut().skip(used).zip(check.to_le_bytes()) {
        *to = from;
    }
    (bytes, used + CHECK)
}

/// The record in a slot's bytes, if their checksum is right.
pub fn decode(bytes: &[u8; BODY]) -> Option<Record<'_>> {
    let (head, behind) = bytes.split_first_chunk::<HEAD>()?;
    let [s0, s1, s2, s3, v0, v1, l0, l1] = *head;
    let length = usize::from(u16::from_le_bytes([l0, l1]));
    let (pairs, behind) = behind.split_at_checked(length)?;
    let (check, _) = behind.split_first_chunk::<CHECK>()?;
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
    /// What it knows; the default of what it does not know, or holds beyond its range of today.
    pub fn parameters(&self) -> Parameters {
        let mut parameters = Parameters::DEFAULT;
        let mut rest = self.pairs;
        while let Ok(((id, value), behind)) = postcard::take_from_bytes::<(u16, i32)>(rest) {
            // A parameter that is no more, or whose range has changed: its default stays.
            let _ = parameters.set(id, value);
            rest = behind;
        }
        parameters
    }
}
