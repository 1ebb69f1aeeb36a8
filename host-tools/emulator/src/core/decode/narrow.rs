//! 16-bit instructions (DDI0403E A5.2).

use crate::core::Width;
use crate::core::arithmetic::{Condition, Shift, sign_extend};
use crate::core::decode::{Decoded, Invalid, bit, bits, require};
use crate::core::instruction::{
    DataOperation, Extension, Hint, Instruction, LoadKind, LogicalFlags, MultipleMode, Register,
};

pub(super) fn decode(h: u32, inside_it_block: bool) -> Decoded {
    let flags = !inside_it_block;
    match bits(h, 11, 5) {
        0b00000..=0b00010 => Ok(shift_immediate(h, flags)),
        0b00011 => Ok(add_subtract(h, flags)),
        0b00100..=0b00111 => Ok(immediate(h, flags)),
        0b01000 if !bit(h, 10) => Ok(data_processing(h, flags)),
        0b01000 => special(h),
        0b01001 => {
            let (t, offset) = (Register::low_field(h, 8), bits(h, 0, 8) as i32 * 4);
            Ok(Instruction::LoadLiteral(LoadKind::Word, t, offset))
        }
        0b01010 | 0b01011 => Ok(load_store_indexed(h)),
        0b01100..=0b10011 => Ok(load_store(h)),
        0b10100 => {
            let (d, offset) = (Register::low_field(h, 8), bits(h, 0, 8) as i32 * 4);
            Ok(Instruction::AddToPc(d, offset))
        }
        0b10101 => Ok(Instruction::AddImmediate(
            Register::low_field(h, 8),
            Register::SP,
            bits(h, 0, 8) * 4,
            false,
        )),
        0b10110 | 0b10111 => miscellaneous(h, inside_it_block),
        0b11000 | 0b11001 => multiple(h),
        0b11010 | 0b11011 => conditional_branch(h, inside_it_block),
        0b11100 => {
            let offset = sign_extend(bits(h, 0, 11) << 1, 12) as i32;
            Ok(Instruction::Branch(offset))
        }
        _ => Err(Invalid::Undefined),
    }
}

fn shift_immediate(h: u32, flags: bool) -> Instruction {
    let (d, m) = (Register::low_field(h, 0), Register::low_field(h, 3));
    match Shift::from_immediate(bits(h, 11, 2), bits(h, 6, 5)) {
        (Shift::Left, 0) => Instruction::MoveRegister(d, m, flags),
        (Shift::Left, amount) => Instruction::ShiftLeft(d, m, amount, flags),
        (Shift::LogicalRight, amount) => Instruction::ShiftLogicalRight(d, m, amount, flags),
        (_, amount) => Instruction::ShiftArithmeticRight(d, m, amount, flags),
    }
}

fn add_subtract(h: u32, flags: bool) -> Instruction {
    let (d, n, m) =
        (Register::low_field(h, 0), Register::low_field(h, 3), Register::low_field(h, 6));
    let value = bits(h, 6, 3);
    match bits(h, 9, 2) {
        0b00 => Instruction::AddRegister(d, n, m, flags),
        0b01 => Instruction::SubtractRegister(d, n, m, flags),
        0b10 => Instruction::AddImmediate(d, n, value, flags),
        _ => Instruction::SubtractImmediate(d, n, value, flags),
    }
}

fn immediate(h: u32, flags: bool) -> Instruction {
    let (d, value) = (Register::low_field(h, 8), bits(h, 0, 8));
    match bits(h, 11, 2) {
        0b00 => {
            let flags = if flags { LogicalFlags::nz_and(None) } else { LogicalFlags::UNCHANGED };
            Instruction::MoveImmediate(d, value, flags)
        }
        0b01 => Instruction::CompareImmediate(d, value),
        0b10 => Instruction::AddImmediate(d, d, value, flags),
        _ => Instruction::SubtractImmediate(d, d, value, flags),
    }
}

