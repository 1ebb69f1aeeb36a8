//! Decoded instructions: 8 bytes each, with everything that does not depend on the state computed.

use crate::core::Width;
use crate::core::arithmetic::{Condition, Shift};

/// Number of a core register, 0 to 15.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Register(u8);

impl Register {
    pub(super) const SP: Self = Self(13);
    pub(super) const PC: Self = Self(15);

    /// The register of the four bits of `encoding` from bit `low` up.
    #[inline]
    pub(super) const fn field(encoding: u32, low: u32) -> Self {
        Self((encoding >> low & 15) as u8)
    }

    /// The register r0 to r7 of the three bits of `encoding` from bit `low` up.
    #[inline]
    pub(super) const fn low_field(encoding: u32, low: u32) -> Self {
        Self((encoding >> low & 7) as u8)
    }

    /// Index into the register file. With the mask the compiler omits the check of the
    /// range.
    #[inline(always)]
    pub(super) const fn index(self) -> usize {
        (self.0 & 15) as usize
    }

    /// Bit of the register in the list of a multiple transfer.
    #[inline(always)]
    pub(super) const fn list_bit(self) -> u16 {
        1 << self.index()
    }
}

/// Number of a single-precision register, 0 to 31.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FloatRegister(u8);

impl FloatRegister {
    #[inline]
    pub(super) const fn new(number: u32) -> Self {
        Self((number & 31) as u8)
    }

    #[inline(always)]
    pub(super) const fn index(self) -> usize {
        (self.0 & 31) as usize
    }
}

/// Flags that a logical instruction with a constant operand sets: its carry out is determined when it
/// is decoded. Packed into a byte, so that an instruction takes 8.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LogicalFlags(u8);

impl LogicalFlags {
    const NZ: u8 = 1;
    const CARRY_KNOWN: u8 = 2;
    const CARRY: u8 = 4;

    pub(super) const UNCHANGED: Self = Self(0);

    /// N and Z from the result, and C where the encoding has a carry out.
    pub(super) const fn nz_and(carry: Option<bool>) -> Self {
        match carry {
            None => Self(Self::NZ),
            Some(false) => Self(Self::NZ | Self::CARRY_KNOWN),
            Some(true) => Self(Self::NZ | Self::CARRY_KNOWN | Self::CARRY),
        }
    }

    /// Whether N and Z are set; else no flag is.
    #[inline(always)]
    pub(super) const fn sets_nz(self) -> bool {
        self.0 & Self::NZ != 0
    }

    #[inline(always)]
    pub(super) const fn carry(self) -> Option<bool> {
        if self.0 & Self::CARRY_KNOWN != 0 { Some(self.0 & Self::CARRY != 0) } else { None }
    }
}

/// Data-processing operations with a shifted register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DataOperation {
    And,
    BitClear,
    Or,
    OrNot,
    ExclusiveOr,
    Add,
    AddCarry,
    Subtract,
    SubtractCarry,
    ReverseSubtract,
    Move,
    MoveNot,
    Test,
    TestEquivalence,
    Compare,
    CompareNegative,
}

/// What a load puts into its register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LoadKind {
    Word,
    Half,
    Byte,
    SignedHalf,
    SignedByte,
}

/// How a load or store uses its offset and its base register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum IndexMode {
    /// Address base + offset; the base is unchanged.
    Offset,
    /// Address base + offset, which is written back.
    PreIndexed,
    /// Address base; base + offset is written back.
    PostIndexed,
}

/// Order of a multiple transfer and write-back of its base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct MultipleMode {
    /// The block ends below the base instead of starting at it.
    pub(super) decrement: bool,
    /// The base register receives the other end of the block.
    pub(super) write_back: bool,
}

/// Parallel additions and subtractions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ParallelOperation {
    pub(super) format: ParallelFormat,
    /// Bits of a lane.
    pub(super) width: u8,
    pub(super) subtract: bool,
}

/// Number format of the parallel additions and subtractions. The GE flags are not modelled: no instruction here reads them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ParallelFormat {
    Signed,
    SignedSaturating,
    Unsigned,
    UnsignedSaturating,
}

/// Widths of the extending additions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Extension {
    SignedByte,
    SignedHalf,
    SignedBytePair,
    UnsignedByte,
    UnsignedHalf,
    UnsignedBytePair,
}

/// Multiplications of the DSP extension with a 32-bit result. Without accumulation the accumulator
/// register is the PC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DspMultiply {
    /// SMLAxy, SMULxy.
    Half { n_top: bool, m_top: bool },
    /// SMLAWy, SMULWy.
    WordByHalf { m_top: bool },
    /// SMLAD, SMUAD, with X: exchanged.
    DualAdd { exchange: bool },
    /// SMMLA, SMMUL, with R: rounded.
    MostSignificant { round: bool },
    /// SMMLS, with R: rounded.
    MostSignificantSubtract { round: bool },
}

