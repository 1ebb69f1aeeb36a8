//! WFE, WFI, SEV and what ends a sleep.

use crate::core::state::Sleep;
use crate::core::tests::{Machine, PROGRAM, Pause};

const HANDLER: u32 = PROGRAM + 0x400;
const WFE: u16 = 0xBF20;
const WFI: u16 = 0xBF30;

/// A machine with interrupt 0 enabled at priority 0x40; its handler counts in r5.
fn machine(program: &[u16]) -> Machine {
    let mut machine = Machine::new(program);
    machine.handler(16, HANDLER, &[0x3501, 0x4770]); // adds r5, #1; bx lr
    machine.system_write(0xE000_E400, 0x40);
    machine.system_write(0xE000_E100, 1);
    machine
}

#[test]
fn wfe_sleeps_until_an_interrupt_was_handled() {
    let mut machine = machine(&[WFE, 0x2101]); // wfe; movs r1, #1
    machine.sleep();
    assert_eq!(machine.core.state.sleep, Sleep::Event);
    assert_eq!((machine.core.pc(), machine.bus.time), (PROGRAM + 2, 1));
    machine.sleep();
    machine.interrupt(0);
    machine.finish();
    assert_eq!((machine.r(5), machine.r(1)), (1, 1));
}

#[test]
fn wfe_continues_with_the_event_register_set() {
    let mut machine = machine(&[
        0xBF40, // sev
        WFE,    // clears the event
        WFE,
    ]);
    machine.sleep();
    assert_eq!(machine.core.pc(), PROGRAM + 6);
    machine.bus.system.signal_event();
    machine.finish();
}

#[test]
fn exception_sets_the_event_register() {
    let mut machine = machine(&[0xBF00, WFE, WFE]); // nop; wfe; wfe
    machine.interrupt(0);
    machine.sleep();
    // The first WFE found the event of the handler.
    assert_eq!((machine.r(5), machine.core.pc()), (1, PROGRAM + 6));
}

#[test]
fn wfe_ignores_masked_interrupts() {
    let mut machine = machine(&[0xB672, WFE]); // cpsid i; wfe
    machine.sleep();
    machine.bus.system.set_line(0, true);
    machine.sleep();
    assert_eq!(machine.core.state.sleep, Sleep::Event);
}

#[test]
fn wfi_wakes_under_primask_and_takes_the_interrupt_later() {
    let mut machine = machine(&[
        0xB672, // cpsid i
        WFI, 0x2101, // movs r1, #1
        0xB662, // cpsie i
        0xBF00, // nop
    ]);
    machine.sleep();
    machine.interrupt(0);
    machine.step(1);
    assert_eq!((machine.r(1), machine.r(5), machine.core.state.sleep), (1, 0, Sleep::Awake));
    machine.finish();
    assert_eq!(machine.r(5), 1);
}

#[test]
fn wfi_does_not_wake_by_what_basepri_masks() {
    let mut machine = machine(&[
        0x2040, // movs r0, #0x40
        0xF380, 0x8811, // msr basepri, r0
        WFI,
    ]);
    machine.sleep();
    machine.bus.system.set_line(0, true);
    machine.sleep();
    machine.bus.system.set_line(0, false);
    machine.system_write(0xE000_E400, 0x30);
    machine.finish();
    assert_eq!(machine.r(5), 1);
}

#[test]
fn wfi_with_a_pending_interrupt_does_not_sleep() {
    let mut machine = machine(&[0xB672, WFI]); // cpsid i; wfi
    machine.step(1);
    machine.bus.system.set_line(0, true);
    machine.finish();
    assert_eq!((machine.r(5), machine.bus.time), (0, 3));
}

#[test]
fn run_returns_when_an_event_is_due() {
    let mut machine = machine(&[0xE7FE]); // b .
    machine.bus.event_at = 100;
    assert_eq!(machine.core.run(&mut machine.bus), Ok(Pause::EventDue));
    // Two cycles each, so exactly at the event.
    assert_eq!(machine.bus.time, 100);
    assert_eq!(machine.core.run(&mut machine.bus), Ok(Pause::EventDue));
    assert_eq!(machine.bus.time, 100);
}
