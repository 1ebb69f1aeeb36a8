//! Loads and stores: addressing, write-back, alignment, order, exclusive accesses.

use crate::core::tests::{DATA, Machine, STACK, execute};

/// A machine with r1 = `DATA` + `offset` and four words there: 0x11, 0x22, 0x33, 0x44.
fn with_data(program: &[u16], offset: u32) -> Machine {
    let mut machine = Machine::new(program);
    for (k, word) in [0x11, 0x22, 0x33, 0x44].into_iter().enumerate() {
        machine.set_word(DATA + 4 * k as u32, word);
    }
    machine.core.set_register(1, DATA + offset);
    machine
}

#[test]
fn single_loads_extend_and_write_back() {
    // Mnemonic, halfwords, r1 as offset to the data, r2; r0, r1 as offset.
    type Case = (&'static str, &'static [u16], u32, u32, u32, u32);
    let cases: [Case; 14] = [
        ("ldr r0, [r1, #4]", &[0x6848], 0, 0, 0x8899_AABB, 0),
        ("ldrb r0, [r1, #5]", &[0x7948], 0, 0, 0xAA, 0),
        ("ldrh r0, [r1, #6]", &[0x88C8], 0, 0, 0x8899, 0),
        ("ldrsb r0, [r1, r2]", &[0x5688], 0, 6, 0xFFFF_FF99, 0),
        ("ldrsh r0, [r1, r2]", &[0x5E88], 0, 4, 0xFFFF_AABB, 0),
        ("ldr.w r0, [r1, #-4]", &[0xF851, 0x0C04], 8, 0, 0x8899_AABB, 8),
        ("ldr.w r0, [r1], #4", &[0xF851, 0x0B04], 4, 0, 0x8899_AABB, 8),
        ("ldr.w r0, [r1, #4]!", &[0xF851, 0x0F04], 0, 0, 0x8899_AABB, 4),
        ("ldrb.w r0, [r1], #-1", &[0xF811, 0x0901], 4, 0, 0xBB, 3),
        ("ldrsh.w r0, [r1, #-2]!", &[0xF931, 0x0D02], 8, 0, 0xFFFF_8899, 6),
        ("ldr.w r0, [r1, r2, lsl #2]", &[0xF851, 0x0022], 0, 1, 0x8899_AABB, 0),
        ("ldrh.w r0, [r1, r2, lsl #1]", &[0xF831, 0x0012], 0, 3, 0x8899, 0),
        ("ldrsb.w r0, [r1, #7]", &[0xF991, 0x0007], 0, 0, 0xFFFF_FF88, 0),
        ("ldrt r0, [r1, #4]", &[0xF851, 0x0E04], 0, 0, 0x8899_AABB, 0),
    ];
    for (mnemonic, halfwords, offset, r2, result, moved) in cases {
        let mut machine = Machine::new(halfwords);
        machine.set_word(DATA + 4, 0x8899_AABB);
        machine.core.set_register(1, DATA + offset);
        machine.core.set_register(2, r2);
        machine.step(1);
        assert_eq!((machine.r(0), machine.r(1)), (result, DATA + moved), "{mnemonic}");
    }
}

#[test]
fn single_stores_change_their_bytes_only() {
    let cases: [(&str, &[u16], u32); 6] = [
        ("str r0, [r1, #4]", &[0x6048], 0x1234_5678),
        ("strh r0, [r1, #6]", &[0x80C8], 0x5678_FFFF),
        ("strb r0, [r1, #5]", &[0x7148], 0xFFFF_78FF),
        ("strb.w r0, [r1, #7]!", &[0xF801, 0x0F07], 0x78FF_FFFF),
        ("strh.w r0, [r1, r2, lsl #1]", &[0xF821, 0x0012], 0xFFFF_5678),
        ("strb r0, [r1, r2]", &[0x5488], 0xFFFF_FFFF),
    ];
    for (mnemonic, halfwords, expected) in cases {
        let mut machine = Machine::new(halfwords);
        machine.set_word(DATA + 4, u32::MAX);
        machine.core.set_register(0, 0x1234_5678);
        machine.core.set_register(1, DATA);
        machine.core.set_register(2, 2);
        machine.step(1);
        assert_eq!(machine.word(DATA + 4), expected, "{mnemonic}");
    }
}

