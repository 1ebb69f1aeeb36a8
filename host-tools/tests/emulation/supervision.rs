//! Parts that the drive needs are lost while the fingers move at full speed, or close on an object: trigger, clock, rotor
//! sensor, supplies, core, memory, power stage, loops. Without the current loop the duties would stay, and currents rise above
//! any limit.

use emulator::Time;
use emulator::core::{Bus, Width};
use emulator::peripherals::clocks::ResetCause;
use emulator::registers::interrupt;
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TASK_CODE, TaskState};
use firmware::motor::as5047;
use firmware::motor::calibration::CalibrationKind;
use firmware::motor::settings::MotorLimits;
use firmware::protocol::messages::Command;
use firmware::protocol::session::op;
use firmware::system::crash::CrashKind;
use firmware::system::faults::Fault;
use libtest_mimic::{Failed, Trial};
use sim::closed_loop::grasp_rig::{contact_object, grip_command};
use sim::faults::injection::InjectedFault;

use crate::faults::{CONTACT, came, go_to};
use crate::motion::{Cell, SET_N, cell, home, homed, move_to};

/// Longest time from a loss to bridges without duties, in milliseconds: all switches off, or all low sides on.
const LIMIT_MS: f64 = 5.0;
/// Time after a loss in which no duties may return, in milliseconds.
const WATCHED_MS: u64 = 40;
/// Resolution of the time, in microseconds: half a period.
const STEP_US: u64 = 25;
/// Peak current of a phase in amperes, with a margin for the periods until a reaction; the motor is driven with up to 10.
const MAX_A: f64 = 25.0;

/// What the fingers do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    /// They close at the highest speed, to a position.
    Moving,
    /// They press on an object with a rising force.
    Pressing,
}

impl Motion {
    /// When within a millisecond the loss comes, in microseconds.
    const fn phase_us(self) -> u64 {
        match self {
            Self::Moving => 375,
            Self::Pressing => 825,
        }
    }
}

/// What is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    Trigger,
    Crystal,
    RotorSilent,
    RotorStuck,
    RotorParity,
    MotorSupply,
    MotorUndervoltage,
    ChipSupply,
    Core,
    FlashWord,
    GateDrivers,
    BreakWire,
    MotionLoop,
    GripTask,
}

/// What the board reports afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Record {
    /// A fault, without a reset.
    Fault(Fault),
    /// A crash, after a reset.
    Crash(CrashKind, ResetCause),
}

impl Loss {
    const ALL: [Self; 14] = [
        Self::Trigger,
        Self::Crystal,
        Self::RotorSilent,
        Self::RotorStuck,
        Self::RotorParity,
        Self::MotorSupply,
        Self::MotorUndervoltage,
        Self::ChipSupply,
        Self::Core,
        Self::FlashWord,
        Self::GateDrivers,
        Self::BreakWire,
        Self::MotionLoop,
        Self::GripTask,
    ];

