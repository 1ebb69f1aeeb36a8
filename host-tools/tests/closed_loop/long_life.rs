//! Hours of operation in minutes of virtual time: what accumulates, drifts, or returns late.

use std::f64::consts::PI;

use firmware::grip::commands::mode;
use firmware::grip::states::TaskState;
use firmware::protocol::messages::Command;
use nalgebra::{Rotation3, Vector3};
use sim::drivetrain::parameters::Lead;

use crate::gripper::{SET_N, gripping};

/// Earth's field in gauss, and that of a magnet of 10 mm at 20 cm.
const EARTH_G: [f64; 3] = [0.25, 0.0, -0.43];
const MAGNET_G: [f64; 3] = [0.2, 0.0, 0.0];

/// The gripper is turned by 180 degrees and back; meanwhile the magnet comes and goes. The screw is backdrivable: the current
/// holds the force all the time.
#[test]
fn hold_of_half_an_hour_keeps_its_force_within_1_n() {
    let cell = &mut gripping(Lead::B);
    let gravity = cell.gripper.borrow().gravity;
    let mut worst_n = 0.0_f64;
    for ms in 0..1_800_000_u32 {
        let s = 1e-3 * f64::from(ms);
        if ms % 10 == 0 {
            let turned = ((s - 300.0) / 2.0).clamp(0.0, 1.0) - ((s - 900.0) / 2.0).clamp(0.0, 1.0);
            let body = Rotation3::from_axis_angle(&Vector3::x_axis(), PI * turned).inverse();
            let magnet = if (600.0..1200.0).contains(&s) { MAGNET_G } else { [0.0; 3] };
            let gripper = &mut *cell.gripper.borrow_mut();
            gripper.gravity = body * gravity;
            gripper.ambient.roll_rad = PI * turned;
            gripper.ambient.field_g = body * Vector3::from(EARTH_G) + Vector3::from(magnet);
        }
        cell.tick();
        worst_n = worst_n.max((cell.force_n() - SET_N).abs());
    }
    println!("{worst_n:.2} N off at most");
    assert!(worst_n < 1.0, "{worst_n}");
    assert!(cell.is_in(TaskState::HoldActive), "{}", cell.state());
    assert!(cell.host.received.faults.is_empty(), "{:?}", cell.host.received.faults);
}

/// The only other node is absent for a minute. The object is held, and the node that returns opens the fingers.
#[test]
fn peer_that_acknowledges_nothing_for_a_minute_is_served_at_once() {
    for lead in Lead::BOTH {
        let cell = &mut gripping(lead);
        cell.board.connections.can.borrow_mut().no_acknowledge = true;
        cell.host.is_silent = true;
        cell.run(60.0);
        assert!((cell.force_n() - SET_N).abs() < 3.0, "{lead:?}: {}", cell.force_n());
        cell.board.connections.can.borrow_mut().no_acknowledge = false;
        cell.host.is_silent = false;
        cell.host.arm();
        let returned_us = cell.time_us();
        let received_s = cell.until(0.2, |cell| {
            cell.host.received.heartbeat.as_ref().is_some_and(|(at_us, _)| *at_us > returned_us)
        });
        assert!(received_s.is_some(), "{lead:?}: no heartbeat");
        let open =
            Command { mode: mode::RELEASE, position: 1200, speed: 160, ..Command::default() };
        cell.host.order(open);
        let took_s = cell.until(3.0, |cell| cell.force_n() == 0.0 && cell.is_in(TaskState::Idle));
        assert!(took_s.is_some(), "{lead:?}: {}", cell.state());
    }
}
