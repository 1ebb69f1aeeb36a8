//! 32-bit loads and stores (DDI0403E A5.3.5 to A5.3.10).

use crate::core::Width;
use crate::core::decode::{Decoded, Invalid, bit, bits, general, not_pc, not_sp, require};
use crate::core::instruction::{IndexMode, Instruction, LoadKind, MultipleMode, Register};

/// Load and store multiple (A5.3.5).
pub(super) fn multiple(h: u32, h2: u32) -> Decoded {
    let decrement = match bits(h, 7, 2) {
        0b01 => false,
        0b10 => true,
        _ => return Err(Invalid::Undefined),
    };
    let (write_back, load) = (bit(h, 5), bit(h, 4));
    let mode = MultipleMode { decrement, write_back };
    let (n, list) = (not_pc(h, 0)?, h2 as u16);
    require(list.count_ones() >= 2 && list & Register::SP.list_bit() == 0)?;
    require(!write_back || list & n.list_bit() == 0)?;
    if load {
        require(!(bit(h2, 15) && bit(h2, 14)))?;
        return Ok(Instruction::LoadMultiple(n, mode, list));
    }
    require(!bit(h2, 15))?;
    Ok(Instruction::StoreMultiple(n, mode, list))
}

/// Load and store dual or exclusive, table branch (A5.3.6).
pub(super) fn dual_exclusive_table(h: u32, h2: u32) -> Decoded {
    if bit(h, 8) || bit(h, 5) {
        return dual(h, h2);
    }
    let load = bit(h, 4);
    if !bit(h, 7) {
        let offset = bits(h2, 0, 8) as u16 * 4;
        return if load {
            let (t, n) = (general(h2, 12)?, not_pc(h, 0)?);
            require(bits(h2, 8, 4) == 0b1111)?;
            Ok(Instruction::LoadExclusive(Width::Word, t, n, offset))
        } else {
            store_exclusive(h, h2, general(h2, 8)?, Width::Word, offset)
        };
    }
    let width = match bits(h2, 4, 4) {
        0b0000 | 0b0001 if load => {
            let (n, m) = (not_sp(h, 0)?, general(h2, 0)?);
            require(bits(h2, 8, 8) == 0xF0)?;
            return Ok(Instruction::TableBranch(n, m, bit(h2, 4)));
        }
        0b0100 => Width::Byte,
        0b0101 => Width::Half,
        _ => return Err(Invalid::Undefined),
    };
    require(bits(h2, 8, 4) == 0b1111)?;
    if load {
        let (t, n) = (general(h2, 12)?, not_pc(h, 0)?);
        require(bits(h2, 0, 4) == 0b1111)?;
        Ok(Instruction::LoadExclusive(width, t, n, 0))
    } else {
        store_exclusive(h, h2, general(h2, 0)?, width, 0)
    }
}

fn store_exclusive(h: u32, h2: u32, d: Register, width: Width, offset: u16) -> Decoded {
    let (t, n) = (general(h2, 12)?, not_pc(h, 0)?);
    require(d != n && d != t)?;
    Ok(Instruction::StoreExclusive(width, d, t, n, offset))
}

fn dual(h: u32, h2: u32) -> Decoded {
    let mode = match (bit(h, 8), bit(h, 5)) {
        (true, false) => IndexMode::Offset,
        (true, true) => IndexMode::PreIndexed,
        _ => IndexMode::PostIndexed,
    };
    let magnitude = bits(h2, 0, 8) as i16 * 4;
    let offset = if bit(h, 7) { magnitude } else { -magnitude };
    let (t, t2, n) = (general(h2, 12)?, general(h2, 8)?, Register::field(h, 0));
    let load = bit(h, 4);
    require(mode == IndexMode::Offset || n != t && n != t2)?;
    if load {
        require(t != t2)?;
        if n == Register::PC {
            require(mode == IndexMode::Offset)?;
            return Ok(Instruction::LoadDualLiteral(t, t2, offset));
        }
        return Ok(Instruction::LoadDual(t, t2, n, mode, offset));
    }
    require(n != Register::PC)?;
    Ok(Instruction::StoreDual(t, t2, n, mode, offset))
}

/// Addressing of a single transfer.
enum Address {
    Offset(i32),
    Indexed { m: Register, shift: u8 },
    WriteBack { mode: IndexMode, offset: i16 },
    Literal(i32),
}

