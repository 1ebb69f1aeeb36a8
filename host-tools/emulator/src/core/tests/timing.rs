//! Cycles of the models.

use crate::core::tests::{CCM, CycleModel, DATA, END, FLASH, Machine, PROGRAM};

/// Cycles of a program up to its BKPT, in each of the three models.
fn cycles(program: &[u16]) -> [u64; 3] {
    [CycleModel::FAST, CycleModel::TYPICAL, CycleModel::SLOW].map(|model| {
        let mut machine = Machine::with_model(program, model);
        machine.system_write(0xE000_ED88, 0x00F0_0000);
        machine.set_r(1, DATA);
        machine.set_r(2, FLASH);
        machine.set_r(3, 3);
        machine.finish();
        assert_eq!(machine.core.state.cycles, machine.bus.time);
        // Without the BKPT.
        machine.bus.time - 1
    })
}

#[test]
fn instructions_take_the_cycles_of_their_class() {
    let cases: [(&str, &[u16], [u64; 3]); 25] = [
        ("nop", &[0xBF00], [1, 1, 1]),
        ("adds r0, #1", &[0x3001], [1, 1, 1]),
        ("ldr r0, [r1]", &[0x6808], [2, 2, 2]),
        // The second load overlaps with the first.
        ("ldr r0, [r1]; ldr r0, [r1]", &[0x6808, 0x6808], [3, 3, 4]),
        ("str r0, [r1]; ldr r0, [r1]", &[0x6008, 0x6808], [2, 2, 4]),
        ("ldr r0, [r1]; nop; ldr r0, [r1]", &[0x6808, 0xBF00, 0x6808], [5, 5, 5]),
        ("str r0, [r1]", &[0x6008], [1, 1, 2]),
        ("ldrd r4, r5, [r1]", &[0xE9D1, 0x4500], [3, 3, 3]),
        ("ldmia r1!, {r4, r5, r6}", &[0xC970], [4, 4, 4]),
        ("push {r4, r5, lr}", &[0xB530], [4, 4, 4]),
        ("b.n . + 2", &[0xE7FF], [2, 4, 8]),
        ("udiv r0, r2, r3", &[0xFBB2, 0xF0F3], [2, 7, 12]),
        ("mla r0, r1, r2, r3", &[0xFB01, 0x3002], [1, 1, 2]),
        ("smlad r0, r1, r2, r3", &[0xFB21, 0x3002], [1, 1, 1]),
        ("smlal r0, r4, r1, r2", &[0xFBC1, 0x0402], [1, 1, 1]),
        ("vadd.f32 s0, s0, s0", &[0xEE30, 0x0A00], [1, 1, 1]),
        ("vmla.f32 s0, s0, s0", &[0xEE00, 0x0A00], [3, 3, 3]),
        ("vdiv.f32 s0, s0, s0", &[0xEE80, 0x0A00], [14, 14, 14]),
        ("vldr s0, [r1]", &[0xED91, 0x0A00], [2, 2, 2]),
        ("vldmia r1, {s0-s3}", &[0xEC91, 0x0A04], [5, 5, 5]),
        // Data in flash.
        ("ldr r0, [r2]", &[0x6810], [2, 3, 6]),
        ("ldr r0, [pc]", &[0x4800], [2, 3, 6]),
        ("ldrd r4, r5, [r2]", &[0xE9D2, 0x4500], [3, 5, 11]),
        // Not taken, and a failed condition: one cycle.
        ("cmp r3, #0; beq . + 2", &[0x2B00, 0xD0FF], [2, 2, 2]),
        ("cmp r3, #0; it eq; ldreq r0, [r2]", &[0x2B00, 0xBF08, 0x6810], [3, 3, 3]),
    ];
    for (mnemonic, program, expected) in cases {
        assert_eq!(cycles(program), expected, "{mnemonic}");
    }
}

#[test]
fn branch_to_ram_does_not_wait() {
    for (address, wait) in [(CCM, 0), (PROGRAM + 0x100, 4)] {
        let mut machine = Machine::with_model(&[0x4700], CycleModel::SLOW); // bx r0
        machine.place(address, &[END]);
        machine.set_r(0, address | 1);
        machine.finish();
        assert_eq!(machine.bus.time, 1 + 3 + wait + 1);
    }
}

#[test]
fn exception_entry_takes_12_and_return_10_cycles() {
    for (model, wait) in [(CycleModel::FAST, 0), (CycleModel::SLOW, 4)] {
        let mut machine = Machine::with_model(&[0xBF00], model); // nop
        machine.handler(16, PROGRAM + 0x400, &[0xBF00, 0x4770]); // nop; bx lr
        machine.system_write(0xE000_E100, 1);
        machine.interrupt(0);
        machine.finish();
        assert_eq!(machine.bus.time, 12 + wait + 1 + 1 + 10 + wait + 1 + 1);
    }
}
