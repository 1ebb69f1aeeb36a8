//! The whole gripper in virtual time: Hall sensors, bytes on their buses, forces, grasp, motor; commanded over the
//! CAN bus. Motor constants are assumed; the fingertips are as drawn, and so are the tables.

use std::sync::LazyLock;

use firmware::grip::order::mode;
use firmware::grip::states::{Power, Task};
use firmware::loops::FIRST_TICK_US;
use firmware::parameters::Screw;
use firmware::params::TICK_US;
use firmware::session::{op, status};
use firmware::status::Fault;
use firmware::wire;
use firmware::wire::messages::{Command, FaultEvent};
use host_tools::drive::grasp::{grip_command, object};
use host_tools::drive::tables;
use host_tools::drive::workcell::{Plan, Workcell};
use host_tools::plant::parameters::Lead;
use model_export::inverse::quantise::TableSet;

static TABLES: LazyLock<TableSet> = LazyLock::new(|| tables::as_drawn().unwrap());

/// Newtons of the grips.
const SET_N: f64 = 100.0;

/// A rigid object of 40 mm between the fingers, which are 42 mm apart.
fn before_object(lead: Lead) -> Workcell {
    let plan = Plan::nominal(lead, 42.0, 1);
    let mut cell = Workcell::new(&plan, &TABLES);
    let object = object(&plan.plant, 40.0, 333.0);
    cell.gripper.borrow_mut().rig.plant.hold(Some(&object));
    assert!(cell.enable(), "{}", cell.state());
    cell
}

fn holding(lead: Lead) -> Workcell {
    let mut cell = before_object(lead);
    cell.host.order(grip_command(SET_N));
    let held = cell.until(3.0, |cell| cell.is_in(Task::HoldActive));
    assert!(held.is_some(), "{lead:?}: {}", cell.state());
    cell.run(0.4);
    cell
}

/// Force that the bus tells of the left finger.
fn told_n(cell: &Workcell) -> f64 {
    let newtons = |sensor: usize| wire::newtons(&cell.host.told.forces[sensor].unwrap().1).0[0];
    newtons(0) + newtons(1)
}

#[test]
fn a_host_arms_grips_reads_the_true_force_and_releases() {
    for lead in Lead::BOTH {
        let cell = &mut holding(lead);
        let peak_n = cell.gripper.borrow().peak_n;
        let (true_n, told_n) = (cell.force_n(), told_n(cell));
        println!("{lead:?}: peak {peak_n:.2} N, true {true_n:.2} N, told {told_n:.2} N");
        assert!(peak_n <= SET_N + 2.0, "{peak_n}");
        assert!((true_n - SET_N).abs() < 2.0, "{true_n}");
        assert!((told_n - true_n).abs() < 2.0, "{told_n} {true_n}");
        let (_, status) = cell.host.told.status.unwrap();
        assert!((f64::from(status.force) / 10.0 - true_n).abs() < 2.0);
        assert_eq!(status.object, 2);
        cell.host.order(Command {
            mode: mode::RELEASE,
            position: 1200,
            speed: 160,
            ..Command::default()
        });
        assert!(cell.until(3.0, |cell| cell.is_in(Task::Idle)).is_some());
        let opening_mm = 1e3 * cell.gripper.borrow().rig.plant.opening_m();
        assert!((opening_mm - 60.0).abs() < 0.2, "{opening_mm}");
        assert_eq!(cell.force_n(), 0.0);
        assert!(
            cell.host.told.faults.is_empty(),
            "{:?}",
            cell.host.told.faults
        );
    }
}

#[test]
fn a_force_sample_reaches_the_motor_within_a_millisecond() {
    let mut cell = before_object(Lead::A);
    cell.host.order(grip_command(SET_N));
    let (mut least_us, mut greatest_us) = (u64::MAX, 0);
    for _ in 0..500 {
        cell.tick();
        let obeyed_us = cell.gripper.borrow().obeyed_us;
        let after_us = (obeyed_us - FIRST_TICK_US) % TICK_US;
        (least_us, greatest_us) = (least_us.min(after_us), greatest_us.max(after_us));
    }
    println!("obeyed {least_us} to {greatest_us} us after the tick of sensing began");
    // Two transfers of 102 us and the next period of the pulses.
    assert!((204..=300).contains(&least_us) && greatest_us <= 300);
}

#[test]
fn homing_over_the_bus_finds_the_opening() {
    let plan = Plan {
        is_homed: false,
        ..Plan::nominal(Lead::A, 6.0, 1)
    };
    let mut cell = Workcell::new(&plan, &TABLES);
    assert!(cell.enable() && cell.is_in(Task::Unhomed));
    cell.host.order(Command {
        mode: mode::HOME,
        ..Command::default()
    });
    let took_s = cell.until(20.0, |cell| cell.is_in(Task::Idle));
    println!("homed in {:.2} s", took_s.unwrap());
    cell.run(0.2);
    let gripper = cell.gripper.borrow();
    let told_mm = f64::from(gripper.rig.motor.telling().opening_mm.unwrap());
    let true_mm = 1e3 * gripper.rig.plant.opening_m();
    assert!((told_mm - true_mm).abs() < 0.1, "{told_mm} {true_mm}");
}

