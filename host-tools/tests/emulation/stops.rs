//! What a host can rely on: release after a lost sensor, stop frames that stay in effect and pass a flood, also one of forged
//! frames, calibrations that end; and option bytes of the chip that do not suit.

use embedded_can::{Frame, StandardId};
use emulator::peripherals::flash::OPTIONS_AS_SHIPPED;
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TASK_CODE, TaskState};
use firmware::motor::calibration::{CalibrationFailure, CalibrationKind};
use firmware::protocol::ESTOP_ALL_ID;
use firmware::protocol::can::CanFrame;
use firmware::protocol::messages::{Command, FaultEvent};
use firmware::protocol::session::{op, status};
use firmware::system::faults::{Event, Fault};
use libtest_mimic::{Failed, Trial};
use rand::RngExt;
use sim::board::SimulatedBoard;
use sim::board::forger::Forger;
use sim::closed_loop::grasp_rig::contact_object;
use sim::faults::injection::InjectedFault;
use sim::random::{Purpose, stream};

use crate::Effort;
use crate::faults::{CONTACT, holding};
use crate::motion::{Cell, cell, homed};

/// Opening that a release must reach, and the time for it (hazard "trapping").
const OPENS_MM: f64 = 10.0;
const OPENS_S: f64 = 3.0;
/// Longest time from the request of a stop to a deceleration, in milliseconds, in a flood of frames.
const STOP_MS: u32 = 15;
/// Frames of a flood in a millisecond.
const FLOOD: u32 = 8;
/// Forged frames of eight bytes in a millisecond: they take at most 95 % of a bus of 1 Mbit/s.
pub const FORGED: u32 = 7;
/// Half of them, rounded up.
const FORGED_HALF: u32 = 4;
/// Stops in a flood of forged frames: usually, and in an acceptance run.
const STOPS: [u64; 2] = [6, 1000];

type Test = fn() -> Result<(), Failed>;

pub fn trials(effort: Effort) -> Vec<Trial> {
    let stops = STOPS[usize::from(effort == Effort::Acceptance)];
    let forged = Trial::test("stops_either_stop_passes_forged_frames", move || {
        stops_in_forged_frames(stops)
    });
    let tests: [(&str, Test); 9] = [
        ("stops_release_opens_after_sensor_unplugged", || release_without(&[1])),
        ("stops_release_opens_after_all_sensors_unplugged", || release_without(&[0, 1, 2, 3])),
        ("stops_stop_of_all_stays_until_cleared_at_rest", stop_of_all_is_latched),
        ("stops_own_stop_passes_a_flood", stop_in_flood),
        ("release_opens_among_forged_frames", release_in_forged_frames),
        ("stops_calibration_ends_on_sensor_fault", || calibration_ends(CalibrationFailure::Fault)),
        ("stops_calibration_ends_on_stop_frame", || calibration_ends(CalibrationFailure::Stopped)),
        ("option_bytes_that_suit_report_no_fault", suitable_options),
        ("option_bytes_that_do_not_suit_are_reported", unsuitable_options),
    ];
    let tests = tests.into_iter().map(|(name, test)| Trial::test(name, test));
    tests.chain([forged]).collect()
}

/// A stop of this node, or of all.
fn stop(cell: &mut Cell, is_for_all: bool) -> Result<(), Failed> {
    if !is_for_all {
        cell.host.stop();
        return Ok(());
    }
    let id = StandardId::new(ESTOP_ALL_ID).ok_or("no identifier")?;
    let stop = CanFrame::new(id, &[]).ok_or("no frame")?;
    cell.board.connections.can.borrow_mut().put(stop);
    Ok(())
}

fn opening_mm(cell: &Cell) -> f64 {
    1e3 * cell.gripper.borrow().rig.plant.opening_m()
}

