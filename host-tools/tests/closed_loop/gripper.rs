//! The whole gripper in virtual time: Hall sensors, sensor buses, force estimation, grasp and motor, commanded over
//! CAN. Motor constants are assumed; fingertips and tables are nominal.

use std::sync::atomic::Ordering;

use firmware::config::constants::TICK_US;
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TaskState};
use firmware::motor::as5047;
use firmware::parameters::{Backdrivability, Parameters};
use firmware::protocol;
use firmware::protocol::messages::{Command, FaultEvent};
use firmware::protocol::session::{op, status};
use firmware::system::faults::Fault;
use firmware::tasks::FIRST_TICK_US;
use rayon::prelude::*;
use sim::board::forger::Forger;
use sim::closed_loop::grasp_rig::{contact_object, grip_command};
use sim::closed_loop::motor_rig::MotorRig;
use sim::closed_loop::{ClosedLoop, ClosedLoopSetup};
use sim::drivetrain::parameters::Lead;

use crate::nominal_tables;

/// Force set-point in newtons.
pub const SET_N: f64 = 100.0;

/// Enabled at an opening of 42 mm around a rigid object of 40 mm.
fn before_object(lead: Lead) -> ClosedLoop {
    let setup = ClosedLoopSetup::nominal(lead, 42.0, 1);
    let mut cell = ClosedLoop::new(&setup, nominal_tables());
    let object = contact_object(&setup.plant, 40.0, 333.0);
    cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
    assert!(cell.enable(), "{}", cell.state());
    cell
}

pub fn gripping(lead: Lead) -> ClosedLoop {
    let mut cell = before_object(lead);
    cell.host.order(grip_command(SET_N));
    let held = cell.until(3.0, |cell| cell.is_in(TaskState::HoldActive));
    assert!(held.is_some(), "{lead:?}: {}", cell.state());
    cell.run(0.4);
    cell
}

/// Force of the left finger as reported on the bus.
fn reported_n(cell: &ClosedLoop) -> f64 {
    let newtons =
        |sensor: usize| protocol::force_newtons(&cell.host.received.forces[sensor].unwrap().1).0[0];
    newtons(0) + newtons(1)
}

/// Forged frames on half of a bus of 1 Mbit/s, which has room for nine of eight bytes in a millisecond.
const FORGED: u32 = 5;
/// Grippers, and releases of each among forged frames.
const GRIPPERS: u64 = 10;
const RELEASES: u32 = 100;

/// In motion, gripping, and at rest. The session is that of the beginning, and no command stays away for 100 ms.
#[test]
fn release_opens_among_forged_frames() {
    // Before the parallel loop.
    nominal_tables();
    (0..GRIPPERS).into_par_iter().for_each(release_among_forged_frames);
}

fn release_among_forged_frames(seed: u64) {
    let cell = &mut gripping(Lead::BOTH[seed as usize % 2]);
    let mut forger = Forger::new(seed);
    let mut until = |cell: &mut ClosedLoop, task| {
        for _ in 0..4000 {
            forger.flood(&cell.board.connections.can, FORGED);
            cell.tick();
            let counts = &cell.board.exchange.counts;
            assert_eq!(counts.command_alive.load(Ordering::Relaxed), 1);
            if cell.is_in(task) {
                return;
            }
        }
        panic!("{task:?} not reached: {}", cell.state());
    };
    for _ in 0..RELEASES {
        let release =
            Command { mode: mode::RELEASE, position: 1000, speed: 160, ..Command::default() };
        cell.host.order(release);
        until(cell, TaskState::Releasing);
        until(cell, TaskState::Idle);
        assert!(cell.gripper.borrow().rig.plant.opening_m() > 0.049);
        cell.host.order(grip_command(SET_N));
        until(cell, TaskState::HoldActive);
    }
    assert!(cell.board.exchange.is_active(Fault::StrangeFrames));
    assert!(cell.board.exchange.counts.dropped.load(Ordering::Relaxed) > 10_000);
}