    /// Motions in which it is tested: all that differ by what detects it.
    fn motions(self) -> &'static [Motion] {
        match self {
            Self::Trigger
            | Self::Crystal
            | Self::RotorSilent
            | Self::ChipSupply
            | Self::MotionLoop
            | Self::GripTask => &[Motion::Moving, Motion::Pressing],
            _ => &[Motion::Moving],
        }
    }

    fn inject(self, cell: &mut Cell) {
        let soc = &mut cell.board.chip.soc;
        match self {
            Self::Trigger => soc.set_motor_trigger(false),
            Self::Crystal => soc.fail_crystal(),
            Self::RotorSilent => {
                cell.gripper.borrow_mut().errors.frame = Some(Box::new(|_| u16::MAX));
            }
            Self::RotorStuck => InjectedFault::EncoderStuck.inject(cell, 0),
            Self::RotorParity => InjectedFault::EncoderChecksum.inject(cell, 0),
            Self::MotorSupply => lose_motor_supply(cell),
            Self::MotorUndervoltage => InjectedFault::BusLow.inject(cell, 0),
            // Below the detector's 2.8 V, above every brown-out level of a chip as shipped.
            Self::ChipSupply => soc.set_supply(2700),
            Self::Core => lock_up(cell),
            Self::FlashWord => {
                let offset = checksum_table(cell);
                cell.board.chip.soc.corrupt_flash(offset);
            }
            Self::GateDrivers => soc.set_gate_fault(true),
            Self::BreakWire => soc.set_break_wire_open(true),
            Self::MotionLoop => disable(cell, "CORDIC"),
            Self::GripTask => disable(cell, "FMAC"),
        }
    }

    /// What was changed for good outside of the registers is as before, so that the board starts again.
    fn repair(self, cell: &mut Cell, code: &Code) {
        match self {
            Self::Crystal => cell.board.chip.soc.restore_crystal(),
            Self::Core | Self::FlashWord => code.restore(cell),
            _ => {}
        }
    }

    const fn record(self) -> Record {
        match self {
            Self::Trigger | Self::MotionLoop => Record::Fault(Fault::Runaway),
            Self::RotorSilent | Self::RotorStuck | Self::RotorParity => {
                Record::Fault(Fault::RotorSensor)
            }
            Self::MotorSupply | Self::MotorUndervoltage => Record::Fault(Fault::Supply),
            Self::ChipSupply | Self::GateDrivers | Self::BreakWire => {
                Record::Fault(Fault::PowerStage)
            }
            Self::Crystal | Self::FlashWord => {
                Record::Crash(CrashKind::NonMaskable, ResetCause::Software)
            }
            Self::Core | Self::GripTask => Record::Crash(CrashKind::Watchdog, ResetCause::Watchdog),
        }
    }

    /// Longest time to bridges without duties, in milliseconds.
    const fn limit_ms(self, motion: Motion) -> f64 {
        match (self, motion) {
            // The motion to a position ends by itself; the watchdog ends it before: 10 ms of the task, 5 ms of feeding,
            // 20 ms of its own.
            (Self::GripTask, Motion::Moving) => 35.0,
            // Five milliseconds after the last set-point, a tick of the motion loop, a period of the current loop, and a step of the
            // observation.
            (Self::GripTask, _) => LIMIT_MS + 0.3 + 1e-3 * STEP_US as f64,
            _ => LIMIT_MS,
        }
    }
}

type Test = fn() -> Result<(), Failed>;

pub fn trials() -> Vec<Trial> {
    let losses = Loss::ALL.into_iter().flat_map(|loss| {
        loss.motions().iter().map(move |motion| {
            let name = format!("supervision_{loss:?}_lost_while_{motion:?}");
            Trial::test(name, move || loses(loss, *motion))
        })
    });
    let returned = [Loss::Trigger, Loss::ChipSupply, Loss::GateDrivers, Loss::BreakWire];
    let returned = returned.map(|loss| {
        let name = format!("supervision_{loss:?}_returns_then_drive_works");
        Trial::test(name, move || returns(loss))
    });
    let others: [(&str, Test); 4] = [
        ("supervision_Trigger_lost_while_Commissioning", trigger_lost_while_commissioning),
        ("supervision_break_wire_open_at_start_no_duties", break_wire_open_at_start),
        ("supervision_brown_out_resets_without_duties", brown_out),
        ("supervision_one_disturbed_rotor_command_no_stop", disturbed_command),
    ];
    losses
        .chain(returned)
        .chain(others.into_iter().map(|(name, test)| Trial::test(name, test)))
        .collect()
}

/// Contents of the flash that a loss changes.
struct Code {
    words: Vec<(usize, Vec<u8>)>,
}

impl Code {
    fn of(cell: &Cell) -> Self {
        let soc = &cell.board.chip.soc;
        let word = |offset: usize| {
            let bytes = soc.memory(FLASH + offset as u32, 8).unwrap_or_default();
            (offset, bytes.to_vec())
        };
        Self { words: [checksum_table(cell), fault_handler(cell)].map(word).to_vec() }
    }

    fn restore(&self, cell: &mut Cell) {
        for (offset, bytes) in &self.words {
            cell.board.chip.soc.load_flash(*offset, bytes);
        }
    }
}

const FLASH: u32 = 0x0800_0000;

