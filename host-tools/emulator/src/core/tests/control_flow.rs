//! Conditions, and breakpoints inside an IT block.

use crate::core::tests::{Machine, PROGRAM, Stop};

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
            let mut machine = Machine::new(&[0xD002 | (code as u16) << 8]);
            machine.core.state.apsr = flags << 28;
            machine.step(1);
            let taken = machine.core.pc() == PROGRAM + 8;
            assert_eq!(taken, expected >> flags & 1 != 0, "{name} with flags {flags:04b}");
        }
    }
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
