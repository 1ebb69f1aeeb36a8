//! Bits of the configurable fault status register, CFSR (DDI0403E B3.2.15).

/// MMFSR: instruction fetch from a region that is execute never.
pub const INSTRUCTION_ACCESS: u32 = 1 << 0;
/// BFSR: instruction fetch refused by the bus.
pub const INSTRUCTION_BUS: u32 = 1 << 8;
/// BFSR: data access refused by the bus; the stacked address is that of the instruction.
pub const PRECISE: u32 = 1 << 9;
/// BFSR: the return from an exception could not read its frame.
pub const UNSTACKING: u32 = 1 << 11;
/// BFSR: the entry to an exception could not write its frame.
pub const STACKING: u32 = 1 << 12;
/// BFSR: the floating-point registers could not be preserved.
pub const LAZY_STACKING: u32 = 1 << 13;
/// BFSR: the address of the fault is known. Its register is not modelled.
pub const BFAR_VALID: u32 = 1 << 15;
/// UFSR: undefined instruction.
pub const UNDEFINED: u32 = 1 << 16;
/// UFSR: execution in another state than Thumb.
pub const INVALID_STATE: u32 = 1 << 17;
/// UFSR: integrity check of a return from an exception.
pub const INVALID_RETURN: u32 = 1 << 18;
/// UFSR: coprocessor absent, or access to it denied.
pub const NO_COPROCESSOR: u32 = 1 << 19;
/// UFSR: unaligned access.
pub const UNALIGNED: u32 = 1 << 24;