/// Offset of a double word with the symbol's first byte, plus `within` bytes.
fn flash_offset(cell: &Cell, symbol: &str, within: u32) -> usize {
    let mut found = cell.board.chip.image().symbols_named(symbol);
    let address = found.next().map_or(FLASH, |symbol| symbol.address);
    ((address + within) & !7).wrapping_sub(FLASH) as usize
}

/// In the table of the serial line's checksum, which every packet reads.
fn checksum_table(cell: &Cell) -> usize {
    flash_offset(cell, "checksum::CRC16", 64)
}

fn fault_handler(cell: &Cell) -> usize {
    flash_offset(cell, "HardFault", 0)
}

/// A fault whose handler cannot run: its code is gone.
fn lock_up(cell: &mut Cell) {
    const UNDEFINED: [u8; 8] = [0, 0xDE, 0, 0xDE, 0, 0xDE, 0, 0xDE];
    let handler = fault_handler(cell);
    cell.board.chip.soc.load_flash(handler, &UNDEFINED);
    // No memory is there.
    go_to(cell, 0x6000_0000);
}

/// The capacitor of the bus supplies the drive for some milliseconds: the loss is when its voltage is out of range.
fn lose_motor_supply(cell: &mut Cell) {
    let [low_v, _] = MotorLimits::GRIPPER.undervoltage_v.map(f64::from);
    cell.gripper.borrow_mut().rig.plant.set_supply(0.0);
    let bus_v = |cell: &Cell| cell.gripper.borrow().rig.plant.bus.voltage_v;
    assert!(cell.until(0.1, |cell| bus_v(cell) < low_v + 0.5).is_some());
    while bus_v(cell) >= low_v {
        let next = cell.board.chip.now() + Time::from_us(STEP_US);
        cell.board.chip.run_until(next).expect("the chip runs");
    }
}

/// Disables an interrupt by its bit in the interrupt controller.
fn disable(cell: &mut Cell, name: &str) {
    const CLEAR_ENABLE: u32 = 0xE000_E180;
    let number = interrupt(name) as u32;
    let register = CLEAR_ENABLE + 4 * (number / 32);
    let written = cell.board.chip.soc.write(register, Width::Word, 1 << (number % 32));
    assert!(written.is_ok());
}

/// A homed gripper in this motion.
fn in_motion(motion: Motion) -> Result<Cell, Failed> {
    let mut cell = homed()?;
    let speed_mm_s = |cell: &Cell| 1e3 * cell.gripper.borrow().rig.plant.train.travel_m_s;
    match motion {
        Motion::Moving => {
            let full =
                Command { mode: mode::MOVE, position: 100, speed: 232, ..Command::default() };
            cell.host.order(full);
            let is_fast = cell.until(2.0, |cell| speed_mm_s(cell) > 55.0);
            assert!(is_fast.is_some(), "{} mm/s", speed_mm_s(&cell));
        }
        Motion::Pressing => {
            move_to(&mut cell, 42.0);
            let object =
                contact_object(cell.gripper.borrow().rig.plant.parameters(), 40.0, CONTACT);
            cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
            cell.host.order(grip_command(SET_N));
            let presses = cell.until(4.0, |cell| cell.force_n() > 0.5 * SET_N);
            assert!(presses.is_some(), "{} N", cell.force_n());
        }
    }
    cell.board.take_dated_events();
    Ok(cell)
}

fn has_duties(cell: &Cell) -> bool {
    cell.board.chip.soc.motor_duties().is_some_and(|duties| duties != [0.0; 3])
}

/// What the bridges do after a loss.
struct Observed {
    /// Milliseconds after which no duties are on the bridges until the end of the observation.
    off_ms: f64,
    /// Peak of the phase currents in amperes.
    peak_a: f64,
}

/// Observes the bridges for some milliseconds; the time counts from `from_us` on the emulated clock. After a reset,
/// `repair` is called.
fn observe(
    cell: &mut Cell,
    from_us: f64,
    milliseconds: u64,
    mut repair: impl FnMut(&mut Cell),
) -> Observed {
    let mut observed = Observed { off_ms: 0.0, peak_a: 0.0 };
    let resets = cell.board.chip.resets.len();
    let mut is_repaired = false;
    for _ in 0..milliseconds {
        for step in 1..=1000 / STEP_US {
            cell.advance_us(step * STEP_US);
            if !is_repaired && cell.board.chip.resets.len() > resets {
                is_repaired = true;
                repair(cell);
            }
            if has_duties(cell) {
                observed.off_ms = 1e3 * cell.board.chip.now().as_s() - 1e-3 * from_us;
            }
            let currents_a = cell.gripper.borrow().rig.plant.motor.currents_a;
            observed.peak_a =
                currents_a.into_iter().fold(observed.peak_a, |peak, a| a.abs().max(peak));
        }
        cell.tick();
    }
    observed
}

