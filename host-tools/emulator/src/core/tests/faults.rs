//! Faults, their status, and lock-up.

use crate::core::system_control::fault_status as status;
use crate::core::tests::{DATA, END, Machine, PROGRAM, SRAM, STACK, Stop};

const HANDLER: u32 = PROGRAM + 0x400;
/// No memory here.
const NOWHERE: u32 = 0x3000_0000;
const PRECISE: u32 = status::PRECISE | status::BFAR_VALID;

/// A machine with a HardFault handler that stops, and interrupt 0 with a handler.
fn machine(program: &[u16], interrupt: &[u16]) -> Machine {
    let mut machine = Machine::new(program);
    machine.handler(3, HANDLER, &[END]);
    machine.handler(16, HANDLER + 0x80, interrupt);
    machine.system_write(0xE000_E100, 1);
    machine
}

/// Runs to the handler of HardFault; gives CFSR and the return address.
fn hard_fault(machine: &mut Machine) -> (u32, u32) {
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    let address = machine.r(13) + 24;
    (machine.cfsr(), machine.word(address))
}

#[test]
fn faults_of_instructions_have_their_status_and_address() {
    // Mnemonic, program, r1; CFSR.
    let cases: [(&str, &[u16], u32, u32); 16] = [
        ("udf #0", &[0xDE00], 0, status::UNDEFINED),
        ("udf.w #0", &[0xF7F0, 0xA000], 0, status::UNDEFINED),
        ("mrc p15, 0, r0, c0, c0, 0", &[0xEE10, 0x0F10], 0, status::NO_COPROCESSOR),
        ("vmov.f32 s0, s0", &[0xEEB0, 0x0A40], 0, status::NO_COPROCESSOR),
        ("ldrd r0, r2, [r1]", &[0xE9D1, 0x0200], DATA + 2, status::UNALIGNED),
        ("ldmia r1!, {r0, r2}", &[0xC905], DATA + 1, status::UNALIGNED),
        ("ldrex r0, [r1]", &[0xE851, 0x0F00], DATA + 2, status::UNALIGNED),
        ("strd r0, r2, [r1]", &[0xE9C1, 0x0200], DATA + 1, status::UNALIGNED),
        // Device memory, where nothing unaligned is defined.
        ("ldr r0, [r1]", &[0x6808], 0x4000_0002, status::UNALIGNED),
        ("ldr r0, [r1, #8]", &[0x6888], NOWHERE, PRECISE),
        ("str r0, [r1, #8]", &[0x6088], NOWHERE, PRECISE),
        ("ldrd r0, r2, [r1, #8]", &[0xE9D1, 0x0202], NOWHERE, PRECISE),
        ("ldmia.w r1!, {r0, r2}", &[0xE8B1, 0x0005], NOWHERE, PRECISE),
        // The second word is behind the end.
        ("ldmia.w r1!, {r0, r2}", &[0xE8B1, 0x0005], SRAM + super::SRAM_SIZE - 4, PRECISE),
        ("vadd.f64 d0, d0, d0", &[0xEE30, 0x0B00], 0, status::UNDEFINED),
        ("vldr s0, [r1]", &[0xED91, 0x0A00], DATA + 2, status::UNALIGNED),
    ];
    for (mnemonic, program, r1, cfsr) in cases {
        let mut machine = machine(program, &[]);
        if mnemonic.contains("f64") || mnemonic.contains("vldr") {
            machine.system_write(0xE000_ED88, 0x00F0_0000);
        }
        machine.set_r(0, 0x77);
        machine.set_r(1, r1);
        assert_eq!(hard_fault(&mut machine), (cfsr, PROGRAM), "{mnemonic}");
        // Neither destination nor base changed.
        assert_eq!((machine.r(0), machine.r(1)), (0x77, r1), "{mnemonic}");
    }
}

#[test]
fn instruction_faults_have_their_own_status() {
    // r0 of bx r0; CFSR, return address.
    let cases = [
        (NOWHERE | 1, status::INSTRUCTION_BUS, NOWHERE),
        (0x4000_0001, status::INSTRUCTION_ACCESS, 0x4000_0000),
        (0xE000_E001, status::INSTRUCTION_ACCESS, 0xE000_E000),
        // An even address selects another state, at the target.
        (PROGRAM + 0x10, status::INVALID_STATE, PROGRAM + 0x10),
    ];
    for (r0, cfsr, address) in cases {
        let mut machine = machine(&[0x4700], &[]); // bx r0
        machine.set_r(0, r0);
        assert_eq!(hard_fault(&mut machine), (cfsr, address), "{r0:#x}");
        let thumb = machine.word(STACK - 32 + 28) >> 24 & 1;
        assert_eq!(thumb, r0 & 1, "{r0:#x}");
    }
}