/// Multiplications with a 64-bit result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LongMultiply {
    Signed,
    Unsigned,
    SignedAccumulate,
    UnsignedAccumulate,
    /// UMAAL: both result registers are added separately.
    UnsignedAccumulateTwo,
}

/// Special registers of MRS and MSR.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SpecialRegister {
    Msp,
    Primask,
    Basepri,
    /// BASEPRI, of which a write raises the priority only.
    BasepriMax,
}

/// Hints with an effect on the core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hint {
    WaitForEvent,
    WaitForInterrupt,
    SendEvent,
}

/// Floating-point operations with two operands and, in four of them, the former value of the destination d.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FloatArithmetic {
    Add,
    Subtract,
    Multiply,
    NegatedMultiply,
    Divide,
    /// VMLA: `d + n * m`, rounded twice.
    MultiplyAdd,
    /// VMLS: `d - n * m`, rounded twice.
    MultiplySubtract,
    /// VNMLA: `-d - n * m`, rounded twice.
    NegatedMultiplyAdd,
    /// VNMLS: `-d + n * m`, rounded twice.
    NegatedMultiplySubtract,
}

/// Floating-point operations with one operand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FloatUnary {
    Move,
    Absolute,
    Negate,
    SquareRoot,
    /// VCVT from an integer.
    FromInteger {
        unsigned: bool,
    },
    /// VCVT or VCVTR to an integer.
    ToInteger {
        unsigned: bool,
        toward_zero: bool,
    },
}

/// Whether an instruction sets condition flags.
pub(super) type SetFlags = bool;
/// Distance of a shift or rotation in bits; 0 to 32.
pub(super) type Amount = u8;
/// Distance in bytes from a base register or from the PC.
pub(super) type Offset = i32;
/// Registers of a multiple transfer, a bit for each.
pub(super) type RegisterList = u16;