fn data_processing(h: u32, flags: bool) -> Instruction {
    let (d, m) = (Register::low_field(h, 0), Register::low_field(h, 3));
    let n = d;
    let shifted_by = |shift| Instruction::ShiftByRegister(shift, d, n, m, flags);
    let plain = |operation| Instruction::Shifted(operation, d, n, m, Shift::Left, 0, flags);
    match bits(h, 6, 4) {
        0b0000 => plain(DataOperation::And),
        0b0001 => plain(DataOperation::ExclusiveOr),
        0b0010 => shifted_by(Shift::Left),
        0b0011 => shifted_by(Shift::LogicalRight),
        0b0100 => shifted_by(Shift::ArithmeticRight),
        0b0101 => plain(DataOperation::AddCarry),
        0b0110 => plain(DataOperation::SubtractCarry),
        0b0111 => shifted_by(Shift::RotateRight),
        0b1000 => Instruction::TestRegister(n, m),
        0b1001 => Instruction::ReverseSubtractImmediate(d, m, 0, flags),
        0b1010 => Instruction::CompareRegister(n, m),
        0b1011 => {
            let operation = DataOperation::CompareNegative;
            Instruction::Shifted(operation, d, n, m, Shift::Left, 0, true)
        }
        0b1100 => plain(DataOperation::Or),
        0b1101 => Instruction::Multiply(d, m, d, flags),
        0b1110 => plain(DataOperation::BitClear),
        _ => plain(DataOperation::MoveNot),
    }
}

/// High registers, BX and BLX (A5.2.3).
fn special(h: u32) -> Decoded {
    let d = Register::field(bits(h, 0, 3) | bits(h, 7, 1) << 3, 0);
    let m = Register::field(h, 3);
    Ok(match bits(h, 8, 2) {
        0b00 => {
            require(d != Register::PC || m != Register::PC)?;
            if d == Register::PC {
                Instruction::AddRegisterToPc(m)
            } else {
                Instruction::AddRegister(d, d, m, false)
            }
        }
        0b01 => {
            require(d != Register::PC && m != Register::PC)?;
            Instruction::CompareRegister(d, m)
        }
        0b10 if d == Register::PC => Instruction::MoveToPc(m),
        0b10 => Instruction::MoveRegister(d, m, false),
        _ => {
            require(bits(h, 0, 3) == 0)?;
            if bit(h, 7) {
                require(m != Register::PC)?;
                Instruction::BranchLinkExchange(m)
            } else {
                Instruction::BranchExchange(m)
            }
        }
    })
}

fn load_store_indexed(h: u32) -> Instruction {
    let (t, n, m) =
        (Register::low_field(h, 0), Register::low_field(h, 3), Register::low_field(h, 6));
    let shift = 0;
    match bits(h, 9, 3) {
        0b000 => Instruction::StoreIndexed(Width::Word, t, n, m, shift),
        0b001 => Instruction::StoreIndexed(Width::Half, t, n, m, shift),
        0b010 => Instruction::StoreIndexed(Width::Byte, t, n, m, shift),
        0b011 => Instruction::LoadIndexed(LoadKind::SignedByte, t, n, m, shift),
        0b100 => Instruction::LoadIndexed(LoadKind::Word, t, n, m, shift),
        0b101 => Instruction::LoadIndexed(LoadKind::Half, t, n, m, shift),
        0b110 => Instruction::LoadIndexed(LoadKind::Byte, t, n, m, shift),
        _ => Instruction::LoadIndexed(LoadKind::SignedHalf, t, n, m, shift),
    }
}

fn load_store(h: u32) -> Instruction {
    let (t, n) = (Register::low_field(h, 0), Register::low_field(h, 3));
    let offset = bits(h, 6, 5) as i32;
    let (stack_t, stack_offset) = (Register::low_field(h, 8), bits(h, 0, 8) as i32 * 4);
    match bits(h, 11, 5) {
        0b01100 => Instruction::StoreWord(t, n, offset * 4),
        0b01101 => Instruction::LoadWord(t, n, offset * 4),
        0b01110 => Instruction::Store(Width::Byte, t, n, offset),
        0b01111 => Instruction::Load(LoadKind::Byte, t, n, offset),
        0b10000 => Instruction::Store(Width::Half, t, n, offset * 2),
        0b10001 => Instruction::Load(LoadKind::Half, t, n, offset * 2),
        0b10010 => Instruction::StoreWord(stack_t, Register::SP, stack_offset),
        _ => Instruction::LoadWord(stack_t, Register::SP, stack_offset),
    }
}

