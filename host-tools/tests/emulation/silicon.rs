//! Errata and properties of the silicon that the reference manual states in passing or not at all
//! (`emulator/README.md`).

use emulator::wiring::Wiring;
use emulator::{Frequency, Time};
use firmware::config::constants::MODULATION;
use firmware::grip::commands::mode;
use firmware::parameters::Parameters;
use firmware::parameters::schema::{counter, detector, id};
use firmware::protocol::messages::{Command, Message};
use firmware::protocol::serial::{Packet, PacketDecoder};
use firmware::protocol::session::{op, status};
use firmware::system::faults::{Event, Fault};
use libtest_mimic::{Failed, Trial};
use sim::board::SimulatedBoard;
use sim::closed_loop::emulated_board::{self, ChipConditions, EmulatedBoard};
use sim::drivetrain::PERIOD_S;
use sim::drivetrain::sensors::ROOM_C;

use crate::boards::{at_rest, board, image, pressed, violations};
use crate::faults::holding;
use crate::images::Variant;
use crate::motion::{Cell, SET_N, cell, homed, move_to};
use crate::storage;

type Test = fn() -> Result<(), Failed>;

pub fn trials() -> Vec<Trial> {
    let tests: [(&str, Test); 10] = [
        ("silicon_log_reader_stops_no_tick_is_missed", log_reader_stops),
        ("silicon_debugger_halts_core_bridges_are_off", debugger_halts),
        ("silicon_temperatures_after_pauses_are_right", temperatures),
        ("silicon_full_modulation_samples_are_valid", full_modulation),
        ("silicon_spurious_bus_errors_no_transfer_is_lost", spurious_bus_errors),
        ("silicon_dead_crystal_is_reported", dead_crystal),
        ("silicon_direct_current_is_zero_in_both_directions", direct_current),
        ("silicon_single_bank_nothing_is_erased", single_bank),
        ("silicon_late_stops_no_reading_is_wrong", late_stops),
        ("silicon_low_supply_without_its_detector_is_counted", low_supply),
    ];
    tests.into_iter().map(|(name, test)| Trial::test(name, test)).collect()
}

/// A full buffer of the log blocks nobody: the program that reads it has ended, and faults are still logged.
fn log_reader_stops() -> Result<(), Failed> {
    let mut cell = holding()?;
    cell.board.chip.stall_log();
    cell.host.received.faults.clear();
    cell.board.chip.soc.set_gate_fault(true);
    cell.run(0.2);
    assert_eq!(cell.board.chip.resets, []);
    // The screw locks itself.
    assert!(cell.force_n() > 0.85 * SET_N, "{} N", cell.force_n());
    let codes: Vec<_> = cell.host.received.faults.iter().map(|(_, event)| event.code).collect();
    assert!(codes.contains(&(Fault::PowerStage as u16)), "{codes:?}");
    assert!(!codes.contains(&(Fault::TicksMissed as u16)), "{codes:?}");
    Ok(())
}

/// The duties do not stay on the bridges until the watchdog resets the chip.
fn debugger_halts() -> Result<(), Failed> {
    let mut cell = homed()?;
    cell.host.order(Command { mode: mode::MOVE, position: 1000, speed: 232, ..Command::default() });
    cell.run(0.2);
    assert!(cell.board.chip.soc.motor_duties().is_some());
    cell.board.chip.set_halted(true);
    let mut peak_a = 0.0_f64;
    for step in 1..=600 {
        cell.advance_us(25 * step);
        assert_eq!(cell.board.chip.soc.motor_duties(), None);
        let currents_a = cell.gripper.borrow().rig.plant.motor.currents_a;
        peak_a = currents_a.into_iter().fold(peak_a, |peak, current| current.abs().max(peak));
    }
    println!("at most {peak_a:.1} A in 15 ms");
    assert!(peak_a < 12.0, "{peak_a} A");
    Ok(())
}

/// Each is converted ten times a second: the first conversion after a pause is wrong.
fn temperatures() -> Result<(), Failed> {
    let mut cell = cell(40.0)?;
    cell.gripper.borrow_mut().temperatures_c = [40.0, 60.0];
    cell.run(1.0);
    let (_, power) = cell.host.received.power.ok_or("no message")?;
    let found = [power.mcu, power.motor].map(f64::from);
    println!("chip and motor: {found:?} degrees");
    assert!((found[0] - ROOM_C).abs() <= 2.0 && (found[1] - 40.0).abs() <= 2.0, "{found:?}");
    assert_eq!(violations(&cell.board), [""; 0]);
    Ok(())
}

