//! IT blocks, conditions, branches.

use crate::core::tests::{C, Machine, Stop, Z, execute};

#[test]
fn it_block_executes_by_condition_and_keeps_flags() {
    let mut machine = Machine::new(&[
        0x2005, // movs r0, #5
        0x2805, // cmp r0, #5
        0xBF06, // itte eq
        0x3001, // addeq r0, #1
        0x1C41, // addeq r1, r0, #1
        0x2200, // movne r2, #0
        0x3200, // adds r2, #0
    ]);
    machine.core.set_register(2, 9);
    machine.step(3);
    assert_eq!(machine.flags(), Z | C);
    machine.step(2);
    // Inside the block the additions set no flags.
    assert_eq!((machine.r(0), machine.r(1), machine.flags()), (6, 7, Z | C));
    machine.step(1);
    assert_eq!(machine.r(2), 9);
    // The first instruction behind the block sets flags again.
    machine.step(1);
    assert_eq!(machine.flags(), 0);
}

#[test]
fn it_block_compares_set_flags_for_the_rest_of_it() {
    let mut machine = Machine::new(&[
        0xBF08, // it eq
        0x2801, // cmpeq r0, #1
        0xBF0C, // ite eq
        0x2101, // moveq r1, #1
        0x2102, // movne r1, #2
    ]);
    machine.core.set_register(0, 3);
    machine.core.set_xpsr(Z);
    machine.finish();
    assert_eq!((machine.r(1), machine.flags()), (2, C));
}

#[test]
fn every_condition_selects_its_flags() {
    // Conditions 0 to 13 with the flags NZCV (0 to 15) with which they are met.
    let met: [(&str, u16); 14] = [
        ("eq", 0b1111_0000_1111_0000),
        ("ne", 0b0000_1111_0000_1111),
        ("cs", 0b1100_1100_1100_1100),
        ("cc", 0b0011_0011_0011_0011),
        ("mi", 0b1111_1111_0000_0000),
        ("pl", 0b0000_0000_1111_1111),
        ("vs", 0b1010_1010_1010_1010),
        ("vc", 0b0101_0101_0101_0101),
        ("hi", 0b0000_1100_0000_1100),
        ("ls", 0b1111_0011_1111_0011),
        ("ge", 0b1010_1010_0101_0101),
        ("lt", 0b0101_0101_1010_1010),
        ("gt", 0b0000_1010_0000_0101),
        ("le", 0b1111_0101_1111_1010),
    ];
    for (code, (name, expected)) in met.into_iter().enumerate() {
        for flags in 0..16 {
            // b<condition>.n . + 8
            let machine = execute(&[0xD002 | (code as u16) << 8], &[], flags << 28);
            let taken = machine.core.pc() == super::PROGRAM + 8;
            assert_eq!(taken, expected >> flags & 1 != 0, "{name} with flags {flags:04b}");
        }
    }
}

#[test]
fn branches_reach_their_targets_and_link() {
    let at = super::PROGRAM;
    // Halfwords, r0; target, link register.
    let cases: [(&str, &[u16], u32, u32, u32); 9] = [
        ("b.n . + 2048", &[0xE3FE], 0, at + 2048, u32::MAX),
        ("b.n . - 256", &[0xE77E], 0, at - 256, u32::MAX),
        ("b.w . + 0x100000", &[0xF0FF, 0xBFFE], 0, at + 0x10_0000, u32::MAX),
        ("bl . - 0x200", &[0xF7FF, 0xFEFE], 0, at - 0x200, (at + 4) | 1),
        ("cbz r0, . + 66", &[0xB1F8], 0, at + 66, u32::MAX),
        ("cbz r0, . + 66", &[0xB1F8], 1, at + 2, u32::MAX),
        ("cbnz r0, . + 130", &[0xBBF8], 1, at + 130, u32::MAX),
        ("bx r0", &[0x4700], 0x0800_1001, 0x0800_1000, u32::MAX),
        ("blx r0", &[0x4780], 0x0800_1001, 0x0800_1000, (at + 2) | 1),
    ];
    for (mnemonic, halfwords, r0, target, link) in cases {
        let machine = execute(halfwords, &[r0], 0);
        assert_eq!((machine.core.pc(), machine.r(14)), (target, link), "{mnemonic}");
    }
}

#[test]
fn table_branch_skips_twice_the_entry() {
    let mut machine = Machine::new(&[
        0xE8DF, 0xF000, // tbb [pc, r0]
        0x0604,
    ]);
    machine.core.set_register(0, 1);
    machine.step(1);
    assert_eq!(machine.core.pc(), super::PROGRAM + 4 + 12);
    let mut machine = Machine::new(&[
        0xE8DF, 0xF010, // tbh [pc, r0, lsl #1]
        0x0004, 0x0123,
    ]);
    machine.core.set_register(0, 1);
    machine.step(1);
    assert_eq!(machine.core.pc(), super::PROGRAM + 4 + 2 * 0x123);
}

#[test]
fn pc_reads_as_the_instruction_plus_four() {
    let at = super::PROGRAM;
    let machine = execute(&[0x4678], &[], 0); // mov r0, pc
    assert_eq!(machine.r(0), at + 4);
    let machine = execute(&[0x4478], &[0x10], 0); // add r0, pc
    assert_eq!(machine.r(0), at + 4 + 0x10);
    let machine = execute(&[0xA002], &[], 0); // add r0, pc, #8
    assert_eq!(machine.r(0), at + 12);
    let machine = execute(&[0x4487], &[0x11], 0); // add pc, r0
    assert_eq!(machine.core.pc(), at + 4 + 0x10);
    let machine = execute(&[0x4687], &[0x0800_2001], 0); // mov pc, r0
    assert_eq!(machine.core.pc(), 0x0800_2000);
    // adr.w from an address that is not aligned to a word
    let mut machine = Machine::new(&[0xBF00, 0xF2AF, 0x0008]); // nop; subw r0, pc, #8
    machine.step(2);
    assert_eq!(machine.r(0), at + 4 - 8);
}

#[test]
fn breakpoint_in_an_it_block_ignores_the_condition() {
    let mut machine = Machine::new(&[
        0xBF08, // it eq
        0xBE07, // bkpt 7
    ]);
    let stop = machine.run();
    assert!(matches!(stop, Stop::Breakpoint { immediate: 7, .. }), "{stop}");
    machine.finish();
}
