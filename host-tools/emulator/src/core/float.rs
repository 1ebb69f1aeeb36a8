//! Floating-point unit: single precision, FPv4-SP (DDI0403E A2.5 and A7.7).
//!
//! The computer's own arithmetic is used where it provably gives the same result and no flag changes:
//! rounding to nearest without flush to zero, the inexact flag already set, and a result that is a
//! normal number. Everything else is computed by [`ieee754`](super::ieee754), which is exact in every
//! mode. All modes of the FPSCR are modelled.

use crate::core::Width;
use crate::core::arithmetic::NZCV;
use crate::core::bus::Bus;
use crate::core::ieee754::{self, FLUSH_TO_ZERO, INEXACT, ROUNDING_MODE};
use crate::core::instruction::{FixedFormat, FloatRegister, MultipleMode, MultiplyAdd, Register};
use crate::core::state::{PC, State, Trap};

/// Sign bit of a single-precision number.
pub(super) const SIGN: u32 = 1 << 31;
const INFINITY: u32 = 0x7F80_0000;
const MIN_NORMAL: u32 = 0x0080_0000;

/// Whether a result raises nothing but the inexact flag: a normal number above the smallest, which may
/// have been a denormal before rounding.
#[inline(always)]
const fn is_plain(bits: u32) -> bool {
    (bits & !SIGN).wrapping_sub(MIN_NORMAL + 1) < INFINITY - MIN_NORMAL - 1
}

#[inline(always)]
const fn is_zero(bits: u32) -> bool {
    bits & !SIGN == 0
}

#[inline(always)]
const fn is_nan(bits: u32) -> bool {
    bits & !SIGN > INFINITY
}

#[inline(always)]
const fn float(bits: u32) -> f32 {
    f32::from_bits(bits)
}

impl State {
    /// Access to the floating-point unit, before each of its instructions (`ExecuteFPCheck`, B1.5.7).
    #[inline(always)]
    pub(super) fn check_float<B: Bus>(&mut self, bus: &mut B) -> Result<(), Trap> {
        if self.float_ready { Ok(()) } else { self.prepare_float(bus) }
    }

    /// Whether the modes and flags leave nothing to do but the rounding to nearest.
    #[inline(always)]
    fn is_simple(&self) -> bool {
        self.fpscr & (FLUSH_TO_ZERO | ROUNDING_MODE | INEXACT) == INEXACT
    }

    #[inline(always)]
    pub(super) fn float_add(&mut self, a: u32, b: u32) -> u32 {
        if self.is_simple() {
            let sum = (float(a) + float(b)).to_bits();
            // A sum that is zero is exact.
            if is_plain(sum) || is_zero(sum) {
                return sum;
            }
        }
        ieee754::add(a, b, &mut self.fpscr)
    }

    #[inline(always)]
    pub(super) fn float_subtract(&mut self, a: u32, b: u32) -> u32 {
        if self.is_simple() {
            let difference = (float(a) - float(b)).to_bits();
            if is_plain(difference) || is_zero(difference) {
                return difference;
            }
        }
        ieee754::subtract(a, b, &mut self.fpscr)
    }

    #[inline(always)]
    pub(super) fn float_multiply(&mut self, a: u32, b: u32) -> u32 {
        if self.is_simple() {
            let product = (float(a) * float(b)).to_bits();
            if is_plain(product) || is_zero(product) && (is_zero(a) || is_zero(b)) {
                return product;
            }
        }
        ieee754::multiply(a, b, &mut self.fpscr)
    }

    #[inline(always)]
    pub(super) fn float_divide(&mut self, a: u32, b: u32) -> u32 {
        if self.is_simple() {
            let quotient = (float(a) / float(b)).to_bits();
            if is_plain(quotient) {
                return quotient;
            }
        }
        ieee754::divide(a, b, &mut self.fpscr)
    }