#[test]
fn a_hold_survives_the_sensors_of_a_finger_a_silent_host_and_a_dead_bus() {
    for lead in Lead::BOTH {
        for trouble in ["sensors", "host", "bus"] {
            let cell = &mut holding(lead);
            match trouble {
                "sensors" => {
                    let wires = &mut cell.board.connections.buses[0].borrow_mut();
                    wires.sensors.iter_mut().for_each(|s| s.unplugged = true);
                }
                "host" => cell.host.is_silent = true,
                _ => cell.board.connections.can.borrow_mut().disturbed = true,
            }
            cell.gripper.borrow_mut().peak_n = 0.0;
            cell.run(0.5);
            let (force_n, peak_n) = (cell.force_n(), cell.gripper.borrow().peak_n);
            println!("{lead:?} without {trouble}: {force_n:.2} N, peak {peak_n:.2} N");
            assert!(
                (force_n - SET_N).abs() < 3.0,
                "{lead:?} {trouble}: {force_n}"
            );
            assert!(peak_n < 110.0, "{lead:?} {trouble}: {peak_n}");
            let found = match trouble {
                "sensors" => Fault::SensorLost,
                "host" => Fault::HostSilent,
                _ => Fault::BusOff,
            };
            assert!(cell.board.exchange.is_active(found), "{trouble}");
            assert!(
                cell.is_in(Task::HoldActive) || cell.is_in(Task::HoldLatched),
                "{lead:?} {trouble}: {}",
                cell.state()
            );
        }
    }
}

/// The answer to a service that takes its time.
fn answered(cell: &mut Workcell, op: u8, argument: u32) -> Option<(u8, u32)> {
    let before = cell.host.told.replies.len();
    cell.host.service(op, argument);
    cell.until(15.0, |cell| cell.host.told.replies.len() > before)?;
    let (_, reply) = cell.host.told.replies.last()?;
    (reply.op == op).then_some((reply.status, reply.detail))
}

#[test]
fn the_device_measures_its_motor_and_its_screw_when_a_host_asks() {
    for lead in Lead::BOTH {
        let plan = Plan::nominal(lead, 42.0, 1);
        let cell = &mut Workcell::new(&plan, &TABLES);
        cell.run(0.05);
        assert_eq!(answered(cell, op::MEASURE, 0), Some((status::DONE, 0)));
        let found = cell.board.exchange.parameters().settings();
        let off =
            f64::from(found.machine.resistance_ohm) / plan.plant.windings.resistance_ohm - 1.0;
        assert!(off.abs() < 0.05, "{off}");
        let object = object(&plan.plant, 40.0, 333.0);
        cell.gripper.borrow_mut().rig.plant.hold(Some(&object));
        cell.gripper.borrow_mut().peak_n = 0.0;
        let locks = u32::from(lead == Lead::A);
        assert_eq!(answered(cell, op::MEASURE, 1), Some((status::DONE, locks)));
        let peak_n = cell.gripper.borrow().peak_n;
        println!("{lead:?}: gripped with {peak_n:.0} N for the test");
        assert!((60.0..200.0).contains(&peak_n), "{peak_n}");
        assert_eq!(cell.force_n(), 0.0);
        let told = cell.board.exchange.parameters().screw();
        let expected = [Screw::BackDriven, Screw::SelfLocking][locks as usize];
        assert_eq!(told, expected);
        // Not while somebody is armed.
        assert!(cell.enable());
        assert_eq!(answered(cell, op::MEASURE, 0), Some((status::ARMED, 0)));
    }
}

#[test]
fn a_fault_is_kept_until_a_host_clears_it_and_arms_anew() {
    let mut cell = before_object(Lead::A);
    cell.host.order(grip_command(SET_N));
    cell.run(0.05);
    assert!(cell.is_in(Task::Approach));
    // A wire that is loose: the parity of each answer is wrong.
    cell.gripper.borrow_mut().wrong.frame = Some(Box::new(|frame| frame ^ 1));
    cell.run(0.3);
    assert_eq!(cell.state(), Power::Fault as u8);
    let came = |event: &FaultEvent| event.code == Fault::RotorSensor as u16 && event.active == 1;
    assert!(cell.host.told.faults.iter().any(|(_, event)| came(event)));
    cell.gripper.borrow_mut().wrong.frame = None;
    cell.run(0.3);
    assert_eq!(cell.state(), Power::Fault as u8);
    assert_eq!(
        answered(&mut cell, op::CLEAR_FAULTS, 0),
        Some((status::DONE, 0))
    );
    cell.run(0.3);
    // The host's old commands go on and move nothing.
    assert_eq!(cell.state(), Power::Safe as u8);
    assert!(cell.enable());
    // The place was lost with the angle.
    assert!(cell.is_in(Task::Unhomed), "{}", cell.state());
}

#[test]
fn a_stop_of_anybody_stops_a_motion_and_a_refused_command_is_told() {
    let mut cell = before_object(Lead::A);
    let away = Command {
        mode: mode::MOVE,
        position: 1400,
        speed: 80,
        ..Command::default()
    };
    cell.host.order(away);
    cell.run(0.3);
    assert!(cell.is_in(Task::Moving));
    cell.host.stop();
    cell.run(0.1);
    assert_eq!(cell.state(), Power::Armed as u8);
    let opening_m = cell.gripper.borrow().rig.plant.opening_m();
    cell.run(0.3);
    assert!((cell.gripper.borrow().rig.plant.opening_m() - opening_m).abs() < 0.1e-3);
    let refused = cell.host.told.replies.last().unwrap().1;
    assert_eq!((refused.op, refused.status), (op::COMMAND, status::REFUSED));
}