#[test]
fn host_grips_reads_the_force_and_releases() {
    for lead in Lead::BOTH {
        let cell = &mut gripping(lead);
        let peak_n = cell.gripper.borrow().peak_n;
        let (true_n, reported_n) = (cell.force_n(), reported_n(cell));
        println!("{lead:?}: peak {peak_n:.2} N, true {true_n:.2} N, screw {reported_n:.2} N");
        assert!(peak_n <= SET_N + 2.0, "{peak_n}");
        assert!((true_n - SET_N).abs() < 2.0, "{true_n}");
        assert!((reported_n - true_n).abs() < 2.0, "{reported_n} {true_n}");
        let (_, status) = cell.host.received.status.unwrap();
        assert!((f64::from(status.force) / 10.0 - true_n).abs() < 2.0);
        assert_eq!(status.object, 2);
        cell.host.order(Command {
            mode: mode::RELEASE,
            position: 1200,
            speed: 160,
            ..Command::default()
        });
        assert!(cell.until(3.0, |cell| cell.is_in(TaskState::Idle)).is_some());
        let opening_mm = 1e3 * cell.gripper.borrow().rig.plant.opening_m();
        assert!((opening_mm - 60.0).abs() < 0.2, "{opening_mm}");
        assert_eq!(cell.force_n(), 0.0);
        assert!(cell.host.received.faults.is_empty(), "{:?}", cell.host.received.faults);
    }
}

#[test]
fn force_sample_reaches_the_motor_within_1_ms() {
    let mut cell = before_object(Lead::A);
    cell.host.order(grip_command(SET_N));
    let (mut min_us, mut max_us) = (u64::MAX, 0);
    for _ in 0..500 {
        cell.tick();
        let order_us = cell.gripper.borrow().last_order_us;
        let after_us = (order_us - FIRST_TICK_US) % TICK_US;
        (min_us, max_us) = (min_us.min(after_us), max_us.max(after_us));
    }
    println!("order executed {min_us} to {max_us} us after the sensor tick");
    // Two transfers of 102 us and the next PWM period.
    assert!((204..=300).contains(&min_us) && max_us <= 300);
}

#[test]
fn homing_over_can_finds_the_opening() {
    for lead in Lead::BOTH {
        let setup = ClosedLoopSetup { is_homed: false, ..ClosedLoopSetup::nominal(lead, 6.0, 1) };
        let mut cell = ClosedLoop::new(&setup, nominal_tables());
        assert!(cell.enable() && cell.is_in(TaskState::Unhomed));
        cell.host.order(Command { mode: mode::HOME, ..Command::default() });
        let took_s = cell.until(20.0, |cell| cell.is_in(TaskState::Idle));
        println!("{lead:?}: homed in {:.2} s", took_s.unwrap());
        cell.run(0.2);
        let gripper = cell.gripper.borrow();
        let estimated_mm = f64::from(gripper.rig.motor.status().opening_mm.unwrap());
        let true_mm = 1e3 * gripper.rig.plant.opening_m();
        assert!((estimated_mm - true_mm).abs() < 0.1, "{lead:?}: {estimated_mm} {true_mm}");
    }
}

#[test]
fn hold_survives_loss_of_sensors_host_or_bus() {
    for lead in Lead::BOTH {
        for failure in ["sensors", "host", "host and sensors", "bus"] {
            let cell = &mut gripping(lead);
            if failure.starts_with("host") {
                cell.host.is_silent = true;
            }
            if failure == "host and sensors" {
                cell.run(0.5);
            }
            if failure.ends_with("sensors") {
                let wires = &mut cell.board.connections.buses[0].borrow_mut();
                wires.sensors.iter_mut().for_each(|s| s.unplugged = true);
            }
            if failure == "bus" {
                cell.board.connections.can.borrow_mut().disturbed = true;
            }
            cell.gripper.borrow_mut().peak_n = 0.0;
            cell.run(0.5);
            let (force_n, peak_n) = (cell.force_n(), cell.gripper.borrow().peak_n);
            println!("{lead:?} without {failure}: {force_n:.2} N, peak {peak_n:.2} N");
            assert!((force_n - SET_N).abs() < 3.0, "{lead:?} {failure}: {force_n}");
            assert!(peak_n < 110.0, "{lead:?} {failure}: {peak_n}");
            let found = match failure {
                "host" => Fault::HostSilent,
                "sensors" | "host and sensors" => Fault::SensorLost,
                _ => Fault::BusOff,
            };
            assert!(cell.board.exchange.is_active(found), "{failure}");
            assert!(
                cell.is_in(TaskState::HoldActive) || cell.is_in(TaskState::HoldLatched),
                "{lead:?} {failure}: {}",
                cell.state()
            );
        }
    }
}

