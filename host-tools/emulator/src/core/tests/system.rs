//! Registers of the system control space, special registers, statistics.

use crate::core::tests::{Machine, PROGRAM, STACK, Stop, SystemControl, Width};

const HANDLER: u32 = PROGRAM + 0x400;

#[test]
fn reset_values_are_those_of_the_chip() {
    let system = SystemControl::new();
    let registers = [
        ("AIRCR", 0xE000_ED0C, 0xFA05_0000),
        ("CFSR", 0xE000_ED28, 0),
        ("CPACR", 0xE000_ED88, 0),
        ("IPR", 0xE000_E400, 0),
    ];
    for (name, address, value) in registers {
        assert_eq!(system.read(address), Some(value), "{name}");
    }
}

#[test]
fn absent_registers_are_reported() {
    let mut system = SystemControl::new();
    // SysTick, VTOR, MPU_TYPE, MMFAR, DWT_CTRL, behind the last priority that the architecture has.
    let absent = [0xE000_E010, 0xE000_ED08, 0xE000_ED90, 0xE000_ED34, 0xE000_1000, 0xE000_E5F0];
    for address in absent {
        assert_eq!(system.read(address), None, "{address:#x}");
        assert!(!system.write(address, Width::Word, 0), "{address:#x}");
    }
    // A priority of an interrupt that the chip does not have is ignored.
    assert!(system.write(0xE000_E470, Width::Word, 0xF0F0_F0F0));
    assert_eq!(system.read(0xE000_E470), Some(0));
    // A word register by bytes, and a priority group.
    assert!(!system.write(0xE000_ED88, Width::Byte, 0));
    assert!(!system.write(0xE000_ED0C, Width::Word, 0x05FA_0500));
}

#[test]
fn priorities_have_four_bits_and_any_width() {
    let mut system = SystemControl::new();
    assert!(system.write(0xE000_E402, Width::Byte, 0x7F));
    assert!(system.write(0xE000_E400, Width::Half, 0x1F2F));
    assert_eq!(system.read(0xE000_E400), Some(0x0070_1020));
    assert_eq!((system.priority(16), system.priority(17), system.priority(18)), (0x20, 0x10, 0x70));
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
fn reset_request_needs_the_key() {
    let mut machine = Machine::new(&[
        0x6008, // str r0, [r1]
        0x600A, // str r2, [r1]
        0xBF00, // nop
    ]);
    machine.set_r(0, 4);
    machine.set_r(1, 0xE000_ED0C);
    machine.set_r(2, 0x05FA_0004);
    assert_eq!(machine.run(), Stop::ResetRequested);
    assert_eq!(machine.core.pc(), PROGRAM + 4);
    assert!(machine.bus.system.reset_requested());
    machine.core.reset(&mut machine.bus).expect("the vector table is there");
    assert!(!machine.bus.system.reset_requested());
}

#[test]
fn statistics_attribute_to_exceptions() {
    let mut machine = Machine::new(&[0xBF00, 0xBF00]); // nop; nop
    machine.handler(16, HANDLER, &[0xB500, 0xB580, 0xBC03, 0xBD00]); // push {lr}; push {r7, lr}; pop {r0, r1}; pop {pc}
    machine.system_write(0xE000_E100, 1);
    machine.step(1);
    machine.interrupt(0);
    // The handler, and the second instruction of the program.
    machine.step(5);
    machine.interrupt(0);
    machine.finish();
    let total = machine.core.state.cycles;
    let statistics = machine.core.statistics().clone();
    let (thread, handler) = (statistics.by_exception[0], statistics.by_exception[16]);
    // Two instructions and the BKPT.
    assert_eq!((thread.instructions, thread.cycles, thread.entries), (3, 3, 0));
    // Entry 12, push 1 + 1, push 1 + 2, pop 1 + 2, pop 1 + 1, return 10.
    assert_eq!((handler.instructions, handler.entries), (8, 2));
    assert_eq!((handler.cycles, handler.longest_cycles), (2 * 32, 32));
    assert_eq!(thread.cycles + handler.cycles, total);
    assert_eq!(statistics.lowest_msp, STACK - 32 - 12);
    machine.core.clear_statistics();
    assert_eq!(machine.core.statistics().by_exception[16].entries, 0);
}

#[test]
fn special_registers_are_read_and_written() {
    let mut machine = Machine::new(&[
        0xF384, 0x8808, // msr MSP, r4
        0xF3EF, 0x8508, // mrs r5, MSP
        0xB672, // cpsid i
        0xF3EF, 0x8610, // mrs r6, PRIMASK
        0xF386, 0x8811, // msr BASEPRI, r6
        0xF384, 0x8811, // msr BASEPRI, r4
        0xF3EF, 0x8711, // mrs r7, BASEPRI
    ]);
    machine.set_r(4, 0x2000_08F7);
    machine.finish();
    assert_eq!([5, 13, 6, 7].map(|k| machine.r(k)), [0x2000_08F4, 0x2000_08F4, 1, 0xF0]);
}

#[test]
fn longest_stay_includes_preemption() {
    let mut machine = Machine::new(&[0xBF00]); // nop
    machine.handler(16, HANDLER, &[0xBF00, 0x4770]); // nop; bx lr
    machine.handler(17, HANDLER + 0x40, &[0xBF00, 0x4770]); // nop; bx lr
    machine.system_write(0xE000_E400, 0x0080);
    machine.system_write(0xE000_E100, 3);
    machine.interrupt(0);
    machine.step(1);
    machine.interrupt(1);
    machine.finish();
    let statistics = machine.core.statistics();
    // Entry 12, two instructions, return 10.
    assert_eq!(statistics.by_exception[17].longest_cycles, 24);
    assert_eq!(statistics.by_exception[16].cycles, 24);
    assert_eq!(statistics.by_exception[16].longest_cycles, 48);
}

#[test]
fn breakpoint_stops_behind_itself() {
    let mut machine = Machine::new(&[0xBEAB, 0x2101]); // bkpt 0xab; movs r1, #1
    assert_eq!(machine.run(), Stop::Breakpoint { address: PROGRAM, immediate: 0xAB });
    assert_eq!(machine.core.pc(), PROGRAM + 2);
    machine.finish();
    assert_eq!(machine.r(1), 1);
}
