//! Integer arithmetic: results and flags.

use crate::core::tests::{C, Machine, N, Q, V, Z, execute};

/// Mnemonic, halfwords, r0 to r3, flags before; r0 and flags after.
type Case = (&'static str, &'static [u16], [u32; 4], u32, u32, u32);

fn check(cases: &[Case]) {
    for &(mnemonic, halfwords, registers, before, result, after) in cases {
        let machine = execute(halfwords, &registers, before);
        let found = (machine.r(0), machine.flags());
        assert_eq!(found, (result, after), "{mnemonic} of {registers:#010x?}, flags {before:#x}");
        assert_eq!(machine.core.pc(), super::PROGRAM + 2 * halfwords.len() as u32, "{mnemonic}");
    }
}

#[test]
fn additions_and_subtractions_give_result_and_flags() {
    const MAX: u32 = 0x7FFF_FFFF;
    const MIN: u32 = 0x8000_0000;
    check(&[
        ("adds r0, r0, r1", &[0x1840], [u32::MAX, 1, 0, 0], 0, 0, Z | C),
        ("adds r0, r0, r1", &[0x1840], [MAX, 1, 0, 0], C, MIN, N | V),
        ("adds r0, r0, r1", &[0x1840], [MIN, MIN, 0, 0], 0, 0, Z | C | V),
        ("adcs r0, r1", &[0x4148], [u32::MAX, 0, 0, 0], C, 0, Z | C),
        ("adcs r0, r1", &[0x4148], [MAX, 0, 0, 0], C, MIN, N | V),
        ("adcs r0, r1", &[0x4148], [MAX, 0, 0, 0], 0, MAX, 0),
        ("adcs r0, r1", &[0x4148], [MIN, MIN, 0, 0], C, 1, C | V),
        ("adcs r0, r1", &[0x4148], [u32::MAX, u32::MAX, 0, 0], C, u32::MAX, N | C),
        ("sbcs r0, r1", &[0x4188], [0, 0, 0, 0], 0, u32::MAX, N),
        ("sbcs r0, r1", &[0x4188], [5, 3, 0, 0], C, 2, C),
        ("sbcs r0, r1", &[0x4188], [5, 5, 0, 0], C, 0, Z | C),
        ("sbcs r0, r1", &[0x4188], [MIN, 0, 0, 0], 0, MAX, C | V),
        ("sbcs r0, r1", &[0x4188], [0, u32::MAX, 0, 0], 0, 0, Z),
        ("subs r0, r0, r1", &[0x1A40], [3, 5, 0, 0], 0, 0xFFFF_FFFE, N),
        ("subs r0, r0, r1", &[0x1A40], [MIN, 1, 0, 0], 0, MAX, C | V),
        ("subs r0, r0, r1", &[0x1A40], [MAX, u32::MAX, 0, 0], 0, MIN, N | V),
        ("negs r0, r1", &[0x4248], [7, MIN, 0, 0], C, MIN, N | V),
        ("negs r0, r1", &[0x4248], [7, 0, 0, 0], 0, 0, Z | C),
        ("rsb r0, r1, #10", &[0xF1C1, 0x000A], [7, 3, 0, 0], V, 7, V),
        ("cmn r0, r1", &[0x42C8], [1, u32::MAX, 0, 0], 0, 1, Z | C),
        ("cmp r0, r1", &[0x4288], [1, 2, 0, 0], C, 1, N),
        ("cmp r0, r1", &[0x4288], [2, 2, 0, 0], 0, 2, Z | C),
        ("sbc.w r0, r1, #0", &[0xF161, 0x0000], [9, 5, 0, 0], 0, 4, 0),
        ("adds.w r0, r1, r2, lsl #4", &[0xEB11, 0x1002], [0, 1, 2, 0], N, 33, 0),
        ("rsbs r0, r1, r2, asr #1", &[0xEBD1, 0x0062], [0, 1, 8, 0], 0, 3, C),
        ("addw r0, r1, #4095", &[0xF601, 0x70FF], [0, 1, 0, 0], C, 4096, C),
    ]);
}

