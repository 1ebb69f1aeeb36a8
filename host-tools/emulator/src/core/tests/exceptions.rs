//! Entry, return, priorities, masks, tail-chaining.

use crate::core::tests::{DATA, FLASH, Machine, PROGRAM, STACK, Z};

/// Handlers are here, 0x40 bytes each.
const HANDLERS: u32 = PROGRAM + 0x400;

const ISER: u32 = 0xE000_E100;
const ISPR: u32 = 0xE000_E200;
const IPR: u32 = 0xE000_E400;

/// A machine whose interrupts 0 to 3 are enabled with the given priorities. Their handlers append
/// their exception number to the bytes from r6 on.
fn with_interrupts(program: &[u16], priorities: [u8; 4]) -> Machine {
    let mut machine = Machine::new(program);
    for irq in 0..4 {
        machine.handler(
            16 + irq,
            HANDLERS + 0x40 * irq,
            &[
                0x2010 + irq as u16, // movs r0, #16 + irq
                0xF806,
                0x0B01, // strb.w r0, [r6], #1
                0x4770, // bx lr
            ],
        );
    }
    machine.set_r(6, DATA);
    machine.system_write(IPR, u32::from_le_bytes(priorities));
    machine.system_write(ISER, 0xF);
    machine
}

fn entered(machine: &mut Machine) -> Vec<u8> {
    let count = machine.r(6) - DATA;
    (0..count).map(|k| machine.word(DATA + k) as u8).collect()
}

#[test]
fn entry_stacks_the_frame_and_return_restores_it() {
    let mut machine = with_interrupts(&[0xBF00, 0xBF00], [0; 4]); // nop; nop
    for number in 0..4 {
        machine.set_r(number, 0x100 + number as u32);
    }
    machine.set_r(12, 0x112);
    machine.set_r(14, 0x115);
    machine.core.state.apsr = Z;
    machine.step(1);
    machine.interrupt(0);
    machine.step(1);
    assert_eq!(machine.core.current_exception(), 16);
    assert_eq!((machine.r(14), machine.r(13)), (0xFFFF_FFF9, STACK - 32));
    let frame: Vec<u32> = (0..8).map(|k| machine.word(STACK - 32 + 4 * k)).collect();
    let xpsr = Z | 1 << 24;
    assert_eq!(frame, [0x100, 0x101, 0x102, 0x103, 0x112, 0x115, PROGRAM + 2, xpsr]);
    machine.finish();
    assert_eq!([0, 1, 2, 3, 12, 14].map(|k| machine.r(k)), frame[..6]);
    assert_eq!((machine.r(13), machine.core.state.xpsr()), (STACK, xpsr));
}

#[test]
fn frame_is_aligned_to_8_bytes() {
    let mut machine = with_interrupts(&[0xB081], [0; 4]); // sub sp, #4
    machine.step(1);
    machine.interrupt(1);
    machine.step(1);
    assert_eq!(machine.r(13), STACK - 40);
    // Bit 9 of the stacked xPSR.
    assert_ne!(machine.word(STACK - 40 + 28) & 1 << 9, 0);
    machine.finish();
    assert_eq!(machine.r(13), STACK - 4);
}

#[test]
fn pending_exceptions_are_taken_by_priority_then_number() {
    let mut machine = with_interrupts(&[0xBF00], [0x30, 0x10, 0x20, 0x10]); // nop
    for irq in 0..4 {
        machine.interrupt(irq);
    }
    machine.finish();
    assert_eq!(entered(&mut machine), [17, 19, 18, 16]);
}

#[test]
fn higher_priority_preempts_and_equal_does_not() {
    for (priority, order) in [(0x10, [17, 16]), (0x20, [16, 17]), (0x30, [16, 17])] {
        let mut machine = with_interrupts(&[0xBF00], [0x20, priority, 0, 0]); // nop
        // Interrupt 0 pends interrupt 1 before it stores its own number.
        machine.handler(
            16,
            HANDLERS + 0x200,
            &[
                0x2002, // movs r0, #2
                0x6038, // str r0, [r7]
                0xBF00, // nop
                0x2010, // movs r0, #16
                0xF806, 0x0B01, // strb.w r0, [r6], #1
                0x4770, // bx lr
            ],
        );
        machine.set_r(7, ISPR);
        machine.interrupt(0);
        machine.finish();
        assert_eq!(entered(&mut machine), order, "priority {priority:#x}");
    }
}

