//! 32-bit data processing, branches and system instructions (DDI0403E A5.3).

use crate::core::arithmetic::{Condition, Shift, expand_immediate, sign_extend};
use crate::core::decode::{
    Decoded, Invalid, bit, bits, float, general, narrow, not_pc, require, transfer,
};
use crate::core::instruction::{
    DataOperation, DspMultiply, Extension, Instruction, LogicalFlags, LongMultiply, ParallelFormat,
    ParallelOperation, Register, SpecialRegister,
};

/// `h` and `h2` are the first and the second halfword.
pub(super) fn decode(h: u32, h2: u32) -> Decoded {
    let op2 = bits(h, 4, 7);
    match (bits(h, 11, 2), op2 >> 6) {
        (0b01, 0) if !bit(op2, 5) && !bit(op2, 2) => transfer::multiple(h, h2),
        (0b01, 0) if !bit(op2, 5) => transfer::dual_exclusive_table(h, h2),
        (0b01, 0) => shifted_register(h, h2),
        (0b10, _) if bit(h2, 15) => branches_and_control(h, h2),
        (0b10, _) if bit(h, 9) => plain_immediate(h, h2),
        (0b10, _) => modified_immediate(h, h2),
        (0b11, 0) if op2 >> 5 == 0b00 => transfer::single(h, h2),
        (0b11, 0) if op2 >> 4 == 0b010 => data_processing_register(h, h2),
        (0b11, 0) if op2 >> 3 == 0b0110 => multiply(h, h2),
        (0b11, 0) => long_multiply(h, h2),
        _ => float::decode(h, h2),
    }
}

/// A5.3.11.
fn shifted_register(h: u32, h2: u32) -> Decoded {
    require(!bit(h2, 15))?;
    let flags = bit(h, 4);
    let (shift, amount) =
        Shift::from_immediate(bits(h2, 4, 2), bits(h2, 12, 3) << 2 | bits(h2, 6, 2));
    let (n_field, d_field) = (Register::field(h, 0), Register::field(h2, 8));
    let (no_result, no_operand) = (d_field == Register::PC && flags, n_field == Register::PC);
    let operation = match bits(h, 5, 4) {
        0b0000 if no_result => DataOperation::Test,
        0b0000 => DataOperation::And,
        0b0001 => DataOperation::BitClear,
        0b0010 if no_operand => return move_shifted(h2, shift, amount, flags),
        0b0010 => DataOperation::Or,
        0b0011 if no_operand => DataOperation::MoveNot,
        0b0011 => DataOperation::OrNot,
        0b0100 if no_result => DataOperation::TestEquivalence,
        0b0100 => DataOperation::ExclusiveOr,
        0b0110 => return pack_halfwords(h, h2, shift, amount),
        0b1000 if no_result => DataOperation::CompareNegative,
        0b1000 => DataOperation::Add,
        0b1010 => DataOperation::AddCarry,
        0b1011 => DataOperation::SubtractCarry,
        0b1101 if no_result => DataOperation::Compare,
        0b1101 => DataOperation::Subtract,
        0b1110 => DataOperation::ReverseSubtract,
        _ => return Err(Invalid::Undefined),
    };
    let m = general(h2, 0)?;
    let stack = n_field == Register::SP;
    let (d, n) = match operation {
        DataOperation::Test | DataOperation::TestEquivalence => (d_field, general(h, 0)?),
        DataOperation::Compare | DataOperation::CompareNegative => (d_field, not_pc(h, 0)?),
        DataOperation::MoveNot => (general(h2, 8)?, n_field),
        DataOperation::Add | DataOperation::Subtract if stack => {
            // With the SP as destination only a short shift to the left is defined.
            require(d_field != Register::SP || shift == Shift::Left && amount <= 3)?;
            (not_pc(h2, 8)?, n_field)
        }
        _ => (general(h2, 8)?, general(h, 0)?),
    };
    Ok(data_processing(operation, d, n, m, shift, amount, flags))
}

