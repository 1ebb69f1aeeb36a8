//! Faults, their status, escalation and lock-up.

use crate::core::system_control::fault_status as status;
use crate::core::tests::{DATA, END, Machine, PROGRAM, SRAM, STACK, Stop};

const HANDLER: u32 = PROGRAM + 0x400;
const SHCSR: u32 = 0xE000_ED24;
const CCR: u32 = 0xE000_ED14;
const CFSR: u32 = 0xE000_ED28;
/// No memory here.
const NOWHERE: u32 = 0x3000_0000;

/// A machine with a HardFault handler that stops.
fn machine(program: &[u16]) -> Machine {
    let mut machine = Machine::new(program);
    machine.handler(3, HANDLER, &[END]);
    machine
}

/// Runs to the handler of HardFault; gives CFSR, HFSR and the return address.
fn hard_fault(machine: &mut Machine) -> (u32, u32, u32) {
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    let system = &machine.bus.system;
    let (cfsr, hfsr) = (system.cfsr(), system.hfsr());
    let address = machine.r(13) + 24;
    (cfsr, hfsr, machine.word(address))
}

#[test]
fn usage_faults_escalate_to_hard_fault_where_disabled() {
    // Mnemonic, program, CCR, r1; CFSR.
    let cases: [(&str, &[u16], u32, u32, u32); 12] = [
        ("udf #0", &[0xDE00], 0x200, 0, status::UNDEFINED),
        ("udf.w #0", &[0xF7F0, 0xA000], 0x200, 0, status::UNDEFINED),
        ("vadd.f64 d0, d0, d0", &[0xEE30, 0x0B00], 0x200, 0, status::UNDEFINED),
        ("mrc p15, 0, r0, c0, c0, 0", &[0xEE10, 0x0F10], 0x200, 0, status::NO_COPROCESSOR),
        ("vmov.f32 s0, s0", &[0xEEB0, 0x0A40], 0x200, 0, status::NO_COPROCESSOR),
        ("sdiv r0, r0, r2", &[0xFB90, 0xF0F2], 0x210, 0, status::DIVISION_BY_ZERO),
        ("ldr r0, [r1]", &[0x6808], 0x208, DATA + 2, status::UNALIGNED),
        ("ldrd r0, r2, [r1]", &[0xE9D1, 0x0200], 0x200, DATA + 2, status::UNALIGNED),
        ("ldmia r1!, {r0, r2}", &[0xC905], 0x200, DATA + 1, status::UNALIGNED),
        ("ldrex r0, [r1]", &[0xE851, 0x0F00], 0x200, DATA + 2, status::UNALIGNED),
        ("strd r0, r2, [r1]", &[0xE9C1, 0x0200], 0x200, DATA + 1, status::UNALIGNED),
        // Device memory, where nothing unaligned is defined.
        ("ldr r0, [r1]", &[0x6808], 0x200, 0x4000_0002, status::UNALIGNED),
    ];
    for (mnemonic, program, ccr, r1, cfsr) in cases {
        let mut machine = machine(program);
        if mnemonic.contains("f64") {
            machine.system_write(0xE000_ED88, 0x00F0_0000);
        }
        machine.system_write(CCR, ccr);
        machine.core.set_register(1, r1);
        let found = hard_fault(&mut machine);
        assert_eq!(found, (cfsr, status::FORCED, PROGRAM), "{mnemonic}");
        assert_eq!(machine.r(1), r1, "{mnemonic}");
    }
}

#[test]
fn vldr_faults_where_unaligned() {
    let mut machine = machine(&[0xED91, 0x0A00]); // vldr s0, [r1]
    machine.system_write(0xE000_ED88, 0x00F0_0000);
    machine.core.set_register(1, DATA + 2);
    assert_eq!(hard_fault(&mut machine), (status::UNALIGNED, status::FORCED, PROGRAM));
}

#[test]
fn enabled_usage_fault_has_its_own_handler() {
    let mut machine = machine(&[0xBF00, 0xDE00]); // nop; udf #0
    machine.handler(6, HANDLER + 0x40, &[0x2166, END]); // movs r1, #0x66
    machine.system_write(SHCSR, 1 << 18);
    machine.finish();
    assert_eq!((machine.core.current_exception(), machine.r(1)), (6, 0x66));
    assert_eq!((machine.bus.system.cfsr(), machine.bus.system.hfsr()), (status::UNDEFINED, 0));
    assert_eq!(machine.word(STACK - 32 + 24), PROGRAM + 2);
    // USGFAULTACT and the enable bit.
    assert_eq!(machine.system_read(SHCSR), 1 << 18 | 1 << 3);
}