    #[inline(always)]
    pub(super) fn float_square_root(&mut self, a: u32) -> u32 {
        if self.is_simple() {
            let root = float(a).sqrt().to_bits();
            if is_plain(root) {
                return root;
            }
        }
        ieee754::square_root(a, &mut self.fpscr)
    }

    /// `addend + a * b`, rounded once.
    #[inline]
    fn fused(&mut self, addend: u32, a: u32, b: u32) -> u32 {
        if self.is_simple() {
            let sum = float(a).mul_add(float(b), float(addend)).to_bits();
            if is_plain(sum) {
                return sum;
            }
        }
        ieee754::multiply_add(addend, a, b, &mut self.fpscr)
    }

    #[inline]
    pub(super) fn float_multiply_add(
        &mut self,
        operation: MultiplyAdd,
        d: FloatRegister,
        n: FloatRegister,
        m: FloatRegister,
    ) {
        let (addend, a, b) = (self.s[d.index()], self.s[n.index()], self.s[m.index()]);
        self.s[d.index()] = match operation {
            MultiplyAdd::NegatedAdd => {
                let product = self.float_multiply(a, b);
                self.float_add(addend ^ SIGN, product ^ SIGN)
            }
            MultiplyAdd::NegatedSubtract => {
                let product = self.float_multiply(a, b);
                self.float_add(addend ^ SIGN, product)
            }
            MultiplyAdd::FusedAdd => self.fused(addend, a, b),
            MultiplyAdd::FusedSubtract => self.fused(addend, a ^ SIGN, b),
            MultiplyAdd::FusedNegatedAdd => self.fused(addend ^ SIGN, a ^ SIGN, b),
            MultiplyAdd::FusedNegatedSubtract => self.fused(addend ^ SIGN, a, b),
        };
    }

    #[inline]
    pub(super) fn float_compare(&mut self, a: u32, b: u32, signal_quiet: bool) {
        let flags = if self.fpscr & FLUSH_TO_ZERO == 0 && !is_nan(a) && !is_nan(b) {
            let (a, b) = (float(a), float(b));
            // Z and C where equal, N where less, C where greater.
            let (less, greater) = ((a < b) as u32, (a > b) as u32);
            let equal = (a == b) as u32;
            less << 31 | equal << 30 | (equal | greater) << 29
        } else {
            ieee754::compare(a, b, signal_quiet, &mut self.fpscr)
        };
        self.fpscr = self.fpscr & !NZCV | flags;
    }

    #[inline]
    pub(super) fn float_from_integer(&mut self, value: u32, unsigned: bool) -> u32 {
        if self.is_simple() {
            let value = if unsigned { value as f32 } else { value as i32 as f32 };
            return value.to_bits();
        }
        let value = if unsigned { value as i64 } else { value as i32 as i64 };
        ieee754::from_fixed(value, 0, false, &mut self.fpscr)
    }

    #[inline]
    pub(super) fn float_to_integer(&mut self, a: u32, unsigned: bool, toward_zero: bool) -> u32 {
        // Below 2^31 in magnitude nothing saturates, apart from a negative number without sign.
        const LIMIT: u32 = 0x4F00_0000;
        if toward_zero && self.is_simple() && a & !SIGN < LIMIT && !(unsigned && a & SIGN != 0) {
            return float(a) as i32 as u32;
        }
        ieee754::to_fixed(a, 32, 0, unsigned, toward_zero, &mut self.fpscr)
    }

    pub(super) fn float_from_fixed(&mut self, value: u32, format: FixedFormat) -> u32 {
        let value = match (format.half, format.unsigned) {
            (true, true) => value as u16 as i64,
            (true, false) => value as i16 as i64,
            (false, true) => value as i64,
            (false, false) => value as i32 as i64,
        };
        ieee754::from_fixed(value, format.fraction_bits as u32, true, &mut self.fpscr)
    }

