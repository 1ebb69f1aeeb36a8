//! Data processing: shifted operands, results with flags, division.

use crate::core::arithmetic::{Shift, add_with_carry, shift_with_carry, subtract};
use crate::core::instruction::{DataOperation, Register};
use crate::core::state::State;

impl State {
    /// Writes a result and, where `flags`, its condition flags.
    #[inline(always)]
    pub(super) fn finish(&mut self, d: Register, flags: bool, (result, nzcv): (u32, u32)) {
        self.write_any(d, result);
        if flags {
            self.set_nzcv(nzcv);
        }
    }

    /// Writes a result and, where `flags`, N and Z.
    #[inline(always)]
    pub(super) fn finish_logical(&mut self, d: Register, flags: bool, result: u32) {
        self.write(d, result);
        if flags {
            self.set_nz(result);
        }
    }

    #[inline(always)]
    pub(super) fn shift(
        &mut self,
        d: Register,
        value: u32,
        shift: Shift,
        amount: u32,
        flags: bool,
    ) {
        let (result, carry) = shift_with_carry(value, shift, amount, self.carry());
        self.write(d, result);
        if flags {
            self.set_nzc(result, carry);
        }
    }

    #[inline]
    pub(super) fn shifted(
        &mut self,
        operation: DataOperation,
        (d, n, m): (Register, Register, Register),
        shift: Shift,
        amount: u8,
        flags: bool,
    ) {
        let carry_in = self.carry();
        let (operand, carry) = shift_with_carry(self.read(m), shift, amount as u32, carry_in);
        let first = self.read(n);
        let result = match operation {
            DataOperation::And => first & operand,
            DataOperation::BitClear => first & !operand,
            DataOperation::Or => first | operand,
            DataOperation::OrNot => first | !operand,
            DataOperation::ExclusiveOr => first ^ operand,
            DataOperation::Move => operand,
            DataOperation::MoveNot => !operand,
            DataOperation::Test => return self.set_nzc(first & operand, carry),
            DataOperation::TestEquivalence => return self.set_nzc(first ^ operand, carry),
            DataOperation::Add => {
                return self.finish(d, flags, add_with_carry(first, operand, false));
            }
            DataOperation::AddCarry => {
                return self.finish(d, flags, add_with_carry(first, operand, carry_in));
            }
            DataOperation::Subtract => return self.finish(d, flags, subtract(first, operand)),
            DataOperation::SubtractCarry => {
                return self.finish(d, flags, add_with_carry(first, !operand, carry_in));
            }
            DataOperation::ReverseSubtract => {
                return self.finish(d, flags, subtract(operand, first));
            }
            DataOperation::Compare => return self.set_nzcv(subtract(first, operand).1),
            DataOperation::CompareNegative => {
                return self.set_nzcv(add_with_carry(first, operand, false).1);
            }
        };
        self.write(d, result);
        if flags {
            self.set_nzc(result, carry);
        }
    }

    #[inline(always)]
    pub(super) fn rotated(&self, m: Register, rotation: u8) -> u32 {
        self.read(m).rotate_right(rotation as u32)
    }
}

/// The `width` (1 to 32) lowest bits.
#[inline(always)]
pub(super) const fn field_mask(width: u8) -> u32 {
    u32::MAX >> ((32 - width as u32) & 31)
}
