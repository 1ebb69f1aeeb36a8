//! Floating-point arithmetic of the architecture, exact for every rounding mode and flag.
//!
//! Source: DDI0403E A2.5 (floating-point data types and arithmetic): the functions carry the names of
//! its pseudocode. Values are bit patterns; the FPSCR gives the modes and collects the exceptions.
//!
//! Tininess is detected before rounding. Trapped exceptions do not exist on this core.

/// Cumulative exception: invalid operation.
pub(super) const INVALID: u32 = 1 << 0;
/// Cumulative exception: division by zero.
pub(super) const DIVISION_BY_ZERO: u32 = 1 << 1;
/// Cumulative exception: overflow.
pub(super) const OVERFLOW: u32 = 1 << 2;
/// Cumulative exception: underflow.
pub(super) const UNDERFLOW: u32 = 1 << 3;
/// Cumulative exception: inexact.
pub(super) const INEXACT: u32 = 1 << 4;
/// Cumulative exception: denormal operand flushed to zero.
pub(super) const INPUT_DENORMAL: u32 = 1 << 7;
/// Rounding mode, two bits.
pub(super) const ROUNDING_MODE: u32 = 3 << 22;
/// Denormal operands and results become zero.
pub(super) const FLUSH_TO_ZERO: u32 = 1 << 24;
/// Every NaN result is the default NaN.
pub(super) const DEFAULT_NAN: u32 = 1 << 25;
/// Half precision without infinities and NaN.
pub(super) const ALTERNATIVE_HALF: u32 = 1 << 26;

const SIGN: u32 = 1 << 31;
const INFINITY: u32 = 0x7F80_0000;
const QUIET: u32 = 1 << 22;
const NAN: u32 = 0x7FC0_0000;

/// Flags N, Z, C and V of a comparison, in bits 31 to 28.
const LESS: u32 = 0b1000 << 28;
const EQUAL: u32 = 0b0110 << 28;
const GREATER: u32 = 0b0010 << 28;
const UNORDERED: u32 = 0b0011 << 28;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rounding {
    NearestEven,
    PlusInfinity,
    MinusInfinity,
    Zero,
}

impl Rounding {
    const fn of(fpscr: u32) -> Self {
        match (fpscr & ROUNDING_MODE) >> 22 {
            0 => Self::NearestEven,
            1 => Self::PlusInfinity,
            2 => Self::MinusInfinity,
            _ => Self::Zero,
        }
    }

    /// Whether the magnitude is incremented that was cut off before `remainder` of `unit`.
    fn increments(self, sign: bool, odd: bool, remainder: u128, unit: u128) -> bool {
        match self {
            Self::NearestEven => remainder > unit / 2 || remainder == unit / 2 && odd,
            Self::PlusInfinity => remainder != 0 && !sign,
            Self::MinusInfinity => remainder != 0 && sign,
            Self::Zero => false,
        }
    }
}

/// Widths of a binary format.
struct Format {
    exponent_bits: u32,
    fraction_bits: u32,
}

const SINGLE: Format = Format { exponent_bits: 8, fraction_bits: 23 };
const HALF: Format = Format { exponent_bits: 5, fraction_bits: 10 };

/// The number `(-1)^sign * significand * 2^exponent`; a significand of zero is a zero.
#[derive(Debug, Clone, Copy)]
struct Number {
    sign: bool,
    significand: u128,
    exponent: i32,
}

#[derive(Debug, Clone, Copy)]
enum Value {
    Nan,
    Infinity { sign: bool },
    Finite(Number),
}

impl Value {
    fn sign(self, bits: u32) -> bool {
        match self {
            Value::Nan => bits & SIGN != 0,
            Value::Infinity { sign } => sign,
            Value::Finite(number) => number.sign,
        }
    }
}