#[test]
fn fault_escalates_where_its_priority_does_not_suffice() {
    // An undefined instruction in a handler of the priority of UsageFault.
    let mut machine = machine(&[0xDF00]); // svc 0
    machine.handler(11, HANDLER + 0x40, &[0xDE00]); // udf #0
    machine.handler(6, HANDLER + 0x80, &[END]);
    machine.system_write(SHCSR, 1 << 18);
    let (cfsr, hfsr, address) = hard_fault(&mut machine);
    assert_eq!((cfsr, hfsr), (status::UNDEFINED, status::FORCED));
    assert_eq!(address, HANDLER + 0x40);
    assert_eq!(machine.bus.system.active_exceptions().collect::<Vec<_>>(), [3, 11]);
}

#[test]
fn svc_escalates_where_masked() {
    let mut machine = machine(&[0xB672, 0xDF00]); // cpsid i; svc 0
    assert_eq!(hard_fault(&mut machine), (0, status::FORCED, PROGRAM + 4));
}

#[test]
fn precise_bus_fault_gives_the_address() {
    let precise = status::PRECISE | status::BFAR_VALID;
    let cases: [(&str, &[u16]); 4] = [
        ("ldr r0, [r1, #8]", &[0x6888]),
        ("str r0, [r1, #8]", &[0x6088]),
        ("ldrd r0, r2, [r1, #8]", &[0xE9D1, 0x0202]),
        ("ldmia.w r3!, {r0, r2}", &[0xE8B3, 0x0005]),
    ];
    for (mnemonic, program) in cases {
        let mut machine = machine(program);
        machine.core.set_register(0, 0x77);
        machine.core.set_register(1, NOWHERE);
        machine.core.set_register(3, NOWHERE + 8);
        let found = hard_fault(&mut machine);
        assert_eq!(found, (precise, status::FORCED, PROGRAM), "{mnemonic}");
        assert_eq!(machine.bus.system.bfar(), NOWHERE + 8, "{mnemonic}");
        // Neither destination nor base changed.
        assert_eq!((machine.r(0), machine.r(3)), (0x77, NOWHERE + 8), "{mnemonic}");
    }
}

#[test]
fn load_multiple_that_faults_late_changes_no_register() {
    let end = SRAM + super::SRAM_SIZE;
    let mut machine = machine(&[0xE8B3, 0x0107]); // ldmia.w r3!, {r0, r1, r2, r8}
    machine.core.set_register(3, end - 8);
    machine.core.set_register(0, 0x70);
    assert_eq!(hard_fault(&mut machine).0, status::PRECISE | status::BFAR_VALID);
    assert_eq!(machine.bus.system.bfar(), end);
    assert_eq!((machine.r(0), machine.r(3)), (0x70, end - 8));
}

#[test]
fn enabled_bus_fault_can_correct_and_continue() {
    let mut machine = machine(&[0x6808]); // ldr r0, [r1]
    machine.handler(
        5,
        HANDLER + 0x40,
        &[
            0x9201, // str r2, [sp, #4]
            0x4770, // bx lr
        ],
    );
    machine.system_write(SHCSR, 1 << 17);
    machine.set_word(DATA, 0x1234);
    machine.core.set_register(1, NOWHERE);
    machine.core.set_register(2, DATA);
    machine.finish();
    // The handler replaced the stacked r1; the load was executed again.
    assert_eq!((machine.r(0), machine.r(1)), (0x1234, DATA));
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
        let mut machine = machine(&[0x4700]); // bx r0
        machine.core.set_register(0, r0);
        assert_eq!(hard_fault(&mut machine), (cfsr, status::FORCED, address), "{r0:#x}");
        let thumb = machine.word(STACK - 32 + 28) >> 24 & 1;
        assert_eq!(thumb, r0 & 1, "{r0:#x}");
    }
}

#[test]
fn stack_overflow_into_unmapped_memory_ends_in_hard_fault() {
    // A push below the start of SRAM, then the frame of the fault below it too.
    let mut machine = machine(&[0xB500]); // push {lr}
    machine.core.set_register(13, SRAM);
    machine.finish();
    let system = &machine.bus.system;
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!(system.cfsr(), status::PRECISE | status::BFAR_VALID | status::STACKING);
    assert_eq!((system.hfsr(), system.bfar()), (status::FORCED, SRAM - 4));
    // The pointer moved although nothing was written.
    assert_eq!(machine.r(13), SRAM - 32);
}

