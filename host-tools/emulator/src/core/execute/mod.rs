//! Execution of decoded instructions.
//!
//! - this file: the dispatch.
//! - [`data`]: data processing.
//! - [`branch`]: branches, hints.
//! - [`memory`]: data accesses with their faults.
//! - [`multiple`]: loads and stores of several registers, exclusive accesses.
//! - [`special`]: special registers.
//!
//! The DSP extension is in [`dsp`](super::dsp), the floating-point unit in [`float`](super::float).

mod branch;
mod data;
pub(super) mod memory;
mod multiple;
mod special;

use crate::core::Width;
use crate::core::arithmetic::{
    NZCV, Shift, add_with_carry, divide_signed, divide_unsigned, reverse_halfwords,
    shift_with_carry, sign_extend, subtract,
};
use crate::core::bus::Bus;
use crate::core::float;
use crate::core::instruction::{IndexMode, Instruction, Register};
use crate::core::state::{Fault, LR, PC, SP, State, Trap};
use data::field_mask;

impl State {
    /// Executes one instruction, whose condition is met, and gives the address of the next one.
    /// `next` is the address behind it; `r[15]` contains its own address plus 4.
    ///
    /// # Errors
    /// [`Trap`] where the execution does not continue in sequence. A fault leaves the core registers as
    /// they were, so that the instruction can be executed again.
    #[inline(always)]
    pub(super) fn execute<B: Bus>(
        &mut self,
        bus: &mut B,
        instruction: &Instruction,
        next: u32,
    ) -> Result<u32, Trap> {
        use Instruction as I;
        match *instruction {
            I::Nop | I::DataBarrier => {}

            I::MoveImmediate(d, value, flags) => {
                self.write(d, value);
                self.set_logical(value, flags);
            }
            I::AndImmediate(d, n, value, flags) => {
                let result = self.read(n) & value;
                self.write(d, result);
                self.set_logical(result, flags);
            }
            I::OrImmediate(d, n, value, flags) => {
                let result = self.read(n) | value;
                self.write(d, result);
                self.set_logical(result, flags);
            }
            I::ExclusiveOrImmediate(d, n, value, flags) => {
                let result = self.read(n) ^ value;
                self.write(d, result);
                self.set_logical(result, flags);
            }
            I::TestImmediate(n, value, flags) => self.set_logical(self.read(n) & value, flags),
            I::TestEquivalenceImmediate(n, value, flags) => {
                self.set_logical(self.read(n) ^ value, flags);
            }
            I::AddImmediate(d, n, value, flags) => {
                self.finish(d, flags, add_with_carry(self.read(n), value, false));
            }
            I::SubtractImmediate(d, n, value, flags) => {
                self.finish(d, flags, subtract(self.read(n), value));
            }
            I::ReverseSubtractImmediate(d, n, value, flags) => {
                self.finish(d, flags, subtract(value, self.read(n)));
            }
            I::AddCarryImmediate(d, n, value, flags) => {
                self.finish(d, flags, add_with_carry(self.read(n), value, self.carry()));
            }
            I::CompareImmediate(n, value) => self.set_nzcv(subtract(self.read(n), value).1),
            I::CompareNegativeImmediate(n, value) => {
                self.set_nzcv(add_with_carry(self.read(n), value, false).1);
            }
            I::MoveTop(d, value) => {
                self.write(d, self.read(d) & 0xFFFF | (value as u32) << 16);
            }
            I::AddToPc(d, offset) => self.write(d, self.literal(offset)),

            I::MoveRegister(d, m, flags) => {
                let value = self.read(m);
                self.write_any(d, value);
                if flags {
                    self.set_nz(value);
                }
            }
            I::AddRegister(d, n, m, flags) => {
                self.finish(d, flags, add_with_carry(self.read(n), self.read(m), false));
            }
            I::SubtractRegister(d, n, m, flags) => {
                self.finish(d, flags, subtract(self.read(n), self.read(m)));
            }
            I::CompareRegister(n, m) => {
                self.set_nzcv(subtract(self.read(n), self.read(m)).1);
            }
            I::TestRegister(n, m) => self.set_nz(self.read(n) & self.read(m)),
            I::Shifted(operation, d, n, m, shift, amount, flags) => {
                self.shifted(operation, (d, n, m), shift, amount, flags);
            }
            I::ShiftLeft(d, m, amount, flags) => {
                self.shift(d, self.read(m), Shift::Left, amount as u32, flags);
            }
            I::ShiftLogicalRight(d, m, amount, flags) => {
                self.shift(d, self.read(m), Shift::LogicalRight, amount as u32, flags);
            }
            I::ShiftArithmeticRight(d, m, amount, flags) => {
                self.shift(d, self.read(m), Shift::ArithmeticRight, amount as u32, flags);
            }
            I::ShiftByRegister(shift, d, n, m, flags) => {
                self.shift(d, self.read(n), shift, self.read(m) & 0xFF, flags);
            }

            I::SignedBitField(d, n, low, width) => {
                self.write(d, sign_extend(self.read(n) >> (low & 31), width as u32));
            }
            I::UnsignedBitField(d, n, low, width) => {
                self.write(d, self.read(n) >> (low & 31) & field_mask(width));
            }
            I::BitFieldInsert(d, n, low, width) => {
                let field = field_mask(width) << (low & 31);
                let value = self.read(n) << (low & 31);
                self.write(d, self.read(d) & !field | value & field);
            }
            I::ExtendAdd(extension, d, n, m, rotation) => {
                self.extend_add(extension, d, n, self.rotated(m, rotation));
            }
            I::ReverseBytes(d, m) => self.write(d, self.read(m).swap_bytes()),
            I::ReverseHalfwords(d, m) => self.write(d, reverse_halfwords(self.read(m))),
            I::ReverseSignedHalf(d, m) => {
                self.write(d, (self.read(m) as i16).swap_bytes() as u32);
            }
            I::ReverseBits(d, m) => self.write(d, self.read(m).reverse_bits()),
            I::CountLeadingZeros(d, m) => self.write(d, self.read(m).leading_zeros()),

            I::Multiply(d, n, m, flags) => {
                let result = self.read(n).wrapping_mul(self.read(m));
                self.finish_logical(d, flags, result);
            }
            I::MultiplyAccumulate(d, n, m, a) => {
                let product = self.read(n).wrapping_mul(self.read(m));
                self.write(d, self.read(a).wrapping_add(product));
            }
            I::MultiplySubtract(d, n, m, a) => {
                let product = self.read(n).wrapping_mul(self.read(m));
                self.write(d, self.read(a).wrapping_sub(product));
            }
            I::LongMultiply(operation, low, high, n, m) => {
                self.long_multiply(operation, low, high, self.read(n), self.read(m));
            }
            I::DivideSigned(d, n, m) => {
                self.write(d, divide_signed(self.read(n), self.read(m)));
            }
            I::DivideUnsigned(d, n, m) => {
                self.write(d, divide_unsigned(self.read(n), self.read(m)));
            }

            I::Dsp(operation, d, n, m, a) => {
                self.dsp_multiply(operation, d, self.read(n), self.read(m), a);
            }
            I::Parallel(operation, d, n, m) => {
                self.parallel(operation, d, self.read(n), self.read(m));
            }
            I::SaturatingAdd(d, n, m, subtract) => {
                self.saturating_add(d, self.read(n), self.read(m), subtract);
            }
            I::PackHalfwords(d, n, m, top, shift, amount) => {
                let operand = shift_with_carry(self.read(m), shift, amount as u32, self.carry()).0;
                self.pack_halfwords(d, self.read(n), operand, top);
            }
            I::SaturateSigned(d, n, bits, shift, amount) => {
                let operand = shift_with_carry(self.read(n), shift, amount as u32, self.carry()).0;
                self.saturate_signed(d, operand, bits as u32);
            }
            I::SaturateUnsigned(d, n, bits, shift, amount) => {
                let operand = shift_with_carry(self.read(n), shift, amount as u32, self.carry()).0;
                self.saturate_unsigned(d, operand, bits as u32);
            }

            I::Branch(offset) => return self.branch_by(bus, offset),
            I::BranchIf(condition, offset) => {
                if condition.is_met(self.apsr) {
                    return self.branch_by(bus, offset);
                }
            }
            I::BranchLink(offset) => {
                let target = self.branch_by(bus, offset)?;
                self.r[LR] = next | 1;
                return Ok(target);
            }
            I::BranchExchange(m) => return self.branch_exchange(bus, self.read(m)),
            I::BranchLinkExchange(m) => {
                let target = self.branch_with_state(bus, self.read(m))?;
                self.r[LR] = next | 1;
                return Ok(target);
            }
            I::CompareBranch(n, nonzero, offset) => {
                if (self.read(n) != 0) == nonzero {
                    return self.branch_by(bus, offset);
                }
            }
            I::TableBranch(n, m, half) => {
                let entry = if half {
                    let address = self.read(n).wrapping_add(self.read(m) << 1);
                    self.load(bus, address, Width::Half)?
                } else {
                    let address = self.read(n).wrapping_add(self.read(m));
                    self.load(bus, address, Width::Byte)?
                };
                return self.branch_by(bus, entry as i32 * 2);
            }
            I::MoveToPc(m) => return self.branch(bus, self.read(m)),
            I::AddRegisterToPc(m) => {
                return self.branch(bus, self.r[PC].wrapping_add(self.read(m)));
            }

            I::LoadWord(t, n, offset) => {
                let value = self.load(bus, self.at(n, offset), Width::Word)?;
                self.write_any(t, value);
            }
            I::Load(kind, t, n, offset) => {
                let value = self.load_kind(bus, kind, self.at(n, offset))?;
                self.write(t, value);
            }
            I::StoreWord(t, n, offset) => {
                self.store(bus, self.at(n, offset), Width::Word, self.read(t))?;
            }
            I::Store(width, t, n, offset) => {
                self.store(bus, self.at(n, offset), width, self.read(t))?;
            }
            I::LoadIndexed(kind, t, n, m, shift) => {
                let value = self.load_kind(bus, kind, self.indexed(n, m, shift))?;
                self.write_any(t, value);
            }
            I::StoreIndexed(width, t, n, m, shift) => {
                self.store(bus, self.indexed(n, m, shift), width, self.read(t))?;
            }
            I::LoadWriteBack(kind, t, n, mode, offset) => {
                let (address, base) = self.write_back_address(n, mode, offset);
                if t == Register::PC {
                    self.require_last_in_it_block()?;
                }
                let value = self.load_kind(bus, kind, address)?;
                self.write_any(n, base);
                if t == Register::PC {
                    return self.branch_exchange(bus, value);
                }
                self.write_any(t, value);
            }
            I::StoreWriteBack(width, t, n, mode, offset) => {
                let (address, base) = self.write_back_address(n, mode, offset);
                self.store(bus, address, width, self.read(t))?;
                self.write_any(n, base);
            }
            I::LoadLiteral(kind, t, offset) => {
                let value = self.load_kind(bus, kind, self.literal(offset))?;
                self.write_any(t, value);
            }
            I::LoadToPc(n, offset) => {
                let target = self.load(bus, self.at(n, offset), Width::Word)?;
                return self.branch_exchange(bus, target);
            }
            I::LoadToPcIndexed(n, m, shift) => {
                let target = self.load(bus, self.indexed(n, m, shift), Width::Word)?;
                return self.branch_exchange(bus, target);
            }
            I::LoadToPcLiteral(offset) => {
                let target = self.load(bus, self.literal(offset), Width::Word)?;
                return self.branch_exchange(bus, target);
            }

            I::LoadDual(t, t2, n, mode, offset) => {
                let (address, base) = self.write_back_address(n, mode, offset);
                self.load_dual(bus, t, t2, address)?;
                if mode != IndexMode::Offset {
                    self.write_any(n, base);
                }
            }
            I::LoadDualLiteral(t, t2, offset) => {
                self.load_dual(bus, t, t2, self.literal(offset as i32))?;
            }
            I::StoreDual(t, t2, n, mode, offset) => {
                let (address, base) = self.write_back_address(n, mode, offset);
                self.store_dual(bus, t, t2, address)?;
                if mode != IndexMode::Offset {
                    self.write_any(n, base);
                }
            }
            I::LoadMultiple(n, mode, list) => {
                if let Some(target) = self.load_multiple(bus, n, mode, list)? {
                    return self.branch_exchange(bus, target);
                }
            }
            I::StoreMultiple(n, mode, list) => self.store_multiple(bus, n, mode, list)?,
            I::Push(list) => {
                let address = self.r[SP].wrapping_sub(4 * list.count_ones());
                self.store_list(bus, address, list)?;
                self.r[SP] = address;
            }
            I::Pop(list) => {
                let end = self.r[SP].wrapping_add(4 * list.count_ones());
                let target = self.load_list(bus, self.r[SP], list)?;
                self.r[SP] = end;
                if let Some(target) = target {
                    return self.branch_exchange(bus, target);
                }
            }

            I::LoadExclusive(width, t, n, offset) => {
                self.load_exclusive(bus, width, t, self.at(n, offset as i32))?;
            }
            I::StoreExclusive(width, d, t, n, offset) => {
                self.store_exclusive(bus, width, d, t, self.at(n, offset as i32))?;
            }
            I::ClearExclusive => self.exclusive = false,

            I::IfThen(state) => self.itstate = state,
            I::Hint(hint) => self.hint(bus, hint),
            I::SynchronisationBarrier => {
                self.barrier = true;
                bus.system().request_recheck();
            }
            I::ChangeState(masked) => self.change_state(bus, masked),
            I::ReadSpecial(d, special) => self.write(d, self.read_special(special)),
            I::WriteSpecial(n, special) => self.write_special(bus, special, self.read(n)),
            I::Breakpoint(immediate) => return Err(Trap::Breakpoint(immediate)),
            I::Undefined => return Err(Trap::Fault(Fault::Undefined)),
            I::NoCoprocessor => return Err(Trap::Fault(Fault::NoCoprocessor)),
            I::Unsupported => return Err(Trap::Unsupported),

            I::FloatArithmetic(operation, d, n, m) => {
                self.check_float(bus)?;
                let [old, n, m] = [d, n, m].map(|register| self.s[register.index()]);
                self.s[d.index()] = float::arithmetic(operation, old, n, m);
            }
            I::FloatUnary(operation, d, m) => {
                self.check_float(bus)?;
                self.s[d.index()] = float::unary(operation, self.s[m.index()]);
            }
            I::FloatMoveImmediate(d, value) => {
                self.check_float(bus)?;
                self.s[d.index()] = value;
            }
            I::FloatCompare(d, m) => {
                self.check_float(bus)?;
                self.float_compare(self.s[d.index()], self.s[m.index()]);
            }
            I::FloatCompareZero(d) => {
                self.check_float(bus)?;
                self.float_compare(self.s[d.index()], 0);
            }
            I::FloatLoad(d, n, double, offset) => {
                self.check_float(bus)?;
                let address = self.float_address(n, offset);
                self.float_load(bus, d, double, address)?;
            }
            I::FloatStore(d, n, double, offset) => {
                self.check_float(bus)?;
                let address = self.float_address(n, offset);
                self.float_store(bus, d, double, address)?;
            }
            I::FloatLoadMultiple(d, words, n, mode, bytes) => {
                self.check_float(bus)?;
                self.float_load_multiple(bus, d, words, n, mode, bytes)?;
            }
            I::FloatStoreMultiple(d, words, n, mode, bytes) => {
                self.check_float(bus)?;
                self.float_store_multiple(bus, d, words, n, mode, bytes)?;
            }
            I::FloatFromCore(s, t) => {
                self.check_float(bus)?;
                self.s[s.index()] = self.read(t);
            }
            I::FloatToCore(t, s) => {
                self.check_float(bus)?;
                self.write(t, self.s[s.index()]);
            }
            I::FloatPairFromCore(s, t, t2) => {
                self.check_float(bus)?;
                self.s[s.index()] = self.read(t);
                self.s[(s.index() + 1) & 31] = self.read(t2);
            }
            I::FloatPairToCore(t, t2, s) => {
                self.check_float(bus)?;
                self.write(t, self.s[s.index()]);
                self.write(t2, self.s[(s.index() + 1) & 31]);
            }
            I::ReadFloatFlags => {
                self.check_float(bus)?;
                self.set_nzcv(self.fpscr & NZCV);
            }
        }
        Ok(next)
    }
}