/// The supply barely suffices for the speed: the low sides are on for as short as they ever are.
fn full_modulation() -> Result<(), Failed> {
    let mut cell = homed()?;
    move_to(&mut cell, 60.0);
    cell.gripper.borrow_mut().rig.plant.set_supply(17.5);
    cell.host.order(Command { mode: mode::MOVE, position: 100, speed: 240, ..Command::default() });
    let mut most = 0.0_f64;
    for _ in 0..400 {
        for step in 1..=20 {
            cell.advance_us(50 * step);
            let duties = cell.board.chip.soc.motor_duties().unwrap_or_default();
            most = duties.into_iter().fold(most, f64::max);
        }
        cell.tick();
    }
    println!("duty at most {most:.3}");
    assert!(most > MODULATION.value - 0.002, "not driven to the limit: {most}");
    assert_eq!(violations(&cell.board), [""; 0]);
    Ok(())
}

/// A detected misplaced start or stop alone is none.
fn spurious_bus_errors() -> Result<(), Failed> {
    let made = image(Variant::Default)?;
    let mut board = board(&made, ChipConditions::TYPICAL, pressed(&made.built));
    board.run_until(500_000)?;
    let (mut ticks, mut errors) = (0, 0);
    let mut receiver = PacketDecoder::default();
    board.take_packets(&mut receiver);
    for step in 1..=300 {
        board.run_until(500_000 + 4_000 * step + 60)?;
        assert!(board.chip.soc.raise_bus_error((step % 2) as usize));
        board.run_until(500_000 + 4_000 * step + 3_000)?;
        for (_, packet) in board.take_packets(&mut receiver) {
            match packet {
                Packet::Tick(tick) => {
                    ticks += u32::from(tick.sensors.iter().all(|sensor| sensor.field != [0; 3]));
                }
                Packet::Message { message: Message::Timing(timing), .. } => {
                    errors = timing.i2c_errors.max(errors);
                }
                Packet::Message { .. } => {}
            }
        }
    }
    println!("{ticks} valid ticks, {errors} errors");
    assert_eq!(errors, 0);
    assert!(ticks > 1190, "{ticks}");
    Ok(())
}

/// The chip runs from its own oscillator, and says so.
fn dead_crystal() -> Result<(), Failed> {
    let made = image(Variant::Default)?;
    let wiring = Wiring { crystal: Frequency(0), ..emulated_board::wiring() };
    let world = pressed(&made.built);
    let conditions = ChipConditions::TYPICAL;
    let mut board =
        EmulatedBoard::wired(made.image.clone(), conditions, wiring, world, at_rest(1))?;
    board.run_until(600_000)?;
    let mut receiver = PacketDecoder::default();
    let packets = board.take_packets(&mut receiver);
    let ticks = packets.iter().filter(|(_, packet)| matches!(packet, Packet::Tick(_))).count();
    assert!(ticks > 300, "{ticks} ticks");
    let reported = board.take_dated_events().into_iter().any(|(_, event)| match event {
        Event::Fault(event) => {
            (event.code, event.source, event.detail) == (Fault::StoreUnsound as u16, 2, 3)
        }
        _ => false,
    });
    assert!(reported, "no fault");
    assert_eq!(board.chip.resets, []);
    assert_eq!(violations(&board), [""; 0]);
    Ok(())
}

/// The angle that the currents are transformed with has the age that the driver states: an error of a period would be four
/// degrees at full speed.
fn direct_current() -> Result<(), Failed> {
    let mut cell = homed()?;
    for position in [1200, 100] {
        cell.host.order(Command { mode: mode::MOVE, position, speed: 232, ..Command::default() });
        let speed = |cell: &Cell| cell.gripper.borrow().rig.plant.train.travel_m_s.abs();
        assert!(cell.until(2.0, |cell| speed(cell) > 0.055).is_some());
        let (mut along, mut across, mut count) = (0.0, 0.0, 0.0);
        let mut turned = 0.0;
        for _ in 0..200 {
            for step in 1..=40 {
                cell.advance_us(25 * step);
                let plant = &cell.gripper.borrow().rig.plant;
                // In the middle of a period, where the currents are sampled.
                if (2.0 * plant.time_s() / PERIOD_S).round() % 2.0 == 1.0 {
                    let [d, q] = plant.direct_quadrature_a();
                    let rad_s = plant.parameters().windings.pole_pairs * plant.train.speed_rad_s;
                    (along, across) = (along + q, across + d);
                    (turned, count) = (turned + rad_s * PERIOD_S, count + 1.0);
                }
            }
            cell.tick();
        }
        let (error, period) = (across / along, turned / count);
        println!(
            "to {position}: {:.2} A, {error:.4} rad, {period:.4} rad in a period",
            along / count
        );
        assert!(error.abs() < 0.3 * period.abs(), "{error} {period}");
        cell.run(1.0);
    }
    Ok(())
}

