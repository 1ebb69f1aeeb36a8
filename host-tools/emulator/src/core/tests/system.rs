//! Registers of the system control space, special registers, statistics.

use crate::core::tests::{DATA, END, Machine, PROGRAM, STACK, Stop, SystemControl, Width};

const HANDLER: u32 = PROGRAM + 0x400;

#[test]
fn reset_values_are_those_of_the_chip() {
    let system = SystemControl::new();
    let registers = [
        ("CPUID", 0xE000_ED00, 0x410F_C241),
        ("ICTR", 0xE000_E004, 3),
        ("AIRCR", 0xE000_ED0C, 0xFA05_0000),
        ("CCR", 0xE000_ED14, 0x200),
        ("FPCCR", 0xE000_EF34, 0xC000_0000),
        ("MVFR0", 0xE000_EF40, 0x1011_0021),
        ("MVFR1", 0xE000_EF44, 0x1100_0011),
        ("DWT_CTRL", 0xE000_1000, 0x4000_0000),
        ("CPACR", 0xE000_ED88, 0),
        ("VTOR", 0xE000_ED08, 0),
    ];
    for (name, address, value) in registers {
        assert_eq!(system.read(address), Some(value), "{name}");
    }
}

#[test]
fn absent_registers_are_reported() {
    let mut system = SystemControl::new();
    // SysTick, MPU_TYPE, MMFAR, behind the last priority that the architecture has.
    for address in [0xE000_E010, 0xE000_ED90, 0xE000_ED34, 0xE000_E5F0] {
        assert_eq!(system.read(address), None, "{address:#x}");
        assert!(!system.write(address, Width::Word, 0), "{address:#x}");
    }
    // A priority of an interrupt that the chip does not have is ignored.
    assert!(system.write(0xE000_E470, Width::Word, 0xF0F0_F0F0));
    assert_eq!(system.read(0xE000_E470), Some(0));
    // A word register by bytes, and functions that are not modelled.
    assert!(!system.write(0xE000_ED08, Width::Byte, 0));
    assert!(!system.write(0xE000_E008, Width::Word, 1 << 8));
    assert!(!system.write(0xE000_1000, Width::Word, 1 << 12));
}

#[test]
fn priorities_have_four_bits_and_any_width() {
    let mut system = SystemControl::new();
    assert!(system.write(0xE000_E402, Width::Byte, 0x7F));
    assert!(system.write(0xE000_E400, Width::Half, 0x1F2F));
    assert_eq!(system.read(0xE000_E400), Some(0x0070_1020));
    assert_eq!((system.priority(16), system.priority(17), system.priority(18)), (0x20, 0x10, 0x70));
    assert!(system.write(0xE000_ED23, Width::Byte, 0xC0));
    assert_eq!(system.read(0xE000_ED20), Some(0xC000_0000));
    assert_eq!(system.priority(15), 0xC0);
    assert_eq!((system.priority(2), system.priority(3), system.priority(0)), (-2, -1, 256));
}

#[test]
fn interrupt_registers_set_and_clear_single_bits() {
    let mut system = SystemControl::new();
    assert!(system.write(0xE000_E104, Width::Word, 0x5));
    assert!(system.write(0xE000_E184, Width::Word, 0x1));
    assert_eq!(system.read(0xE000_E104), Some(0x4));
    assert_eq!(system.read(0xE000_E184), Some(0x4));
    // 112 interrupts: the last word has 16 bits.
    assert!(system.write(0xE000_E10C, Width::Word, u32::MAX));
    assert_eq!(system.read(0xE000_E10C), Some(0xFFFF));
    assert!(system.write(0xE000_E204, Width::Word, 0x6));
    assert!(system.write(0xE000_E284, Width::Word, 0x2));
    assert_eq!(system.read(0xE000_E204), Some(0x4));
    assert!(system.is_pending(16 + 34) && system.is_enabled(16 + 34));
}