#[test]
fn shifts_by_register_use_the_low_byte_of_the_amount() {
    const X: u32 = 0x8000_0001;
    check(&[
        ("lsls r0, r1", &[0x4088], [X, 0, 0, 0], C, X, N | C),
        ("lsls r0, r1", &[0x4088], [X, 1, 0, 0], 0, 2, C),
        ("lsls r0, r1", &[0x4088], [X, 31, 0, 0], C, 0x8000_0000, N),
        ("lsls r0, r1", &[0x4088], [X, 32, 0, 0], 0, 0, Z | C),
        ("lsls r0, r1", &[0x4088], [X, 33, 0, 0], C, 0, Z),
        ("lsls r0, r1", &[0x4088], [X, 256, 0, 0], 0, X, N),
        ("lsrs r0, r1", &[0x40C8], [X, 1, 0, 0], 0, 0x4000_0000, C),
        ("lsrs r0, r1", &[0x40C8], [X, 31, 0, 0], C, 1, 0),
        ("lsrs r0, r1", &[0x40C8], [X, 32, 0, 0], 0, 0, Z | C),
        ("lsrs r0, r1", &[0x40C8], [X, 33, 0, 0], C, 0, Z),
        ("lsrs r0, r1", &[0x40C8], [X, 255, 0, 0], C, 0, Z),
        ("asrs r0, r1", &[0x4108], [X, 31, 0, 0], C, u32::MAX, N),
        ("asrs r0, r1", &[0x4108], [0x4000_0000, 31, 0, 0], 0, 0, Z | C),
        ("asrs r0, r1", &[0x4108], [X, 32, 0, 0], 0, u32::MAX, N | C),
        ("asrs r0, r1", &[0x4108], [X, 33, 0, 0], 0, u32::MAX, N | C),
        ("asrs r0, r1", &[0x4108], [0x4000_0000, 33, 0, 0], C, 0, Z),
        ("rors r0, r1", &[0x41C8], [X, 0, 0, 0], C, X, N | C),
        ("rors r0, r1", &[0x41C8], [X, 1, 0, 0], 0, 0xC000_0000, N | C),
        ("rors r0, r1", &[0x41C8], [X, 32, 0, 0], 0, X, N | C),
        ("rors r0, r1", &[0x41C8], [2, 33, 0, 0], C, 1, 0),
    ]);
}

#[test]
fn shifts_by_constant_encode_32_and_rrx_as_0() {
    check(&[
        ("lsls r0, r1, #31", &[0x07C8], [0, 3, 0, 0], 0, 0x8000_0000, N | C),
        ("movs r0, r1", &[0x0008], [7, 0, 0, 0], C | V, 0, Z | C | V),
        ("lsrs r0, r1, #32", &[0x0808], [7, 0x8000_0000, 0, 0], 0, 0, Z | C),
        ("asrs r0, r1, #32", &[0x1008], [7, 0x8000_0000, 0, 0], 0, u32::MAX, N | C),
        ("asrs r0, r1, #32", &[0x1008], [7, 0x4000_0000, 0, 0], C, 0, Z),
        ("movs.w r0, r1, rrx", &[0xEA5F, 0x0031], [7, 3, 0, 0], C, 0x8000_0001, N | C),
        ("movs.w r0, r1, rrx", &[0xEA5F, 0x0031], [7, 2, 0, 0], 0, 1, 0),
        ("movs.w r0, r1, ror #4", &[0xEA5F, 0x1031], [7, 0x18, 0, 0], 0, 0x8000_0001, N | C),
    ]);
}

#[test]
fn logical_operations_take_carry_from_the_operand() {
    check(&[
        // A rotated constant gives a carry, a replicated one does not.
        ("movs.w r0, #0x80000000", &[0xF05F, 0x4000], [7, 0, 0, 0], 0, 0x8000_0000, N | C),
        ("movs.w r0, #0x01000000", &[0xF05F, 0x7080], [7, 0, 0, 0], C, 0x0100_0000, 0),
        ("movs.w r0, #0x00ab00ab", &[0xF05F, 0x10AB], [7, 0, 0, 0], C, 0x00AB_00AB, C),
        ("mvns.w r0, #0x7f000000", &[0xF07F, 0x40FE], [7, 0, 0, 0], C, 0x80FF_FFFF, N),
        ("ands.w r0, r1, r2, lsl #1", &[0xEA11, 0x0042], [7, 2, 0x8000_0001, 0], 0, 2, C),
        ("bics.w r0, r1, r2, lsr #1", &[0xEA31, 0x0052], [7, 3, 3, 0], 0, 2, C),
        ("orrs.w r0, r1, r2, asr #4", &[0xEA51, 0x1022], [7, 0, 0x18, 0], 0, 1, C),
        ("orns r0, r1, r2", &[0xEA71, 0x0002], [7, 0, u32::MAX, 0], C | V, 0, Z | C | V),
        ("eors r0, r1", &[0x4048], [5, 5, 0, 0], C | V, 0, Z | C | V),
        ("tst.w r0, #0x80000000", &[0xF010, 0x4F00], [1, 0, 0, 0], 0, 1, Z | C),
        ("teq r0, r1, lsl #1", &[0xEA90, 0x0F41], [2, 0x8000_0001, 0, 0], V, 2, Z | C | V),
        ("mvns r0, r1", &[0x43C8], [7, 0, 0, 0], C, u32::MAX, N | C),
        ("bic r0, r1, #0xff", &[0xF021, 0x00FF], [7, 0x1234, 0, 0], N, 0x1200, N),
        ("movw r0, #0x1234", &[0xF241, 0x2034], [7, 0, 0, 0], C, 0x1234, C),
        ("movt r0, #0xabcd", &[0xF6CA, 0x30CD], [0x1234, 0, 0, 0], C, 0xABCD_1234, C),
    ]);
}