fn loses(loss: Loss, motion: Motion) -> Result<(), Failed> {
    let mut cell = in_motion(motion)?;
    let code = Code::of(&cell);
    cell.gripper.borrow_mut().peak_n = 0.0;
    cell.advance_us(motion.phase_us());
    assert!(has_duties(&cell), "{loss:?}: not driven");
    loss.inject(&mut cell);
    let from_us = 1e6 * cell.board.chip.now().as_s();
    let before = cell.board.chip.resets.len();
    let Observed { off_ms, peak_a } =
        observe(&mut cell, from_us, WATCHED_MS, |cell| loss.repair(cell, &code));
    println!(
        "{loss:?} lost while {motion:?}: no duties after {off_ms:.2} ms, at most {peak_a:.1} A"
    );
    cell.run(0.5);
    assert!(!has_duties(&cell), "{loss:?}: duties return");
    check_record(loss, &mut cell, before)?;
    let limit_ms = loss.limit_ms(motion);
    assert!(off_ms <= limit_ms, "{loss:?}: duties for {off_ms:.2} ms");
    assert!(peak_a <= MAX_A, "{loss:?}: {peak_a:.1} A");
    let peak_n = cell.gripper.borrow().peak_n;
    assert!(peak_n <= SET_N + 10.0, "{loss:?}: {peak_n:.1} N");
    Ok(())
}

/// The hazard table requires a fault with its reaction, or a crash record after the reset; nothing moves without a session.
fn check_record(loss: Loss, cell: &mut Cell, resets: usize) -> Result<(), Failed> {
    let state = cell.state();
    match loss.record() {
        Record::Fault(fault) => {
            let (_, event) = came(cell, fault).ok_or(format!("{loss:?}: no {fault:?}"))?;
            assert_eq!(event.code, fault as u16);
            assert_eq!(state, PowerState::Fault as u8, "{loss:?}");
            assert_eq!(cell.board.chip.resets.len(), resets, "{:?}", cell.board.chip.resets);
        }
        Record::Crash(kind, cause) => {
            let [.., reset] = cell.board.chip.resets[..] else {
                return Err(format!("{loss:?}: no reset").into());
            };
            assert_eq!(reset.cause, cause, "{loss:?}");
            assert_eq!(cell.board.chip.resets.len(), resets + 1, "{:?}", cell.board.chip.resets);
            let (_, event) = came(cell, Fault::Crashed).ok_or("no crash is reported")?;
            assert_eq!(event.detail >> 24, kind.number(), "{loss:?}: {event:?}");
            assert!(state < TASK_CODE && state != 0, "{loss:?}: {state}");
        }
    }
    Ok(())
}

/// The motor identifies its windings: the current loop alone drives, and the grip task has no order.
fn trigger_lost_while_commissioning() -> Result<(), Failed> {
    let mut cell = cell(40.0)?;
    cell.run(0.4);
    cell.host.service(op::MEASURE, CalibrationKind::Motor as u32);
    cell.run(0.2);
    assert!(has_duties(&cell), "{}", cell.state());
    cell.board.chip.soc.set_motor_trigger(false);
    let from_us = 1e6 * cell.board.chip.now().as_s();
    let Observed { off_ms, peak_a } = observe(&mut cell, from_us, WATCHED_MS, |_| ());
    println!("trigger lost while commissioning: no duties after {off_ms:.2} ms, {peak_a:.1} A");
    assert!(off_ms <= LIMIT_MS, "duties for {off_ms:.2} ms");
    cell.run(0.3);
    assert!(cell.state() < PowerState::Armed as u8, "{}", cell.state());
    assert!(came(&mut cell, Fault::Runaway).is_some(), "{:?}", cell.host.received.faults);
    Ok(())
}