/// The variant of the operation: its own where the register is not shifted.
fn data_processing(
    operation: DataOperation,
    d: Register,
    n: Register,
    m: Register,
    shift: Shift,
    amount: u8,
    flags: bool,
) -> Instruction {
    match (operation, shift, amount) {
        (DataOperation::Add, Shift::Left, 0) => Instruction::AddRegister(d, n, m, flags),
        (DataOperation::Subtract, Shift::Left, 0) => Instruction::SubtractRegister(d, n, m, flags),
        (DataOperation::Compare, Shift::Left, 0) => Instruction::CompareRegister(n, m),
        (DataOperation::Test, Shift::Left, 0) => Instruction::TestRegister(n, m),
        _ => Instruction::Shifted(operation, d, n, m, shift, amount, flags),
    }
}

/// MOV (register) and the shifts by a constant.
fn move_shifted(h2: u32, shift: Shift, amount: u8, flags: bool) -> Decoded {
    if shift == Shift::Left && amount == 0 && !flags {
        let (d, m) = (not_pc(h2, 8)?, not_pc(h2, 0)?);
        require(d != Register::SP || m != Register::SP)?;
        return Ok(Instruction::MoveRegister(d, m, flags));
    }
    let (d, m) = (general(h2, 8)?, general(h2, 0)?);
    Ok(match (shift, amount) {
        (Shift::Left, 0) => Instruction::MoveRegister(d, m, flags),
        (Shift::Left, _) => Instruction::ShiftLeft(d, m, amount, flags),
        (Shift::LogicalRight, _) => Instruction::ShiftLogicalRight(d, m, amount, flags),
        (Shift::ArithmeticRight, _) => Instruction::ShiftArithmeticRight(d, m, amount, flags),
        _ => {
            let operation = DataOperation::Move;
            Instruction::Shifted(operation, d, d, m, shift, amount, flags)
        }
    })
}

fn pack_halfwords(h: u32, h2: u32, shift: Shift, amount: u8) -> Decoded {
    if bit(h, 4) || bit(h2, 4) {
        return Err(Invalid::Undefined);
    }
    let (d, n, m) = (general(h2, 8)?, general(h, 0)?, general(h2, 0)?);
    Ok(Instruction::PackHalfwords(d, n, m, bit(h2, 5), shift, amount))
}

/// A5.3.1.
fn modified_immediate(h: u32, h2: u32) -> Decoded {
    let field = bits(h, 10, 1) << 11 | bits(h2, 12, 3) << 8 | bits(h2, 0, 8);
    let (value, carry) = expand_immediate(field).ok_or(Invalid::Unpredictable)?;
    let flags = bit(h, 4);
    let logical = if flags { LogicalFlags::nz_and(carry) } else { LogicalFlags::UNCHANGED };
    let no_operand = Register::field(h, 0) == Register::PC;
    let no_result = Register::field(h2, 8) == Register::PC && flags;
    let operands = || Ok((general(h2, 8)?, general(h, 0)?));
    // The SP may be added to and subtracted from; as a destination only of itself.
    let stack_operands = || {
        if Register::field(h, 0) == Register::SP {
            Ok((not_pc(h2, 8)?, Register::SP))
        } else {
            operands()
        }
    };
    Ok(match bits(h, 5, 4) {
        0b0000 if no_result => Instruction::TestImmediate(general(h, 0)?, value, logical),
        0b0000 => {
            let (d, n) = operands()?;
            Instruction::AndImmediate(d, n, value, logical)
        }
        0b0001 => {
            let (d, n) = operands()?;
            Instruction::AndImmediate(d, n, !value, logical)
        }
        0b0010 if no_operand => Instruction::MoveImmediate(general(h2, 8)?, value, logical),
        0b0010 => {
            let (d, n) = operands()?;
            Instruction::OrImmediate(d, n, value, logical)
        }
        0b0011 if no_operand => Instruction::MoveImmediate(general(h2, 8)?, !value, logical),
        0b0011 => {
            let (d, n) = operands()?;
            Instruction::OrImmediate(d, n, !value, logical)
        }
        0b0100 if no_result => {
            Instruction::TestEquivalenceImmediate(general(h, 0)?, value, logical)
        }
        0b0100 => {
            let (d, n) = operands()?;
            Instruction::ExclusiveOrImmediate(d, n, value, logical)
        }
        0b1000 if no_result => Instruction::CompareNegativeImmediate(not_pc(h, 0)?, value),
        0b1000 => {
            let (d, n) = stack_operands()?;
            Instruction::AddImmediate(d, n, value, flags)
        }
        0b1010 => {
            let (d, n) = operands()?;
            Instruction::AddCarryImmediate(d, n, value, flags)
        }
        0b1011 => {
            let (d, n) = operands()?;
            Instruction::AddCarryImmediate(d, n, !value, flags)
        }
        0b1101 if no_result => Instruction::CompareImmediate(not_pc(h, 0)?, value),
        0b1101 => {
            let (d, n) = stack_operands()?;
            Instruction::SubtractImmediate(d, n, value, flags)
        }
        0b1110 => {
            let (d, n) = operands()?;
            Instruction::ReverseSubtractImmediate(d, n, value, flags)
        }
        _ => return Err(Invalid::Undefined),
    })
}