#[test]
fn icsr_shows_active_and_pending_exceptions() {
    let mut machine = Machine::new(&[0xBF00]); // nop
    machine.handler(16 + 5, HANDLER, &[0x6838, 0x4770]); // ldr r0, [r7]; bx lr
    machine.system_write(0xE000_E404, 0x0000_4000);
    machine.system_write(0xE000_E100, 1 << 5 | 1 << 9);
    machine.system_write(0xE000_E408, 0x0000_8000);
    machine.core.set_register(7, 0xE000_ED04);
    machine.bus.system.set_line(5, true);
    machine.bus.system.set_line(9, true);
    machine.step(1);
    // VECTACTIVE 21, RETTOBASE, VECTPENDING 25, ISRPENDING.
    assert_eq!(machine.r(0), 21 | 1 << 11 | 25 << 12 | 1 << 22);
}

#[test]
fn cycle_counter_counts_while_enabled() {
    let mut machine = Machine::new(&[
        0x6801, // ldr r1, [r0]
        0xBF00, // nop
        0xBF00, // nop
        0x6802, // ldr r2, [r0]
        0x6803, // ldr r3, [r0]
        0x603C, // str r4, [r7]
        0x6805, // ldr r5, [r0]
        0x6806, // ldr r6, [r0]
    ]);
    machine.system_write(0xE000_EDFC, 1 << 24);
    machine.system_write(0xE000_1004, 1000);
    machine.system_write(0xE000_1000, 1);
    machine.core.set_register(0, 0xE000_1004);
    machine.core.set_register(7, 0xE000_1000);
    machine.core.set_register(4, 0);
    machine.finish();
    // Load 2, two instructions, load 2, overlapping load 1.
    assert_eq!(machine.r(2) - machine.r(1), 4);
    assert_eq!(machine.r(3) - machine.r(2), 1);
    assert!(machine.r(1) >= 1000);
    assert_eq!(machine.r(5), machine.r(6));
}

#[test]
fn reset_request_needs_the_key() {
    let mut machine = Machine::new(&[
        0x6008, // str r0, [r1]
        0x600A, // str r2, [r1]
        0xBF00, // nop
    ]);
    machine.core.set_register(0, 4);
    machine.core.set_register(1, 0xE000_ED0C);
    machine.core.set_register(2, 0x05FA_0004);
    assert_eq!(machine.run(), Stop::ResetRequested);
    assert_eq!(machine.core.pc(), PROGRAM + 4);
    assert!(machine.bus.system.reset_requested());
    machine.core.reset(&mut machine.bus).expect("the vector table is there");
    assert!(!machine.bus.system.reset_requested());
}

#[test]
fn special_registers_are_read_and_written_by_parts() {
    let mut machine = Machine::new(&[
        0xF380, 0x8C00, // msr APSR_nzcvqg, r0
        0xF3EF, 0x8100, // mrs r1, APSR
        0xF382, 0x8400, // msr APSR_g, r2
        0xF3EF, 0x8303, // mrs r3, PSR
        0xF384, 0x8808, // msr MSP, r4
        0xF3EF, 0x8508, // mrs r5, MSP
        0xF3EF, 0x8606, // mrs r6, EPSR
    ]);
    machine.core.set_register(0, u32::MAX);
    machine.core.set_register(4, 0x2000_0807);
    machine.finish();
    assert_eq!(machine.r(1), 0xF80F_0000);
    assert_eq!(machine.r(3), 0xF800_0000);
    assert_eq!((machine.r(5), machine.r(13)), (0x2000_0804, 0x2000_0804));
    assert_eq!(machine.r(6), 0);
}

#[test]
fn unprivileged_code_is_restricted() {
    let mut machine = Machine::new(&[
        0x2001, // movs r0, #1
        0xF380, 0x8814, // msr control, r0
        0xB672, // cpsid i
        0xF380, 0x8811, // msr basepri, r0
        0x2000, // movs r0, #0
        0xF380, 0x8814, // msr control, r0
        0xF3EF, 0x8108, // mrs r1, MSP
        0x683A, // ldr r2, [r7]
    ]);
    machine.handler(3, HANDLER, &[END]);
    machine.core.set_register(7, 0xE000_ED00);
    machine.finish();
    assert_eq!(machine.core.masks(), (false, false, 0));
    assert_eq!((machine.core.control(), machine.r(1)), (1, 0));
    // Access to the system control space is a bus fault.
    assert_eq!((machine.core.current_exception(), machine.bus.system.bfar()), (3, 0xE000_ED00));
}