#[test]
fn unaligned_single_accesses_to_memory_work() {
    let mut machine = Machine::new(&[
        0x6808, // ldr r0, [r1, #0]
        0xF8B1, 0x2001, // ldrh.w r2, [r1, #1]
        0xF8C1, 0x0005, // str.w r0, [r1, #5]
    ]);
    machine.set_word(DATA, 0x4433_2211);
    machine.set_word(DATA + 4, 0x8877_6655);
    machine.core.set_register(1, DATA + 1);
    machine.finish();
    assert_eq!((machine.r(0), machine.r(2)), (0x5544_3322, 0x4433));
    assert_eq!((machine.word(DATA + 4), machine.word(DATA + 8)), (0x3322_6655, 0x0000_5544));
}

#[test]
fn literal_loads_use_the_aligned_pc() {
    // The literal is at PROGRAM + 8 in both cases.
    let mut machine = Machine::new(&[0x4801, 0xBF00, 0xBF00, 0xBF00, 0x5678, 0x1234]); // ldr r0, [pc, #4]
    machine.step(1);
    assert_eq!(machine.r(0), 0x1234_5678);
    let mut machine = Machine::new(&[0xBF00, 0x4801, 0xBF00, 0xBF00, 0x5678, 0x1234]); // nop; ldr r0, [pc, #4]
    machine.step(2);
    assert_eq!(machine.r(0), 0x1234_5678);
    let mut machine = Machine::new(&[0x00FF, 0xBF00, 0xF91F, 0x0008]); // the literal; nop; ldrsb.w r0, [pc, #-8]
    machine.core.set_pc(super::PROGRAM + 4);
    machine.step(1);
    assert_eq!(machine.r(0), u32::MAX);
}

#[test]
fn load_multiple_writes_back_unless_the_base_is_loaded() {
    let mut machine = with_data(&[0xC90D], 0); // ldmia r1!, {r0, r2, r3}
    machine.step(1);
    assert_eq!([0, 1, 2, 3].map(|k| machine.r(k)), [0x11, DATA + 12, 0x22, 0x33]);
    let mut machine = with_data(&[0xC907], 0); // ldmia r1, {r0, r1, r2}
    machine.step(1);
    assert_eq!([0, 1, 2].map(|k| machine.r(k)), [0x11, 0x22, 0x33]);
    let mut machine = with_data(&[0xE931, 0x000D], 16); // ldmdb r1!, {r0, r2, r3}
    machine.step(1);
    assert_eq!([0, 1, 2, 3].map(|k| machine.r(k)), [0x22, DATA + 4, 0x33, 0x44]);
    let mut machine = with_data(&[0xE911, 0x0005], 8); // ldmdb r1, {r0, r2}
    machine.step(1);
    assert_eq!([0, 1, 2].map(|k| machine.r(k)), [0x11, DATA + 8, 0x22]);
}

#[test]
fn store_multiple_orders_words_by_register() {
    let mut machine = with_data(&[0xC10D], 0); // stmia r1!, {r0, r2, r3}
    for (number, value) in [(0, 1), (2, 2), (3, 3)] {
        machine.core.set_register(number, value);
    }
    machine.step(1);
    assert_eq!([0, 4, 8, 12].map(|k| machine.word(DATA + k)), [1, 2, 3, 0x44]);
    assert_eq!(machine.r(1), DATA + 12);
    // The lowest register of the list is the base: its old value is stored.
    let mut machine = with_data(&[0xC106], 0); // stmia r1!, {r1, r2}
    machine.core.set_register(2, 2);
    machine.step(1);
    assert_eq!((machine.word(DATA), machine.word(DATA + 4)), (DATA, 2));
    let mut machine = with_data(&[0xE921, 0x000C], 8); // stmdb r1!, {r2, r3}
    machine.core.set_register(2, 2);
    machine.core.set_register(3, 3);
    machine.step(1);
    assert_eq!((machine.word(DATA), machine.word(DATA + 4), machine.r(1)), (2, 3, DATA));
}

#[test]
fn push_and_pop_move_the_stack_pointer() {
    let mut machine = Machine::new(&[
        0xB503, // push {r0, r1, lr}
        0xBC0C, // pop {r2, r3}
        0xBD00, // pop {pc}
    ]);
    machine.place(super::PROGRAM + 0x100, &[0xBF00]);
    machine.core.set_register(0, 10);
    machine.core.set_register(1, 11);
    machine.core.set_register(14, super::PROGRAM + 0x101);
    machine.step(1);
    assert_eq!(machine.r(13), STACK - 12);
    assert_eq!(machine.word(STACK - 12), 10);
    machine.step(2);
    assert_eq!((machine.r(2), machine.r(3)), (10, 11));
    assert_eq!((machine.core.pc(), machine.r(13)), (super::PROGRAM + 0x100, STACK));
}