/// A5.3.3.
fn plain_immediate(h: u32, h2: u32) -> Decoded {
    let n = Register::field(h, 0);
    let value = bits(h, 10, 1) << 11 | bits(h2, 12, 3) << 8 | bits(h2, 0, 8);
    let low = (bits(h2, 12, 3) << 2 | bits(h2, 6, 2)) as u8;
    let last = bits(h2, 0, 5) as u8;
    Ok(match bits(h, 4, 5) {
        0b00000 if n == Register::PC => Instruction::AddToPc(general(h2, 8)?, value as i32),
        0b00000 => {
            let d = wide_add_destination(h2, n)?;
            Instruction::AddImmediate(d, n, value, false)
        }
        0b01010 if n == Register::PC => Instruction::AddToPc(general(h2, 8)?, -(value as i32)),
        0b01010 => {
            let d = wide_add_destination(h2, n)?;
            Instruction::SubtractImmediate(d, n, value, false)
        }
        0b00100 => Instruction::MoveImmediate(
            general(h2, 8)?,
            bits(h, 0, 4) << 12 | value,
            LogicalFlags::UNCHANGED,
        ),
        0b01100 => Instruction::MoveTop(general(h2, 8)?, (bits(h, 0, 4) << 12 | value) as u16),
        0b10000 | 0b10010 | 0b10100 | 0b10110 | 0b11000 | 0b11010 | 0b11100
            if bit(h, 10) || bit(h2, 5) =>
        {
            return Err(Invalid::Unpredictable);
        }
        0b10000 | 0b10010 | 0b11000 | 0b11010 => saturate(h, h2, low)?,
        0b10100 | 0b11100 => {
            let (d, n) = (general(h2, 8)?, general(h, 0)?);
            require(low + last < 32)?;
            if bit(h, 7) {
                Instruction::UnsignedBitField(d, n, low, last + 1)
            } else {
                Instruction::SignedBitField(d, n, low, last + 1)
            }
        }
        0b10110 => {
            let d = general(h2, 8)?;
            require(last >= low)?;
            let width = last - low + 1;
            if n == Register::PC {
                let field = (u32::MAX >> (32 - width)) << low;
                let flags = LogicalFlags::UNCHANGED;
                Instruction::AndImmediate(d, d, !field, flags)
            } else {
                Instruction::BitFieldInsert(d, general(h, 0)?, low, width)
            }
        }
        _ => return Err(Invalid::Undefined),
    })
}

