//! What the power layer finds by itself, at its thresholds.

use super::super::fixture::pressed;
use super::super::order::mode;
use super::super::reason::{Reason, Refused};
use super::super::states::{Phase, Power, Task};
use super::rig::Rig;
use crate::limits::Grasp;
use crate::motor::plausible::Supply;
use crate::motor::{Setpoint, State, Trip};
use crate::params;
use crate::status::Fault;
use crate::units::Force;
use crate::wire::messages::ServiceReply;

const LIMITS: Grasp = Grasp::GRIPPER;

/// Whether the latest tick told that a fault is there now, and its detail.
fn told(rig: &Rig, fault: Fault) -> Option<u32> {
    let events = &rig.said.as_ref().unwrap().events;
    let mut of_fault = events.iter().filter(|event| event.code == fault as u16);
    of_fault.find_map(|event| (event.active == 1).then_some(event.detail))
}

#[test]
fn a_supply_that_is_out_is_told_in_millivolts_and_heat_with_it_while_the_motor_is_armed() {
    for is_armed in [true, false] {
        let mut rig = Rig::new(true);
        rig.run(5);
        if is_armed {
            rig.arm();
        }
        rig.motor.supply = Supply::Low;
        rig.motor.bus_v = 15.5;
        rig.motor.is_hot = true;
        rig.tick();
        assert_eq!(told(&rig, Fault::Supply), is_armed.then_some(15_500));
        assert_eq!(told(&rig, Fault::Hot), is_armed.then_some(0));
    }
}

/// Force on both fingers in the wire's unit.
fn with_force(rig: &mut Rig, newtons: f64) {
    let half = 0.5 * newtons;
    rig.estimates = Some(pressed([half, half, -half, -half], [0.0; 4]));
}

#[test]
fn too_much_force_is_more_than_450_newtons_and_told_in_its_unit() {
    let mut rig = Rig::enabled(true);
    with_force(&mut rig, 450.0);
    rig.run(3);
    assert_eq!(told(&rig, Fault::OverForce), None);
    assert_ne!(rig.grip.power(), Power::Fault);
    with_force(&mut rig, 451.0);
    rig.tick();
    assert_eq!(
        told(&rig, Fault::OverForce),
        Some((451.0 * Force::PER_NEWTON) as u32)
    );
}

#[test]
fn a_foot_s_overload_is_latched_on_a_foot_alone() {
    // Of one fingertip, straight on.
    let overload = f64::from(LIMITS.overload_n) + 2.0;
    let loaded = |mut rig: Rig| {
        rig.estimates = Some(pressed([0.0; 4], [overload, 0.0, 0.0, 0.0]));
        rig.tick();
        told(&rig, Fault::FootOverload).is_some()
    };
    assert!(loaded(Rig::foot(true)));
    assert!(!loaded(Rig::enabled(true)));
    assert!((LIMITS.overload_n - 217.5).abs() < 1e-3);
}

/// Whether an opening is not believed, with a force on the fingers, and after how many ticks.
fn stray(opening_mm: f32, newtons: f64) -> Option<u32> {
    let mut rig = Rig::enabled(true);
    rig.run(3);
    with_force(&mut rig, newtons);
    rig.run(1);
    rig.motor.opening_mm = Some(opening_mm);
    (1..20).find(|_| {
        rig.tick();
        let detail = told(&rig, Fault::StrokeWrong);
        assert_eq!(rig.motor.opening_mm.is_none(), detail.is_some());
        // In micrometres, of an opening that is led back meanwhile.
        let is_near = |detail: u32| (1e-3 * detail as f32 - opening_mm.abs()).abs() < 0.5;
        assert!(detail.is_none_or(is_near), "{detail:?}");
        detail.is_some()
    })
}