/// Loads and stores of one register (A5.3.7 to A5.3.10).
pub(super) fn single(h: u32, h2: u32) -> Decoded {
    let (signed, load) = (bit(h, 8), bit(h, 4));
    let width = match bits(h, 5, 2) {
        0b00 => Width::Byte,
        0b01 => Width::Half,
        0b10 => Width::Word,
        _ => return Err(Invalid::Undefined),
    };
    if signed && (!load || width == Width::Word) {
        return Err(Invalid::Undefined);
    }
    let address = addressing(h, h2, load)?;
    if !load {
        return store(h, h2, width, address);
    }
    let kind = match (width, signed) {
        (Width::Word, _) => LoadKind::Word,
        (Width::Half, false) => LoadKind::Half,
        (Width::Half, true) => LoadKind::SignedHalf,
        (Width::Byte, false) => LoadKind::Byte,
        (Width::Byte, true) => LoadKind::SignedByte,
    };
    if Register::field(h2, 12) == Register::PC && kind != LoadKind::Word {
        return memory_hint(h, h2, address);
    }
    self::load(h, h2, kind, address)
}

fn addressing(h: u32, h2: u32, load: bool) -> Result<Address, Invalid> {
    let wide_offset = bits(h2, 0, 12) as i32;
    let n = Register::field(h, 0);
    if n == Register::PC {
        if !load {
            return Err(Invalid::Undefined);
        }
        return Ok(Address::Literal(if bit(h, 7) { wide_offset } else { -wide_offset }));
    }
    if bit(h, 7) {
        return Ok(Address::Offset(wide_offset));
    }
    let magnitude = bits(h2, 0, 8) as i16;
    let offset = if bit(h2, 9) { magnitude } else { -magnitude };
    match (bit(h2, 11), bit(h2, 10), bit(h2, 8)) {
        (false, _, _) if bits(h2, 6, 6) == 0 => {
            Ok(Address::Indexed { m: general(h2, 0)?, shift: bits(h2, 4, 2) as u8 })
        }
        (false, _, _) | (true, false, false) => Err(Invalid::Undefined),
        // With a positive offset this is the unprivileged form, which has the same effect without a
        // memory protection unit.
        (true, true, false) => Ok(Address::Offset(offset as i32)),
        (true, true, true) => Ok(Address::WriteBack { mode: IndexMode::PreIndexed, offset }),
        (true, false, true) => Ok(Address::WriteBack { mode: IndexMode::PostIndexed, offset }),
    }
}

/// Preloads and unallocated hints: loads of less than a word into the PC.
fn memory_hint(h: u32, h2: u32, address: Address) -> Decoded {
    match address {
        Address::WriteBack { .. } => Err(Invalid::Unpredictable),
        // The unprivileged forms are no hints.
        Address::Offset(_) if !bit(h, 7) && bits(h2, 8, 4) == 0b1110 => Err(Invalid::Unpredictable),
        _ => Ok(Instruction::Nop),
    }
}

fn load(h: u32, h2: u32, kind: LoadKind, address: Address) -> Decoded {
    let (t, n) = (Register::field(h2, 12), Register::field(h, 0));
    require(kind == LoadKind::Word || t != Register::SP)?;
    let to_pc = t == Register::PC;
    Ok(match (address, kind) {
        (Address::Literal(offset), LoadKind::Word) if to_pc => Instruction::LoadToPcLiteral(offset),
        (Address::Literal(offset), _) => Instruction::LoadLiteral(kind, t, offset),
        (Address::WriteBack { mode, offset }, _) => {
            require(n != t)?;
            Instruction::LoadWriteBack(kind, t, n, mode, offset)
        }
        (Address::Offset(offset), LoadKind::Word) if to_pc => Instruction::LoadToPc(n, offset),
        (Address::Offset(offset), LoadKind::Word) => Instruction::LoadWord(t, n, offset),
        (Address::Offset(offset), _) => Instruction::Load(kind, t, n, offset),
        (Address::Indexed { m, shift }, LoadKind::Word) if to_pc => {
            Instruction::LoadToPcIndexed(n, m, shift)
        }
        (Address::Indexed { m, shift }, _) => Instruction::LoadIndexed(kind, t, n, m, shift),
    })
}

fn store(h: u32, h2: u32, width: Width, address: Address) -> Decoded {
    let (t, n) = (not_pc(h2, 12)?, Register::field(h, 0));
    require(width == Width::Word || t != Register::SP)?;
    Ok(match (address, width) {
        (Address::Literal(_), _) => return Err(Invalid::Undefined),
        (Address::WriteBack { mode, offset }, _) => {
            require(n != t)?;
            Instruction::StoreWriteBack(width, t, n, mode, offset)
        }
        (Address::Offset(offset), Width::Word) => Instruction::StoreWord(t, n, offset),
        (Address::Offset(offset), _) => Instruction::Store(width, t, n, offset),
        (Address::Indexed { m, shift }, _) => Instruction::StoreIndexed(width, t, n, m, shift),
    })
}