/// `FPUnpack`. A finite number other than zero has a significand of 24 bits.
fn unpack(bits: u32, fpscr: &mut u32) -> Value {
    let sign = bits & SIGN != 0;
    let (exponent, fraction) = ((bits >> 23 & 0xFF) as i32, bits & 0x7F_FFFF);
    match (exponent, fraction) {
        (0xFF, 0) => Value::Infinity { sign },
        (0xFF, _) => Value::Nan,
        (0, 0) => Value::Finite(Number { sign, significand: 0, exponent: 0 }),
        (0, _) if *fpscr & FLUSH_TO_ZERO != 0 => {
            *fpscr |= INPUT_DENORMAL;
            Value::Finite(Number { sign, significand: 0, exponent: 0 })
        }
        (0, _) => {
            let shift = fraction.leading_zeros() - 8;
            let significand = (fraction << shift) as u128;
            Value::Finite(Number { sign, significand, exponent: -149 - shift as i32 })
        }
        _ => {
            let significand = (fraction | 1 << 23) as u128;
            Value::Finite(Number { sign, significand, exponent: exponent - 150 })
        }
    }
}

fn signed(sign: bool, magnitude: u32) -> u32 {
    if sign { magnitude | SIGN } else { magnitude }
}

fn is_nan(bits: u32) -> bool {
    bits & !SIGN > INFINITY
}

fn is_signalling(bits: u32) -> bool {
    is_nan(bits) && bits & QUIET == 0
}

fn invalid(fpscr: &mut u32) -> u32 {
    *fpscr |= INVALID;
    NAN
}

/// `FPProcessNaN`.
fn process_nan(bits: u32, fpscr: &mut u32) -> u32 {
    if is_signalling(bits) {
        *fpscr |= INVALID;
    }
    if *fpscr & DEFAULT_NAN != 0 { NAN } else { bits | QUIET }
}

/// `FPProcessNaNs` and `FPProcessNaNs3`: the first signalling operand, else the first quiet one.
fn process_nans(operands: &[u32], fpscr: &mut u32) -> Option<u32> {
    let signalling = operands.iter().find(|&&bits| is_signalling(bits));
    let nan = signalling.or_else(|| operands.iter().find(|&&bits| is_nan(bits)))?;
    Some(process_nan(*nan, fpscr))
}

/// `FPRound` to single precision.
fn round(number: Number, fpscr: &mut u32) -> u32 {
    let rounding = Rounding::of(*fpscr);
    round_to(number, &SINGLE, rounding, fpscr)
}

/// `FPRound`: the nearest representable numbers and the flags. The lowest bit of the
/// significand may represent a remainder of any size below it (sticky bit).
fn round_to(number: Number, format: &Format, rounding: Rounding, fpscr: &mut u32) -> u32 {
    let Number { sign, significand, exponent } = number;
    let width = format.exponent_bits + format.fraction_bits;
    let sign_bit = (sign as u32) << width;
    if significand == 0 {
        return sign_bit;
    }
    let bias = (1 << (format.exponent_bits - 1)) - 1;
    let minimum = 1 - bias;
    let leading = exponent + significand.ilog2() as i32;
    let single = format.exponent_bits == SINGLE.exponent_bits;
    if single && *fpscr & FLUSH_TO_ZERO != 0 && leading < minimum {
        *fpscr |= UNDERFLOW;
        return sign_bit;
    }

    // Weight of the last place of the result, and what is cut off below it.
    let last_place = leading.max(minimum) - format.fraction_bits as i32;
    let shift = last_place - exponent;
    let (mut magnitude, inexact) = if shift <= 0 {
        (significand << -shift, false)
    } else if shift > 126 {
        // Far below half of the smallest number.
        let up = rounding.increments(sign, false, 1, 4);
        (up as u128, true)
    } else {
        let unit = 1u128 << shift;
        let (kept, remainder) = (significand >> shift, significand & (unit - 1));
        let up = rounding.increments(sign, kept & 1 != 0, remainder, unit);
        (kept + up as u128, remainder != 0)
    };
    if leading < minimum {
        if inexact {
            *fpscr |= UNDERFLOW;
        }
    } else {
        // The implicit bit of the magnitude adds one to the exponent, as does a carry out of it.
        magnitude += ((leading - minimum) as u128) << format.fraction_bits;
    }

    let alternative = !single && *fpscr & ALTERNATIVE_HALF != 0;
    let limit = (1u128 << width) - if alternative { 0 } else { 1 << format.fraction_bits };
    if magnitude >= limit {
        if alternative {
            *fpscr |= INVALID;
            return sign_bit | ((1 << width) - 1);
        }
        *fpscr |= OVERFLOW | INEXACT;
        let to_infinity = match rounding {
            Rounding::NearestEven => true,
            Rounding::PlusInfinity => !sign,
            Rounding::MinusInfinity => sign,
            Rounding::Zero => false,
        };
        return sign_bit | (limit as u32 - !to_infinity as u32);
    }
    if inexact {
        *fpscr |= INEXACT;
    }
    sign_bit | magnitude as u32
}