/// The sensors stay unplugged.
fn release_without(sensors: &[usize]) -> Result<(), Failed> {
    let mut cell = holding()?;
    for sensor in sensors {
        InjectedFault::SensorGone.inject(&mut cell, *sensor);
    }
    cell.run(0.2);
    let from_mm = opening_mm(&cell);
    let release = Command { mode: mode::RELEASE, position: 1200, speed: 160, ..Command::default() };
    cell.host.order(release);
    let opened_s = cell.until(OPENS_S, |cell| opening_mm(cell) - from_mm >= OPENS_MM);
    println!("opened by {:.2} mm, {opened_s:?} s", opening_mm(&cell) - from_mm);
    assert!(opened_s.is_some(), "{}: {:?}", cell.state(), cell.host.received.faults);
    assert_eq!(cell.board.chip.resets, []);
    Ok(())
}

/// A host that repeats ENABLE, as one that keeps its session alive, does not end the stop.
fn stop_of_all_is_latched() -> Result<(), Failed> {
    let mut cell = homed()?;
    cell.host.order(Command { mode: mode::MOVE, position: 100, speed: 160, ..Command::default() });
    cell.run(0.3);
    stop(&mut cell, true)?;
    cell.host.order(Command { mode: mode::ENABLE, ..Command::default() });
    cell.run(0.5);
    let stopped_mm = opening_mm(&cell);
    cell.run(1.0);
    assert_eq!(cell.state(), PowerState::Armed as u8);
    assert!((opening_mm(&cell) - stopped_mm).abs() < 0.05, "{}", opening_mm(&cell));
    // Neither does it measure the motor, once it is disarmed.
    cell.host.service(op::END, 0);
    cell.run(0.2);
    assert_eq!(cell.state(), PowerState::Safe as u8);
    cell.host.service(op::MEASURE, CalibrationKind::Motor as u32);
    for _ in 0..300 {
        cell.tick();
        assert!(cell.board.chip.soc.motor_duties().is_none());
    }
    let refusal =
        cell.host.received.replies.last().map(|(_, reply)| (reply.op, reply.status, reply.detail));
    let reason = CalibrationFailure::Stopped as u32;
    assert_eq!(refusal, Some((op::MEASURE, status::FAILED, reason)));
    let beat = cell.host.received.heartbeat.as_ref().map(|(_, beat)| beat.stopped);
    assert_eq!(beat, Some(true));
    cell.host.service(op::CLEAR_FAULTS, 0);
    cell.run(0.3);
    assert!(cell.enable());
    let enabled_s = cell.until(0.5, |cell| cell.state() >= TASK_CODE);
    assert!(enabled_s.is_some(), "{}: {:?}", cell.state(), cell.host.received.replies);
    // The reset starts no motion, and ENABLE does not continue the one that was stopped.
    cell.run(1.0);
    println!("moved by {:.3} mm", opening_mm(&cell) - stopped_mm);
    assert!((opening_mm(&cell) - stopped_mm).abs() < 0.05, "{}", opening_mm(&cell));
    Ok(())
}

/// The flood has the node's identifiers, so that every frame passes the filters of the controller.
fn stop_in_flood() -> Result<(), Failed> {
    let mut cell = homed()?;
    cell.host.order(Command { mode: mode::MOVE, position: 100, speed: 232, ..Command::default() });
    let flooded_tick = |cell: &mut Cell| {
        cell.board.connections().can.borrow_mut().flood(FLOOD);
        cell.tick();
    };
    for _ in 0..400 {
        flooded_tick(&mut cell);
    }
    let speed_mm_s = |cell: &Cell| 1e3 * cell.gripper.borrow().rig.plant.train.travel_m_s;
    let before_mm_s = speed_mm_s(&cell);
    assert!(before_mm_s > 50.0, "{before_mm_s} mm/s");
    cell.host.stop();
    let mut stopped_ms = None;
    for ms in 1..=100 {
        flooded_tick(&mut cell);
        if stopped_ms.is_none() && speed_mm_s(&cell) < 0.8 * before_mm_s {
            stopped_ms = Some(ms);
        }
    }
    println!("decelerates after {stopped_ms:?} ms in a flood");
    assert!(stopped_ms.is_some_and(|ms| ms <= STOP_MS), "{stopped_ms:?} ms");
    assert!(speed_mm_s(&cell).abs() < 0.5, "{}", speed_mm_s(&cell));
    assert_eq!(cell.board.chip.resets, []);
    Ok(())
}