    pub(super) fn float_to_fixed(&mut self, a: u32, format: FixedFormat) -> u32 {
        let (size, fraction_bits) =
            (if format.half { 16 } else { 32 }, format.fraction_bits as u32);
        ieee754::to_fixed(a, size, fraction_bits, format.unsigned, true, &mut self.fpscr)
    }

    /// VCVTB, VCVTT: single from a half of the operand.
    pub(super) fn float_from_half(&mut self, operand: u32, top: bool) -> u32 {
        let half = if top { operand >> 16 } else { operand & 0xFFFF };
        ieee754::half_to_single(half, &mut self.fpscr)
    }

    /// VCVTB, VCVTT: a half of the destination from single; the other half is unchanged.
    pub(super) fn float_to_half(&mut self, destination: u32, operand: u32, top: bool) -> u32 {
        let half = ieee754::single_to_half(operand, &mut self.fpscr);
        if top { destination & 0xFFFF | half << 16 } else { destination & 0xFFFF_0000 | half }
    }

    /// Address of VLDR and VSTR; relative to the PC it is aligned to a word.
    #[inline(always)]
    pub(super) fn float_address(&self, n: Register, offset: i16) -> u32 {
        let base = if n == Register::PC { self.r[PC] & !3 } else { self.read(n) };
        base.wrapping_add_signed(offset as i32)
    }

    #[inline(always)]
    pub(super) fn float_load<B: Bus>(
        &mut self,
        bus: &mut B,
        d: FloatRegister,
        double: bool,
        address: u32,
    ) -> Result<(), Trap> {
        self.require_alignment(address, Width::Word)?;
        let first = self.load(bus, address, Width::Word)?;
        if double {
            let second = self.load(bus, address.wrapping_add(4), Width::Word)?;
            self.s[(d.index() + 1) & 31] = second;
        }
        self.s[d.index()] = first;
        Ok(())
    }

    #[inline(always)]
    pub(super) fn float_store<B: Bus>(
        &mut self,
        bus: &mut B,
        d: FloatRegister,
        double: bool,
        address: u32,
    ) -> Result<(), Trap> {
        self.require_alignment(address, Width::Word)?;
        self.store(bus, address, Width::Word, self.s[d.index()])?;
        if double {
            let second = self.s[(d.index() + 1) & 31];
            self.store(bus, address.wrapping_add(4), Width::Word, second)?;
        }
        Ok(())
    }

    /// Lowest address of the block and the base register after it.
    fn float_block(&self, n: Register, mode: MultipleMode, bytes: i16) -> (u32, u32) {
        let base = self.read(n);
        if mode.decrement {
            let start = base.wrapping_sub(bytes as u32);
            (start, start)
        } else {
            (base, base.wrapping_add(bytes as u32))
        }
    }

    pub(super) fn float_load_multiple<B: Bus>(
        &mut self,
        bus: &mut B,
        d: FloatRegister,
        words: u8,
        n: Register,
        mode: MultipleMode,
        bytes: i16,
    ) -> Result<(), Trap> {
        let (start, base) = self.float_block(n, mode, bytes);
        self.require_alignment(start, Width::Word)?;
        for word in 0..words as usize {
            let address = start.wrapping_add(4 * word as u32);
            self.s[(d.index() + word) & 31] = self.load(bus, address, Width::Word)?;
        }
        if mode.write_back {
            self.write_any(n, base);
        }
        Ok(())
    }

    pub(super) fn float_store_multiple<B: Bus>(
        &mut self,
        bus: &mut B,
        d: FloatRegister,
        words: u8,
        n: Register,
        mode: MultipleMode,
        bytes: i16,
    ) -> Result<(), Trap> {
        let (start, base) = self.float_block(n, mode, bytes);
        self.require_alignment(start, Width::Word)?;
        for word in 0..words as usize {
            let address = start.wrapping_add(4 * word as u32);
            self.store(bus, address, Width::Word, self.s[(d.index() + word) & 31])?;
        }
        if mode.write_back {
            self.write_any(n, base);
        }
        Ok(())
    }
}
