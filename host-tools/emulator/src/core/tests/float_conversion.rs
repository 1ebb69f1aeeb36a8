//! Conversions, moves and transfers of floating-point registers.

use crate::core::tests::float::*;
use crate::core::tests::{DATA, Machine, PROGRAM};

#[test]
fn conversions_to_integers_round_and_saturate() {
    const S32: [u16; 2] = [0xEEBD, 0x0AE0]; // vcvt.s32.f32 s0, s1
    const U32: [u16; 2] = [0xEEBC, 0x0AE0]; // vcvt.u32.f32 s0, s1
    const ROUNDED: [u16; 2] = [0xEEBD, 0x0A60]; // vcvtr.s32.f32 s0, s1
    const HALF: u32 = 0x3F00_0000;
    const ONE_AND_HALF: u32 = 0x3FC0_0000;
    check(&[
        ("vcvt.s32.f32", S32, [0, 0xBFC0_0000, 0], 0, -1i32 as u32, INEXACT),
        ("vcvt.s32.f32", S32, [0, 0x4F00_0000, 0], 0, i32::MAX as u32, INVALID),
        ("vcvt.s32.f32", S32, [0, 0xCF00_0000, 0], 0, i32::MIN as u32, 0),
        ("vcvt.s32.f32", S32, [0, 0xCF00_0001, 0], 0, i32::MIN as u32, INVALID),
        ("vcvt.s32.f32", S32, [0, QUIET, 0], 0, 0, INVALID),
        ("vcvt.s32.f32", S32, [0, INFINITY | MINUS, 0], 0, i32::MIN as u32, INVALID),
        ("vcvt.u32.f32", U32, [0, 0x4F80_0000, 0], 0, u32::MAX, INVALID),
        ("vcvt.u32.f32", U32, [0, 0x4F7F_FFFF, 0], 0, 0xFFFF_FF00, 0),
        ("vcvt.u32.f32", U32, [0, MINUS | ONE, 0], INEXACT, 0, INEXACT | INVALID),
        ("vcvt.u32.f32", U32, [0, MINUS | HALF, 0], 0, 0, INEXACT),
        ("vcvtr.s32.f32", ROUNDED, [0, HALF, 0], 0, 0, INEXACT),
        ("vcvtr.s32.f32", ROUNDED, [0, ONE_AND_HALF, 0], 0, 2, INEXACT),
        ("vcvtr.s32.f32", ROUNDED, [0, HALF, 0], TO_PLUS, 1, TO_PLUS | INEXACT),
        ("vcvtr.s32.f32", ROUNDED, [0, MINUS | HALF, 0], TO_MINUS, u32::MAX, TO_MINUS | INEXACT),
        ("vcvtr.s32.f32", ROUNDED, [0, ONE_AND_HALF, 0], TO_ZERO, 1, TO_ZERO | INEXACT),
    ]);
}

#[test]
fn conversions_from_integers_round_by_mode() {
    const FROM_S32: [u16; 2] = [0xEEB8, 0x0AE0]; // vcvt.f32.s32 s0, s1
    const FROM_U32: [u16; 2] = [0xEEB8, 0x0A60]; // vcvt.f32.u32 s0, s1
    check(&[
        ("vcvt.f32.s32", FROM_S32, [0, -2i32 as u32, 0], 0, TWO | MINUS, 0),
        ("vcvt.f32.u32", FROM_U32, [0, -2i32 as u32, 0], 0, 0x4F80_0000, INEXACT),
        // 2^24 + 1
        ("vcvt.f32.s32", FROM_S32, [0, 0x0100_0001, 0], 0, 0x4B80_0000, INEXACT),
        ("vcvt.f32.s32", FROM_S32, [0, 0x0100_0001, 0], TO_PLUS, 0x4B80_0001, TO_PLUS | INEXACT),
        ("vcvt.f32.s32", FROM_S32, [0, 0x0100_0003, 0], INEXACT, 0x4B80_0002, INEXACT),
        ("vcvt.f32.u32", FROM_U32, [0, 0, 0], TO_MINUS, 0, TO_MINUS),
    ]);
}

#[test]
fn fixed_point_conversions_scale_by_fraction_bits() {
    check(&[
        // 1.5 with 16 bits of fraction
        ("vcvt.s32.f32 s0, s0, #16", [0xEEBE, 0x0AC8], [0x3FC0_0000, 0, 0], 0, 0x0001_8000, 0),
        ("vcvt.f32.s32 s0, s0, #16", [0xEEBA, 0x0AC8], [0xFFFE_8000, 0, 0], 0, 0xBFC0_0000, 0),
        ("vcvt.u16.f32 s0, s0, #8", [0xEEBF, 0x0A44], [0x4380_0000, 0, 0], 0, 0xFFFF, INVALID),
        ("vcvt.s16.f32 s0, s0, #8", [0xEEBE, 0x0A44], [0xC380_0000, 0, 0], 0, 0xFFFF_8000, INVALID),
        ("vcvt.s16.f32 s0, s0, #4", [0xEEBE, 0x0A46], [0xBDCC_CCCD, 0, 0], 0, 0xFFFF_FFFF, INEXACT),
        ("vcvt.f32.u16 s0, s0, #1", [0xEEBB, 0x0A67], [0x1234_0003, 0, 0], 0, 0x3FC0_0000, 0),
        // To nearest, whatever the mode.
        (
            "vcvt.f32.u32 s0, s0, #32",
            [0xEEBB, 0x0AC0],
            [u32::MAX, 0, 0],
            TO_ZERO,
            ONE,
            TO_ZERO | INEXACT,
        ),
    ]);
}

