//! DSP extension: results and the flag Q.

use crate::core::tests::{Q, execute};

/// Mnemonic, halfwords, r0 to r2; r0 and Q afterwards.
type Case = (&'static str, [u16; 2], [u32; 3], u32, u32);

fn check(cases: &[Case]) {
    for &(mnemonic, halfwords, registers, result, flags) in cases {
        let machine = execute(&halfwords, &registers, 0);
        let found = (machine.r(0), machine.flags());
        assert_eq!(found, (result, flags), "{mnemonic} of {registers:#010x?}");
    }
}

#[test]
fn saturations_limit_and_set_q() {
    check(&[
        ("ssat r0, #8, r0", [0xF300, 0x0007], [200, 0, 0], 127, Q),
        ("ssat r0, #8, r0", [0xF300, 0x0007], [-200i32 as u32, 0, 0], -128i32 as u32, Q),
        ("ssat r0, #8, r0", [0xF300, 0x0007], [-128i32 as u32, 0, 0], -128i32 as u32, 0),
        ("ssat r0, #1, r0", [0xF300, 0x0000], [1, 0, 0], 0, Q),
        ("ssat r0, #32, r0", [0xF300, 0x001F], [0x8000_0000, 0, 0], 0x8000_0000, 0),
        ("ssat r0, #16, r0, lsl #8", [0xF300, 0x200F], [0x100, 0, 0], 0x7FFF, Q),
        ("ssat r0, #16, r0, asr #4", [0xF320, 0x100F], [0x8000, 0, 0], 0x800, 0),
        ("usat r0, #8, r0", [0xF380, 0x0008], [u32::MAX, 0, 0], 0, Q),
        ("usat r0, #8, r0", [0xF380, 0x0008], [256, 0, 0], 255, Q),
        ("usat r0, #8, r0", [0xF380, 0x0008], [255, 0, 0], 255, 0),
        ("usat r0, #0, r0", [0xF380, 0x0000], [1, 0, 0], 0, Q),
        ("usat r0, #31, r0", [0xF380, 0x001F], [0x7FFF_FFFF, 0, 0], 0x7FFF_FFFF, 0),
        ("qadd r0, r0, r1", [0xFA81, 0xF080], [0x7FFF_FFFF, 1, 0], 0x7FFF_FFFF, Q),
        ("qadd r0, r0, r1", [0xFA81, 0xF080], [0x7FFF_FFFE, 1, 0], 0x7FFF_FFFF, 0),
        ("qsub r0, r0, r1", [0xFA81, 0xF0A0], [0x8000_0000, 1, 0], 0x8000_0000, Q),
        // The doubling saturates for itself: 0 - 0x7FFF_FFFF.
        ("qdsub r0, r0, r1", [0xFA81, 0xF0B0], [0, 0x4000_0000, 0], 0x8000_0001, Q),
        ("qdadd r0, r0, r1", [0xFA81, 0xF090], [5, -3i32 as u32, 0], -1i32 as u32, 0),
    ]);
}

#[test]
fn multiplications_of_halves_overflow_into_q() {
    check(&[
        // (-2^15)^2 + 2^30 = 2^31
        ("smlabb r0, r0, r1, r2", [0xFB10, 0x2001], [0x8000, 0x8000, 0x4000_0000], 0x8000_0000, Q),
        ("smlatb r0, r0, r1, r2", [0xFB10, 0x2021], [0x0002_0000, 3, 4], 10, 0),
        ("smulbt r0, r0, r1", [0xFB10, 0xF011], [-2i32 as u32, 0x0003_0000, 9], -6i32 as u32, 0),
        // 0x1_0000 * -2 >> 16, and the remainder is cut off toward minus infinity
        ("smulwb r0, r0, r1", [0xFB30, 0xF001], [0x1_0000, 0xFFFE, 0], -2i32 as u32, 0),
        ("smulwb r0, r0, r1", [0xFB30, 0xF001], [1, 0xFFFF, 0], u32::MAX, 0),
        (
            "smlawt r0, r0, r1, r2",
            [0xFB30, 0x2011],
            [0x1_0000, 0x0001_0000, 0x7FFF_FFFF],
            0x8000_0000,
            Q,
        ),
        // 2 * 0x7FFF^2 = 0x7FFE_0002
        ("smlad r0, r0, r1, r2", [0xFB20, 0x2001], [0x7FFF_7FFF, 0x7FFF_7FFF, 0], 0x7FFE_0002, 0),
        (
            "smlad r0, r0, r1, r2",
            [0xFB20, 0x2001],
            [0x7FFF_7FFF, 0x7FFF_7FFF, 0x2_0000],
            0x8000_0002,
            Q,
        ),
        ("smuad r0, r0, r1", [0xFB20, 0xF001], [0x8000_8000, 0x8000_8000, 0], 0x8000_0000, Q),
        // 2 * 5 + 3 * 4
        ("smuadx r0, r0, r1", [0xFB20, 0xF011], [0x0003_0002, 0x0005_0004, 0], 22, 0),
        // 2 * 4 - 3 * 5 + 1
        ("smlsd r0, r0, r1, r2", [0xFB40, 0x2001], [0x0003_0002, 0x0005_0004, 1], -6i32 as u32, 0),
        // 2 * 5 - 3 * 4
        ("smusdx r0, r0, r1", [0xFB40, 0xF011], [0x0003_0002, 0x0005_0004, 0], -2i32 as u32, 0),
        // -2^31: the high word, without and with rounding
        ("smmul r0, r0, r1", [0xFB50, 0xF001], [1, 0x8000_0000, 0], u32::MAX, 0),
        ("smmulr r0, r0, r1", [0xFB50, 0xF011], [1, 0x8000_0000, 0], 0, 0),
        ("smmla r0, r0, r1, r2", [0xFB50, 0x2001], [0x4000_0000, 8, 5], 7, 0),
        // 2^32 * 1 - 1 = 0x0000_0000_FFFF_FFFF
        ("smmls r0, r0, r1, r2", [0xFB60, 0x2001], [1, 1, 1], 0, 0),
        ("smmlsr r0, r0, r1, r2", [0xFB60, 0x2011], [1, 1, 1], 1, 0),
    ]);
}

#[test]
fn parallel_arithmetic_wraps_or_saturates() {
    check(&[
        ("uadd8 r0, r0, r1", [0xFA80, 0xF041], [0xFF01_80FF, 0x01FF_8000, 0], 0x0000_00FF, 0),
        ("usub8 r0, r0, r1", [0xFAC0, 0xF041], [0x0102_0304, 0x0201_0305, 0], 0xFF01_00FF, 0),
        ("sadd16 r0, r0, r1", [0xFA90, 0xF001], [0x7FFF_8000, 0x0001_FFFF, 0], 0x8000_7FFF, 0),
        ("ssub16 r0, r0, r1", [0xFAD0, 0xF001], [0x0003_0003, 0x0004_0003, 0], 0xFFFF_0000, 0),
        ("qadd16 r0, r0, r1", [0xFA90, 0xF011], [0x7FFF_8000, 0x0001_FFFF, 0], 0x7FFF_8000, 0),
        ("qsub8 r0, r0, r1", [0xFAC0, 0xF011], [0x807F_0005, 0x01FF_0003, 0], 0x807F_0002, 0),
        ("uqadd8 r0, r0, r1", [0xFA80, 0xF051], [0xFF01_80FF, 0x01FF_8000, 0], 0xFFFF_FFFF, 0),
        ("uqsub16 r0, r0, r1", [0xFAD0, 0xF051], [0x0003_0005, 0x0004_0003, 0], 0x0000_0002, 0),
    ]);
}

#[test]
fn pkh_combines_halves() {
    check(&[
        ("pkhbt r0, r0, r1", [0xEAC0, 0x0001], [0x1111_2222, 0x3333_4444, 0], 0x3333_2222, 0),
        (
            "pkhbt r0, r0, r1, lsl #16",
            [0xEAC0, 0x4001],
            [0x1111_2222, 0x3333_4444, 0],
            0x4444_2222,
            0,
        ),
        (
            "pkhtb r0, r0, r1, asr #16",
            [0xEAC0, 0x4021],
            [0x1111_2222, 0x8333_4444, 0],
            0x1111_8333,
            0,
        ),
        // The encoded shift of 0 is one of 32.
        (
            "pkhtb r0, r0, r1, asr #32",
            [0xEAC0, 0x0021],
            [0x1111_2222, 0x8333_4444, 0],
            0x1111_FFFF,
            0,
        ),
    ]);
}