/// After the return the fault is cleared deliberately; then the gripper works again.
fn returns(loss: Loss) -> Result<(), Failed> {
    // Holding its position: the energy of a motion would charge the bus, which nothing discharges.
    let mut cell = homed()?;
    move_to(&mut cell, 5.0);
    assert!(has_duties(&cell));
    loss.inject(&mut cell);
    cell.run(0.5);
    let soc = &mut cell.board.chip.soc;
    match loss {
        Loss::Trigger => soc.set_motor_trigger(true),
        Loss::ChipSupply => soc.set_supply(3300),
        Loss::GateDrivers => soc.set_gate_fault(false),
        Loss::BreakWire => soc.set_break_wire_open(false),
        _ => return Err(format!("{loss:?} does not return").into()),
    }
    cell.run(0.3);
    assert_eq!(cell.state(), PowerState::Fault as u8);
    assert!(!has_duties(&cell));
    cell.host.service(op::CLEAR_FAULTS, 0);
    cell.run(0.1);
    // Commands of the session that has ended are counted as strange for a second.
    cell.host.is_silent = true;
    cell.run(1.2);
    assert!(cell.state() < PowerState::Armed as u8, "{}", cell.state());
    cell.host.is_silent = false;
    assert!(cell.enable(), "{}: {:?}", cell.state(), cell.host.received.faults);
    if cell.is_in(TaskState::Unhomed) {
        home(&mut cell);
    }
    move_to(&mut cell, 20.0);
    Ok(())
}

/// The motion ends before it begins.
fn break_wire_open_at_start() -> Result<(), Failed> {
    let mut cell = cell(40.0)?;
    cell.board.chip.soc.set_break_wire_open(true);
    cell.board.chip.power_cycle()?;
    assert!(cell.enable(), "{}", cell.state());
    cell.host.order(Command { mode: mode::HOME, ..Command::default() });
    let from_us = 1e6 * cell.board.chip.now().as_s();
    let observed = observe(&mut cell, from_us, 200, |_| ());
    assert_eq!(observed.off_ms, 0.0);
    assert_eq!(cell.state(), PowerState::Fault as u8);
    assert!(came(&mut cell, Fault::PowerStage).is_some(), "{:?}", cell.host.received.faults);
    Ok(())
}

/// Far below the detector's threshold the chip is held in reset; it starts again with the supply, and does not move.
fn brown_out() -> Result<(), Failed> {
    let mut cell = in_motion(Motion::Moving)?;
    cell.board.chip.soc.set_supply(1600);
    let from_us = 1e6 * cell.board.chip.now().as_s();
    let held = observe(&mut cell, from_us, 20, |_| ());
    cell.board.chip.soc.set_supply(3300);
    let after = observe(&mut cell, from_us, 300, |_| ());
    assert_eq!((held.off_ms, after.off_ms), (0.0, 0.0));
    let causes: Vec<_> = cell.board.chip.resets.iter().map(|reset| reset.cause).collect();
    assert_eq!(causes, [ResetCause::PowerOn]);
    assert!(cell.state() < PowerState::Armed as u8, "{}", cell.state());
    Ok(())
}

/// The sensor's error flag stays in every answer until its error register is read: the driver reads it, and the tracker
/// bridges the missing angles.
fn disturbed_command() -> Result<(), Failed> {
    let mut cell = in_motion(Motion::Moving)?;
    let mut disturbed = false;
    let change = move |command: u16| {
        let first = command == as5047::READ_ANGLE && !std::mem::replace(&mut disturbed, true);
        if first { command ^ 1 } else { command }
    };
    cell.gripper.borrow_mut().errors.command = Some(Box::new(change));
    cell.run(2.0);
    assert!(cell.is_in(TaskState::Idle), "{}: {:?}", cell.state(), cell.host.received.faults);
    let opening_mm = 1e3 * cell.gripper.borrow().rig.plant.opening_m();
    assert!((opening_mm - 5.0).abs() < 0.1, "{opening_mm} mm");
    assert!(cell.host.received.faults.is_empty(), "{:?}", cell.host.received.faults);
    Ok(())
}