/// Exact sum, or a sum with a sticky lowest bit where the exponents are far apart.
/// The significands are zero or have 24 to 48 bits.
fn sum(a: Number, b: Number, fpscr: u32) -> Number {
    let zero_sign = Rounding::of(fpscr) == Rounding::MinusInfinity;
    let (large, small) = match (a.significand, b.significand) {
        (0, 0) => {
            let sign = if a.sign == b.sign { a.sign } else { zero_sign };
            return Number { sign, significand: 0, exponent: 0 };
        }
        (_, 0) => return a,
        (0, _) => return b,
        _ if a.exponent >= b.exponent => (a, b),
        _ => (b, a),
    };
    let distance = large.exponent - small.exponent;
    let (shift, small_significand) = if distance <= 64 {
        (distance, small.significand)
    } else {
        // Less than one unit after this shift: only its presence counts.
        (16, 1)
    };
    let large_value = signed_significand(large.sign, large.significand << shift);
    let total = large_value + signed_significand(small.sign, small_significand);
    if total == 0 {
        return Number { sign: zero_sign, significand: 0, exponent: 0 };
    }
    Number { sign: total < 0, significand: total.unsigned_abs(), exponent: large.exponent - shift }
}

fn signed_significand(sign: bool, significand: u128) -> i128 {
    if sign { -(significand as i128) } else { significand as i128 }
}

/// `FPAdd`; a difference is the sum with the second sign inverted, apart from NaN operands.
fn add_values(a: Value, b: Value, fpscr: &mut u32) -> u32 {
    match (a, b) {
        (Value::Infinity { sign: a }, Value::Infinity { sign: b }) if a != b => invalid(fpscr),
        (Value::Infinity { sign }, _) | (_, Value::Infinity { sign }) => signed(sign, INFINITY),
        (Value::Finite(a), Value::Finite(b)) => round(sum(a, b, *fpscr), fpscr),
        _ => NAN,
    }
}

/// `FPAdd`.
pub(super) fn add(a: u32, b: u32, fpscr: &mut u32) -> u32 {
    let values = (unpack(a, fpscr), unpack(b, fpscr));
    process_nans(&[a, b], fpscr).unwrap_or_else(|| add_values(values.0, values.1, fpscr))
}

/// `FPSub`.
pub(super) fn subtract(a: u32, b: u32, fpscr: &mut u32) -> u32 {
    let values = (unpack(a, fpscr), unpack(b ^ SIGN, fpscr));
    process_nans(&[a, b], fpscr).unwrap_or_else(|| add_values(values.0, values.1, fpscr))
}

/// `FPMul`.
pub(super) fn multiply(a: u32, b: u32, fpscr: &mut u32) -> u32 {
    let values = (unpack(a, fpscr), unpack(b, fpscr));
    if let Some(nan) = process_nans(&[a, b], fpscr) {
        return nan;
    }
    match multiply_values(values.0, values.1) {
        Value::Nan => invalid(fpscr),
        Value::Infinity { sign } => signed(sign, INFINITY),
        Value::Finite(number) => round(number, fpscr),
    }
}

/// Exact product of two values, none of them NaN; NaN for infinity times zero.
fn multiply_values(a: Value, b: Value) -> Value {
    let sign = a.sign(0) != b.sign(0);
    match (a, b) {
        (Value::Finite(a), Value::Finite(b)) => Value::Finite(Number {
            sign,
            significand: a.significand * b.significand,
            exponent: a.exponent + b.exponent,
        }),
        (Value::Infinity { .. }, Value::Finite(number))
        | (Value::Finite(number), Value::Infinity { .. })
            if number.significand == 0 =>
        {
            Value::Nan
        }
        _ => Value::Infinity { sign },
    }
}