#[test]
fn fault_in_a_handler_is_a_hard_fault_above_it() {
    let mut machine = machine(&[0xBF00], &[0xDE00]); // nop; in the handler udf #0
    machine.interrupt(0);
    assert_eq!(hard_fault(&mut machine), (status::UNDEFINED, HANDLER + 0x80));
    assert!(machine.bus.system.is_active(3) && machine.bus.system.is_active(16));
}

#[test]
fn stack_overflow_into_unmapped_memory_ends_in_hard_fault() {
    // A push below the start of SRAM, then the frame of the fault below it too.
    let mut machine = machine(&[0xB500], &[]); // push {lr}
    machine.set_r(13, SRAM);
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!(machine.cfsr(), PRECISE | status::STACKING);
    // The pointer moved although nothing was written.
    assert_eq!(machine.r(13), SRAM - 32);
}

#[test]
fn fault_within_hard_fault_locks_up() {
    // A store below the stack, and a load from nowhere.
    for (handler, address) in [([0xB500, END], HANDLER), ([0xBF00, 0x6808], HANDLER + 2)] {
        let mut machine = machine(&[0xB500], &[]); // push {lr}
        machine.handler(3, HANDLER, &handler); // push {lr}; or nop, ldr r0, [r1]
        machine.set_r(13, SRAM);
        machine.set_r(1, NOWHERE);
        assert_eq!(machine.run(), Stop::LockUp { address });
    }
}

#[test]
fn interrupt_that_cannot_stack_stays_pending() {
    let mut machine = machine(&[0xBF00], &[END]); // nop
    machine.set_r(13, SRAM + 8);
    machine.interrupt(0);
    machine.finish();
    assert_eq!((machine.core.current_exception(), machine.cfsr()), (3, status::STACKING));
    assert!(machine.bus.system.is_pending(16) && !machine.bus.system.is_pending(3));
}

#[test]
fn nmi_preempts_hard_fault() {
    let mut machine = machine(&[0xDE00], &[]); // udf #0
    machine.handler(3, HANDLER, &[0xBF00, END]); // nop
    machine.handler(2, HANDLER + 0x40, &[0x2122, 0x4770]); // movs r1, #0x22; bx lr
    machine.step(1);
    machine.bus.system.pend_nmi();
    machine.step(1);
    assert_eq!((machine.core.current_exception(), machine.r(1)), (2, 0x22));
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
}

#[test]
fn invalid_exc_return_is_a_fault_on_the_same_frame() {
    // EXC_RETURN values to handler mode without an active exception below, to the process stack, and of no meaning.
    for lr in [0xFFFF_FFF1u32, 0xFFFF_FFFD, 0xFFFF_FFF5, 0xFFFF_FF09] {
        let mut machine = machine(&[0xBF00], &[0x4720]); // nop; in the handler bx r4
        machine.interrupt(0);
        machine.set_r(4, lr);
        machine.finish();
        assert_eq!(machine.core.current_exception(), 3, "{lr:#x}");
        assert_eq!(machine.cfsr(), status::INVALID_RETURN, "{lr:#x}");
        // Nothing was unstacked, and the interrupt is no longer active.
        assert_eq!((machine.r(13), machine.r(14)), (STACK - 32, lr), "{lr:#x}");
        assert!(!machine.bus.system.is_active(16), "{lr:#x}");
    }
}

#[test]
fn frame_of_another_mode_is_an_invalid_return() {
    // EXC_RETURN selects thread mode, the frame is that of a handler.
    let mut machine = machine(&[0xBF00], &[0x9507, 0x4770]); // nop; in the handler str r5, [sp, #28]; bx lr
    machine.interrupt(0);
    machine.set_r(5, 1 << 24 | 12);
    machine.finish();
    assert_eq!((machine.core.current_exception(), machine.cfsr()), (3, status::INVALID_RETURN));
    assert_eq!((machine.r(13), machine.r(14)), (STACK - 32, 0xFFFF_FFF9));
}

