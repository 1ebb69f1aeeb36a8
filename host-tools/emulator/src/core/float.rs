//! Floating-point unit: single precision, FPv4-SP (DDI0403E A2.5 and A7.7), by the computer's arithmetic: rounding to nearest,
//! denormal numbers, NaN operands as the architecture propagates them. No instruction here changes these modes: VMSR, VMRS to a
//! register, half precision, fixed point and fused multiplication stop the core as unpredictable ones do, and the FPSCR has the
//! flags of comparisons only.

use crate::core::Width;
use crate::core::arithmetic::NZCV;
use crate::core::bus::Bus;
use crate::core::instruction::{
    FloatArithmetic, FloatRegister, FloatUnary, MultipleMode, Register,
};
use crate::core::state::{PC, State, Trap};

/// Sign bit of a single-precision number.
const SIGN: u32 = 1 << 31;
const QUIET: u32 = 1 << 22;
/// NaN of an invalid operation.
const NAN: u32 = 0x7FC0_0000;

const fn is_nan(bits: u32) -> bool {
    float(bits).is_nan()
}

const fn is_signalling(bits: u32) -> bool {
    is_nan(bits) && bits & QUIET == 0
}

#[inline(always)]
const fn float(bits: u32) -> f32 {
    f32::from_bits(bits)
}

/// A result, or the NaN that follows from the operands (`FPProcessNaNs`): the first signalling one, else the first quiet one.
#[inline(always)]
fn result<const N: usize>(value: f32, operands: [u32; N]) -> u32 {
    if value.is_nan() { propagated(operands) } else { value.to_bits() }
}

#[cold]
fn propagated<const N: usize>(operands: [u32; N]) -> u32 {
    let find = |is_kind: fn(u32) -> bool| operands.into_iter().find(|bits| is_kind(*bits));
    find(is_signalling).or_else(|| find(is_nan)).map_or(NAN, |bits| bits | QUIET)
}

fn add(a: u32, b: u32) -> u32 {
    result(float(a) + float(b), [a, b])
}

fn multiply(a: u32, b: u32) -> u32 {
    result(float(a) * float(b), [a, b])
}

/// The new value of the destination, which had the value `d`.
#[inline]
pub(super) fn arithmetic(operation: FloatArithmetic, d: u32, n: u32, m: u32) -> u32 {
    match operation {
        FloatArithmetic::Add => add(n, m),
        FloatArithmetic::Subtract => result(float(n) - float(m), [n, m]),
        FloatArithmetic::Multiply => multiply(n, m),
        FloatArithmetic::NegatedMultiply => multiply(n, m) ^ SIGN,
        FloatArithmetic::Divide => result(float(n) / float(m), [n, m]),
        FloatArithmetic::MultiplyAdd => add(d, multiply(n, m)),
        FloatArithmetic::MultiplySubtract => add(d, multiply(n, m) ^ SIGN),
        FloatArithmetic::NegatedMultiplyAdd => add(d ^ SIGN, multiply(n, m) ^ SIGN),
        FloatArithmetic::NegatedMultiplySubtract => add(d ^ SIGN, multiply(n, m)),
    }
}

/// Conversions to an integer saturate; NaN becomes zero.
#[inline]
pub(super) fn unary(operation: FloatUnary, m: u32) -> u32 {
    match operation {
        FloatUnary::Move => m,
        FloatUnary::Absolute => m & !SIGN,
        FloatUnary::Negate => m ^ SIGN,
        FloatUnary::SquareRoot => result(float(m).sqrt(), [m]),
        FloatUnary::FromInteger { unsigned: true } => (m as f32).to_bits(),
        FloatUnary::FromInteger { unsigned: false } => (m as i32 as f32).to_bits(),
        FloatUnary::ToInteger { unsigned, toward_zero } => {
            let value = if toward_zero { float(m) } else { float(m).round_ties_even() };
            if unsigned { value as u32 } else { value as i32 as u32 }
        }
    }
}

impl State {
    /// Access to the floating-point unit, before each of its instructions (`ExecuteFPCheck`, B1.5.7).
    #[inline(always)]
    pub(super) fn check_float<B: Bus>(&mut self, bus: &mut B) -> Result<(), Trap> {
        if self.float_ready { Ok(()) } else { self.prepare_float(bus) }
    }

    #[inline]
    pub(super) fn float_compare(&mut self, a: u32, b: u32) {
        let (a, b) = (float(a), float(b));
        // Z and C where equal, N where less, C where greater, C and V where unordered.
        let flags: u32 = match a.partial_cmp(&b) {
            Some(std::cmp::Ordering::Less) => 0b1000,
            Some(std::cmp::Ordering::Equal) => 0b0110,
            Some(std::cmp::Ordering::Greater) => 0b0010,
            None => 0b0011,
        };
        self.fpscr = self.fpscr & !NZCV | flags << 28;
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
