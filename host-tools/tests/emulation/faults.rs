//! Faults that concern the chip, while the gripper holds an object with 100 N; and crashes of the program, with their record after
//! the reset. `supervision` has those whose cause is a part of the board.

use emulator::Time;
use emulator::peripherals::clocks::ResetCause;
use firmware::grip::states::{TASK_CODE, TaskState};
use firmware::protocol::messages::FaultEvent;
use firmware::system::crash::CrashKind;
use firmware::system::faults::{Event, Fault};
use libtest_mimic::{Failed, Trial};
use sim::board::SimulatedBoard;
use sim::closed_loop::grasp_rig::{contact_object, grip_command};
use sim::drivetrain::parameters::Lead;
use sim::faults::injection::InjectedFault;
use sim::faults::operating_state::{OperatingState, SET_N};
use sim::faults::run::FaultCase;

use crate::boards::violations;
use crate::motion::{Cell, cell, homed, move_to};

/// Newtons to the millimetre of what is held.
pub const CONTACT: f64 = 333.0;
/// What the emulator's reading of the log, and the image's own time, add to the time within which a fault is found.
const REPORT_MS: f64 = 1.5;
/// Milliseconds after a fault.
const AFTER_MS: u32 = 500;

type Crash = (&'static str, fn() -> Result<(), Failed>);

pub fn trials() -> Vec<Trial> {
    let rows = [InjectedFault::BusHigh, InjectedFault::LineLow, InjectedFault::MemoryCorruption];
    let of_rows =
        rows.into_iter().map(|row| Trial::test(format!("fault_{row:?}"), move || during_hold(row)));
    let crashes: [Crash; 4] = [
        ("panic", || crashes(CrashKind::Panic, ResetCause::Software, panic)),
        ("hard_fault", || crashes(CrashKind::HardFault, ResetCause::Software, hard_fault)),
        ("stack_overflow", || crashes(CrashKind::StackOverflow, ResetCause::Software, recurse)),
        ("hang", || crashes(CrashKind::Watchdog, ResetCause::Watchdog, hang)),
    ];
    let of_crashes =
        crashes.into_iter().map(|(name, test)| Trial::test(format!("crash_{name}"), test));
    of_rows.chain(of_crashes).collect()
}

/// A gripper that holds an object of 40 mm.
pub fn holding() -> Result<Cell, Failed> {
    let mut cell = homed()?;
    move_to(&mut cell, 42.0);
    let thing = contact_object(cell.gripper.borrow().rig.plant.parameters(), 40.0, CONTACT);
    cell.gripper.borrow_mut().rig.plant.set_object(Some(&thing));
    cell.host.order(grip_command(SET_N));
    let held = cell.until(4.0, |cell| cell.is_in(TaskState::HoldActive));
    assert!(held.is_some(), "{}", cell.state());
    cell.run(0.4);
    cell.board.take_events();
    Ok(cell)
}

/// When a fault came, in milliseconds since the board was switched on.
pub fn came(cell: &mut Cell, fault: Fault) -> Option<(f64, FaultEvent)> {
    let events = cell.board.take_dated_events().into_iter();
    events.into_iter().find_map(|(time, event)| match event {
        Event::Fault(event) if event.code == fault as u16 && event.active != 0 => {
            Some((time.as_ms(), event))
        }
        _ => None,
    })
}

fn during_hold(row: InjectedFault) -> Result<(), Failed> {
    let mut cell = holding()?;
    let at_us = cell.time_us();
    row.inject(&mut cell, 1);
    for _ in 0..AFTER_MS {
        cell.tick();
    }
    let case = FaultCase {
        fault: row,
        state: OperatingState::Hold,
        lead: Lead::A,
        contact_n_per_mm: CONTACT,
        seed: 1,
    };
    let state = cell.state();
    assert!(case.is_specified(state), "{row:?}: {state:#x}");
    let facts = row.specification();
    let Some((time_ms, event)) = came(&mut cell, facts.fault) else {
        return Err(format!("{row:?}: {:?} is not reported", facts.fault).into());
    };
    if row != InjectedFault::MemoryCorruption {
        let found_ms = time_ms - 1e-3 * at_us as f64;
        println!("{row:?} reported after {found_ms:.2} ms");
        assert!(found_ms <= facts.within_ms + REPORT_MS, "{row:?}: {found_ms:.2} ms");
        assert_eq!(cell.board.chip.resets, []);
    } else {
        assert_eq!(event.detail, CrashKind::Corruption.number() << 24);
        assert_eq!(cell.board.chip.resets.len(), 1);
    }
    // The screw locks itself.
    let force_n = cell.force_n();
    assert!(force_n > 0.85 * SET_N, "{row:?}: {force_n} N");
    Ok(())
}

/// The board crashes while it is armed; after the reset the record is reported, and the gripper is not enabled before a host
/// arms again.
fn crashes(kind: CrashKind, cause: ResetCause, crash: fn(&mut Cell)) -> Result<(), Failed> {
    let mut cell = cell(40.0)?;
    assert!(cell.enable(), "{}", cell.state());
    cell.run(0.2);
    cell.board.take_events();
    let at_us = cell.time_us();
    crash(&mut cell);
    cell.host.received.heartbeat = None;
    let lasts_us = 20_000_000;
    let is_reset =
        |cell: &Cell| !cell.board.chip.resets.is_empty() || cell.time_us() > at_us + lasts_us;
    cell.until(21.0, is_reset);
    let [reset] = cell.board.chip.resets[..] else {
        return Err(format!("{:?}", cell.board.chip.resets).into());
    };
    assert_eq!(reset.cause, cause);
    println!("{kind:?}: reset after {:.2} ms", reset.time.as_ms() - 1e-3 * at_us as f64);
    cell.run(0.5);
    let (_, event) =
        came(&mut cell, Fault::Crashed).ok_or("no crash is reported after the reset")?;
    assert_eq!(event.detail >> 24, kind.number(), "{event:?}");
    assert!(cell.state() < TASK_CODE && cell.state() != 0, "{}", cell.state());
    assert_eq!(cell.board.chip.resets.len(), 1, "{:?}", cell.board.chip.resets);
    assert_eq!(violations(&cell.board), [""; 0]);
    Ok(())
}

/// Goes on in thread mode.
pub fn go_to(cell: &mut Cell, address: u32) {
    while cell.board.chip.core().current_exception() != 0 {
        let next = cell.board.chip.now() + Time::from_us(1);
        cell.board.chip.run_until(next).expect("the chip runs");
    }
    cell.board.chip.core_mut().set_pc(address);
}

/// Runs instructions that are put at the end of RAM, which is unused.
fn run_code(cell: &mut Cell, halfwords: &[u16]) {
    const ADDRESS: u32 = 0x2001_7F00;
    let bytes: Vec<u8> = halfwords.iter().flat_map(|halfword| halfword.to_le_bytes()).collect();
    assert!(cell.board.chip.soc.write_memory(ADDRESS, &bytes));
    go_to(cell, ADDRESS);
}

fn panic(cell: &mut Cell) {
    let function =
        cell.board.chip.image().symbols_named("core::panicking::panic_bounds_check").next();
    let address = function.expect("the image has a function that panics").address;
    go_to(cell, address);
}

/// No memory is there.
fn hard_fault(cell: &mut Cell) {
    go_to(cell, 0x6000_0000);
}

/// PUSH {R4-R7, LR}; BL to itself.
fn recurse(cell: &mut Cell) {
    run_code(cell, &[0xB5F0, 0xF7FF, 0xFFFD]);
}

/// B to itself.
fn hang(cell: &mut Cell) {
    run_code(cell, &[0xE7FE]);
}