#[test]
fn unreadable_frame_is_an_unstacking_fault() {
    let mut machine = machine(&[0xBF00], &[0xF384, 0x8808, 0x4770]); // nop; in the handler msr msp, r4; bx lr
    machine.interrupt(0);
    machine.set_r(4, NOWHERE);
    machine.finish();
    assert_eq!((machine.core.current_exception(), machine.cfsr()), (3, status::UNSTACKING));
    assert_eq!((machine.r(13), machine.r(14)), (NOWHERE, 0xFFFF_FFF9));
}

#[test]
fn fault_in_an_it_block_is_executed_again_with_its_condition() {
    let program = [
        0x2800, // cmp r0, #0
        0xBF0C, // ite eq
        0x680A, // ldreq r2, [r1]
        0x2307, // movne r3, #7
    ];
    let mut machine = machine(&program, &[]);
    // The handler corrects the stacked r1.
    machine.handler(3, HANDLER, &[0x9501, 0x4770]); // str r5, [sp, #4]; bx lr
    machine.set_word(DATA, 0x1234);
    machine.set_r(1, NOWHERE);
    machine.set_r(5, DATA);
    machine.finish();
    assert_eq!([1, 2, 3].map(|k| machine.r(k)), [DATA, 0x1234, 0]);
}

#[test]
fn unpredictable_and_unmodelled_instructions_stop_the_core() {
    let programs: [(&str, &[u16]); 23] = [
        ("ldmia r1!, {r1, r2}", &[0xE8B1, 0x0006]),
        ("add.w sp, r1, #1", &[0xF101, 0x0D01]),
        ("smull r0, r0, r1, r2", &[0xFB81, 0x0002]),
        ("ldr.w r1, [r1], #4", &[0xF851, 0x1B04]),
        ("bfi r0, r1, #8, #-3", &[0xF361, 0x2004]),
        ("vmsr fpscr, r0", &[0xEEE1, 0x0A10]),
        ("vmrs r1, fpscr", &[0xEEF1, 0x1A10]),
        ("vcvtb.f16.f32 s0, s1", &[0xEEB3, 0x0A60]),
        ("vcvtt.f32.f16 s0, s1", &[0xEEB2, 0x0AE0]),
        ("vcvt.s32.f32 s0, s0, #16", &[0xEEBE, 0x0AC8]),
        ("vcvt.f32.u16 s0, s0, #1", &[0xEEBB, 0x0A67]),
        ("vfma.f32 s0, s1, s2", &[0xEEA0, 0x0A81]),
        ("vfnms.f32 s0, s1, s2", &[0xEE90, 0x0A81]),
        // There are 16 double-precision registers.
        ("vstmdb r1!, {d16}", &[0xED61, 0x0B02]),
        ("smlsd r0, r0, r1, r2", &[0xFB40, 0x2001]),
        ("smlaldx r0, r1, r2, r3", &[0xFBC2, 0x01D3]),
        ("smlsld r0, r1, r2, r3", &[0xFBD2, 0x01C3]),
        ("qdadd r0, r0, r1", &[0xFA81, 0xF090]),
        ("mrs r0, CONTROL", &[0xF3EF, 0x8014]),
        ("msr PSP, r0", &[0xF380, 0x8809]),
        ("msr APSR_nzcvq, r0", &[0xF380, 0x8800]),
        ("cpsid f", &[0xB671, 0]),
        ("svc 0", &[0xDF00, 0]),
    ];
    for (mnemonic, program) in programs {
        let mut machine = Machine::with_float(program);
        let halfwords = [program[0], program[1]];
        assert_eq!(machine.run(), Stop::Unsupported { address: PROGRAM, halfwords }, "{mnemonic}");
        assert_eq!(machine.core.pc(), PROGRAM);
    }
}

#[test]
fn branch_inside_an_it_block_stops_the_core_unchanged() {
    // Neither is the last instruction of its block.
    let programs: [(&str, [u16; 3]); 3] = [
        ("itt ne; bne . + 4; nopne", [0xBF1C, 0xE000, 0xBF00]),
        ("itt ne; popne {r0, pc}; nopne", [0xBF1C, 0xBD01, 0xBF00]),
        ("itt ne; blxne r1; nopne", [0xBF1C, 0x4788, 0xBF00]),
    ];
    for (mnemonic, program) in programs {
        let mut machine = Machine::new(&program);
        let stop = Stop::Unsupported { address: PROGRAM + 2, halfwords: [program[1], 0] };
        assert_eq!(machine.run(), stop, "{mnemonic}");
        assert_eq!((machine.r(13), machine.r(14)), (STACK, u32::MAX), "{mnemonic}");
    }
}
