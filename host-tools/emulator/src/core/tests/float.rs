//! Floating-point arithmetic: values, NaN, modes, cumulative flags, comparison.

use crate::core::tests::Machine;

pub(super) const INVALID: u32 = 1 << 0;
pub(super) const DIVISION_BY_ZERO: u32 = 1 << 1;
pub(super) const OVERFLOW: u32 = 1 << 2;
pub(super) const UNDERFLOW: u32 = 1 << 3;
pub(super) const INEXACT: u32 = 1 << 4;
pub(super) const INPUT_DENORMAL: u32 = 1 << 7;

pub(super) const TO_PLUS: u32 = 1 << 22;
pub(super) const TO_MINUS: u32 = 2 << 22;
pub(super) const TO_ZERO: u32 = 3 << 22;
pub(super) const FLUSH: u32 = 1 << 24;
pub(super) const DEFAULT_NAN: u32 = 1 << 25;
pub(super) const ALTERNATIVE: u32 = 1 << 26;

pub(super) const ONE: u32 = 0x3F80_0000;
pub(super) const TWO: u32 = 0x4000_0000;
pub(super) const THREE: u32 = 0x4040_0000;
pub(super) const INFINITY: u32 = 0x7F80_0000;
pub(super) const MINUS: u32 = 0x8000_0000;
pub(super) const NAN: u32 = 0x7FC0_0000;
/// Largest finite and smallest normal number, smallest denormal.
pub(super) const MAX: u32 = 0x7F7F_FFFF;
pub(super) const MIN_NORMAL: u32 = 0x0080_0000;
pub(super) const DENORMAL: u32 = 0x0000_0001;
pub(super) const QUIET: u32 = 0x7FC1_2345;
pub(super) const SIGNALLING: u32 = 0x7F81_2345;