/// Destination of ADDW and SUBW: the SP only from the SP.
fn wide_add_destination(h2: u32, n: Register) -> Result<Register, Invalid> {
    if n == Register::SP { not_pc(h2, 8) } else { general(h2, 8) }
}

fn saturate(h: u32, h2: u32, amount: u8) -> Decoded {
    let (d, n) = (general(h2, 8)?, general(h, 0)?);
    let unsigned = bit(h, 7);
    // The signed instructions encode the number of bits less one.
    let bits_of = |count: u32| (bits(h2, 0, count) + !unsigned as u32) as u8;
    if bit(h, 5) && amount == 0 {
        require(!bit(h2, 4))?;
        return Err(Invalid::Unpredictable);
    }
    let shift = if bit(h, 5) { Shift::ArithmeticRight } else { Shift::Left };
    Ok(if unsigned {
        Instruction::SaturateUnsigned(d, n, bits_of(5), shift, amount)
    } else {
        Instruction::SaturateSigned(d, n, bits_of(5), shift, amount)
    })
}

/// A5.3.4.
fn branches_and_control(h: u32, h2: u32) -> Decoded {
    let low = bits(h2, 0, 11) << 1;
    let long_offset = || {
        let sign = bits(h, 10, 1);
        let (j1, j2) = (bits(h2, 13, 1), bits(h2, 11, 1));
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        let offset = sign << 24 | i1 << 23 | i2 << 22 | bits(h, 0, 10) << 12 | low;
        sign_extend(offset, 25) as i32
    };
    match (bit(h2, 14), bit(h2, 12)) {
        (false, true) => Ok(Instruction::Branch(long_offset())),
        (true, true) => Ok(Instruction::BranchLink(long_offset())),
        // BLX to the other instruction set, which this core has not.
        (true, false) => Err(Invalid::Undefined),
        (false, false) if bits(h, 7, 3) != 0b111 => {
            let offset = bits(h, 10, 1) << 20
                | bits(h2, 11, 1) << 19
                | bits(h2, 13, 1) << 18
                | bits(h, 0, 6) << 12
                | low;
            Ok(Instruction::BranchIf(Condition::new(bits(h, 6, 4)), sign_extend(offset, 21) as i32))
        }
        (false, false) if bit(h2, 13) => Err(Invalid::Undefined),
        (false, false) => control(h, h2),
    }
}

/// MSR, hints, barriers, MRS (A5.3.4 and A5.3.5).
fn control(h: u32, h2: u32) -> Decoded {
    require(!bit(h2, 13))?;
    match bits(h, 4, 7) {
        0b0111000 => {
            require(bits(h2, 8, 4) == 0b1000)?;
            Ok(Instruction::WriteSpecial(general(h, 0)?, special_register(h2)?))
        }
        0b0111110 => {
            require(bits(h, 0, 4) == 0b1111)?;
            Ok(Instruction::ReadSpecial(general(h2, 8)?, special_register(h2)?))
        }
        0b0111010 if bits(h2, 8, 3) == 0 => {
            require(bits(h, 0, 4) == 0b1111 && !bit(h2, 11))?;
            Ok(narrow::hint(bits(h2, 0, 8)))
        }
        0b0111011 => match bits(h2, 4, 4) {
            0b0010 | 0b0100..=0b0110 if bits(h, 0, 4) != 0b1111 || bits(h2, 8, 4) != 0b1111 => {
                Err(Invalid::Unpredictable)
            }
            0b0010 => Ok(Instruction::ClearExclusive),
            0b0100 | 0b0101 => Ok(Instruction::DataBarrier),
            0b0110 => Ok(Instruction::SynchronisationBarrier),
            _ => Err(Invalid::Undefined),
        },
        _ => Err(Invalid::Undefined),
    }
}