#[test]
fn an_opening_beyond_its_ends_is_forgotten_after_three_milliseconds() {
    let stroke = params::STROKE.value as f32;
    assert_eq!(stray(stroke + 0.9, 0.0), Some(3));
    assert_eq!(stray(stroke + 0.7, 0.0), None);
    assert_eq!(stray(stroke + 0.8, 0.0), None);
    assert_eq!(stray(-0.9, 0.0), Some(3));
    assert_eq!(stray(-0.7, 0.0), None);
    assert_eq!(stray(-0.8, 0.0), None);
    // Fingers that press on each other give way.
    assert_eq!(stray(-0.9, f64::from(LIMITS.contact_n)), None);
    assert_eq!(stray(-0.9, f64::from(LIMITS.contact_n) - 0.1), Some(3));
    // Beyond the far end a force means nothing.
    assert_eq!(stray(stroke + 0.9, 20.0), Some(3));
}

#[test]
fn while_homing_no_opening_is_strange() {
    let mut rig = Rig::enabled(true);
    rig.order(mode::HOME, |_| {});
    assert_eq!(rig.grip.task(), Task::Homing);
    rig.motor.opening_mm = Some(params::STROKE.value as f32 + 5.0);
    for _ in 0..10 {
        rig.tick();
        assert_eq!(told(&rig, Fault::StrokeWrong), None);
    }
}

#[test]
fn a_fault_that_others_found_too_is_reacted_to() {
    let mut rig = Rig::enabled(true);
    rig.fault(Fault::OverSpeed, true);
    rig.motor.state = State::Tripped(Trip::OverSpeed);
    rig.tick();
    assert_eq!(rig.setpoint(), Setpoint::Brake);
}

fn may_arm(rig: &Rig) -> bool {
    rig.said.as_ref().unwrap().may_arm
}

#[test]
fn who_may_arm_is_kept_from_it_by_what_would_brake_or_has_and_by_nothing_less() {
    let mut rig = Rig::new(true);
    rig.run(5);
    assert!(may_arm(&rig));
    rig.fault(Fault::SensorLost, true);
    rig.tick();
    assert!(may_arm(&rig), "a quick stop stops nothing that rests");
    let mut rig = Rig::new(true);
    rig.run(5);
    rig.arm();
    assert!(may_arm(&rig));
    // The cause is gone, its latch is not.
    rig.fault(Fault::OverSpeed, true);
    rig.run(300);
    rig.fault(Fault::OverSpeed, false);
    rig.run(5);
    assert_eq!((rig.grip.power(), may_arm(&rig)), (Power::Fault, false));
}

#[test]
fn a_refusal_names_reason_state_and_mode_a_byte_each() {
    let refused = Refused {
        mode: mode::GRIP,
        reason: Reason::NotEnabled,
        state: 0x13,
    };
    let detail = 0x0004_1300 | Reason::NotEnabled as u32;
    let reply = refused.reply();
    assert_eq!((mode::GRIP, reply.detail, reply.nonce), (4, detail, 0));
    assert_ne!(reply, ServiceReply::default());
    assert_ne!(Reason::NotEnabled as u32, 0);
}

#[test]
fn a_force_that_was_once_reached_is_a_hold_and_one_that_rises_is_not() {
    assert_eq!(Task::Force.phase(true), Phase::Holding);
    assert_eq!(Task::Force.phase(false), Phase::Moving);
    assert_eq!(Task::Approach.phase(true), Phase::Moving);
}

#[test]
fn what_hangs_on_a_screw_that_is_driven_back_is_held_without_a_host_and_else_the_session_ends() {
    for (locks, is_held) in [(true, false), (false, true)] {
        let mut rig = Rig::holding(locks);
        // Stopped while it holds: armed, and the load hangs on.
        rig.fault(Fault::TablesUnsound, true);
        rig.run(300);
        assert_eq!(rig.grip.power(), Power::Armed);
        rig.host.is_open = false;
        rig.run(5);
        assert_eq!(rig.grip.power() == Power::Armed, is_held, "{locks}");
    }
}

#[test]
fn a_session_that_closes_leaves_an_armed_gripper_safe_and_one_that_is_open_does_not() {
    let mut rig = Rig::new(true);
    rig.run(5);
    rig.arm();
    rig.run(50);
    assert_eq!(rig.grip.power(), Power::Armed);
    rig.host.is_open = false;
    rig.run(2);
    assert_eq!(rig.grip.power(), Power::Safe);
}
