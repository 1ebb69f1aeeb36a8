//! Integer arithmetic of the architecture as pure functions.
//!
//! Source: ARMv7-M Architecture Reference Manual (DDI0403E), A2.2 (integer arithmetic, shifts,
//! saturation) and A5.3.2 (modified immediate constants).

/// APSR bit 31: negative.
pub(super) const NEGATIVE: u32 = 1 << 31;
/// APSR bit 30: zero.
pub(super) const ZERO: u32 = 1 << 30;
/// APSR bit 29: carry.
pub(super) const CARRY: u32 = 1 << 29;
/// APSR bit 28: signed overflow.
pub(super) const OVERFLOW: u32 = 1 << 28;
/// APSR bit 27: saturation or overflow of a DSP instruction (cumulative).
pub(super) const SATURATED: u32 = 1 << 27;
/// The four condition flags.
pub(super) const NZCV: u32 = NEGATIVE | ZERO | CARRY | OVERFLOW;

/// Kind of a shift of a register operand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shift {
    Left,
    LogicalRight,
    ArithmeticRight,
    RotateRight,
    /// Rotation by one bit through the carry flag.
    RotateExtended,
}

impl Shift {
    /// `DecodeImmShift`: kind and amount of the two-bit type and five-bit immediate of an encoding,
    /// in which an amount of 0 encodes 32 or, with a rotation, RRX.
    pub(super) const fn from_immediate(kind: u32, amount: u32) -> (Shift, u8) {
        match (kind & 3, amount as u8 & 31) {
            (0, amount) => (Shift::Left, amount),
            (1, 0) => (Shift::LogicalRight, 32),
            (1, amount) => (Shift::LogicalRight, amount),
            (2, 0) => (Shift::ArithmeticRight, 32),
            (2, amount) => (Shift::ArithmeticRight, amount),
            (_, 0) => (Shift::RotateExtended, 1),
            (_, amount) => (Shift::RotateRight, amount),
        }
    }
}

/// `Shift_C`: the shifted value and the carry out. `amount` is 0 to 255.
#[inline]
pub(super) const fn shift_with_carry(
    value: u32,
    shift: Shift,
    amount: u32,
    carry: bool,
) -> (u32, bool) {
    if amount == 0 && !matches!(shift, Shift::RotateExtended) {
        return (value, carry);
    }
    match shift {
        Shift::Left => match amount {
            1..=31 => (value << amount, value >> (32 - amount) & 1 != 0),
            _ => (0, amount == 32 && value & 1 != 0),
        },
        Shift::LogicalRight => match amount {
            1..=31 => (value >> amount, value >> (amount - 1) & 1 != 0),
            _ => (0, amount == 32 && value >> 31 != 0),
        },
        Shift::ArithmeticRight => match amount {
            1..=31 => (((value as i32) >> amount) as u32, value >> (amount - 1) & 1 != 0),
            _ => (((value as i32) >> 31) as u32, value >> 31 != 0),
        },
        Shift::RotateRight => {
            let result = value.rotate_right(amount & 31);
            (result, result >> 31 != 0)
        }
        Shift::RotateExtended => (value >> 1 | (carry as u32) << 31, value & 1 != 0),
    }
}

/// `AddWithCarry`: the sum and its flags N, Z, C and V in bits 31 to 28.
#[inline(always)]
pub(super) const fn add_with_carry(a: u32, b: u32, carry: bool) -> (u32, u32) {
    let wide = a as u64 + b as u64 + carry as u64;
    let sum = wide as u32;
    let overflow = !(a ^ b) & (a ^ sum);
    (sum, flags(sum, wide >> 32 != 0, overflow))
}

/// The difference `a - b` and its flags N, Z, C and V in bits 31 to 28: C is set without a borrow.
#[inline(always)]
pub(super) const fn subtract(a: u32, b: u32) -> (u32, u32) {
    let difference = a.wrapping_sub(b);
    let overflow = (a ^ b) & (a ^ difference);
    (difference, flags(difference, a >= b, overflow))
}

/// Flags of a result; bit 31 of `overflow` becomes V.
#[inline(always)]
const fn flags(result: u32, carry: bool, overflow: u32) -> u32 {
    result & NEGATIVE
        | ((result == 0) as u32) << 30
        | (carry as u32) << 29
        | overflow >> 3 & OVERFLOW
}