/// Special registers by their numbers (B5.1.1). Parts of the xPSR, the process stack pointer, FAULTMASK and CONTROL are not
/// modelled.
const fn special_register(h2: u32) -> Result<SpecialRegister, Invalid> {
    Ok(match bits(h2, 0, 8) {
        8 => SpecialRegister::Msp,
        16 => SpecialRegister::Primask,
        17 => SpecialRegister::Basepri,
        18 => SpecialRegister::BasepriMax,
        _ => return Err(Invalid::Unpredictable),
    })
}

/// A5.3.12.
fn data_processing_register(h: u32, h2: u32) -> Decoded {
    if bits(h2, 12, 4) != 0b1111 {
        return Err(Invalid::Undefined);
    }
    let d = general(h2, 8);
    let m = general(h2, 0);
    if !bit(h, 7) {
        if !bit(h2, 7) {
            if bits(h2, 4, 3) != 0 {
                return Err(Invalid::Undefined);
            }
            let shift = match bits(h, 5, 2) {
                0b00 => Shift::Left,
                0b01 => Shift::LogicalRight,
                0b10 => Shift::ArithmeticRight,
                _ => Shift::RotateRight,
            };
            let flags = bit(h, 4);
            return Ok(Instruction::ShiftByRegister(shift, d?, general(h, 0)?, m?, flags));
        }
        return extend(h, h2);
    }
    match bits(h2, 6, 2) {
        0b00 | 0b01 => parallel(h, h2),
        0b10 if !bit(h, 6) => miscellaneous(h, h2),
        _ => Err(Invalid::Undefined),
    }
}

fn extend(h: u32, h2: u32) -> Decoded {
    let extension = match bits(h, 4, 3) {
        0b000 => Extension::SignedHalf,
        0b001 => Extension::UnsignedHalf,
        0b010 => Extension::SignedBytePair,
        0b011 => Extension::UnsignedBytePair,
        0b100 => Extension::SignedByte,
        0b101 => Extension::UnsignedByte,
        _ => return Err(Invalid::Undefined),
    };
    require(!bit(h2, 6))?;
    let (d, m) = (general(h2, 8)?, general(h2, 0)?);
    let n = Register::field(h, 0);
    require(n != Register::SP)?;
    let rotation = bits(h2, 4, 2) as u8 * 8;
    Ok(Instruction::ExtendAdd(extension, d, n, m, rotation))
}

/// A5.3.13 and A5.3.14; exchanging and halving ones are not modelled.
fn parallel(h: u32, h2: u32) -> Decoded {
    let (subtract, width) = match bits(h, 4, 3) {
        0b000 => (false, 8),
        0b001 => (false, 16),
        0b100 => (true, 8),
        0b101 => (true, 16),
        0b010 | 0b110 => return Err(Invalid::Unpredictable),
        _ => return Err(Invalid::Undefined),
    };
    let format = match bits(h2, 4, 3) {
        0b000 => ParallelFormat::Signed,
        0b001 => ParallelFormat::SignedSaturating,
        0b100 => ParallelFormat::Unsigned,
        0b101 => ParallelFormat::UnsignedSaturating,
        0b010 | 0b110 => return Err(Invalid::Unpredictable),
        _ => return Err(Invalid::Undefined),
    };
    let operation = ParallelOperation { format, width, subtract };
    let (d, n, m) = (general(h2, 8)?, general(h, 0)?, general(h2, 0)?);
    Ok(Instruction::Parallel(operation, d, n, m))
}

/// A5.3.15.
fn miscellaneous(h: u32, h2: u32) -> Decoded {
    let (group, operation) = (bits(h, 4, 2), bits(h2, 4, 2));
    if group >= 0b10 && operation != 0 {
        return Err(Invalid::Undefined);
    }
    let (d, n, m) = (general(h2, 8)?, general(h, 0)?, general(h2, 0)?);
    // The operand of these is encoded twice.
    require(matches!(group, 0b00 | 0b10) || n == m)?;
    Ok(match (group, operation) {
        // QDADD and QDSUB are not modelled.
        (0b00, 0b01 | 0b11) => return Err(Invalid::Unpredictable),
        (0b00, _) => Instruction::SaturatingAdd(d, n, m, bit(operation, 1)),
        (0b01, 0b00) => Instruction::ReverseBytes(d, m),
        (0b01, 0b01) => Instruction::ReverseHalfwords(d, m),
        (0b01, 0b10) => Instruction::ReverseBits(d, m),
        (0b01, _) => Instruction::ReverseSignedHalf(d, m),
        (0b10, _) => return Err(Invalid::Unpredictable),
        (_, _) => Instruction::CountLeadingZeros(d, m),
    })
}