/// `FPDiv`.
pub(super) fn divide(a: u32, b: u32, fpscr: &mut u32) -> u32 {
    let values = (unpack(a, fpscr), unpack(b, fpscr));
    if let Some(nan) = process_nans(&[a, b], fpscr) {
        return nan;
    }
    let sign = (a ^ b) & SIGN != 0;
    match values {
        (Value::Finite(a), Value::Finite(b)) if a.significand == 0 && b.significand == 0 => {
            invalid(fpscr)
        }
        (Value::Finite(_), Value::Finite(b)) if b.significand == 0 => {
            *fpscr |= DIVISION_BY_ZERO;
            signed(sign, INFINITY)
        }
        (Value::Finite(a), Value::Finite(b)) => {
            let dividend = a.significand << 40;
            let remainder = !dividend.is_multiple_of(b.significand);
            let significand = (dividend / b.significand) | remainder as u128;
            let exponent = a.exponent - b.exponent - 40;
            round(Number { sign, significand, exponent }, fpscr)
        }
        (Value::Infinity { .. }, Value::Infinity { .. }) => invalid(fpscr),
        (Value::Infinity { .. }, _) => signed(sign, INFINITY),
        _ => signed(sign, 0),
    }
}

/// `FPSqrt`.
pub(super) fn square_root(a: u32, fpscr: &mut u32) -> u32 {
    match unpack(a, fpscr) {
        Value::Nan => process_nan(a, fpscr),
        Value::Finite(number) if number.significand == 0 => signed(number.sign, 0),
        value if value.sign(a) => invalid(fpscr),
        Value::Infinity { .. } => INFINITY,
        Value::Finite(number) => {
            // An even exponent, and a root of at least 32 bits.
            let shift = 40 + number.exponent.rem_euclid(2);
            let square = number.significand << shift;
            let root = square.isqrt();
            let significand = root | (root * root != square) as u128;
            let exponent = (number.exponent - shift) / 2;
            round(Number { sign: false, significand, exponent }, fpscr)
        }
    }
}

/// `FPMulAdd`: `addend + a * b`, rounded once.
pub(super) fn multiply_add(addend: u32, a: u32, b: u32, fpscr: &mut u32) -> u32 {
    let third = unpack(addend, fpscr);
    let (first, second) = (unpack(a, fpscr), unpack(b, fpscr));
    let invalid_product =
        !is_nan(a) && !is_nan(b) && { matches!(multiply_values(first, second), Value::Nan) };
    // The invalid product counts even where the addend is a quiet NaN.
    if invalid_product && !is_signalling(addend) {
        return invalid(fpscr);
    }
    if let Some(nan) = process_nans(&[addend, a, b], fpscr) {
        return nan;
    }
    add_values(third, multiply_values(first, second), fpscr)
}

/// `FPCompare`: flags N, Z, C and V in bits 31 to 28.
pub(super) fn compare(a: u32, b: u32, signal_quiet: bool, fpscr: &mut u32) -> u32 {
    let values = (unpack(a, fpscr), unpack(b, fpscr));
    if is_nan(a) || is_nan(b) {
        if signal_quiet || is_signalling(a) || is_signalling(b) {
            *fpscr |= INVALID;
        }
        return UNORDERED;
    }
    let order = |value: Value, bits: u32| {
        // Monotonic in the value; both zeros, and flushed operands, are 0.
        let magnitude = match value {
            Value::Finite(Number { significand: 0, .. }) => 0,
            _ => (bits & !SIGN) as i32,
        };
        if value.sign(bits) { -magnitude } else { magnitude }
    };
    match order(values.0, a).cmp(&order(values.1, b)) {
        std::cmp::Ordering::Less => LESS,
        std::cmp::Ordering::Equal => EQUAL,
        std::cmp::Ordering::Greater => GREATER,
    }
}