/// A5.2.5.
fn miscellaneous(h: u32, inside_it_block: bool) -> Decoded {
    let (d, m) = (Register::low_field(h, 0), Register::low_field(h, 3));
    Ok(match bits(h, 8, 4) {
        0b0000 => {
            let (d, value) = (Register::SP, bits(h, 0, 7) * 4);
            if bit(h, 7) {
                Instruction::SubtractImmediate(d, d, value, false)
            } else {
                Instruction::AddImmediate(d, d, value, false)
            }
        }
        0b0001 | 0b0011 | 0b1001 | 0b1011 => {
            require(!inside_it_block)?;
            let offset = (bits(h, 3, 5) << 1 | bits(h, 9, 1) << 6) as i32;
            Instruction::CompareBranch(d, bit(h, 11), offset)
        }
        0b0010 => match bits(h, 6, 2) {
            0b00 => Instruction::ExtendAdd(Extension::SignedHalf, d, Register::PC, m, 0),
            0b01 => Instruction::ExtendAdd(Extension::SignedByte, d, Register::PC, m, 0),
            0b10 => Instruction::ExtendAdd(Extension::UnsignedHalf, d, Register::PC, m, 0),
            _ => Instruction::ExtendAdd(Extension::UnsignedByte, d, Register::PC, m, 0),
        },
        0b0100 | 0b0101 => {
            let list = (bits(h, 0, 8) | bits(h, 8, 1) << 14) as u16;
            require(list != 0)?;
            Instruction::Push(list)
        }
        0b0110 if bits(h, 5, 3) == 0b011 => {
            // FAULTMASK is not modelled.
            require(!inside_it_block && bits(h, 0, 4) == 0b0010)?;
            Instruction::ChangeState(bit(h, 4))
        }
        0b1010 => match bits(h, 6, 2) {
            0b00 => Instruction::ReverseBytes(d, m),
            0b01 => Instruction::ReverseHalfwords(d, m),
            0b11 => Instruction::ReverseSignedHalf(d, m),
            _ => return Err(Invalid::Undefined),
        },
        0b1100 | 0b1101 => {
            let list = (bits(h, 0, 8) | bits(h, 8, 1) << 15) as u16;
            require(list != 0)?;
            Instruction::Pop(list)
        }
        0b1110 => Instruction::Breakpoint(bits(h, 0, 8) as u8),
        0b1111 if bits(h, 0, 4) != 0 => {
            let (first, mask) = (bits(h, 4, 4), bits(h, 0, 4));
            require(!inside_it_block && first != 15 && (first != 14 || mask.count_ones() == 1))?;
            Instruction::IfThen(bits(h, 0, 8) as u8)
        }
        0b1111 => hint(bits(h, 4, 4)),
        _ => return Err(Invalid::Undefined),
    })
}

/// Hints; those without an effect on this core, and the unallocated ones, do nothing.
pub(super) fn hint(number: u32) -> Instruction {
    match number {
        2 => Instruction::Hint(Hint::WaitForEvent),
        3 => Instruction::Hint(Hint::WaitForInterrupt),
        4 => Instruction::Hint(Hint::SendEvent),
        _ => Instruction::Nop,
    }
}

fn multiple(h: u32) -> Decoded {
    let (n, list) = (Register::low_field(h, 8), bits(h, 0, 8) as u16);
    require(list != 0)?;
    let in_list = list & n.list_bit() != 0;
    if bit(h, 11) {
        let mode = MultipleMode { decrement: false, write_back: !in_list };
        return Ok(Instruction::LoadMultiple(n, mode, list));
    }
    // The stored value of a written-back base is unknown unless it is stored first.
    require(!in_list || list.trailing_zeros() as usize == n.index())?;
    let mode = MultipleMode { decrement: false, write_back: true };
    Ok(Instruction::StoreMultiple(n, mode, list))
}

fn conditional_branch(h: u32, inside_it_block: bool) -> Decoded {
    match bits(h, 8, 4) {
        0b1110 => Err(Invalid::Undefined),
        // SVC.
        0b1111 => Err(Invalid::Unpredictable),
        code => {
            require(!inside_it_block)?;
            let offset = sign_extend(bits(h, 0, 8) << 1, 9) as i32;
            Ok(Instruction::BranchIf(Condition::new(code), offset))
        }
    }
}