/// An instruction with its operands, in the order of the assembly language: destination d (or
/// transferred register t), operands n and m, accumulator a, constant, shift; and at the end whether
/// flags are set.
///
/// Offsets of branches and literals are relative to the PC, the address of the instruction plus 4.
/// Instructions that are frequent in compiled code have their own variant so that one dispatch reaches
/// them; the others share one by form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Instruction {
    Nop,

    // Data processing with a constant.
    MoveImmediate(Register, u32, LogicalFlags),
    AndImmediate(Register, Register, u32, LogicalFlags),
    OrImmediate(Register, Register, u32, LogicalFlags),
    ExclusiveOrImmediate(Register, Register, u32, LogicalFlags),
    TestImmediate(Register, u32, LogicalFlags),
    TestEquivalenceImmediate(Register, u32, LogicalFlags),
    AddImmediate(Register, Register, u32, SetFlags),
    SubtractImmediate(Register, Register, u32, SetFlags),
    ReverseSubtractImmediate(Register, Register, u32, SetFlags),
    /// Also SBC, with the inverted constant.
    AddCarryImmediate(Register, Register, u32, SetFlags),
    CompareImmediate(Register, u32),
    CompareNegativeImmediate(Register, u32),
    /// MOVT.
    MoveTop(Register, u16),
    /// ADR: the PC, aligned to a word, plus the offset.
    AddToPc(Register, Offset),

    // Data processing with registers.
    MoveRegister(Register, Register, SetFlags),
    AddRegister(Register, Register, Register, SetFlags),
    SubtractRegister(Register, Register, Register, SetFlags),
    CompareRegister(Register, Register),
    TestRegister(Register, Register),
    Shifted(DataOperation, Register, Register, Register, Shift, Amount, SetFlags),
    ShiftLeft(Register, Register, Amount, SetFlags),
    ShiftLogicalRight(Register, Register, Amount, SetFlags),
    ShiftArithmeticRight(Register, Register, Amount, SetFlags),
    ShiftByRegister(Shift, Register, Register, Register, SetFlags),

    // Bit fields (lowest bit, width), extension (rotation), reversal.
    SignedBitField(Register, Register, u8, u8),
    UnsignedBitField(Register, Register, u8, u8),
    BitFieldInsert(Register, Register, u8, u8),
    /// Extension, d, n, m, rotation; without addition n is the PC.
    ExtendAdd(Extension, Register, Register, Register, Amount),
    ReverseBytes(Register, Register),
    ReverseHalfwords(Register, Register),
    ReverseSignedHalf(Register, Register),
    ReverseBits(Register, Register),
    CountLeadingZeros(Register, Register),

    // Multiplication and division.
    Multiply(Register, Register, Register, SetFlags),
    MultiplyAccumulate(Register, Register, Register, Register),
    MultiplySubtract(Register, Register, Register, Register),
    /// Low and high word of the result, n, m.
    LongMultiply(LongMultiply, Register, Register, Register, Register),
    DivideSigned(Register, Register, Register),
    DivideUnsigned(Register, Register, Register),

    // DSP extension.
    Dsp(DspMultiply, Register, Register, Register, Register),
    Parallel(ParallelOperation, Register, Register, Register),
    /// QADD or QSUB: d, n, m; m - n instead of m + n.
    SaturatingAdd(Register, Register, Register, bool),
    /// PKHBT or, with the high halfword of n, PKHTB.
    PackHalfwords(Register, Register, Register, bool, Shift, Amount),
    /// SSAT: d, n, number of bits, shift of n.
    SaturateSigned(Register, Register, u8, Shift, Amount),
    /// USAT: d, n, number of bits, shift of n.
    SaturateUnsigned(Register, Register, u8, Shift, Amount),

    // Branches.
    Branch(Offset),
    BranchIf(Condition, Offset),
    BranchLink(Offset),
    /// BX, which may be the return from an exception.
    BranchExchange(Register),
    BranchLinkExchange(Register),
    /// CBZ or, where not zero, CBNZ.
    CompareBranch(Register, bool, Offset),
    /// TBB or, with halfwords, TBH.
    TableBranch(Register, Register, bool),
    /// MOV PC, Rm.
    MoveToPc(Register),
    /// ADD PC, PC, Rm.
    AddRegisterToPc(Register),

    // Loads and stores of one register: constant offset,
    LoadWord(Register, Register, Offset),
    Load(LoadKind, Register, Register, Offset),
    StoreWord(Register, Register, Offset),
    Store(Width, Register, Register, Offset),
    // register offset, shifted left,
    LoadIndexed(LoadKind, Register, Register, Register, Amount),
    StoreIndexed(Width, Register, Register, Register, Amount),
    // base register written back,
    LoadWriteBack(LoadKind, Register, Register, IndexMode, i16),
    StoreWriteBack(Width, Register, Register, IndexMode, i16),
    // relative to the PC, aligned to a word,
    LoadLiteral(LoadKind, Register, Offset),
    // a word loaded into the PC.
    LoadToPc(Register, Offset),
    LoadToPcIndexed(Register, Register, Amount),
    LoadToPcLiteral(Offset),

    // Loads and stores of several registers.
    LoadDual(Register, Register, Register, IndexMode, i16),
    StoreDual(Register, Register, Register, IndexMode, i16),
    LoadDualLiteral(Register, Register, i16),
    LoadMultiple(Register, MultipleMode, RegisterList),
    StoreMultiple(Register, MultipleMode, RegisterList),
    Push(RegisterList),
    Pop(RegisterList),

    // Exclusive accesses.
    LoadExclusive(Width, Register, Register, u16),
    /// Width, status, t, n, offset.
    StoreExclusive(Width, Register, Register, Register, u16),
    ClearExclusive,

    // System.
    /// IT, with the ITSTATE that it sets.
    IfThen(u8),
    Hint(Hint),
    /// DSB and DMB.
    DataBarrier,
    /// ISB.
    SynchronisationBarrier,
    /// CPSID i or CPSIE i: whether interrupts are masked.
    ChangeState(bool),
    /// MRS.
    ReadSpecial(Register, SpecialRegister),
    /// MSR.
    WriteSpecial(Register, SpecialRegister),
    Breakpoint(u8),
    /// UDF and the encodings that the architecture defines as undefined.
    Undefined,
    /// An instruction for a coprocessor that the chip has not.
    NoCoprocessor,
    /// Encodings that the architecture leaves unpredictable, and instructions that are not modelled.
    Unsupported,

    // Floating point.
    FloatArithmetic(FloatArithmetic, FloatRegister, FloatRegister, FloatRegister),
    FloatUnary(FloatUnary, FloatRegister, FloatRegister),
    FloatMoveImmediate(FloatRegister, u32),
    /// VCMP or VCMPE.
    FloatCompare(FloatRegister, FloatRegister),
    FloatCompareZero(FloatRegister),
    /// VLDR: d, n, double word, offset.
    FloatLoad(FloatRegister, Register, bool, i16),
    /// VSTR: d, n, double word, offset.
    FloatStore(FloatRegister, Register, bool, i16),
    /// VLDM: first register, words, n, mode, bytes that the base moves.
    FloatLoadMultiple(FloatRegister, u8, Register, MultipleMode, i16),
    /// VSTM: first register, words, n, mode, bytes that the base moves.
    FloatStoreMultiple(FloatRegister, u8, Register, MultipleMode, i16),
    FloatFromCore(FloatRegister, Register),
    FloatToCore(Register, FloatRegister),
    /// Two consecutive single-precision registers from two core registers.
    FloatPairFromCore(FloatRegister, Register, Register),
    FloatPairToCore(Register, Register, FloatRegister),
    /// VMRS APSR_nzcv, FPSCR.
    ReadFloatFlags,
}

const _: () = assert!(size_of::<Instruction>() == 8);