/// With the option DBANK = 0 an erased page would be one of the image.
fn single_bank() -> Result<(), Failed> {
    const DBANK: u32 = 1 << 22;
    let mut cell = cell(40.0)?;
    let options = cell.board.chip.soc.option_bytes() & !DBANK;
    cell.board.chip.soc.set_option_bytes(options);
    cell.board.chip.power_cycle()?;
    cell.run(0.4);
    let image = cell.board.chip.soc.memory(0x0800_0000, 0x4_0000).ok_or("no flash")?.to_vec();
    cell.host.received.replies.clear();
    cell.host.service(op::SAVE, 0);
    cell.until(2.0, |cell| !cell.host.received.replies.is_empty());
    let reply = cell.host.received.replies.first().map(|(_, reply)| *reply).ok_or("no reply")?;
    assert_ne!(reply.status, status::DONE, "{reply:?}");
    let after = cell.board.chip.soc.memory(0x0800_0000, 0x4_0000).ok_or("no flash")?;
    assert!(image == after, "the image has changed");
    let found = violations(&cell.board);
    assert_eq!(found, [""; 0]);
    Ok(())
}

/// A sensor or its lines hold the stop of every transfer back, up to the time of a whole one, and at last by a millisecond: then
/// readings are missing, but none is another one's, and all return.
fn late_stops() -> Result<(), Failed> {
    const TOLERANCE: i16 = 30;
    let made = image(Variant::Default)?;
    let mut board = board(&made, ChipConditions::TYPICAL, pressed(&made.built));
    let mut receiver = PacketDecoder::default();
    let mut fields = |board: &mut EmulatedBoard, until_us| -> anyhow::Result<Vec<[[i16; 3]; 4]>> {
        board.run_until(until_us)?;
        let ticks = board.take_packets(&mut receiver).into_iter().filter_map(|(_, packet)| {
            if let Packet::Tick(tick) = packet {
                Some(tick.sensors.map(|each| each.field))
            } else {
                None
            }
        });
        Ok(ticks.collect())
    };
    let first = fields(&mut board, 500_000)?;
    let reference = *first.last().ok_or("no tick")?;
    let (mut read, mut lost) = (0, 0);
    for (step, late_us) in (1..).zip((20..=200).step_by(20).chain([1000])) {
        let begin_us = 500_000 + 150_000 * step;
        board.chip.soc.delay_stops((step % 2) as usize, Time::from_us(late_us));
        let late = fields(&mut board, begin_us + 30_000)?;
        board.chip.soc.delay_stops((step % 2) as usize, Time::ZERO);
        let after = fields(&mut board, begin_us + 150_000)?;
        for (found, expected) in
            late.iter().chain(&after).flat_map(|tick| tick.iter().zip(&reference))
        {
            let is_missing = *found == [0; 3];
            (read, lost) = (read + u32::from(!is_missing), lost + u32::from(is_missing));
            let is_near =
                found.iter().zip(expected).all(|(a, b)| a.abs_diff(*b) < TOLERANCE as u16);
            assert!(is_missing || is_near, "{} us: {found:?} instead of {expected:?}", late_us);
        }
        let last = after.last().ok_or("no tick")?;
        assert!(last.iter().all(|field| *field != [0; 3]), "{} us: {last:?}", late_us);
    }
    println!("{read} readings, {lost} missing");
    assert!(lost > 0, "a stop that comes a millisecond late is not noticed");
    assert_eq!(board.chip.resets, []);
    assert_eq!(violations(&board), [""; 0]);
    Ok(())
}

/// The parameter `detectors` takes the low supply away from the break.
fn low_supply() -> Result<(), Failed> {
    let mut cell = cell(40.0)?;
    let mut parameters = Parameters::DEFAULT;
    for (id, value) in [(id::BENCH, 0), (id::DETECTORS, detector::ALL - detector::LOW_SUPPLY)] {
        assert_eq!(parameters.set(id, value), Ok(()));
    }
    cell.board.store(&parameters);
    cell.board.chip.power_cycle()?;
    assert!(cell.enable(), "{}", cell.state());
    cell.host.order(Command { mode: mode::HOME, ..Command::default() });
    cell.run(0.2);
    assert!(cell.board.chip.soc.motor_duties().is_some());
    cell.board.chip.soc.set_supply(2700);
    cell.run(0.3);
    cell.board.chip.soc.set_supply(3300);
    assert!(cell.board.chip.soc.motor_duties().is_some());
    let count = storage::read(&mut cell, counter::LOW_SUPPLY)?;
    println!("low {count} times");
    assert!((3..=8).contains(&count), "{count}");
    Ok(())
}