#[test]
fn multiplications_set_n_and_z_only() {
    check(&[
        ("muls r0, r1", &[0x4348], [0x1_0000, 0x1_0000, 0, 0], C | V, 0, Z | C | V),
        ("muls r0, r1", &[0x4348], [3, 0xFFFF_FFFF, 0, 0], 0, 0xFFFF_FFFD, N),
        ("mla r0, r1, r2, r3", &[0xFB01, 0x3002], [0, 5, 6, 7], N, 37, N),
        ("mls r0, r1, r2, r3", &[0xFB01, 0x3012], [0, 5, 6, 7], 0, 7u32.wrapping_sub(30), 0),
    ]);
}

#[test]
fn division_rounds_to_zero_and_gives_0_for_0() {
    check(&[
        ("sdiv r0, r0, r1", &[0xFB90, 0xF0F1], [7, -2i32 as u32, 0, 0], 0, -3i32 as u32, 0),
        ("sdiv r0, r0, r1", &[0xFB90, 0xF0F1], [-7i32 as u32, 2, 0, 0], 0, -3i32 as u32, 0),
        ("sdiv r0, r0, r1", &[0xFB90, 0xF0F1], [0x8000_0000, u32::MAX, 0, 0], 0, 0x8000_0000, 0),
        ("sdiv r0, r0, r1", &[0xFB90, 0xF0F1], [7, 0, 0, 0], C, 0, C),
        ("udiv r0, r0, r1", &[0xFBB0, 0xF0F1], [0xFFFF_FFFF, 16, 0, 0], 0, 0x0FFF_FFFF, 0),
        ("udiv r0, r0, r1", &[0xFBB0, 0xF0F1], [7, 0, 0, 0], 0, 0, 0),
    ]);
}

