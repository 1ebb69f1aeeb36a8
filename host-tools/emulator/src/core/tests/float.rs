//! Floating point: arithmetic, NaN, comparison, conversions, moves and transfers.

use crate::core::tests::{DATA, Machine, PROGRAM, STACK, Stop};

const ONE: u32 = 0x3F80_0000;
const TWO: u32 = 0x4000_0000;
const THREE: u32 = 0x4040_0000;
const INFINITY: u32 = 0x7F80_0000;
const MINUS: u32 = 0x8000_0000;
const NAN: u32 = 0x7FC0_0000;
/// Largest finite and smallest normal number, smallest denormal.
const MAX: u32 = 0x7F7F_FFFF;
const MIN_NORMAL: u32 = 0x0080_0000;
const DENORMAL: u32 = 0x0000_0001;
const QUIET: u32 = 0x7FC1_2345;
const SIGNALLING: u32 = 0x7F81_2345;

/// Instructions by S0 to S2, which leave their result in S0.
fn check(cases: &[(&str, [u16; 2], [u32; 3], u32)]) {
    for &(mnemonic, halfwords, operands, result) in cases {
        let mut machine = Machine::with_float(&halfwords);
        for (number, &bits) in operands.iter().enumerate() {
            machine.core.set_float_register(number, bits);
        }
        machine.step(1);
        let found = machine.core.float_register(0);
        assert_eq!(found, result, "{mnemonic} of {operands:#010x?}: {found:#x}");
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
fn arithmetic_rounds_to_nearest() {
    check(&[
        ("vadd.f32", VADD, [0, ONE, TWO], THREE),
        // 1 + 2^-24 is a tie: to even. A little more rounds up.
        ("vadd.f32", VADD, [0, ONE, 0x3380_0000], ONE),
        ("vadd.f32", VADD, [0, ONE, 0x3380_0001], ONE + 1),
        ("vadd.f32", VADD, [0, MAX, MAX], INFINITY),
        ("vadd.f32", VADD, [7, DENORMAL, 0], DENORMAL),
        ("vsub.f32", VSUB, [0, ONE, ONE], 0),
        ("vsub.f32", VSUB, [0, MIN_NORMAL, DENORMAL], MIN_NORMAL - 1),
        ("vmul.f32", VMUL, [0, MIN_NORMAL, 0x3F00_0000], MIN_NORMAL / 2),
        ("vmul.f32", VMUL, [0, MINUS, ONE], MINUS),
        ("vdiv.f32", VDIV, [0, ONE, THREE], 0x3EAA_AAAB),
        ("vdiv.f32", VDIV, [0, ONE, MINUS], INFINITY | MINUS),
        ("vsqrt.f32", VSQRT, [0, TWO, 0], 0x3FB5_04F3),
        ("vsqrt.f32", VSQRT, [0, MINUS, 0], MINUS),
        ("vnmul.f32 s0, s1, s2", [0xEE20, 0x0AC1], [0, TWO, ONE], TWO | MINUS),
    ]);
}

#[test]
fn nan_operands_are_propagated_in_order() {
    const QUIETED: u32 = 0x7FC1_2345;
    const OTHER: u32 = 0xFFC0_0007;
    check(&[
        ("vadd.f32", VADD, [0, QUIET, OTHER], QUIET),
        ("vadd.f32", VADD, [0, ONE, OTHER], OTHER),
        // The signalling one precedes, and is quieted.
        ("vadd.f32", VADD, [0, OTHER, SIGNALLING], QUIETED),
        // A difference takes the operand, not its negation.
        ("vsub.f32", VSUB, [0, ONE, QUIET], QUIET),
        ("vadd.f32", VADD, [0, INFINITY, INFINITY | MINUS], NAN),
        ("vmul.f32", VMUL, [0, INFINITY, 0], NAN),
        ("vdiv.f32", VDIV, [0, 0, MINUS], NAN),
        ("vsqrt.f32", VSQRT, [0, ONE | MINUS, 0], NAN),
        // The negation of a NaN product changes its sign.
        ("vmls.f32 s0, s1, s2", [0xEE00, 0x0AC1], [ONE, QUIET, ONE], QUIET | MINUS),
        ("vfma.f32", VFMA, [QUIET, INFINITY, 0], NAN),
        ("vfma.f32", VFMA, [SIGNALLING, INFINITY, 0], QUIETED),
        ("vneg.f32 s0, s1", [0xEEB1, 0x0A60], [0, SIGNALLING, 0], SIGNALLING | MINUS),
        ("vabs.f32 s0, s1", [0xEEB0, 0x0AE0], [0, OTHER, 0], OTHER & !MINUS),
    ]);
}

#[test]
fn multiply_add_rounds_once_or_twice() {
    // (1 + 2^-23)^2 = 1 + 2^-22 + 2^-46; the last term is lost when the product is rounded.
    let x = ONE + 1;
    let minus_rounded = (ONE + 2) | MINUS;
    check(&[
        ("vmla.f32", VMLA, [minus_rounded, x, x], 0),
        ("vfma.f32", VFMA, [minus_rounded, x, x], 0x2880_0000),
        ("vmla.f32", VMLA, [ONE, TWO, THREE], 0x40E0_0000),
        ("vmls.f32 s0, s1, s2", [0xEE00, 0x0AC1], [ONE, TWO, THREE], 0xC0A0_0000),
        ("vnmla.f32 s0, s1, s2", [0xEE10, 0x0AC1], [ONE, TWO, THREE], 0xC0E0_0000),
        ("vnmls.f32 s0, s1, s2", [0xEE10, 0x0A81], [ONE, TWO, THREE], 0x40A0_0000),
        ("vfms.f32 s0, s1, s2", [0xEEA0, 0x0AC1], [ONE, TWO, THREE], 0xC0A0_0000),
        ("vfnma.f32 s0, s1, s2", [0xEE90, 0x0AC1], [ONE, TWO, THREE], 0xC0E0_0000),
        ("vfnms.f32 s0, s1, s2", [0xEE90, 0x0A81], [ONE, TWO, THREE], 0x40A0_0000),
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
        (vcmp, ONE, TWO, LESS),
        (vcmp, ONE, ONE, EQUAL),
        (vcmp, TWO, ONE, GREATER),
        (vcmp, MINUS, 0, EQUAL),
        (vcmp, MINUS | TWO, MINUS | ONE, LESS),
        (vcmp, QUIET, ONE, UNORDERED),
        (vcmpe, ONE, QUIET, UNORDERED),
        (vcmp, INFINITY, MAX, GREATER),
        (vcmp, DENORMAL, 0, GREATER),
        (zero, MINUS | ONE, 0, LESS),
    ];
    for (program, a, b, flags) in cases {
        let mut machine = Machine::with_float(program);
        machine.core.set_float_register(0, a);
        machine.core.set_float_register(1, b);
        machine.finish();
        assert_eq!(machine.flags(), flags, "{a:#x} {b:#x}");
    }
}

#[test]
fn conversions_of_integers_round_and_saturate() {
    const S32: [u16; 2] = [0xEEBD, 0x0AE0]; // vcvt.s32.f32 s0, s1
    const U32: [u16; 2] = [0xEEBC, 0x0AE0]; // vcvt.u32.f32 s0, s1
    const ROUNDED: [u16; 2] = [0xEEBD, 0x0A60]; // vcvtr.s32.f32 s0, s1
    const FROM_S32: [u16; 2] = [0xEEB8, 0x0AE0]; // vcvt.f32.s32 s0, s1
    const FROM_U32: [u16; 2] = [0xEEB8, 0x0A60]; // vcvt.f32.u32 s0, s1
    const ONE_AND_HALF: u32 = 0x3FC0_0000;
    check(&[
        ("vcvt.s32.f32", S32, [0, MINUS | ONE_AND_HALF, 0], -1i32 as u32),
        ("vcvt.s32.f32", S32, [0, 0x4F00_0000, 0], i32::MAX as u32),
        ("vcvt.s32.f32", S32, [0, QUIET, 0], 0),
        ("vcvt.s32.f32", S32, [0, INFINITY | MINUS, 0], i32::MIN as u32),
        ("vcvt.u32.f32", U32, [0, 0x4F80_0000, 0], u32::MAX),
        ("vcvt.u32.f32", U32, [0, 0x4F7F_FFFF, 0], 0xFFFF_FF00),
        ("vcvt.u32.f32", U32, [0, MINUS | ONE, 0], 0),
        ("vcvtr.s32.f32", ROUNDED, [0, 0x3F00_0000, 0], 0),
        ("vcvtr.s32.f32", ROUNDED, [0, ONE_AND_HALF, 0], 2),
        ("vcvt.f32.s32", FROM_S32, [0, -2i32 as u32, 0], TWO | MINUS),
        ("vcvt.f32.u32", FROM_U32, [0, -2i32 as u32, 0], 0x4F80_0000),
        // 2^24 + 1
        ("vcvt.f32.s32", FROM_S32, [0, 0x0100_0001, 0], 0x4B80_0000),
    ]);
}

#[test]
fn modes_half_precision_and_fixed_point_stop_the_core() {
    for (mnemonic, halfwords) in [
        ("vmsr fpscr, r0", [0xEEE1, 0x0A10]),
        ("vmrs r1, fpscr", [0xEEF1, 0x1A10]),
        ("vcvtb.f16.f32 s0, s1", [0xEEB3, 0x0A60]),
        ("vcvtt.f32.f16 s0, s1", [0xEEB2, 0x0AE0]),
        ("vcvt.s32.f32 s0, s0, #16", [0xEEBE, 0x0AC8]),
        ("vcvt.f32.u16 s0, s0, #1", [0xEEBB, 0x0A67]),
    ] {
        let stop = Machine::with_float(&halfwords).run();
        assert_eq!(stop, Stop::Unsupported { address: PROGRAM, halfwords }, "{mnemonic}");
    }
}

#[test]
fn moves_between_registers_keep_all_bits() {
    let mut machine = Machine::with_float(&[
        0xEE00, 0x0A10, // vmov s0, r0
        0xEE10, 0x1A10, // vmov r1, s0
        0xEC43, 0x2B11, // vmov d1, r2, r3
        0xEC55, 0x4B11, // vmov r4, r5, d1
        0xEC43, 0x2A32, // vmov s5, s6, r2, r3
        0xEE24, 0x0B10, // vmov.32 d4[1], r0
        0xEE14, 0x6B10, // vmov.32 r6, d4[0]
        0xEEB0, 0x5A40, // vmov.f32 s10, s0
        0xEEF7, 0x5A08, // vmov.f32 s11, #1.5
        0xEEB8, 0x6A00, // vmov.f32 s12, #-2.0
    ]);
    for (number, value) in [SIGNALLING, 0, 0x2222, 0x3333].into_iter().enumerate() {
        machine.core.set_register(number, value);
    }
    machine.finish();
    assert_eq!([1, 4, 5, 6].map(|k| machine.r(k)), [SIGNALLING, 0x2222, 0x3333, 0]);
    let s = |k| machine.core.float_register(k);
    assert_eq!([2, 3, 5, 6].map(s), [0x2222, 0x3333, 0x2222, 0x3333]);
    assert_eq!([9, 10, 11, 12].map(s), [SIGNALLING, SIGNALLING, 0x3FC0_0000, 0xC000_0000]);
}

#[test]
fn transfers_of_single_double_and_several_registers() {
    let mut machine = Machine::with_float(&[
        0xED91, 0x0A01, // vldr s0, [r1, #4]
        0xED11, 0x1B02, // vldr d1, [r1, #-8]
        0xECB1, 0x5A02, // vldmia r1!, {s10, s11}
        0xED61, 0x0B02, // would be vstmdb r1!, {d16}
    ]);
    for k in 0..4 {
        machine.set_word(DATA + 4 * k, 0x10 + k);
    }
    machine.core.set_register(1, DATA + 8);
    machine.step(3);
    let s = |k| machine.core.float_register(k);
    assert_eq!([0, 2, 3, 10, 11].map(s), [0x13, 0x10, 0x11, 0x12, 0x13]);
    assert_eq!(machine.r(1), DATA + 16);
    // There are 16 double-precision registers.
    assert!(matches!(machine.run(), Stop::Unsupported { .. }));

    let mut machine = Machine::with_float(&[
        0xED2D, 0x8B04, // vpush {d8, d9}
        0xECBD, 0x0A03, // vpop {s0, s1, s2}
        0xED8D, 0x0B02, // vstr d0, [sp, #8]
    ]);
    for k in 16..20 {
        machine.core.set_float_register(k, k as u32);
    }
    machine.finish();
    assert_eq!([0, 1, 2].map(|k| machine.core.float_register(k)), [16, 17, 18]);
    assert_eq!(machine.r(13), STACK - 4);
    assert_eq!(machine.word(STACK + 4), 16);
    assert_eq!(machine.word(STACK + 8), 17);
}

#[test]
fn literal_of_a_float_uses_the_aligned_pc() {
    let mut machine = Machine::with_float(&[0xBF00, 0xED9F, 0x0A00, 0x1234, 0x5678]); // nop; vldr s0, [pc]
    machine.step(2);
    // PROGRAM + 6 aligned down is PROGRAM + 4: the second halfword of the instruction and the next.
    assert_eq!(machine.core.float_register(0), 0x1234_0A00);
    assert_eq!(machine.core.pc(), PROGRAM + 6);
}
