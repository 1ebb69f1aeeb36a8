//! Decoding of Thumb instructions (DDI0403E chapter A5 and A6, encodings of A7.7).
//!
//! - [`narrow`]: 16-bit instructions.
//! - [`wide`]: 32-bit data processing, branches and system instructions.
//! - [`transfer`]: 32-bit loads and stores.
//! - [`float`]: the floating-point extension.
//!
//! Encodings that the architecture leaves unpredictable are not executed: they decode to
//! [`Instruction::Unsupported`]. So do encodings in which a bit that should be zero or one is not.

mod float;
mod narrow;
mod transfer;
mod wide;

use crate::core::instruction::{Instruction, Register};

/// Why an encoding is not an instruction of this core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Invalid {
    Undefined,
    Unpredictable,
    NoCoprocessor,
}

type Decoded = Result<Instruction, Invalid>;

/// Whether a halfword is the first of a 32-bit instruction (A5.1).
#[inline]
pub(super) const fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// The instruction of a halfword that [`is_wide`] rejects. Inside an IT block most of them do not set
/// flags.
pub(super) fn decode_narrow(halfword: u16, inside_it_block: bool) -> Instruction {
    instruction(narrow::decode(halfword as u32, inside_it_block))
}

/// The instruction of two halfwords.
pub(super) fn decode_wide(first: u16, second: u16, inside_it_block: bool) -> Instruction {
    match instruction(wide::decode(first as u32, second as u32)) {
        Instruction::BranchIf(..) if inside_it_block => Instruction::Unsupported,
        instruction => instruction,
    }
}

fn instruction(decoded: Decoded) -> Instruction {
    match decoded {
        Ok(instruction) => instruction,
        Err(Invalid::Undefined) => Instruction::Undefined,
        Err(Invalid::Unpredictable) => Instruction::Unsupported,
        Err(Invalid::NoCoprocessor) => Instruction::NoCoprocessor,
    }
}

/// `count` bits of a value from bit `low` up.
const fn bits(value: u32, low: u32, count: u32) -> u32 {
    value >> low & ((1 << count) - 1)
}

const fn bit(value: u32, position: u32) -> bool {
    value >> position & 1 != 0
}

/// Unpredictable unless the condition is met.
const fn require(condition: bool) -> Result<(), Invalid> {
    if condition { Ok(()) } else { Err(Invalid::Unpredictable) }
}

/// The register of four bits, which must be neither SP nor PC.
fn general(encoding: u32, low: u32) -> Result<Register, Invalid> {
    let register = Register::field(encoding, low);
    require(register != Register::SP && register != Register::PC)?;
    Ok(register)
}

/// The register of four bits, which must not be the PC.
fn not_pc(encoding: u32, low: u32) -> Result<Register, Invalid> {
    let register = Register::field(encoding, low);
    require(register != Register::PC)?;
    Ok(register)
}

/// The register of four bits, which must not be the SP.
fn not_sp(encoding: u32, low: u32) -> Result<Register, Invalid> {
    let register = Register::field(encoding, low);
    require(register != Register::SP)?;
    Ok(register)
}