/// The gripper moves to and fro; in each motion forged frames begin, and a stop follows at a random time. The two stops
/// alternate.
fn stops_in_forged_frames(stops: u64) -> Result<(), Failed> {
    let mut cell = homed()?;
    let mut rng = stream(1, Purpose::FaultInjection, 1);
    let mut forger = Forger::new(2);
    let speed_mm_s = |cell: &Cell| 1e3 * cell.gripper.borrow().rig.plant.train.travel_m_s;
    let mut latencies_ms = Vec::new();
    for number in 0..stops {
        let target_mm = if opening_mm(&cell) > 40.0 { 5.0 } else { 75.0 };
        let position = (20.0 * target_mm) as u16;
        if !cell.is_in(TaskState::Idle) {
            assert!(
                cell.enable(),
                "{number}: {} {:?}",
                cell.state(),
                cell.host.received.replies.last()
            );
        }
        cell.host.order(Command { mode: mode::MOVE, position, speed: 232, ..Command::default() });
        let fast = cell.until(1.0, |cell| speed_mm_s(cell).abs() > 50.0);
        assert!(fast.is_some(), "{number}: {} mm/s", speed_mm_s(&cell));
        for _ in 0..rng.random_range(5..40) {
            forger.flood(&cell.board.connections.can, FORGED);
            cell.tick();
        }
        let before_mm_s = speed_mm_s(&cell).abs();
        assert!(before_mm_s > 50.0, "{number}: {before_mm_s} mm/s");
        stop(&mut cell, number % 2 == 0)?;
        let mut latency_ms = None;
        for ms in 1..=100 {
            forger.flood(&cell.board.connections.can, FORGED);
            cell.tick();
            if latency_ms.is_none() && speed_mm_s(&cell).abs() < 0.8 * before_mm_s {
                latency_ms = Some(ms);
            }
        }
        assert!(speed_mm_s(&cell).abs() < 0.5, "{number}: {}", speed_mm_s(&cell));
        latencies_ms.push(latency_ms.unwrap_or(u32::MAX));
        // The stop is cleared at rest.
        cell.run(0.3);
        cell.host.service(op::CLEAR_FAULTS, 0);
        cell.run(0.1);
    }
    let within = latencies_ms.iter().filter(|ms| **ms <= STOP_MS).count();
    let max_ms = latencies_ms.iter().max();
    println!(
        "{within} of {stops} stops decelerate within {STOP_MS} ms, the last after {max_ms:?} ms"
    );
    assert_eq!(within as u64, stops, "{latencies_ms:?}");
    assert_eq!(cell.board.chip.resets, []);
    Ok(())
}

/// Half of the bus is forged, from the grip to the end: the host is alive all the time, and its session stays.
fn release_in_forged_frames() -> Result<(), Failed> {
    let mut cell = holding()?;
    let mut forger = Forger::new(3);
    let mut forged_tick = |cell: &mut Cell| {
        forger.flood(&cell.board.connections.can, FORGED_HALF);
        cell.tick();
        let alive = cell.host.received.heartbeat.as_ref().map(|(_, beat)| beat.command_alive);
        assert_eq!(alive, Some(true), "{}", cell.state());
    };
    (0..1500).for_each(|_| forged_tick(&mut cell));
    assert!(cell.is_in(TaskState::HoldActive), "{}", cell.state());
    let from_mm = opening_mm(&cell);
    let release = Command { mode: mode::RELEASE, position: 1200, speed: 160, ..Command::default() };
    cell.host.order(release);
    (0..2500).for_each(|_| forged_tick(&mut cell));
    println!("opened by {:.2} mm", opening_mm(&cell) - from_mm);
    assert!(opening_mm(&cell) - from_mm >= OPENS_MM, "{}", cell.state());
    assert!(cell.is_in(TaskState::Idle), "{}", cell.state());
    let strange = |(_, event): &(u64, FaultEvent)| event.code == Fault::StrangeFrames as u16;
    assert!(cell.host.received.faults.iter().any(strange));
    assert_eq!(cell.board.chip.resets, []);
    Ok(())
}

