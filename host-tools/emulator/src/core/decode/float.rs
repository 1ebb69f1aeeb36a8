//! Floating-point extension, FPv4-SP (DDI0403E A6).

use crate::core::decode::{Decoded, Invalid, bit, bits, general, require};
use crate::core::instruction::{
    FloatArithmetic, FloatRegister, FloatUnary, Instruction, MultipleMode, Register,
};

/// Any instruction of the coprocessor space.
pub(super) fn decode(h: u32, h2: u32) -> Decoded {
    if bits(h2, 9, 3) != 0b101 {
        return Err(Invalid::NoCoprocessor);
    }
    if bit(h, 12) {
        return Err(Invalid::Undefined);
    }
    match (bits(h, 8, 4), bit(h2, 4)) {
        (0b1100 | 0b1101, _) => transfer(h, h2),
        (0b1110, false) => data_processing(h, h2),
        (0b1110, true) => core_register(h, h2),
        _ => Err(Invalid::Undefined),
    }
}

/// Single-precision register: four bits at `low` and the lowest bit at `extra`.
fn register(word: u32, low: u32, extra_word: u32, extra: u32) -> FloatRegister {
    FloatRegister::new(bits(word, low, 4) << 1 | bits(extra_word, extra, 1))
}

/// First single-precision half of a double-precision register; there are 16 of them.
fn double_register(
    word: u32,
    low: u32,
    extra_word: u32,
    extra: u32,
) -> Result<FloatRegister, Invalid> {
    require(!bit(extra_word, extra))?;
    Ok(FloatRegister::new(bits(word, low, 4) << 1))
}

/// A6.4.
fn data_processing(h: u32, h2: u32) -> Decoded {
    // Arithmetic in double precision does not exist on this unit.
    if bit(h2, 8) {
        return Err(Invalid::Undefined);
    }
    let d = register(h2, 12, h, 6);
    let n = register(h, 0, h2, 7);
    let m = register(h2, 0, h2, 5);
    let second = bit(h2, 6);
    let operation = match (bit(h, 7), bits(h, 4, 2), second) {
        (false, 0b00, false) => FloatArithmetic::MultiplyAdd,
        (false, 0b00, true) => FloatArithmetic::MultiplySubtract,
        (false, 0b01, false) => FloatArithmetic::NegatedMultiplySubtract,
        (false, 0b01, true) => FloatArithmetic::NegatedMultiplyAdd,
        (false, 0b10, false) => FloatArithmetic::Multiply,
        (false, 0b10, true) => FloatArithmetic::NegatedMultiply,
        (false, 0b11, false) => FloatArithmetic::Add,
        (false, 0b11, true) => FloatArithmetic::Subtract,
        (true, 0b00, false) => FloatArithmetic::Divide,
        // Rounded once: VFMA and the like.
        (true, 0b01 | 0b10, _) => return Err(Invalid::Unpredictable),
        (true, 0b11, false) => {
            require(!bit(h2, 7) && !bit(h2, 5))?;
            let value = expand_constant(bits(h, 0, 4) << 4 | bits(h2, 0, 4));
            return Ok(Instruction::FloatMoveImmediate(d, value));
        }
        (true, 0b11, true) => return one_operand(h, h2, d, m),
        _ => return Err(Invalid::Undefined),
    };
    Ok(Instruction::FloatArithmetic(operation, d, n, m))
}

/// `VFPExpandImm` (A6.4.1): sign, inverted exponent bit replicated, two exponent and four fraction
/// bits.
const fn expand_constant(field: u32) -> u32 {
    let exponent = if bit(field, 6) { 0b0111_1100 } else { 0b1000_0000 } | bits(field, 4, 2);
    bits(field, 7, 1) << 31 | exponent << 23 | bits(field, 0, 4) << 19
}

fn one_operand(h: u32, h2: u32, d: FloatRegister, m: FloatRegister) -> Decoded {
    let top = bit(h2, 7);
    let operation = bits(h, 0, 4);
    let operation = match operation {
        0b0000 if top => FloatUnary::Absolute,
        0b0000 => FloatUnary::Move,
        0b0001 if top => FloatUnary::SquareRoot,
        0b0001 => FloatUnary::Negate,
        0b0100 => return Ok(Instruction::FloatCompare(d, m)),
        0b0101 => {
            require(bits(h2, 0, 4) == 0 && !bit(h2, 5))?;
            return Ok(Instruction::FloatCompareZero(d));
        }
        0b1000 => FloatUnary::FromInteger { unsigned: !top },
        0b1100 => FloatUnary::ToInteger { unsigned: true, toward_zero: top },
        0b1101 => FloatUnary::ToInteger { unsigned: false, toward_zero: top },
        // Half precision and fixed point.
        0b0010 | 0b0011 | 0b1010 | 0b1011 | 0b1110 | 0b1111 => return Err(Invalid::Unpredictable),
        _ => return Err(Invalid::Undefined),
    };
    Ok(Instruction::FloatUnary(operation, d, m))
}