/// `ThumbExpandImm_C` of a 12-bit field: the constant, and the carry out where the encoding rotates.
/// `None` where the encoding is unpredictable (a replicated byte of 0).
pub(super) const fn expand_immediate(field: u32) -> Option<(u32, Option<bool>)> {
    let byte = field & 0xFF;
    let pattern = match field >> 8 & 0xF {
        0 => 1,
        1 => 0x0001_0001,
        2 => 0x0100_0100,
        3 => 0x0101_0101,
        _ => {
            let value = (0x80 | field & 0x7F).rotate_right(field >> 7 & 31);
            return Some((value, Some(value >> 31 != 0)));
        }
    };
    if byte == 0 && pattern != 1 {
        return None;
    }
    Some((byte * pattern, None))
}

/// Low `bits` (1 to 32) of a value, extended with the sign.
#[inline(always)]
pub(super) const fn sign_extend(value: u32, bits: u32) -> u32 {
    let unused = 32 - bits;
    ((value << unused) as i32 >> unused) as u32
}

/// `SignedSatQ`: the value limited to a signed number of `bits` (1 to 32), and whether it was limited.
#[inline]
pub(super) const fn saturate_signed(value: i64, bits: u32) -> (i32, bool) {
    let max = (1i64 << (bits - 1)) - 1;
    let min = -max - 1;
    if value > max {
        (max as i32, true)
    } else if value < min {
        (min as i32, true)
    } else {
        (value as i32, false)
    }
}

/// `UnsignedSatQ`: the value limited to an unsigned number of `bits` (0 to 32), and whether it was
/// limited.
#[inline]
pub(super) const fn saturate_unsigned(value: i64, bits: u32) -> (u32, bool) {
    let max = (1i64 << bits) - 1;
    if value > max {
        (max as u32, true)
    } else if value < 0 {
        (0, true)
    } else {
        (value as u32, false)
    }
}

/// Signed quotient, rounded toward zero; 0 for a divisor of 0. `0x8000_0000 / -1` is `0x8000_0000`.
#[inline]
pub(super) const fn divide_signed(dividend: u32, divisor: u32) -> u32 {
    if divisor == 0 {
        return 0;
    }
    (dividend as i32).wrapping_div(divisor as i32) as u32
}

/// Unsigned quotient; 0 for a divisor of 0.
#[inline]
pub(super) const fn divide_unsigned(dividend: u32, divisor: u32) -> u32 {
    if divisor == 0 {
        return 0;
    }
    dividend / divisor
}

/// Bytes in reverse order within each halfword.
#[inline(always)]
pub(super) const fn reverse_halfwords(value: u32) -> u32 {
    value.swap_bytes().rotate_right(16)
}

/// A set of values of the flags N, Z, C and V, in which an instruction is executed: bit `i` for
/// the flags `i` (bits 31 to 28 of the APSR).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Condition(u16);

impl Condition {
    /// Condition of a four-bit field (A7.3); 14 and 15 are always met.
    pub(super) const fn new(code: u32) -> Self {
        Self(MASKS[(code & 15) as usize])
    }

    /// Whether the condition is met with these flags (bits 31 to 28 of the APSR).
    #[inline(always)]
    pub(super) const fn is_met(self, apsr: u32) -> bool {
        self.0 >> (apsr >> 28) & 1 != 0
    }
}

const MASKS: [u16; 16] = {
    let mut masks = [0; 16];
    let mut code = 0;
    while code < 16 {
        let mut flags = 0;
        while flags < 16 {
            let (n, z, c, v) = (flags & 8 != 0, flags & 4 != 0, flags & 2 != 0, flags & 1 != 0);
            let base = match code >> 1 {
                0 => z,
                1 => c,
                2 => n,
                3 => v,
                4 => c && !z,
                5 => n == v,
                6 => n == v && !z,
                _ => true,
            };
            if base != (code & 1 != 0 && code != 15) {
                masks[code] |= 1 << flags;
            }
            flags += 1;
        }
        code += 1;
    }
    masks
};