#[test]
fn stack_overflow_in_the_hard_fault_handler_locks_up() {
    let mut machine = machine(&[0xB500]); // push {lr}
    machine.handler(3, HANDLER, &[0xB500]); // push {lr}
    machine.core.set_register(13, SRAM);
    assert_eq!(machine.run(), Stop::LockUp { address: HANDLER });
}

#[test]
fn interrupt_that_cannot_stack_stays_pending() {
    let mut machine = machine(&[0xBF00]); // nop
    machine.handler(5, HANDLER + 0x40, &[END]);
    machine.handler(16, HANDLER + 0x80, &[END]);
    machine.system_write(SHCSR, 1 << 17);
    machine.system_write(0xE000_E400, 0x80);
    machine.system_write(0xE000_E100, 1);
    machine.core.set_register(13, SRAM + 8);
    machine.bus.system.set_line(0, true);
    machine.bus.system.set_line(0, false);
    machine.finish();
    // The BusFault of the stacking has the higher priority.
    assert_eq!(machine.core.current_exception(), 5);
    assert_eq!(machine.bus.system.cfsr(), status::STACKING);
    assert!(machine.bus.system.is_pending(16));
    assert!(!machine.bus.system.is_pending(5));
}

#[test]
fn unreadable_vector_ends_in_hard_fault() {
    let mut machine = machine(&[0xDF00]); // svc 0
    // The vector table ends with the SRAM.
    let table = SRAM + super::SRAM_SIZE - 0x80;
    machine.set_word(table + 12, HANDLER | 1);
    machine.handler(11, HANDLER + 0x40, &[END]);
    machine.system_write(0xE000_ED08, table);
    machine.system_write(0xE000_E100, u32::MAX);
    machine.bus.system.set_line(20, true);
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!((machine.bus.system.cfsr(), machine.bus.system.hfsr()), (0, status::VECTOR_TABLE));
}

#[test]
fn fault_within_hard_fault_locks_up() {
    let mut machine = machine(&[0xDE00]); // udf #0
    machine.handler(3, HANDLER, &[0xBF00, 0x6808]); // nop; ldr r0, [r1]
    machine.core.set_register(1, NOWHERE);
    assert_eq!(machine.run(), Stop::LockUp { address: HANDLER + 2 });
}

#[test]
fn fault_with_faultmask_locks_up() {
    let mut machine = machine(&[0xB671, 0xDE00]); // cpsid f; udf #0
    assert_eq!(machine.run(), Stop::LockUp { address: PROGRAM + 2 });
}

