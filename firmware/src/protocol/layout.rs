//! Layout of the signals of a message in the eight bytes of a frame.

use core::ops::Range;

/// One signal of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalLayout {
    /// Name in the message and in the `.dbc`.
    pub name: &'static str,
    /// First bit; bit 0 is the least significant of the first byte.
    pub first_bit: u8,
    /// The bit after the last.
    pub end_bit: u8,
    /// Whether the value is in two's complement.
    pub signed: bool,
    /// Value of one count, in `unit`.
    pub scale: f64,
    /// Unit of the scaled value; empty for a plain number.
    pub unit: &'static str,
    /// Description in the `.dbc`.
    pub description: &'static str,
}

impl SignalLayout {
    /// Counts per unit, rounded.
    pub const fn counts_per_unit(&self) -> i64 {
        (1.0 / self.scale + 0.5) as i64
    }
}

/// Sender of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The gripper.
    Out,
    /// The host.
    In,
}

/// Identifier and signals of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageLayout {
    /// Name in the `.dbc`.
    pub name: &'static str,
    /// Number, the lower five bits of the identifier.
    pub number: u8,
    /// Count of messages with this layout and consecutive numbers, one for each sensor.
    pub instances: u8,
    /// Sender.
    pub direction: Direction,
    /// Default period in milliseconds; 0: on events.
    pub period_ms: u16,
    /// Whether the first signal selects the sensor of the others.
    pub multiplexed: bool,
    /// Signals in ascending order; bits between them are reserved and zero.
    pub signals: &'static [SignalLayout],
    /// Description in the `.dbc`.
    pub description: &'static str,
}

/// Why a frame is not a valid message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// Unknown message number.
    Unknown,
    /// Not eight bytes.
    Length,
    /// A reserved bit is set.
    Reserved,
}

impl MessageLayout {
    /// Bit mask of its numbers, if a host sends it.
    pub const fn from_host(&self) -> u32 {
        match self.direction {
            Direction::In => ((1 << self.instances) - 1) << self.number,
            Direction::Out => 0,
        }
    }

    /// Bit mask of all signals.
    pub const fn used(&self) -> u64 {
        let (mut used, mut rest) = (0, self.signals);
        while let [signal, others @ ..] = rest {
            used |= mask(signal.first_bit, signal.end_bit);
            rest = others;
        }
        used
    }

    /// Whether the signals are in order, disjoint and within the frame.
    pub const fn is_valid(&self) -> bool {
        let (mut free, mut rest) = (0, self.signals);
        while let [signal, others @ ..] = rest {
            if signal.first_bit < free || signal.end_bit <= signal.first_bit || signal.end_bit > 64
            {
                return false;
            }
            (free, rest) = (signal.end_bit, others);
        }
        self.instances > 0 && self.number < 32 && self.number + self.instances <= 32
    }

    /// The numbers of its instances.
    pub const fn numbers(&self) -> Range<u8> {
        self.number..self.number + self.instances
    }
}

/// Mask of bits `first..end`.
const fn mask(first: u8, end: u8) -> u64 {
    let ones = match 64_u32.checked_sub(end as u32 - first as u32) {
        Some(spare) if spare < 64 => u64::MAX >> spare,
        _ => 0,
    };
    ones << first
}

/// A type of a signal.
pub trait SignalValue: Copy {
    /// Whether the type is signed.
    const SIGNED: bool;
    /// Conversion to the widest type.
    fn widen(self) -> i64;
    /// Inverse of [`SignalValue::widen`]; a signal is never wider than its type.
    fn narrow(value: i64) -> Self;
}

macro_rules! signal_values {
    ($($type:ident),*) => {$(
        impl SignalValue for $type {
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
signal_values!(u8, u16, u32, i8, i16, i32);

impl SignalValue for bool {
    const SIGNED: bool = false;
    fn widen(self) -> i64 {
        i64::from(self)
    }
    fn narrow(value: i64) -> Self {
        value != 0
    }
}

/// The bits of a signal at their position in the frame. The value saturates.
pub fn encode<T: SignalValue>(bits: Range<u8>, value: T) -> u64 {
    let width = u32::from(bits.end.saturating_sub(bits.start)).min(32);
    let (min, max) = if T::SIGNED {
        let limit = 1_i64 << width.saturating_sub(1);
        (-limit, limit - 1)
    } else {
        (0, (1_i64 << width) - 1)
    };
    let value = value.widen().clamp(min, max) as u64;
    (value << bits.start) & mask(bits.start, bits.end)
}

/// The value of a signal in a frame.
pub fn decode<T: SignalValue>(frame: u64, bits: Range<u8>) -> T {
    let above = 64_u32.saturating_sub(u32::from(bits.end)).min(63);
    let width = u32::from(bits.end.saturating_sub(bits.start)).clamp(1, 64);
    let raised = frame << above;
    T::narrow(if T::SIGNED {
        (raised as i64) >> (64 - width)
    } else {
        (raised >> (64 - width)) as i64
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signal_occupies_exactly_its_bits() {
        assert_eq!(encode(4..8, 0xF_u8), 0xF0);
        assert_eq!(encode(20..28, 0xFF_u8), 0x0FF0_0000);
        assert_eq!(encode(14..28, -1_i16), 0x0FFF_C000);
        assert_eq!(decode::<i16>(0x0FFF_C000, 14..28), -1);
        assert_eq!(decode::<u8>(u64::MAX, 20..28), 255);
        assert_eq!(decode::<u16>(0x1234 << 48, 48..64), 0x1234);
        assert!(decode::<bool>(1 << 63, 63..64));
    }

    #[test]
    fn value_beyond_signal_range_saturates() {
        assert_eq!(decode::<i16>(encode(0..12, i16::MAX), 0..12), 2047);
        assert_eq!(decode::<i16>(encode(0..12, i16::MIN), 0..12), -2048);
        assert_eq!(decode::<u16>(encode(0..14, u16::MAX), 0..14), 16383);
    }
}