#[test]
fn basepri_masks_its_priority_and_lower_ones() {
    let mut machine = with_interrupts(
        &[
            0x2020, // movs r0, #0x20
            0xF380, 0x8811, // msr basepri, r0
            0xBF00, // nop
            0x2000, // movs r0, #0
            0xF380, 0x8811, // msr basepri, r0
        ],
        [0x10, 0x20, 0x30, 0],
    );
    machine.set_r(6, DATA);
    machine.step(2);
    for irq in 0..3 {
        machine.interrupt(irq);
    }
    machine.step(4); // three instructions of handler 16, then the nop
    assert_eq!(entered(&mut machine), [16]);
    machine.finish();
    assert_eq!(entered(&mut machine), [16, 17, 18]);
}

#[test]
fn basepri_max_raises_the_priority_only() {
    let mut machine = Machine::new(&[
        0xF380, 0x8812, // msr basepri_max, r0
        0xF381, 0x8812, // msr basepri_max, r1
        0xF382, 0x8812, // msr basepri_max, r2
        0xF383, 0x8812, // msr basepri_max, r3
    ]);
    for (number, value) in [0x40, 0x60, 0x2F, 0].into_iter().enumerate() {
        machine.set_r(number, value);
    }
    let levels = [0x40, 0x40, 0x20, 0x20];
    for level in levels {
        machine.step(1);
        assert_eq!(machine.core.state.basepri, level);
    }
}

#[test]
fn primask_masks_interrupts_and_not_nmi() {
    let mut machine = with_interrupts(
        &[
            0xB672, // cpsid i
            0xBF00, // nop
            0xB662, // cpsie i
        ],
        [0; 4],
    );
    machine.handler(2, HANDLERS + 0x200, &[0x2107, 0x4770]); // movs r1, #7; bx lr
    machine.step(1);
    machine.interrupt(0);
    machine.bus.system.pend_nmi();
    machine.step(1);
    assert_eq!(machine.core.current_exception(), 2);
    machine.step(3); // bx lr, nop, cpsie i
    assert_eq!((machine.core.current_exception(), entered(&mut machine).len()), (0, 0));
    machine.finish();
    assert_eq!(entered(&mut machine), [16]);
}

#[test]
fn tail_chaining_takes_6_cycles_and_keeps_the_frame() {
    let mut machine = with_interrupts(&[0xBF00], [0x10, 0x20, 0, 0]); // nop
    machine.interrupt(0);
    machine.interrupt(1);
    // Entry, then movs, strb and bx of the first handler: 12 + 1 + 1 + 1; the first handler does not
    // return.
    machine.step(3);
    let before = machine.bus.time;
    assert_eq!(before, 15 + 6);
    assert_eq!((machine.core.current_exception(), machine.r(13)), (17, STACK - 32));
    assert_eq!(machine.r(14), 0xFFFF_FFF9);
    machine.finish();
    assert_eq!((entered(&mut machine), machine.r(13)), (vec![16, 17], STACK));
}

#[test]
fn preempted_handler_returns_to_handler_mode() {
    let mut machine = with_interrupts(&[0xBF00], [0x20, 0x10, 0, 0]); // nop
    machine.interrupt(0);
    machine.step(1);
    machine.interrupt(1);
    machine.step(1);
    assert_eq!((machine.core.current_exception(), machine.r(14)), (17, 0xFFFF_FFF1));
    assert!(machine.bus.system.is_active(16) && machine.bus.system.is_active(17));
    machine.step(2);
    assert_eq!(machine.core.current_exception(), 16);
    machine.finish();
    assert_eq!(entered(&mut machine), [17, 16]);
}

#[test]
fn line_that_stays_high_pends_again_after_the_return() {
    let mut machine = with_interrupts(&[0xBF00, 0xBF00], [0; 4]); // nop; nop
    machine.bus.system.set_line(2, true);
    machine.step(1);
    // Active and not pending, although the line is high.
    assert!(machine.bus.system.is_active(18) && !machine.bus.system.is_pending(18));
    machine.step(2);
    assert_eq!(machine.core.current_exception(), 18, "tail-chained to itself");
    machine.bus.system.set_line(2, false);
    machine.finish();
    assert_eq!(entered(&mut machine), [18, 18]);
}

