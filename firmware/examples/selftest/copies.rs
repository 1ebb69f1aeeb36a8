//! Copies of memory: every length up to a few words, between every alignment, against a copy byte by byte.

use core::hint::black_box;

/// Greatest length, and room around it.
const LONGEST: usize = 70;
const ROOM: usize = 96;
const BETWEEN: u8 = 0xA5;

/// Lengths, at places, that are not copied as they should be, or after which something around has changed.
pub fn wrong() -> u32 {
    let mut wrong = 0;
    let mut from = Words([0; ROOM]);
    for (byte, value) in from.0.iter_mut().zip(1..) {
        *byte = value;
    }
    for source in 0..8 {
        for target in 0..8 {
            for length in 0..=LONGEST {
                wrong += u32::from(!is_right(&from, source, target, length).unwrap_or(false));
            }
        }
    }
    wrong
}

#[repr(align(8))]
struct Words([u8; ROOM]);

fn is_right(from: &Words, source: usize, target: usize, length: usize) -> Option<bool> {
    let mut to = Words([BETWEEN; ROOM]);
    let bytes = black_box(from.0.get(source..source + length)?);
    black_box(to.0.get_mut(target..target + length)?).copy_from_slice(bytes);
    let expected = |at: usize| match at.checked_sub(target) {
        Some(place) if place < length => bytes.get(place).copied(),
        _ => Some(BETWEEN),
    };
    Some(
        black_box(&to.0)
            .iter()
            .enumerate()
            .all(|(at, byte)| expected(at) == Some(*byte)),
    )
}
