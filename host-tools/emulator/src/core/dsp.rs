//! DSP extension and the other multiplications with 64-bit intermediate results (DDI0403E A4.4.3 to
//! A4.4.7).

use crate::core::arithmetic::{SATURATED, saturate_signed, saturate_unsigned};
use crate::core::instruction::{
    DspMultiply, Extension, LongMultiply, ParallelFormat, ParallelOperation, Register,
};
use crate::core::state::State;

/// Low or high halfword with its sign.
#[inline(always)]
const fn half(value: u32, top: bool) -> i64 {
    (if top { value >> 16 } else { value }) as i16 as i64
}

/// A word with its sign.
#[inline(always)]
const fn word(value: u32) -> i64 {
    value as i32 as i64
}

/// The lane of `width` bits from bit `low` up.
#[inline(always)]
const fn lane(value: u32, low: u32, width: u32, unsigned: bool) -> i32 {
    let raw = value << (32 - width - low);
    if unsigned { (raw >> (32 - width)) as i32 } else { raw as i32 >> (32 - width) }
}

impl State {
    fn set_saturated(&mut self, saturated: bool) {
        if saturated {
            self.apsr |= SATURATED;
        }
    }

    /// Multiplications with a 32-bit result. An overflow of the final addition sets Q and wraps.
    #[inline]
    pub(super) fn dsp_multiply(
        &mut self,
        operation: DspMultiply,
        d: Register,
        n: u32,
        m: u32,
        a: Register,
    ) {
        let accumulator = if a == Register::PC { 0 } else { self.read(a) };
        let sum = match operation {
            DspMultiply::Half { n_top, m_top } => {
                half(n, n_top) * half(m, m_top) + word(accumulator)
            }
            DspMultiply::WordByHalf { m_top } => {
                ((word(n) * half(m, m_top)) >> 16) + word(accumulator)
            }
            DspMultiply::DualAdd { exchange } => {
                let m = if exchange { m.rotate_right(16) } else { m };
                half(n, false) * half(m, false) + half(n, true) * half(m, true) + word(accumulator)
            }
            DspMultiply::MostSignificant { round } => {
                let product = word(n) * word(m);
                return self.most_significant(d, accumulator, product, round);
            }
            DspMultiply::MostSignificantSubtract { round } => {
                let product = word(n) * word(m);
                return self.most_significant(d, accumulator, product.wrapping_neg(), round);
            }
        };
        self.write(d, sum as u32);
        self.set_saturated(sum != sum as i32 as i64);
    }

    /// High word of the accumulator, extended by a word of zeros, plus the product.
    #[inline]
    fn most_significant(&mut self, d: Register, accumulator: u32, product: i64, round: bool) {
        let rounding = if round { 0x8000_0000 } else { 0 };
        let sum = ((accumulator as i64) << 32).wrapping_add(product).wrapping_add(rounding);
        self.write(d, (sum >> 32) as u32);
    }

    /// Multiplications with a 64-bit result, which wraps.
    #[inline]
    pub(super) fn long_multiply(
        &mut self,
        operation: LongMultiply,
        low: Register,
        high: Register,
        n: u32,
        m: u32,
    ) {
        let (first, second) = (self.read(low) as u64, self.read(high) as u64);
        let accumulator = (second << 32 | first) as i64;
        let unsigned = n as u64 * m as u64;
        let signed = word(n) * word(m);
        let result = match operation {
            LongMultiply::Signed => signed as u64,
            LongMultiply::Unsigned => unsigned,
            LongMultiply::SignedAccumulate => accumulator.wrapping_add(signed) as u64,
            LongMultiply::UnsignedAccumulate => (accumulator as u64).wrapping_add(unsigned),
            LongMultiply::UnsignedAccumulateTwo => unsigned + first + second,
        };
        self.write(low, result as u32);
        self.write(high, (result >> 32) as u32);
    }

    /// Parallel additions and subtractions of bytes or halfwords.
    #[inline]
    pub(super) fn parallel(&mut self, operation: ParallelOperation, d: Register, n: u32, m: u32) {
        use ParallelFormat as F;
        let ParallelOperation { format, width, subtract } = operation;
        let width = u32::from(width);
        let unsigned = matches!(format, F::Unsigned | F::UnsignedSaturating);
        let mut result = 0;
        for low in (0..32).step_by(width as usize) {
            let (first, second) = (lane(n, low, width, unsigned), lane(m, low, width, unsigned));
            let value = if subtract { first - second } else { first + second };
            let limited = match format {
                F::Signed | F::Unsigned => value,
                F::SignedSaturating => saturate_signed(value as i64, width).0,
                F::UnsignedSaturating => saturate_unsigned(value as i64, width).0 as i32,
            };
            result |= (limited as u32 & ((1 << width) - 1)) << low;
        }
        self.write(d, result);
    }

    /// QADD and QSUB.
    #[inline]
    pub(super) fn saturating_add(&mut self, d: Register, n: u32, m: u32, subtract: bool) {
        let sum = if subtract { word(m) - word(n) } else { word(m) + word(n) };
        let (result, saturated) = saturate_signed(sum, 32);
        self.write(d, result as u32);
        self.set_saturated(saturated);
    }

    /// PKHBT and, with the high halfword of the first operand, PKHTB.
    #[inline]
    pub(super) fn pack_halfwords(&mut self, d: Register, n: u32, operand: u32, top: bool) {
        let low = if top { operand } else { n };
        let high = if top { n } else { operand };
        self.write(d, high & 0xFFFF_0000 | low & 0xFFFF);
    }

    #[inline]
    pub(super) fn saturate_signed(&mut self, d: Register, operand: u32, bits: u32) {
        let (result, saturated) = saturate_signed(word(operand), bits);
        self.write(d, result as u32);
        self.set_saturated(saturated);
    }

    #[inline]
    pub(super) fn saturate_unsigned(&mut self, d: Register, operand: u32, bits: u32) {
        let (result, saturated) = saturate_unsigned(word(operand), bits);
        self.write(d, result);
        self.set_saturated(saturated);
    }

    /// SXTAB and the like; without addition `n` is the PC. `operand` is rotated already.
    #[inline]
    pub(super) fn extend_add(
        &mut self,
        extension: Extension,
        d: Register,
        n: Register,
        operand: u32,
    ) {
        let first = if n == Register::PC { 0 } else { self.read(n) };
        let pair = |low: u32, high: u32| {
            let low = first.wrapping_add(low) & 0xFFFF;
            (first >> 16).wrapping_add(high) << 16 | low
        };
        let result = match extension {
            Extension::SignedByte => first.wrapping_add(operand as i8 as u32),
            Extension::SignedHalf => first.wrapping_add(operand as i16 as u32),
            Extension::UnsignedByte => first.wrapping_add(operand & 0xFF),
            Extension::UnsignedHalf => first.wrapping_add(operand & 0xFFFF),
            Extension::SignedBytePair => pair(operand as i8 as u32, (operand >> 16) as i8 as u32),
            Extension::UnsignedBytePair => pair(operand & 0xFF, operand >> 16 & 0xFF),
        };
        self.write(d, result);
    }
}
