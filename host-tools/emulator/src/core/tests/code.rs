//! Decoded instructions after changes of the memory.

use crate::core::tests::{CCM, DATA, END, Machine, PROGRAM, SRAM, STACK};

/// Code in SRAM here.
const CODE: u32 = SRAM + 0x4000;

#[test]
fn store_into_executed_memory_takes_effect_at_once() {
    for base in [CODE, CCM + 0x100] {
        let mut machine = Machine::new(&[0x4708]); // bx r1
        machine.place(
            base,
            &[
                0x2001, // movs r0, #1
                0x800B, // strh r3, [r1]
                0x42A0, // cmp r0, r4
                0xD1FB, // bne . - 6
                END,
            ],
        );
        machine.set_r(1, base | 1);
        machine.step(1);
        machine.set_r(1, base);
        machine.set_r(3, 0x2005); // movs r0, #5
        machine.set_r(4, 5);
        machine.finish();
        assert_eq!(machine.r(0), 5);
    }
}

#[test]
fn store_into_the_second_halfword_takes_effect() {
    let mut machine = Machine::new(&[0x4708]); // bx r1
    machine.place(
        CODE,
        &[
            0xF240, 0x0001, // movw r0, #1
            0x804B, // strh r3, [r1, #2]
            0x42A0, // cmp r0, r4
            0xD1FA, // bne . - 8
            END,
        ],
    );
    machine.set_r(1, CODE | 1);
    machine.step(1);
    machine.set_r(1, CODE);
    machine.set_r(3, 0x0005); // movw r0, #5
    machine.set_r(4, 5);
    machine.finish();
    assert_eq!(machine.r(0), 5);
}

#[test]
fn push_over_executed_memory_takes_effect() {
    let mut machine = Machine::new(&[0x4708, END]); // bx r1
    machine.place(STACK - 4, &[0x2001, 0x4770]); // movs r0, #1; bx lr
    machine.set_r(1, (STACK - 4) | 1);
    machine.set_r(14, (PROGRAM + 2) | 1);
    machine.finish();
    assert_eq!(machine.r(0), 1);
    machine.place(PROGRAM + 0x20, &[0xB410, 0x4708]); // push {r4}; bx r1
    machine.set_r(4, 0x4770_2007); // movs r0, #7; bx lr
    machine.core.set_pc(PROGRAM + 0x20);
    machine.finish();
    assert_eq!(machine.r(0), 7);
}

#[test]
fn change_that_the_bus_reports_takes_effect_with_run() {
    let mut machine = Machine::new(&[0x2001]); // movs r0, #1
    machine.finish();
    machine.place(PROGRAM, &[0x2002]); // movs r0, #2
    machine.core.set_pc(PROGRAM);
    machine.finish();
    assert_eq!(machine.r(0), 1, "not reported");
    machine.bus.modified = Some(PROGRAM..PROGRAM + 2);
    machine.core.set_pc(PROGRAM);
    machine.finish();
    assert_eq!(machine.r(0), 2);
}

#[test]
fn change_of_a_second_halfword_drops_the_instruction() {
    let mut machine = Machine::new(&[0xF240, 0x0001]); // movw r0, #1
    machine.finish();
    // The instruction becomes movw r0, #9.
    machine.place(PROGRAM + 2, &[0x0009]);
    machine.bus.modified = Some(PROGRAM + 2..PROGRAM + 4);
    machine.core.set_pc(PROGRAM);
    machine.finish();
    assert_eq!(machine.r(0), 9);
}

#[test]
fn isb_makes_programmed_code_effective() {
    // Barrier between the store that programs and the changed instruction; result. Without ISB the
    // change may be ineffective, and the decoded instruction remains.
    let barriers: [(&str, [u16; 2], u32); 2] =
        [("isb sy", [0xF3BF, 0x8F6F], 2), ("dsb sy", [0xF3BF, 0x8F4F], 1)];
    for (mnemonic, [first, second], result) in barriers {
        let program = [
            0x2A01, // cmp r2, #1
            0xD100, // bne . + 4
            0x6019, // str r1, [r3]
            first, second, 0x2001, // movs r0, #1
            0x3201, // adds r2, #1
            0x2A02, // cmp r2, #2
            0xD1F6, // bne . - 16
        ];
        let mut machine = Machine::new(&program);
        machine.set_r(3, DATA);
        machine.bus.programming = Some((DATA, PROGRAM + 10, 0x2002)); // movs r0, #2
        machine.finish();
        assert_eq!(machine.r(0), result, "{mnemonic}");
    }
}

#[test]
fn instruction_inside_and_outside_an_it_block_differs() {
    let mut machine = Machine::new(&[
        0xBF08, // it eq
        0x3001, // addeq r0, #1; outside: adds r0, #1
    ]);
    let (inside, outside) = (PROGRAM, PROGRAM + 2);
    for (start, zero, r0, flags) in [
        (inside, super::Z, 1, super::Z),
        (outside, super::Z, 1, 0),
        (inside, 0, 0, 0),
        (outside, 0, 1, 0),
        (inside, super::Z, 1, super::Z),
    ] {
        machine.set_r(0, 0);
        machine.core.state.apsr = zero;
        machine.core.set_pc(start);
        machine.finish();
        assert_eq!((machine.r(0), machine.flags()), (r0, flags));
    }
}

#[test]
fn code_outside_the_usual_memories_is_executed() {
    // The alias of the flash at address 0.
    let mut machine = Machine::new(&[0x2001, 0x3001]); // movs r0, #1; adds r0, #1
    machine.core.set_pc(PROGRAM & 0xFFFF);
    machine.finish();
    assert_eq!((machine.r(0), machine.core.pc()), (2, (PROGRAM & 0xFFFF) + 6));
}