/// A host that pauses and comes back has its object, and needs nothing but its next command. After a long pause its session is over.
#[test]
fn host_that_pauses_during_a_hold_goes_on_with_its_next_command() {
    for lead in Lead::BOTH {
        for pause_s in [0.05, 0.2, 1.0, 5.0] {
            let cell = &mut gripping(lead);
            cell.host.is_silent = true;
            cell.run(pause_s);
            assert!((cell.force_n() - SET_N).abs() < 3.0, "{lead:?} {pause_s}: {}", cell.force_n());
            cell.host.is_silent = false;
            let open =
                Command { mode: mode::RELEASE, position: 1200, speed: 160, ..Command::default() };
            cell.host.order(open);
            let took_s =
                cell.until(3.0, |cell| cell.force_n() == 0.0 && cell.is_in(TaskState::Idle));
            assert!(took_s.is_some(), "{lead:?} {pause_s}: {}", cell.state());
        }
    }
}

/// Each 30th angle is off by 50 degrees, as by a disturbed frame with a valid parity: it is bridged.
#[test]
fn single_wrong_angles_do_not_disturb_motion_and_hold() {
    for lead in Lead::BOTH {
        let cell = &mut before_object(lead);
        let mut frames = 0_u32;
        cell.gripper.borrow_mut().errors.frame = Some(Box::new(move |frame| {
            frames += 1;
            let off = (50.0 / 360.0 * 16_384.0) as u16;
            let angle = frame & as5047::DATA;
            if frames.is_multiple_of(30) { as5047::answer(angle.wrapping_add(off)) } else { frame }
        }));
        cell.host.order(grip_command(SET_N));
        let held = cell.until(3.0, |cell| cell.is_in(TaskState::HoldActive));
        assert!(held.is_some(), "{lead:?}: {}", cell.state());
        cell.gripper.borrow_mut().peak_n = 0.0;
        for _ in 0..1000 {
            cell.tick();
            assert!((cell.force_n() - SET_N).abs() < 3.0, "{lead:?}: {}", cell.force_n());
        }
        let faults = &cell.host.received.faults;
        assert!(faults.is_empty(), "{lead:?}: {faults:?}");
    }
}

/// Waits for the reply to a service.
fn service_reply(cell: &mut ClosedLoop, op: u8, argument: u32) -> Option<(u8, u32)> {
    let before = cell.host.received.replies.len();
    cell.host.service(op, argument);
    cell.until(15.0, |cell| cell.host.received.replies.len() > before)?;
    let (_, reply) = cell.host.received.replies.last()?;
    (reply.op == op).then_some((reply.status, reply.detail))
}

#[test]
fn commissioning_identifies_motor_and_screw() {
    for lead in Lead::BOTH {
        let setup = ClosedLoopSetup::nominal(lead, 42.0, 1);
        let cell = &mut ClosedLoop::new(&setup, nominal_tables());
        cell.run(0.05);
        assert_eq!(service_reply(cell, op::MEASURE, 0), Some((status::DONE, 0)));
        let found = cell.board.exchange.parameters().settings();
        let off =
            f64::from(found.machine.resistance_ohm) / setup.plant.windings.resistance_ohm - 1.0;
        assert!(off.abs() < 0.05, "{off}");
        let object = contact_object(&setup.plant, 40.0, 333.0);
        cell.gripper.borrow_mut().rig.plant.set_object(Some(&object));
        cell.gripper.borrow_mut().peak_n = 0.0;
        let locks = u32::from(lead == Lead::A);
        assert_eq!(service_reply(cell, op::MEASURE, 1), Some((status::DONE, locks)));
        let peak_n = cell.gripper.borrow().peak_n;
        println!("{lead:?}: gripped with {peak_n:.0} N for the test");
        assert!((60.0..200.0).contains(&peak_n), "{peak_n}");
        assert_eq!(cell.force_n(), 0.0);
        let screw = cell.board.exchange.parameters().backdrivability();
        let expected = [Backdrivability::BackDriven, Backdrivability::SelfLocking][locks as usize];
        assert_eq!(screw, expected);
        // Refused while armed.
        assert!(cell.enable());
        assert_eq!(service_reply(cell, op::MEASURE, 0), Some((status::ARMED, 0)));
    }
}