/// Mnemonic, halfwords, S0 to S2, FPSCR; S0 and FPSCR afterwards.
pub(super) type Case = (&'static str, [u16; 2], [u32; 3], u32, u32, u32);

pub(super) fn check(cases: &[Case]) {
    for &(mnemonic, halfwords, operands, before, result, after) in cases {
        let mut machine = Machine::with_float(&halfwords);
        for (number, &bits) in operands.iter().enumerate() {
            machine.core.set_float_register(number, bits);
        }
        // The context is new: its modes come from the FPDSCR.
        machine.system_write(0xE000_EF3C, before);
        machine.core.set_fpscr(before);
        machine.step(1);
        let found = (machine.core.float_register(0), machine.core.fpscr());
        assert_eq!(found, (result, after), "{mnemonic} of {operands:#010x?}, FPSCR {before:#x}");
    }
}

const VADD: [u16; 2] = [0xEE30, 0x0A81]; // vadd.f32 s0, s1, s2
const VSUB: [u16; 2] = [0xEE30, 0x0AC1]; // vsub.f32 s0, s1, s2
const VMUL: [u16; 2] = [0xEE20, 0x0A81]; // vmul.f32 s0, s1, s2
const VDIV: [u16; 2] = [0xEE80, 0x0A81]; // vdiv.f32 s0, s1, s2
const VSQRT: [u16; 2] = [0xEEB1, 0x0AE0]; // vsqrt.f32 s0, s1
const VMLA: [u16; 2] = [0xEE00, 0x0A81]; // vmla.f32 s0, s1, s2
const VFMA: [u16; 2] = [0xEEA0, 0x0A81]; // vfma.f32 s0, s1, s2

#[test]
fn arithmetic_rounds_and_collects_exceptions() {
    const THIRD: u32 = 0x3EAA_AAAB;
    check(&[
        ("vadd.f32", VADD, [0, ONE, TWO], 0, THREE, 0),
        ("vadd.f32", VADD, [0, ONE, 0x3300_0000], 0, ONE, INEXACT),
        // 1 + 2^-24 is a tie: to even. A little more rounds up.
        ("vadd.f32", VADD, [0, ONE, 0x3380_0000], 0, ONE, INEXACT),
        ("vadd.f32", VADD, [0, ONE, 0x3380_0001], 0, ONE + 1, INEXACT),
        ("vadd.f32", VADD, [0, ONE + 1, 0x3380_0000], 0, ONE + 2, INEXACT),
        ("vadd.f32", VADD, [0, ONE, 0x3300_0000], TO_PLUS, ONE + 1, TO_PLUS | INEXACT),
        ("vadd.f32", VADD, [0, ONE, 0xB300_0000], TO_MINUS, ONE - 1, TO_MINUS | INEXACT),
        ("vadd.f32", VADD, [0, ONE, 0xB300_0000], TO_ZERO, ONE - 1, TO_ZERO | INEXACT),
        ("vadd.f32", VADD, [0, MAX, MAX], 0, INFINITY, OVERFLOW | INEXACT),
        ("vadd.f32", VADD, [0, MAX, MAX], TO_ZERO, MAX, TO_ZERO | OVERFLOW | INEXACT),
        ("vsub.f32", VSUB, [0, ONE, ONE], 0, 0, 0),
        ("vsub.f32", VSUB, [0, ONE, ONE], TO_MINUS, MINUS, TO_MINUS),
        ("vsub.f32", VSUB, [0, MIN_NORMAL, DENORMAL], 0, MIN_NORMAL - 1, 0),
        ("vmul.f32", VMUL, [0, MIN_NORMAL, 0x3F00_0000], 0, MIN_NORMAL / 2, 0),
        ("vmul.f32", VMUL, [0, MIN_NORMAL, MIN_NORMAL], 0, 0, UNDERFLOW | INEXACT),
        ("vmul.f32", VMUL, [0, MINUS, ONE], INEXACT, MINUS, INEXACT),
        // 2^-127 (1 + 2^-23): inexact as a denormal.
        (
            "vmul.f32",
            VMUL,
            [0, MIN_NORMAL + 1, 0x3F00_0000],
            0,
            MIN_NORMAL / 2,
            UNDERFLOW | INEXACT,
        ),
        // Tininess is detected before the rounding to the smallest normal number.
        ("vmul.f32", VMUL, [0, 0x3F7F_FFFF, MIN_NORMAL], 0, MIN_NORMAL, UNDERFLOW | INEXACT),
        ("vmul.f32", VMUL, [0, 0x3F7F_FFFF, MIN_NORMAL], INEXACT, MIN_NORMAL, UNDERFLOW | INEXACT),
        ("vdiv.f32", VDIV, [0, ONE, THREE], 0, THIRD, INEXACT),
        ("vdiv.f32", VDIV, [0, ONE, THREE], TO_ZERO, THIRD - 1, TO_ZERO | INEXACT),
        ("vdiv.f32", VDIV, [0, ONE, MINUS], 0, INFINITY | MINUS, DIVISION_BY_ZERO),
        ("vdiv.f32", VDIV, [0, 0, MINUS], 0, NAN, INVALID),
        ("vdiv.f32", VDIV, [0, INFINITY, INFINITY], 0, NAN, INVALID),
        ("vsqrt.f32", VSQRT, [0, TWO, 0], 0, 0x3FB5_04F3, INEXACT),
        ("vsqrt.f32", VSQRT, [0, 0x4080_0000, 0], 0, TWO, 0),
        ("vsqrt.f32", VSQRT, [0, MINUS, 0], 0, MINUS, 0),
        ("vsqrt.f32", VSQRT, [0, ONE | MINUS, 0], 0, NAN, INVALID),
        ("vnmul.f32 s0, s1, s2", [0xEE20, 0x0AC1], [0, TWO, ONE], 0, TWO | MINUS, 0),
    ]);
}

#[test]
fn nan_operands_are_propagated_in_order() {
    const QUIETED: u32 = 0x7FC1_2345;
    const OTHER: u32 = 0xFFC0_0007;
    check(&[
        ("vadd.f32", VADD, [0, QUIET, OTHER], 0, QUIET, 0),
        ("vadd.f32", VADD, [0, ONE, OTHER], 0, OTHER, 0),
        // The signalling one precedes, and is quieted.
        ("vadd.f32", VADD, [0, OTHER, SIGNALLING], 0, QUIETED, INVALID),
        ("vadd.f32", VADD, [0, OTHER, ONE], DEFAULT_NAN, NAN, DEFAULT_NAN),
        // A difference takes the operand, not its negation.
        ("vsub.f32", VSUB, [0, ONE, QUIET], 0, QUIET, 0),
        ("vadd.f32", VADD, [0, INFINITY, INFINITY | MINUS], 0, NAN, INVALID),
        ("vmul.f32", VMUL, [0, INFINITY, 0], 0, NAN, INVALID),
        // The negation of a NaN product changes its sign.
        ("vmls.f32 s0, s1, s2", [0xEE00, 0x0AC1], [ONE, QUIET, ONE], 0, QUIET | MINUS, 0),
        ("vfma.f32", VFMA, [QUIET, INFINITY, 0], 0, NAN, INVALID),
        ("vfma.f32", VFMA, [SIGNALLING, INFINITY, 0], 0, QUIETED, INVALID),
        ("vneg.f32 s0, s1", [0xEEB1, 0x0A60], [0, SIGNALLING, 0], 0, SIGNALLING | MINUS, 0),
        ("vabs.f32 s0, s1", [0xEEB0, 0x0AE0], [0, OTHER, 0], 0, OTHER & !MINUS, 0),
    ]);
}

#[test]
fn flush_to_zero_affects_operands_and_results() {
    check(&[
        ("vadd.f32", VADD, [7, DENORMAL, 0], FLUSH, 0, FLUSH | INPUT_DENORMAL),
        ("vadd.f32", VADD, [7, MINUS | DENORMAL, ONE], FLUSH, ONE, FLUSH | INPUT_DENORMAL),
        // Flushed without being inexact.
        ("vmul.f32", VMUL, [7, MIN_NORMAL, 0xBF00_0000], FLUSH, MINUS, FLUSH | UNDERFLOW),
        (
            "vdiv.f32",
            VDIV,
            [7, ONE, DENORMAL],
            FLUSH,
            INFINITY,
            FLUSH | DIVISION_BY_ZERO | INPUT_DENORMAL,
        ),
        ("vadd.f32", VADD, [7, DENORMAL, 0], 0, DENORMAL, 0),
    ]);
}

#[test]
fn multiply_add_rounds_once_or_twice() {
    // (1 + 2^-23)^2 = 1 + 2^-22 + 2^-46; the last term is lost when the product is rounded.
    let x = ONE + 1;
    let minus_rounded = (ONE + 2) | MINUS;
    check(&[
        ("vmla.f32", VMLA, [minus_rounded, x, x], 0, 0, INEXACT),
        ("vfma.f32", VFMA, [minus_rounded, x, x], 0, 0x2880_0000, 0),
        ("vmla.f32", VMLA, [ONE, TWO, THREE], 0, 0x40E0_0000, 0),
        ("vmls.f32 s0, s1, s2", [0xEE00, 0x0AC1], [ONE, TWO, THREE], 0, 0xC0A0_0000, 0),
        ("vnmla.f32 s0, s1, s2", [0xEE10, 0x0AC1], [ONE, TWO, THREE], 0, 0xC0E0_0000, 0),
        ("vnmls.f32 s0, s1, s2", [0xEE10, 0x0A81], [ONE, TWO, THREE], 0, 0x40A0_0000, 0),
        ("vfms.f32 s0, s1, s2", [0xEEA0, 0x0AC1], [ONE, TWO, THREE], 0, 0xC0A0_0000, 0),
        ("vfnma.f32 s0, s1, s2", [0xEE90, 0x0AC1], [ONE, TWO, THREE], 0, 0xC0E0_0000, 0),
        ("vfnms.f32 s0, s1, s2", [0xEE90, 0x0A81], [ONE, TWO, THREE], 0, 0x40A0_0000, 0),
    ]);
}

#[test]
fn comparison_sets_flags_and_vmrs_moves_them() {
    const LESS: u32 = 0b1000 << 28;
    const EQUAL: u32 = 0b0110 << 28;
    const GREATER: u32 = 0b0010 << 28;
    const UNORDERED: u32 = 0b0011 << 28;
    let vcmp: &[u16] = &[0xEEB4, 0x0A60, 0xEEF1, 0xFA10]; // vcmp.f32 s0, s1; vmrs APSR_nzcv, fpscr
    let vcmpe: &[u16] = &[0xEEB4, 0x0AE0, 0xEEF1, 0xFA10]; // vcmpe.f32 s0, s1; vmrs APSR_nzcv, fpscr
    let zero: &[u16] = &[0xEEB5, 0x0A40, 0xEEF1, 0xFA10]; // vcmp.f32 s0, #0.0; vmrs APSR_nzcv, fpscr
    let cases = [
        (vcmp, ONE, TWO, 0, LESS, 0),
        (vcmp, ONE, ONE, 0, EQUAL, 0),
        (vcmp, TWO, ONE, 0, GREATER, 0),
        (vcmp, MINUS, 0, 0, EQUAL, 0),
        (vcmp, MINUS | TWO, MINUS | ONE, 0, LESS, 0),
        (vcmp, QUIET, ONE, 0, UNORDERED, 0),
        (vcmp, ONE, SIGNALLING, 0, UNORDERED, INVALID),
        (vcmpe, ONE, QUIET, 0, UNORDERED, INVALID),
        (vcmp, INFINITY, MAX, 0, GREATER, 0),
        (vcmp, DENORMAL, 0, 0, GREATER, 0),
        (vcmp, DENORMAL, MINUS | DENORMAL, FLUSH, EQUAL, FLUSH | INPUT_DENORMAL),
        (zero, MINUS | ONE, 0, 0, LESS, 0),
    ];
    for (program, a, b, before, flags, after) in cases {
        let mut machine = Machine::with_float(program);
        machine.system_write(0xE000_EF3C, before);
        machine.core.set_float_register(0, a);
        machine.core.set_float_register(1, b);
        machine.finish();
        assert_eq!(machine.flags(), flags, "{a:#x} {b:#x}");
        assert_eq!(machine.core.fpscr(), flags | after, "{a:#x} {b:#x}");
    }
}