/// `FPToFixed`: a number of `size` bits (16 or 32) with `fraction_bits`, limited to its range, in the
/// low bits.
pub(super) fn to_fixed(
    a: u32,
    size: u32,
    fraction_bits: u32,
    unsigned: bool,
    toward_zero: bool,
    fpscr: &mut u32,
) -> u32 {
    let rounding = if toward_zero { Rounding::Zero } else { Rounding::of(*fpscr) };
    let (min, max) = if unsigned {
        (0, (1i128 << size) - 1)
    } else {
        (-(1i128 << (size - 1)), (1i128 << (size - 1)) - 1)
    };
    let number = match unpack(a, fpscr) {
        Value::Nan => {
            *fpscr |= INVALID;
            return 0;
        }
        Value::Infinity { sign } => {
            *fpscr |= INVALID;
            return if sign { min as u32 } else { max as u32 };
        }
        Value::Finite(number) => number,
    };
    let exponent = number.exponent + fraction_bits as i32;
    let (magnitude, inexact) = match exponent {
        // Beyond every range; the shift is limited so that it does not overflow.
        0.. => (number.significand << exponent.min(64), false),
        -100..=-1 => {
            let unit = 1u128 << -exponent;
            let (kept, remainder) = (number.significand / unit, number.significand % unit);
            let up = rounding.increments(number.sign, kept & 1 != 0, remainder, unit);
            (kept + up as u128, remainder != 0)
        }
        _ => {
            let inexact = number.significand != 0;
            let up = inexact && rounding.increments(number.sign, false, 1, 4);
            (up as u128, inexact)
        }
    };
    let value = signed_significand(number.sign, magnitude);
    if value < min || value > max {
        *fpscr |= INVALID;
    } else if inexact {
        *fpscr |= INEXACT;
    }
    value.clamp(min, max) as u32
}

/// `FixedToFP` of a number with its sign extended.
pub(super) fn from_fixed(value: i64, fraction_bits: u32, nearest: bool, fpscr: &mut u32) -> u32 {
    let rounding = if nearest { Rounding::NearestEven } else { Rounding::of(*fpscr) };
    let number = Number {
        sign: value < 0,
        significand: value.unsigned_abs() as u128,
        exponent: -(fraction_bits as i32),
    };
    round_to(number, &SINGLE, rounding, fpscr)
}

/// `FPHalfToSingle`.
pub(super) fn half_to_single(half: u32, fpscr: &mut u32) -> u32 {
    let sign = half & 0x8000 != 0;
    let (exponent, fraction) = (half >> 10 & 0x1F, half & 0x3FF);
    let number = match exponent {
        0x1F if *fpscr & ALTERNATIVE_HALF == 0 => {
            if fraction == 0 {
                return signed(sign, INFINITY);
            }
            return process_nan(signed(sign, INFINITY | fraction << 13), fpscr);
        }
        0 => Number { sign, significand: fraction as u128, exponent: -24 },
        _ => Number {
            sign,
            significand: (fraction | 1 << 10) as u128,
            exponent: exponent as i32 - 25,
        },
    };
    // Every number of the format is a normal number of single precision.
    round(number, fpscr)
}

/// `FPSingleToHalf`: the low 16 bits.
pub(super) fn single_to_half(a: u32, fpscr: &mut u32) -> u32 {
    let value = unpack(a, fpscr);
    let sign_bit = a >> 16 & 0x8000;
    let alternative = *fpscr & ALTERNATIVE_HALF != 0;
    match value {
        Value::Nan => {
            if alternative || is_signalling(a) {
                *fpscr |= INVALID;
            }
            if alternative {
                sign_bit
            } else if *fpscr & DEFAULT_NAN != 0 {
                0x7E00
            } else {
                sign_bit | 0x7E00 | a >> 13 & 0x1FF
            }
        }
        Value::Infinity { .. } if alternative => {
            *fpscr |= INVALID;
            sign_bit | 0x7FFF
        }
        Value::Infinity { .. } => sign_bit | 0x7C00,
        Value::Finite(number) => round_to(number, &HALF, Rounding::of(*fpscr), fpscr),
    }
}