#[test]
fn nmi_preempts_hard_fault() {
    let mut machine = machine(&[0xDE00]); // udf #0
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
fn ignored_bus_fault_in_hard_fault_reads_zero() {
    let mut machine = machine(&[0xDE00]); // udf #0
    machine.handler(3, HANDLER, &[0x6808, END]); // ldr r0, [r1]
    machine.system_write(CCR, 0x300);
    machine.core.set_register(0, 7);
    machine.core.set_register(1, NOWHERE);
    machine.finish();
    assert_eq!(machine.r(0), 0);
    let cfsr = status::UNDEFINED | status::PRECISE | status::BFAR_VALID;
    assert_eq!(machine.bus.system.cfsr(), cfsr);
}

#[test]
fn invalid_exc_return_is_a_usage_fault_on_the_same_frame() {
    // EXC_RETURN values to handler mode without an active exception below, and of no meaning.
    for lr in [0xFFFF_FFF1u32, 0xFFFF_FFF5, 0xFFFF_FF09] {
        let mut machine = machine(&[0xDF00]); // svc 0
        machine.handler(11, HANDLER + 0x40, &[0x4720]); // bx r4
        machine.core.set_register(4, lr);
        machine.finish();
        assert_eq!(machine.core.current_exception(), 3, "{lr:#x}");
        assert_eq!(machine.bus.system.cfsr(), status::INVALID_RETURN, "{lr:#x}");
        // Nothing was unstacked, and SVCall is no longer active.
        assert_eq!((machine.r(13), machine.r(14)), (STACK - 32, lr), "{lr:#x}");
        assert!(!machine.bus.system.is_active(11), "{lr:#x}");
    }
}

#[test]
fn return_to_thread_needs_the_last_active_exception() {
    for (ccr, exception, cfsr) in [(0x200, 3, status::INVALID_RETURN), (0x201, 0, 0)] {
        let mut machine = machine(&[0xDF00]); // svc 0
        machine.handler(11, HANDLER + 0x40, &[0x603E, END]); // str r6, [r7]
        // Interrupt 0 preempts SVCall and returns to thread mode, with a frame that fits it.
        machine.handler(16, HANDLER + 0x80, &[0x9507, 0x4720]); // str r5, [sp, #28]; bx r4
        machine.system_write(CCR, ccr);
        machine.system_write(0xE000_ED1C, 0x8000_0000);
        machine.system_write(0xE000_E100, 1);
        for (number, value) in [(4, 0xFFFF_FFF9), (5, 1 << 24), (6, 1), (7, 0xE000_E200)] {
            machine.core.set_register(number, value);
        }
        machine.finish();
        assert_eq!(
            (machine.core.current_exception(), machine.bus.system.cfsr()),
            (exception, cfsr)
        );
        assert!(machine.bus.system.is_active(11) && !machine.bus.system.is_active(16));
    }
}

#[test]
fn frame_of_another_mode_is_an_invalid_return() {
    // EXC_RETURN selects thread mode, the frame is that of a handler.
    let mut machine = machine(&[0xDF00]); // svc 0
    machine.handler(11, HANDLER + 0x40, &[0x9507, 0x4770]); // str r5, [sp, #28]; bx lr
    machine.core.set_register(5, 1 << 24 | 12);
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!(machine.bus.system.cfsr(), status::INVALID_RETURN);
    assert_eq!((machine.r(13), machine.r(14)), (STACK - 32, 0xFFFF_FFF9));
}

#[test]
fn unreadable_frame_is_an_unstacking_fault() {
    let mut machine = machine(&[0xDF00]); // svc 0
    machine.handler(
        11,
        HANDLER + 0x40,
        &[
            0xF384, 0x8808, // msr msp, r4
            0x4770, // bx lr
        ],
    );
    machine.core.set_register(4, NOWHERE);
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!(machine.bus.system.cfsr(), status::UNSTACKING);
    assert_eq!((machine.r(13), machine.r(14)), (NOWHERE, 0xFFFF_FFF9));
}

#[test]
fn status_bits_are_cleared_by_writing_one() {
    let mut machine = machine(&[0xDE00]); // udf #0
    machine.core.set_register(1, NOWHERE);
    hard_fault(&mut machine);
    machine.system_write(CFSR, status::PRECISE);
    assert_eq!(machine.system_read(CFSR), status::UNDEFINED);
    // The upper half alone is the UFSR.
    assert!(machine.bus.system.write(CFSR + 2, super::Width::Half, 1));
    assert_eq!(machine.system_read(CFSR), 0);
    machine.system_write(0xE000_ED2C, status::FORCED);
    assert_eq!(machine.system_read(0xE000_ED2C), 0);
}

#[test]
fn fault_in_an_it_block_is_executed_again_with_its_condition() {
    let mut machine = machine(&[
        0x2800, // cmp r0, #0
        0xBF0C, // ite eq
        0x680A, // ldreq r2, [r1]
        0x2307, // movne r3, #7
    ]);
    machine.handler(5, HANDLER + 0x40, &[0x9501, 0x4770]); // str r5, [sp, #4]; bx lr
    machine.system_write(SHCSR, 1 << 17);
    machine.set_word(DATA, 0x1234);
    machine.core.set_register(1, NOWHERE);
    machine.core.set_register(5, DATA);
    machine.finish();
    assert_eq!([2, 3].map(|k| machine.r(k)), [0x1234, 0]);
}

#[test]
fn unpredictable_instructions_stop_the_core() {
    let programs: [(&str, &[u16]); 5] = [
        ("ldmia r1!, {r1, r2}", &[0xE8B1, 0x0006]),
        ("add.w sp, r1, #1", &[0xF101, 0x0D01]),
        ("smull r0, r0, r1, r2", &[0xFB81, 0x0002]),
        ("ldr.w r1, [r1], #4", &[0xF851, 0x1B04]),
        ("bfi r0, r1, #8, #-3", &[0xF361, 0x2004]),
    ];
    for (mnemonic, program) in programs {
        let mut machine = machine(program);
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
        let mut machine = machine(&program);
        let stop = Stop::Unsupported { address: PROGRAM + 2, halfwords: [program[1], 0] };
        assert_eq!(machine.run(), stop, "{mnemonic}");
        assert_eq!((machine.r(13), machine.r(14)), (STACK, u32::MAX), "{mnemonic}");
    }
}
