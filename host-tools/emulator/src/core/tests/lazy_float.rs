//! Floating-point context across exceptions: lazy stacking.

use crate::core::system_control::fault_status as status;
use crate::core::tests::{END, Machine, PROGRAM, SRAM, STACK};

const HANDLERS: u32 = PROGRAM + 0x400;

/// First word of an extended frame below the initial stack.
const FRAME: u32 = STACK - 0x68;

/// Handler that overwrites S0 and S15.
const USES_FLOAT: &[u16] = &[
    0xEEB0, 0x0A61, // vmov.f32 s0, s3
    0xEEF0, 0x7A61, // vmov.f32 s15, s3
    0x4770, // bx lr
];
/// Handler without floating point.
const NO_FLOAT: &[u16] = &[
    0xBF00, // nop
    0x4770, // bx lr
];

/// A program with an active floating-point context (S0 = 0x100 to S31 = 0x11F) whose third
/// instruction is yet to come.
fn with_context(handler: &[u16]) -> Machine {
    let mut machine = Machine::with_float(&[
        0xEEB0, 0x0A40, // vmov.f32 s0, s0
        0xBF00, // nop
        0xBF00, // nop
    ]);
    machine.handler(16, HANDLERS, handler);
    machine.system_write(0xE000_E100, 3);
    for k in 0..32 {
        machine.set_s(k, 0x100 + k as u32);
    }
    machine.step(2);
    assert!(machine.core.state.float_active);
    machine
}

fn assert_context(machine: &Machine) {
    for k in 0..32 {
        assert_eq!(machine.s(k), 0x100 + k as u32, "s{k}");
    }
}

#[test]
fn lazy_entry_reserves_the_frame_and_writes_nothing() {
    let mut machine = with_context(NO_FLOAT);
    machine.set_word(FRAME + 0x20, 0xDEAD);
    machine.interrupt(0);
    machine.step(1);
    assert_eq!((machine.r(13), machine.r(14)), (FRAME, 0xFFFF_FFE9));
    assert_eq!(machine.core.state.lazy_frame, Some(FRAME + 0x20));
    assert!(!machine.core.state.float_active);
    machine.finish();
    assert_eq!(machine.word(FRAME + 0x20), 0xDEAD);
    assert_eq!(machine.core.state.lazy_frame, None);
    assert_eq!((machine.r(13), machine.core.state.float_active), (STACK, true));
    assert_context(&machine);
}

#[test]
fn first_float_instruction_of_the_handler_preserves_the_context() {
    let mut machine = with_context(USES_FLOAT);
    machine.core.state.fpscr = 0x2000_0000;
    machine.interrupt(0);
    machine.step(1);
    assert_eq!(machine.core.state.lazy_frame, None);
    let saved: Vec<u32> = (0..17).map(|k| machine.word(FRAME + 0x20 + 4 * k)).collect();
    assert_eq!(saved[..16], (0x100..0x110).collect::<Vec<u32>>());
    assert_eq!((saved[16], machine.core.state.float_active), (0x2000_0000, true));
    assert_eq!(machine.s(0), 0x103);
    machine.finish();
    assert_context(&machine);
    assert_eq!(machine.core.state.fpscr, 0x2000_0000);
}

#[test]
fn preservation_takes_17_cycles_once() {
    let mut machine = with_context(USES_FLOAT);
    machine.interrupt(0);
    let start = machine.bus.time;
    machine.step(1);
    assert_eq!(machine.bus.time - start, 12 + 17 + 1);
    machine.step(1);
    assert_eq!(machine.bus.time - start, 12 + 17 + 2);
}

#[test]
fn nested_handler_preserves_the_interrupted_context() {
    // The first handler does not use the unit, the second, which preempts it, does.
    let mut machine = with_context(NO_FLOAT);
    machine.handler(17, HANDLERS + 0x40, USES_FLOAT);
    machine.system_write(0xE000_E400, 0x0080);
    machine.interrupt(0);
    machine.step(1);
    machine.interrupt(1);
    machine.step(1);
    // The frame of the second is basic; the registers went into the first.
    assert_eq!((machine.r(14), machine.r(13)), (0xFFFF_FFF1, FRAME - 32));
    assert_eq!(machine.word(FRAME + 0x20), 0x100);
    machine.finish();
    assert_context(&machine);
}

#[test]
fn both_nested_handlers_keep_their_own_contexts() {
    let mut machine = with_context(USES_FLOAT);
    machine.handler(17, HANDLERS + 0x40, USES_FLOAT);
    machine.system_write(0xE000_E400, 0x0080);
    machine.interrupt(0);
    machine.step(1);
    machine.set_s(4, 0x777);
    machine.interrupt(1);
    machine.step(1);
    assert_eq!((machine.r(14), machine.r(13)), (0xFFFF_FFE1, FRAME - 0x68));
    assert_eq!(machine.word(FRAME - 0x68 + 0x20 + 16), 0x777);
    machine.set_s(4, 0x888);
    machine.step(2);
    assert_eq!((machine.core.current_exception(), machine.s(4)), (16, 0x777));
    machine.finish();
    assert_context(&machine);
}

#[test]
fn without_a_context_the_frame_is_basic() {
    let mut machine = Machine::with_float(&[0xBF00]); // nop
    machine.handler(16, HANDLERS, USES_FLOAT);
    machine.system_write(0xE000_E100, 1);
    machine.interrupt(0);
    machine.step(1);
    assert_eq!((machine.r(13), machine.r(14)), (STACK - 32, 0xFFFF_FFF9));
    assert!(machine.core.state.float_active);
    machine.finish();
    assert!(!machine.core.state.float_active);
}

#[test]
fn closing_the_coprocessor_denies_the_next_instruction() {
    let mut machine = Machine::with_float(&[
        0xEEB0, 0x0A40, // vmov.f32 s0, s0
        0x6001, // str r1, [r0]
        0xEEB0, 0x0A40, // vmov.f32 s0, s0
    ]);
    machine.handler(3, HANDLERS, &[END]);
    machine.set_r(0, 0xE000_ED88);
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!(machine.cfsr(), status::NO_COPROCESSOR);
}

#[test]
fn lazy_state_that_cannot_be_written_is_a_fault() {
    let mut machine = with_context(NO_FLOAT);
    machine.handler(3, HANDLERS + 0x40, &[END]);
    machine.place(HANDLERS + 2, USES_FLOAT);
    machine.interrupt(0);
    machine.step(1);
    // Before the first use in the handler the address becomes that of no memory.
    machine.core.state.lazy_frame = Some(SRAM - 0x100);
    machine.finish();
    assert_eq!(machine.core.current_exception(), 3);
    assert_eq!(machine.cfsr(), status::LAZY_STACKING);
    // The instruction is to be executed again, and the state is still to be preserved.
    let frame = machine.r(13);
    assert_eq!(machine.word(frame + 24), HANDLERS + 2);
    assert!(machine.core.state.lazy_frame.is_some());
}