#[test]
fn half_precision_conversions_use_one_half() {
    const TO_BOTTOM: [u16; 2] = [0xEEB3, 0x0A60]; // vcvtb.f16.f32 s0, s1
    const TO_TOP: [u16; 2] = [0xEEB3, 0x0AE0]; // vcvtt.f16.f32 s0, s1
    const FROM_BOTTOM: [u16; 2] = [0xEEB2, 0x0A60]; // vcvtb.f32.f16 s0, s1
    const FROM_TOP: [u16; 2] = [0xEEB2, 0x0AE0]; // vcvtt.f32.f16 s0, s1
    check(&[
        ("vcvtb.f16.f32", TO_BOTTOM, [0xAAAA_BBBB, ONE, 0], 0, 0xAAAA_3C00, 0),
        ("vcvtt.f16.f32", TO_TOP, [0xAAAA_BBBB, MINUS | TWO, 0], 0, 0xC000_BBBB, 0),
        // 65520 is a tie between the largest number, 65504, and the next: infinity.
        ("vcvtb.f16.f32", TO_BOTTOM, [0, 0x477F_F000, 0], 0, 0x7C00, OVERFLOW | INEXACT),
        ("vcvtb.f16.f32", TO_BOTTOM, [0, 0x477F_EFFF, 0], 0, 0x7BFF, INEXACT),
        ("vcvtb.f16.f32", TO_BOTTOM, [0, 0x4780_0000, 0], ALTERNATIVE, 0x7C00, ALTERNATIVE),
        ("vcvtb.f16.f32", TO_BOTTOM, [0, INFINITY, 0], ALTERNATIVE, 0x7FFF, ALTERNATIVE | INVALID),
        ("vcvtb.f16.f32", TO_BOTTOM, [0, SIGNALLING, 0], 0, 0x7E09, INVALID),
        // 2^-24 is the smallest denormal; half of it is a tie to zero.
        ("vcvtb.f16.f32", TO_BOTTOM, [0, 0x3380_0000, 0], 0, 0x0001, 0),
        ("vcvtb.f16.f32", TO_BOTTOM, [0, 0x3300_0000, 0], 0, 0, UNDERFLOW | INEXACT),
        ("vcvtb.f32.f16", FROM_BOTTOM, [0, 0x1234_3C00, 0], 0, ONE, 0),
        ("vcvtt.f32.f16", FROM_TOP, [0, 0xC000_3C00, 0], 0, TWO | MINUS, 0),
        ("vcvtb.f32.f16", FROM_BOTTOM, [0, 0x0001, 0], FLUSH, 0x3380_0000, FLUSH),
        ("vcvtb.f32.f16", FROM_BOTTOM, [0, 0x7C01, 0], 0, 0x7FC0_2000, INVALID),
        ("vcvtb.f32.f16", FROM_BOTTOM, [0, 0x7C00, 0], ALTERNATIVE, 0x4780_0000, ALTERNATIVE),
    ]);
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
    assert!(matches!(machine.run(), super::Stop::Unsupported { .. }));

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
    assert_eq!(machine.r(13), super::STACK - 4);
    assert_eq!(machine.word(super::STACK + 4), 16);
    assert_eq!(machine.word(super::STACK + 8), 17);
}

#[test]
fn literal_of_a_float_uses_the_aligned_pc() {
    let mut machine = Machine::with_float(&[0xBF00, 0xED9F, 0x0A00, 0x1234, 0x5678]); // nop; vldr s0, [pc]
    machine.step(2);
    // PROGRAM + 6 aligned down is PROGRAM + 4: the second halfword of the instruction and the next.
    assert_eq!(machine.core.float_register(0), 0x1234_0A00);
    assert_eq!(machine.core.pc(), PROGRAM + 6);
}

#[test]
fn fpscr_has_its_implemented_bits_only() {
    let mut machine = Machine::with_float(&[
        0xEEE1, 0x0A10, // vmsr fpscr, r0
        0xEEF1, 0x1A10, // vmrs r1, fpscr
    ]);
    machine.core.set_register(0, u32::MAX);
    machine.finish();
    assert_eq!(machine.r(1), 0xF7C0_009F);
}