/// Torque constant and inertia are far from what is assumed. The first power-up has a supply of 12 V and the limits of the bench;
/// then the gripper homes with what was measured, there and with the limits of the gripper at 24 V.
#[test]
fn gripper_homes_with_any_motor_once_it_is_measured() {
    let cases: Vec<(f64, f64)> =
        [0.4, 1.0, 2.5].into_iter().flat_map(|torque| [0.3, 3.0].map(|j| (torque, j))).collect();
    // Not first within one of the tasks, which would wait for each other.
    let tables = nominal_tables();
    cases.into_par_iter().for_each(|(torque_share, inertia_share)| {
        let mut setup = ClosedLoopSetup::nominal(Lead::A, 3.0, 1);
        setup.is_homed = false;
        setup.plant.windings.flux_wb *= torque_share;
        setup.plant.rotor.inertia_kg_m2 *= inertia_share;
        let mut parameters = Parameters::DEFAULT;
        for (volts, on_bench) in [(12.0, true), (24.0, false)] {
            setup.plant.supply.voltage_v = volts;
            setup.grasp = parameters.grip_limits();
            let cell = &mut ClosedLoop::new(&setup, tables);
            let settings = parameters.settings();
            cell.gripper.borrow_mut().rig = MotorRig::with_settings(settings, setup.plant, 3.0, 1);
            cell.run(0.05);
            if on_bench {
                assert_eq!(service_reply(cell, op::MEASURE, 0), Some((status::DONE, 0)));
                let machine = cell.board.exchange.parameters().settings().machine;
                let found = [machine.torque_nm_a / 0.1, machine.inertia_kg_m2 / 6e-5];
                println!("{torque_share} {inertia_share}: {found:?}, {:.4} N m", machine.dry_nm);
                let [torque, inertia] = found.map(f64::from);
                assert!((torque / torque_share - 1.0).abs() < 0.1, "{torque}");
                assert!((inertia / inertia_share - 1.0).abs() < 0.2, "{inertia}");
                parameters = cell.board.exchange.parameters();
            }
            assert!(cell.enable(), "{}", cell.state());
            cell.host.order(Command { mode: mode::HOME, ..Command::default() });
            let took_s = cell.until(30.0, |cell| cell.is_in(TaskState::Idle));
            let faults = &cell.host.received.faults;
            let state = cell.state();
            println!("{torque_share} {inertia_share} at {volts} V: {took_s:?} s");
            assert!(
                took_s.is_some() && faults.is_empty(),
                "{torque_share} {inertia_share} at {volts} V: {state} {faults:?}"
            );
        }
    });
}

#[test]
fn fault_is_latched_until_cleared_and_rearmed() {
    let mut cell = before_object(Lead::A);
    cell.host.order(grip_command(SET_N));
    cell.run(0.05);
    assert!(cell.is_in(TaskState::Approach));
    // Loose wire: wrong parity of each frame.
    cell.gripper.borrow_mut().errors.frame = Some(Box::new(|frame| frame ^ 1));
    cell.run(0.3);
    assert_eq!(cell.state(), PowerState::Fault as u8);
    let came = |event: &FaultEvent| event.code == Fault::RotorSensor as u16 && event.active == 1;
    assert!(cell.host.received.faults.iter().any(|(_, event)| came(event)));
    cell.gripper.borrow_mut().errors.frame = None;
    cell.run(0.3);
    assert_eq!(cell.state(), PowerState::Fault as u8);
    assert_eq!(service_reply(&mut cell, op::CLEAR_FAULTS, 0), Some((status::DONE, 0)));
    cell.run(0.3);
    // The repeated old command moves nothing.
    assert_eq!(cell.state(), PowerState::Safe as u8);
    assert!(cell.enable());
    // The fault invalidated the opening.
    assert!(cell.is_in(TaskState::Unhomed), "{}", cell.state());
}

#[test]
fn stop_ends_motion_and_later_commands_are_refused() {
    let mut cell = before_object(Lead::A);
    let away = Command { mode: mode::MOVE, position: 1400, speed: 80, ..Command::default() };
    cell.host.order(away);
    cell.run(0.3);
    assert!(cell.is_in(TaskState::Moving));
    cell.host.stop();
    cell.run(0.1);
    assert_eq!(cell.state(), PowerState::Armed as u8);
    let opening_m = cell.gripper.borrow().rig.plant.opening_m();
    cell.run(0.3);
    assert!((cell.gripper.borrow().rig.plant.opening_m() - opening_m).abs() < 0.1e-3);
    let refused = cell.host.received.replies.last().unwrap().1;
    assert_eq!((refused.op, refused.status), (op::COMMAND, status::REFUSED));
}