#[test]
fn statistics_attribute_to_exceptions() {
    let mut machine = Machine::new(&[
        0xBF00, // nop
        0xDF00, // svc 0
        0xBF00, // nop
        0xDF00, // svc 0
    ]);
    machine.handler(11, HANDLER, &[0xB500, 0xB580, 0xBC03, 0xBD00]); // push {lr}; push {r7, lr}; pop {r0, r1}; pop {pc}
    machine.finish();
    let total = machine.core.cycles();
    let statistics = machine.core.statistics().clone();
    let (thread, handler) = (statistics.by_exception[0], statistics.by_exception[11]);
    // Four instructions and the BKPT.
    assert_eq!((thread.instructions, thread.cycles, thread.entries), (5, 5, 0));
    // Entry 12, push 1 + 1, push 1 + 2, pop 1 + 2, pop 1 + 1, return 10.
    assert_eq!((handler.instructions, handler.entries), (8, 2));
    assert_eq!((handler.cycles, handler.longest_cycles), (2 * 32, 32));
    assert_eq!(thread.cycles + handler.cycles, total);
    assert_eq!(statistics.lowest_msp, STACK - 32 - 12);
    machine.core.clear_statistics();
    assert_eq!(machine.core.statistics().by_exception[11].entries, 0);
}

#[test]
fn longest_stay_includes_preemption() {
    let mut machine = Machine::new(&[0xBF00]); // nop
    machine.handler(16, HANDLER, &[0xBF00, 0x4770]); // nop; bx lr
    machine.handler(17, HANDLER + 0x40, &[0xBF00, 0x4770]); // nop; bx lr
    machine.system_write(0xE000_E400, 0x0080);
    machine.system_write(0xE000_E100, 3);
    machine.bus.system.set_line(0, true);
    machine.bus.system.set_line(0, false);
    machine.step(1);
    machine.bus.system.set_line(1, true);
    machine.bus.system.set_line(1, false);
    machine.finish();
    let statistics = machine.core.statistics();
    // Entry 12, two instructions, return 10.
    assert_eq!(statistics.by_exception[17].longest_cycles, 24);
    assert_eq!(statistics.by_exception[16].cycles, 24);
    assert_eq!(statistics.by_exception[16].longest_cycles, 48);
}

#[test]
fn history_keeps_the_last_64_addresses() {
    let mut program = vec![0xBF00; 70]; // nop
    program[69] = 0x2101; // movs r1, #1
    let mut machine = Machine::new(&program);
    machine.step(3);
    assert_eq!(machine.core.history(), [PROGRAM, PROGRAM + 2, PROGRAM + 4]);
    machine.finish();
    let history = machine.core.history();
    assert_eq!((history.len(), history[63]), (64, PROGRAM + 140));
    assert_eq!(history[0], PROGRAM + 140 - 126);
}

#[test]
fn breakpoint_stops_behind_itself() {
    let mut machine = Machine::new(&[0xBEAB, 0x2101]); // bkpt 0xab; movs r1, #1
    assert_eq!(machine.run(), Stop::Breakpoint { address: PROGRAM, immediate: 0xAB });
    assert_eq!(machine.core.pc(), PROGRAM + 2);
    machine.finish();
    assert_eq!(machine.r(1), 1);
}

#[test]
fn access_functions_change_the_state() {
    let mut machine = Machine::new(&[0xBF00]); // nop
    machine.core.set_register(3, 7);
    machine.core.set_register(15, DATA | 1);
    assert_eq!((machine.r(3), machine.r(15), machine.core.pc()), (7, DATA, DATA));
    machine.core.set_xpsr(0xF80F_0000);
    assert_eq!(machine.core.xpsr(), 0xF90F_0000);
}