/// The screw is tested on an object; the motor is driven when the calibration ends.
fn calibration_ends(failure: CalibrationFailure) -> Result<(), Failed> {
    let mut cell = cell(41.0)?;
    let object = contact_object(cell.gripper.borrow().rig.plant.parameters(), 40.0, CONTACT);
    cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
    cell.run(0.4);
    cell.host.service(op::MEASURE, CalibrationKind::Screw as u32);
    cell.run(0.15);
    assert_eq!(cell.state(), PowerState::Calibrating as u8);
    assert!(cell.board.chip.soc.motor_duties().is_some());
    match failure {
        CalibrationFailure::Stopped => cell.host.stop(),
        _ => InjectedFault::SensorGone.inject(&mut cell, 0),
    }
    let off_s = cell.until(0.1, |cell| cell.board.chip.soc.motor_duties().is_none());
    println!("{failure:?}: off after {off_s:?} s");
    assert!(off_s.is_some_and(|off_s| off_s <= 0.01), "{off_s:?}");
    for _ in 0..300 {
        cell.tick();
        assert!(cell.board.chip.soc.motor_duties().is_none());
    }
    let replies = &cell.host.received.replies;
    let (_, reply) = replies.last().ok_or("no reply")?;
    assert_eq!(
        (reply.op, reply.status, reply.detail),
        (op::MEASURE, status::FAILED, failure as u32),
        "{replies:?}"
    );
    Ok(())
}

/// A board with these option bytes from its start: the details of faults of stored data.
fn defects(options: u32) -> Result<Vec<(u8, u32)>, Failed> {
    let mut cell = cell(40.0)?;
    cell.board.chip.soc.set_option_bytes(options);
    cell.board.chip.power_cycle()?;
    cell.run(0.3);
    let unsound = |event| match event {
        Event::Fault(event) if event.code == Fault::StoreUnsound as u16 && event.active != 0 => {
            Some((event.source, event.detail))
        }
        _ => None,
    };
    let events = cell.board.take_dated_events().into_iter();
    Ok(events.filter_map(|(_, event)| unsound(event)).collect())
}

/// Single bank, and the boot loader with the choice of a bank (RM0440 3.7.8: DBANK, BFB2).
fn unsuitable_options() -> Result<(), Failed> {
    const DBANK: u32 = 1 << 22;
    const BFB2: u32 = 1 << 20;
    assert_eq!(defects(OPTIONS_AS_SHIPPED & !DBANK)?, [(2, 1)]);
    assert_eq!(defects(OPTIONS_AS_SHIPPED | BFB2)?, [(2, 2)]);
    Ok(())
}

/// As shipped; with the highest brown-out level; with BOOT0 from the option nBOOT0.
fn suitable_options() -> Result<(), Failed> {
    const BROWN_OUT_LEVEL_4: u32 = 4 << 8;
    const N_SWBOOT0: u32 = 1 << 26;
    for options in [
        OPTIONS_AS_SHIPPED,
        OPTIONS_AS_SHIPPED | BROWN_OUT_LEVEL_4,
        OPTIONS_AS_SHIPPED & !N_SWBOOT0,
    ] {
        assert_eq!(defects(options)?, []);
    }
    Ok(())
}