#[test]
fn edge_during_the_handler_pends_it_once_more() {
    let mut machine = with_interrupts(&[0xBF00], [0; 4]); // nop
    machine.bus.system.set_line(2, true);
    machine.step(1);
    machine.bus.system.set_line(2, false);
    machine.interrupt(2);
    assert!(machine.bus.system.is_pending(18));
    machine.finish();
    assert_eq!(entered(&mut machine), [18, 18]);
}

#[test]
fn clearing_a_pending_bit_fails_while_the_line_is_high() {
    let mut machine = with_interrupts(&[], [0; 4]);
    machine.bus.system.set_line(3, true);
    machine.system_write(0xE000_E280, 1 << 3);
    assert!(machine.bus.system.is_pending(19));
    machine.bus.system.set_line(3, false);
    assert!(machine.bus.system.is_pending(19));
    machine.system_write(0xE000_E280, 1 << 3);
    assert!(!machine.bus.system.is_pending(19));
}

#[test]
fn disabled_interrupt_stays_pending_until_enabled() {
    let mut machine = with_interrupts(&[0xBF00, 0xBF00], [0; 4]); // nop; nop
    machine.system_write(0xE000_E180, 1);
    machine.interrupt(0);
    machine.step(1);
    assert_eq!(machine.core.current_exception(), 0);
    machine.system_write(ISER, 1);
    machine.finish();
    assert_eq!(entered(&mut machine), [16]);
}

#[test]
fn itstate_continues_after_an_exception() {
    // The interrupt comes between the two conditional instructions.
    let program = [
        0x2800, // cmp r0, #0
        0xBF0C, // ite eq
        0x2101, // moveq r1, #1
        0x2202, // movne r2, #2
        0x2303, // movs r3, #3
    ];
    let mut machine = with_interrupts(&program, [0; 4]);
    // The handler changes the flags.
    machine.handler(16, HANDLERS + 0x200, &[0x2001, 0x2801, 0x2802, 0x4770]); // movs r0, #1; cmp r0, #1; cmp r0, #2; bx lr
    machine.set_r(2, 9);
    machine.step(3);
    machine.interrupt(0);
    machine.step(1);
    // ITSTATE 0b0001_1000 (ne, last) is stacked in bits 15 to 10 and 26 to 25; the handler has none.
    let xpsr = machine.word(STACK - 32 + 28);
    assert_eq!((xpsr >> 25 & 3, xpsr >> 10 & 0x3F), (0, 0b000110));
    assert_eq!((machine.core.state.xpsr() & 0x0600_FC00, machine.r(0)), (0, 1));
    machine.finish();
    assert_eq!([1, 2, 3].map(|k| machine.r(k)), [1, 9, 3]);
}

#[test]
fn reset_loads_stack_and_entry_and_clears_the_state() {
    let mut machine = with_interrupts(&[0xB672, 0xBF00], [0; 4]); // cpsid i; nop
    machine.bus.system.set_line(1, true);
    machine.step(2);
    machine.core.reset(&mut machine.bus).expect("the vector table is there");
    assert_eq!((machine.core.pc(), machine.r(13), machine.r(14)), (PROGRAM, STACK, u32::MAX));
    assert!(!machine.core.state.primask);
    assert_eq!(machine.system_read(ISER), 0);
    // The peripheral still drives its line.
    assert!(machine.bus.system.is_pending(17));
    assert_eq!(machine.word(FLASH), STACK);
}

#[test]
fn exception_clears_the_exclusive_monitor() {
    let mut machine = with_interrupts(&[0xE851, 0x0F00, 0xE841, 0x3200], [0; 4]); // ldrex r0, [r1]; strex r2, r3, [r1]
    machine.set_r(1, DATA);
    machine.step(1);
    machine.interrupt(0);
    machine.finish();
    assert_eq!(machine.r(2), 1);
}

#[test]
fn software_pends_an_interrupt_by_stir() {
    let mut machine = with_interrupts(&[0x2003, 0x6038, 0xBF00], [0; 4]); // movs r0, #3; str r0, [r7]; nop
    machine.set_r(7, 0xE000_EF00);
    machine.finish();
    assert_eq!(entered(&mut machine), [19]);
}