/// A5.3.16.
fn multiply(h: u32, h2: u32) -> Decoded {
    let (n_top, m_top) = (bit(h2, 5), bit(h2, 4));
    let operation = match (bits(h, 4, 3), bits(h2, 4, 4)) {
        (0b000, 0b0000 | 0b0001) => None,
        (0b001, 0b0000..=0b0011) => Some(DspMultiply::Half { n_top, m_top }),
        (0b010, 0b0000 | 0b0001) => Some(DspMultiply::DualAdd { exchange: m_top }),
        (0b011, 0b0000 | 0b0001) => Some(DspMultiply::WordByHalf { m_top }),
        // SMLSD.
        (0b100, 0b0000 | 0b0001) => return Err(Invalid::Unpredictable),
        (0b101, 0b0000 | 0b0001) => Some(DspMultiply::MostSignificant { round: m_top }),
        (0b110, 0b0000 | 0b0001) => Some(DspMultiply::MostSignificantSubtract { round: m_top }),
        (0b111, 0b0000) => return Err(Invalid::Unpredictable),
        _ => return Err(Invalid::Undefined),
    };
    let (d, n, m) = (general(h2, 8)?, general(h, 0)?, general(h2, 0)?);
    let a = Register::field(h2, 12);
    require(a != Register::SP)?;
    Ok(match operation {
        // Without accumulation these would be other instructions, which do not exist.
        Some(DspMultiply::MostSignificantSubtract { .. }) if a == Register::PC => {
            return Err(Invalid::Unpredictable);
        }
        Some(operation) => Instruction::Dsp(operation, d, n, m, a),
        None if m_top => {
            require(a != Register::PC)?;
            Instruction::MultiplySubtract(d, n, m, a)
        }
        None if a == Register::PC => Instruction::Multiply(d, n, m, false),
        None => Instruction::MultiplyAccumulate(d, n, m, a),
    })
}

/// A5.3.17.
fn long_multiply(h: u32, h2: u32) -> Decoded {
    let operation = match (bits(h, 4, 3), bits(h2, 4, 4)) {
        (0b000, 0b0000) => LongMultiply::Signed,
        (0b001 | 0b011, 0b1111) => {
            require(bits(h2, 12, 4) == 0b1111)?;
            let (d, n, m) = (general(h2, 8)?, general(h, 0)?, general(h2, 0)?);
            return Ok(if bit(h, 5) {
                Instruction::DivideUnsigned(d, n, m)
            } else {
                Instruction::DivideSigned(d, n, m)
            });
        }
        (0b010, 0b0000) => LongMultiply::Unsigned,
        (0b100, 0b0000) => LongMultiply::SignedAccumulate,
        // SMLALxy, SMLALD and SMLSLD.
        (0b100, 0b1000..=0b1101) | (0b101, 0b1100 | 0b1101) => return Err(Invalid::Unpredictable),
        (0b110, 0b0000) => LongMultiply::UnsignedAccumulate,
        (0b110, 0b0110) => LongMultiply::UnsignedAccumulateTwo,
        _ => return Err(Invalid::Undefined),
    };
    let (low, high) = (general(h2, 12)?, general(h2, 8)?);
    let (n, m) = (general(h, 0)?, general(h2, 0)?);
    require(low != high)?;
    Ok(Instruction::LongMultiply(operation, low, high, n, m))
}