#[test]
fn load_pc_branches_with_its_state() {
    let target = super::PROGRAM + 0x80;
    let programs: [(&str, &[u16]); 4] = [
        ("ldr.w pc, [r1]", &[0xF8D1, 0xF000]),
        ("ldr.w pc, [r1], #4", &[0xF851, 0xFB04]),
        ("ldr.w pc, [r1, r0, lsl #2]", &[0xF851, 0xF020]),
        ("ldmia.w r1!, {r2, pc}", &[0xE8B1, 0x8004]),
    ];
    for (mnemonic, halfwords) in programs {
        let mut machine = with_data(halfwords, 0);
        let offset = if mnemonic.starts_with("ldm") { 4 } else { 0 };
        machine.set_word(DATA + offset, target | 1);
        machine.step(1);
        assert_eq!(machine.core.pc(), target, "{mnemonic}");
    }
}

#[test]
fn dual_transfers_write_back() {
    // Mnemonic, halfwords, offset of r1 before; r0, r2, offset of r1 after.
    type Case = (&'static str, [u16; 2], u32, u32, u32, u32);
    let cases: [Case; 4] = [
        ("ldrd r0, r2, [r1, #8]", [0xE9D1, 0x0202], 0, 0x33, 0x44, 0),
        ("ldrd r0, r2, [r1, #-8]", [0xE951, 0x0202], 8, 0x11, 0x22, 8),
        ("ldrd r0, r2, [r1], #8", [0xE8F1, 0x0202], 0, 0x11, 0x22, 8),
        ("ldrd r0, r2, [r1, #-4]!", [0xE971, 0x0201], 8, 0x22, 0x33, 4),
    ];
    for (mnemonic, halfwords, offset, r0, r2, moved) in cases {
        let mut machine = with_data(&halfwords, offset);
        machine.step(1);
        let found = (machine.r(0), machine.r(2), machine.r(1));
        assert_eq!(found, (r0, r2, DATA + moved), "{mnemonic}");
    }
    let mut machine = with_data(&[0xE9E1, 0x0202], 0); // strd r0, r2, [r1, #8]!
    machine.core.set_register(0, 5);
    machine.core.set_register(2, 6);
    machine.step(1);
    assert_eq!((machine.word(DATA + 8), machine.word(DATA + 12), machine.r(1)), (5, 6, DATA + 8));
}

#[test]
fn store_exclusive_succeeds_after_load_exclusive_only() {
    let mut machine = with_data(
        &[
            0xE841, 0x3200, // strex r2, r3, [r1]
            0xE851, 0x0F00, // ldrex r0, [r1]
            0xE841, 0x4300, // strex r3, r4, [r1]
            0xE841, 0x5600, // strex r6, r5, [r1]
            0xE8D1, 0x0F4F, // ldrexb r0, [r1]
            0xF3BF, 0x8F2F, // clrex
            0xE8C1, 0x5F47, // strexb r7, r5, [r1]
        ],
        0,
    );
    machine.core.set_register(4, 0xABCD);
    machine.core.set_register(5, 0x99);
    machine.finish();
    assert_eq!([2, 3, 6, 7].map(|k| machine.r(k)), [1, 0, 1, 1]);
    assert_eq!((machine.r(0), machine.word(DATA)), (0xCD, 0xABCD));
}

#[test]
fn exception_clears_the_exclusive_monitor() {
    let mut machine = with_data(
        &[
            0xE851, 0x0F00, // ldrex r0, [r1]
            0xDF00, // svc 0
            0xE841, 0x3200, // strex r2, r3, [r1]
        ],
        0,
    );
    machine.handler(11, super::PROGRAM + 0x100, &[0x4770]); // bx lr
    machine.finish();
    assert_eq!((machine.r(2), machine.word(DATA)), (1, 0x11));
}

#[test]
fn preloads_do_nothing() {
    let mut machine = execute(&[0xF891, 0xF000], &[0, 0x7000_0000], 0); // pld [r1]
    assert_eq!(machine.core.pc(), super::PROGRAM + 4);
    machine.finish();
}