/// A6.5 and the transfers of two core registers (A6.7).
fn transfer(h: u32, h2: u32) -> Decoded {
    let (pre, up, write_back, load) = (bit(h, 8), bit(h, 7), bit(h, 5), bit(h, 4));
    if !pre && !up && !write_back {
        return if bit(h, 6) { register_pair(h, h2) } else { Err(Invalid::Undefined) };
    }
    let n = Register::field(h, 0);
    let double = bit(h2, 8);
    let d = if double { double_register(h2, 12, h, 6)? } else { register(h2, 12, h, 6) };
    let words = bits(h2, 0, 8);
    let bytes = words as i16 * 4;
    if pre && !write_back {
        require(load || n != Register::PC)?;
        let offset = if up { bytes } else { -bytes };
        return Ok(if load {
            Instruction::FloatLoad(d, n, double, offset)
        } else {
            Instruction::FloatStore(d, n, double, offset)
        });
    }
    if pre == up {
        // Both set with write-back; both clear was handled above.
        return Err(Invalid::Undefined);
    }
    // An odd count of a double-precision transfer skips one word (FLDMX, FSTMX).
    let words = if double { words & !1 } else { words };
    require(words > 0 && words <= 32 && d.index() as u32 + words <= 32)?;
    require(n != Register::PC)?;
    let words = words as u8;
    let mode = MultipleMode { decrement: pre, write_back };
    Ok(if load {
        Instruction::FloatLoadMultiple(d, words, n, mode, bytes)
    } else {
        Instruction::FloatStoreMultiple(d, words, n, mode, bytes)
    })
}

fn register_pair(h: u32, h2: u32) -> Decoded {
    if bits(h2, 6, 2) != 0 || !bit(h2, 4) {
        return Err(Invalid::Undefined);
    }
    let to_core = bit(h, 4);
    let (t, t2) = (general(h2, 12)?, general(h, 0)?);
    require(!to_core || t != t2)?;
    let s = if bit(h2, 8) { double_register(h2, 0, h2, 5)? } else { register(h2, 0, h2, 5) };
    require(s.index() < 31)?;
    Ok(if to_core {
        Instruction::FloatPairToCore(t, t2, s)
    } else {
        Instruction::FloatPairFromCore(s, t, t2)
    })
}

/// A6.6.
fn core_register(h: u32, h2: u32) -> Decoded {
    let to_core = bit(h, 4);
    if bit(h2, 8) {
        // One half of a double-precision register.
        if bits(h, 6, 2) != 0 || bits(h2, 5, 2) != 0 {
            return Err(Invalid::Undefined);
        }
        let t = general(h2, 12)?;
        require(bits(h2, 0, 4) == 0)?;
        let first = double_register(h, 0, h2, 7)?;
        let s = FloatRegister::new(first.index() as u32 + bits(h, 5, 1));
        return Ok(move_register(to_core, t, s));
    }
    require(bits(h2, 0, 4) == 0 && bits(h2, 5, 2) == 0)?;
    match bits(h, 5, 3) {
        0b000 => Ok(move_register(to_core, general(h2, 12)?, register(h, 0, h2, 7))),
        0b111 => {
            // The FPSCR is the only system register of this unit that these instructions reach.
            require(bits(h, 0, 4) == 1 && !bit(h2, 7))?;
            // The modes, and the cumulative exceptions, are not modelled.
            let reads_flags = to_core && Register::field(h2, 12) == Register::PC;
            require(reads_flags)?;
            Ok(Instruction::ReadFloatFlags)
        }
        _ => Err(Invalid::Undefined),
    }
}

fn move_register(to_core: bool, t: Register, s: FloatRegister) -> Instruction {
    if to_core { Instruction::FloatToCore(t, s) } else { Instruction::FloatFromCore(s, t) }
}
