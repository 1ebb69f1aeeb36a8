//! How a message lies in the eight bytes of a frame.

use core::ops::Range;

/// One field of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// As it is called in the message and in the `.dbc`.
    pub name: &'static str,
    /// Its first bit; bit 0 is the least of the first byte.
    pub first: u8,
    /// The bit after its last.
    pub end: u8,
    /// Two's complement?
    pub signed: bool,
    /// What one count means, in `unit`.
    pub scale: f64,
    /// Unit of the scaled value; empty for a plain number.
    pub unit: &'static str,
    /// What it says.
    pub words: &'static str,
}

impl Field {
    /// Counts in its unit.
    pub const fn counts_per_unit(&self) -> i64 {
        (1.0 / self.scale + 0.5) as i64
    }
}

/// Who sends a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The gripper.
    Out,
    /// The host.
    In,
}

/// A message: its place on the bus and its fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// As it is called.
    pub name: &'static str,
    /// Its number, the lower five bits of the identifier.
    pub number: u8,
    /// Messages of this layout with numbers that follow each other, one for each sensor.
    pub copies: u8,
    /// Who sends it.
    pub direction: Direction,
    /// Milliseconds between two, if nobody changes it; 0: when there is a reason.
    pub period_ms: u16,
    /// Whether the first field says which sensor the others are of.
    pub multiplexed: bool,
    /// In order; bits between them are zero.
    pub fields: &'static [Field],
    /// What it is for.
    pub words: &'static str,
}

/// Why bytes are not the message that their number promises.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Malformed {
    /// No message has this number.
    Unknown,
    /// A frame has eight bytes.
    Length,
    /// A bit is set that no field owns.
    Reserved,
}

impl Layout {
    /// A bit for each of its numbers, if a host sends it.
    pub const fn from_host(&self) -> u32 {
        match self.direction {
            Direction::In => ((1 << self.copies) - 1) << self.number,
            Direction::Out => 0,
        }
    }

    /// The bits that fields own.
    pub const fn used(&self) -> u64 {
        let (mut used, mut rest) = (0, self.fields);
        while let [field, others @ ..] = rest {
            used |= mask(field.first, field.end);
            rest = others;
        }
        used
    }

    /// Whether every field has bits of its own, in order, within the frame.
    pub const fn is_sound(&self) -> bool {
        let (mut free, mut rest) = (0, self.fields);
        while let [field, others @ ..] = rest {
            if field.first < free || field.end <= field.first || field.end > 64 {
                return false;
            }
            (free, rest) = (field.end, others);
        }
        self.copies > 0 && self.number < 32 && self.number + self.copies <= 32
    }

    /// The numbers of its copies.
    pub const fn numbers(&self) -> Range<u8> {
        self.number..self.number + self.copies
    }
}

/// Ones from bit `first` to before bit `end`.
const fn mask(first: u8, end: u8) -> u64 {
    let ones = match 64_u32.checked_sub(end as u32 - first as u32) {
        Some(spare) if spare < 64 => u64::MAX >> spare,
        _ => 0,
    };
    ones << first
}

/// A type that a field may have.
pub trait Raw: Copy {
    /// Two's complement?
    const SIGNED: bool;
    /// The number.
    fn widen(self) -> i64;
    /// The number that [`Raw::widen`] gave; a field is never wider than its type.
    fn narrow(value: i64) -> Self;
}

macro_rules! raw {
    ($($type:ident),*) => {$(
        impl Raw for $type {
            const SIGNED: bool = $type::MIN != 0;
            fn widen(self) -> i64 {
                i64::from(self)
            }
            fn narrow(value: i64) -> Self {
                value as $type
            }
        }
    )*};
}
raw!(u8, u16, u32, i8, i16, i32);

impl Raw for bool {
    const SIGNED: bool = false;
    fn widen(self) -> i64 {
        i64::from(self)
    }
    fn narrow(value: i64) -> Self {
        value != 0
    }
}

/// The bits of a field, in place. What does not fit stays at the end of the field's range.
pub fn put<T: Raw>(bits: Range<u8>, value: T) -> u64 {
    let width = u32::from(bits.end.saturating_sub(bits.start)).min(32);
    let (least, greatest) = match T::SIGNED {
        true => (
            -(1_i64 << (width.saturating_sub(1))),
            (1_i64 << width.saturating_sub(1)) - 1,
        ),
        false => (0, (1_i64 << width) - 1),
    };
    let value = value.widen().clamp(least, greatest) as u64;
    (value << bits.start) & mask(bits.start, bits.end)
}

/// The value of a field.
pub fn take<T: Raw>(frame: u64, bits: Range<u8>) -> T {
    let above = 64_u32.saturating_sub(u32::from(bits.end)).min(63);
    let width = u32::from(bits.end.saturating_sub(bits.start)).clamp(1, 64);
    let raised = frame << above;
    T::narrow(match T::SIGNED {
        true => (raised as i64) >> (64 - width),
        false => (raised >> (64 - width)) as i64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_takes_its_bits_and_no_other() {
        assert_eq!(put(4..8, 0xF_u8), 0xF0);
        assert_eq!(put(20..28, 0xFF_u8), 0x0FF0_0000);
        assert_eq!(put(14..28, -1_i16), 0x0FFF_C000);
        assert_eq!(take::<i16>(0x0FFF_C000, 14..28), -1);
        assert_eq!(take::<u8>(u64::MAX, 20..28), 255);
        assert_eq!(take::<u16>(0x1234 << 48, 48..64), 0x1234);
        assert!(take::<bool>(1 << 63, 63..64));
    }

    #[test]
    fn what_does_not_fit_stays_at_the_end_of_the_range() {
        assert_eq!(take::<i16>(put(0..12, i16::MAX), 0..12), 2047);
        assert_eq!(take::<i16>(put(0..12, i16::MIN), 0..12), -2048);
        assert_eq!(take::<u16>(put(0..14, u16::MAX), 0..14), 16383);
    }
}