#[test]
fn long_multiplications_give_64_bits() {
    // Halfwords, r0 to r3; r0 and r1 afterwards.
    type Case = (&'static str, [u16; 2], [u32; 4], u64);
    const ONES: u32 = u32::MAX;
    let cases: [Case; 8] = [
        ("umull r0, r1, r2, r3", [0xFBA2, 0x0103], [0, 0, ONES, ONES], 0xFFFF_FFFE_0000_0001),
        ("smull r0, r1, r2, r3", [0xFB82, 0x0103], [0, 0, ONES, 5], -5i64 as u64),
        ("umlal r0, r1, r2, r3", [0xFBE2, 0x0103], [1, 1, 2, 3], 0x1_0000_0007),
        ("smlal r0, r1, r2, r3", [0xFBC2, 0x0103], [1, 0, ONES, 2], -1i64 as u64),
        // (2^32 - 1)^2 + 2 (2^32 - 1) = 2^64 - 1
        ("umaal r0, r1, r2, r3", [0xFBE2, 0x0163], [ONES, ONES, ONES, ONES], u64::MAX),
        // 5 + 6 * -7
        ("smlalbt r0, r1, r2, r3", [0xFBC2, 0x0193], [5, 0, 6, 0xFFF9_0000], -37i64 as u64),
        // 1 + 2 * 5 + 3 * 4
        ("smlaldx r0, r1, r2, r3", [0xFBC2, 0x01D3], [1, 0, 0x0003_0002, 0x0005_0004], 23),
        // 1 + 2 * 4 - 3 * 5
        ("smlsld r0, r1, r2, r3", [0xFBD2, 0x01C3], [1, 0, 0x0003_0002, 0x0005_0004], -6i64 as u64),
    ];
    for (mnemonic, halfwords, registers, expected) in cases {
        let machine = execute(&halfwords, &registers, N | C);
        let found = (machine.r(1) as u64) << 32 | machine.r(0) as u64;
        assert_eq!(found, expected, "{mnemonic}");
        assert_eq!(machine.flags(), N | C, "{mnemonic}");
    }
}

#[test]
fn bit_fields_are_extracted_and_inserted() {
    check(&[
        ("bfi r0, r1, #4, #4", &[0xF361, 0x1007], [u32::MAX, 0xA, 0, 0], 0, 0xFFFF_FFAF, 0),
        ("bfi r0, r1, #0, #32", &[0xF361, 0x001F], [7, 0x1234_5678, 0, 0], 0, 0x1234_5678, 0),
        ("bfc r0, #4, #8", &[0xF36F, 0x100B], [u32::MAX, 0, 0, 0], 0, 0xFFFF_F00F, 0),
        ("bfc r0, #0, #32", &[0xF36F, 0x001F], [u32::MAX, 0, 0, 0], N, 0, N),
        ("ubfx r0, r1, #4, #8", &[0xF3C1, 0x1007], [0, 0xABCD_EF12, 0, 0], 0, 0xF1, 0),
        ("sbfx r0, r1, #4, #8", &[0xF341, 0x1007], [0, 0xABCD_EF12, 0, 0], 0, 0xFFFF_FFF1, 0),
        ("ubfx r0, r1, #0, #32", &[0xF3C1, 0x001F], [0, 0x8765_4321, 0, 0], 0, 0x8765_4321, 0),
        ("sbfx r0, r1, #31, #1", &[0xF341, 0x70C0], [0, 0x8000_0000, 0, 0], 0, u32::MAX, 0),
    ]);
}

#[test]
fn extensions_and_reversals_of_bytes() {
    const X: u32 = 0x8182_83F4;
    check(&[
        ("sxtb r0, r1", &[0xB248], [0, X, 0, 0], 0, 0xFFFF_FFF4, 0),
        ("sxth r0, r1", &[0xB208], [0, X, 0, 0], 0, 0xFFFF_83F4, 0),
        ("uxtb.w r0, r1, ror #16", &[0xFA5F, 0xF0A1], [0, X, 0, 0], 0, 0x82, 0),
        ("sxth.w r0, r1, ror #8", &[0xFA0F, 0xF091], [0, X, 0, 0], 0, 0xFFFF_8283, 0),
        ("uxtab r0, r1, r2", &[0xFA51, 0xF082], [0, 0x1000, X, 0], 0, 0x10F4, 0),
        ("sxtb16 r0, r1", &[0xFA2F, 0xF081], [0, X, 0, 0], 0, 0xFF82_FFF4, 0),
        ("uxtab16 r0, r1, r2", &[0xFA31, 0xF082], [0, 0xFFFF_FFFF, X, 0], 0, 0x0081_00F3, 0),
        ("rev r0, r1", &[0xBA08], [0, X, 0, 0], 0, 0xF483_8281, 0),
        ("rev16 r0, r1", &[0xBA48], [0, X, 0, 0], 0, 0x8281_F483, 0),
        ("revsh r0, r1", &[0xBAC8], [0, X, 0, 0], 0, 0xFFFF_F483, 0),
        ("rbit r0, r1", &[0xFA91, 0xF0A1], [0, 0x8000_0003, 0, 0], 0, 0xC000_0001, 0),
        ("clz r0, r1", &[0xFAB1, 0xF081], [0, 0, 0, 0], 0, 32, 0),
        ("clz r0, r1", &[0xFAB1, 0xF081], [0, 0x0001_0000, 0, 0], 0, 15, 0),
    ]);
}

#[test]
fn stack_pointer_keeps_its_low_bits_clear() {
    let machine = execute(&[0x4685], &[0x2000_0803], 0); // mov sp, r0
    assert_eq!(machine.r(13), 0x2000_0800);
    let machine = execute(&[0xF2AD, 0x0D03], &[], 0); // subw sp, sp, #3
    assert_eq!(machine.r(13), super::STACK - 4);
}

#[test]
fn q_flag_remains_until_it_is_written() {
    let mut machine = Machine::new(&[
        0x2001, // movs r0, #1
        0xF380, 0x8800, // msr APSR_nzcvq, r0
    ]);
    machine.core.set_xpsr(Q | N);
    machine.step(1);
    assert_eq!(machine.flags(), Q);
    machine.step(1);
    assert_eq!(machine.flags(), 0);
}
