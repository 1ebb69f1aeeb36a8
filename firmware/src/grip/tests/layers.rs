//! The states of both layers, and what leads from one to another.

use std::vec::Vec;

use super::super::order::mode;
use super::super::reason::Reason;
use super::super::states::{Power, Task, code};
use super::super::table::{POWER, PowerEvent, TASK, TaskEvent, power, task};
use super::rig::Rig;
use crate::motor::Setpoint;
use crate::status::Fault;

/// Each state's words against a table: where it comes from and goes to, itself left out.
macro_rules! words_match {
    ($table:expr, $layer:ty) => {
        for state in <$layer>::ALL {
            let others = |states: Vec<$layer>| {
                let mut codes: Vec<u8> = states.iter().map(|state| *state as u8).collect();
                codes.retain(|code| *code != *state as u8);
                codes.sort_unstable();
                codes.dedup();
                codes
            };
            let from = $table
                .iter()
                .filter(|(_, _, to)| to == state)
                .map(|(from, ..)| *from);
            assert_eq!(
                others(from.collect()),
                others(state.entered_from().to_vec()),
                "into {state:?}"
            );
            let to = $table
                .iter()
                .filter(|(from, ..)| from == state)
                .map(|(.., to)| *to);
            assert_eq!(
                others(to.collect()),
                others(state.left_to().to_vec()),
                "out of {state:?}"
            );
        }
    };
}

#[test]
fn each_state_is_entered_and_left_as_its_words_say() {
    words_match!(POWER, Power);
    words_match!(TASK, Task);
}

#[test]
fn every_state_meets_every_event_and_what_is_not_listed_is_refused() {
    let mut listed = 0;
    for from in Power::ALL {
        for event in PowerEvent::ALL {
            let rows = POWER.iter().filter(|row| row.0 == *from && row.1 == event);
            let rows: Vec<_> = rows.collect();
            assert!(rows.len() <= 1, "{from:?} {event:?}");
            assert_eq!(power(*from, event), rows.first().map(|row| row.2));
            listed += rows.len();
        }
    }
    assert_eq!(listed, POWER.len());
    listed = 0;
    for from in Task::ALL {
        for event in TaskEvent::ALL {
            let rows = TASK.iter().filter(|row| row.0 == *from && row.1 == event);
            let rows: Vec<_> = rows.collect();
            assert!(rows.len() <= 1, "{from:?} {event:?}");
            let expected = rows.first().map(|row| row.2).ok_or(Reason::of(*from));
            assert_eq!(task(*from, event), expected);
            listed += rows.len();
        }
    }
    assert_eq!(listed, TASK.len());
}

#[test]
fn only_an_armed_gripper_is_enabled_and_a_fault_leads_nowhere_but_to_safe() {
    let into: Vec<_> = POWER.iter().filter(|row| row.2 == Power::Enabled).collect();
    assert_eq!(into, [&(Power::Armed, PowerEvent::Enable, Power::Enabled)]);
    let out: Vec<_> = POWER.iter().filter(|row| row.0 == Power::Fault).collect();
    assert_eq!(out, [&(Power::Fault, PowerEvent::Cleared, Power::Safe)]);
    let armed = POWER.iter().filter(|row| row.2 == Power::Armed);
    assert!(
        armed
            .into_iter()
            .all(|row| row.0 != Power::Fault && row.0 != Power::Safe)
    );
}

#[test]
fn the_wire_has_a_number_for_each_state() {
    assert_eq!(code(Power::Armed, Task::Foot), 4);
    assert_eq!(code(Power::Enabled, Task::Unhomed), 16);
    assert_eq!(code(Power::Enabled, Task::TimeoutHold), 32);
}

#[test]
fn without_arming_nothing_is_enabled() {
    let mut rig = Rig::new(true);
    rig.run(10);
    assert_eq!(rig.grip.power(), Power::Safe);
    rig.order(mode::ENABLE, |_| {});
    rig.order(mode::GRIP, |command| command.force = 500);
    assert_eq!(rig.refused, [Reason::NotEnabled; 2]);
    assert_eq!(rig.setpoint(), Setpoint::Off);
}

#[test]
fn a_nonce_that_is_not_said_back_leaves_it_safe() {
    let mut rig = Rig::new(true);
    rig.run(5);
    rig.host.is_offered = true;
    rig.run(2);
    assert_eq!(rig.grip.power(), Power::ArmPending);
    rig.host.is_offered = false;
    rig.run(2);
    assert_eq!(rig.grip.power(), Power::Safe);
}

#[test]
fn a_self_test_that_fails_and_a_calibration_let_nobody_arm() {
    let mut rig = Rig::new(true);
    rig.is_sound = None;
    rig.run(5);
    assert_eq!(rig.grip.power(), Power::SelfTest);
    rig.is_sound = Some(false);
    rig.run(2);
    assert_eq!(rig.grip.power(), Power::Fault);
    assert!(!rig.said.as_ref().unwrap().may_arm);
    let mut rig = Rig::new(true);
    rig.is_calibrating = true;
    rig.run(5);
    assert_eq!(rig.grip.power(), Power::Calibrating);
    assert!(!rig.said.as_ref().unwrap().may_arm);
}

#[test]
fn a_grip_goes_through_its_states_and_a_release_opens() {
    let mut rig = Rig::enabled(true);
    rig.object = Some((40.0, 50.0));
    rig.order(mode::GRIP, |command| command.force = 1000);
    let mut seen = std::vec![rig.grip.task()];
    for _ in 0..3000 {
        rig.tick();
        if seen.last() != Some(&rig.grip.task()) {
            seen.push(rig.grip.task());
        }
    }
    use Task::{Approach, Force, HoldActive, HoldLatched};
    assert_eq!(seen, [Approach, Force, HoldActive, HoldLatched]);
    assert!((rig.force_n() - 100.0).abs() < 2.0, "{}", rig.force_n());
    assert_eq!(rig.setpoint(), Setpoint::Off);
    rig.order(mode::MOVE, |command| {
        (command.position, command.speed) = (1200, 80)
    });
    assert_eq!(rig.refused, [Reason::Gripping]);
    rig.order(mode::RELEASE, |command| {
        (command.position, command.speed) = (1200, 80)
    });
    assert_eq!(rig.grip.task(), Task::Releasing);
    rig.run_until(Task::Idle);
    assert!((rig.motor.opening_mm.unwrap() - 60.0).abs() < 0.1);
}

#[test]
fn a_screw_that_is_driven_back_is_never_left_without_current() {
    let mut rig = Rig::holding(false);
    for _ in 0..5000 {
        rig.tick();
        assert_eq!(rig.grip.task(), Task::HoldActive);
        assert!(matches!(rig.setpoint(), Setpoint::Speed { .. }));
    }
}

#[test]
fn fingers_that_meet_find_no_object_and_the_same_command_again_begins_nothing() {
    let mut rig = Rig::enabled(true);
    rig.object = Some((0.0, 500.0));
    let grip = |rig: &mut Rig, flags| {
        rig.order(mode::GRIP, |command| {
            (command.force, command.flags) = (500, flags)
        });
    };
    grip(&mut rig, 0);
    rig.run_until(Task::NoObject);
    grip(&mut rig, 0);
    rig.run(100);
    assert_eq!(rig.grip.task(), Task::NoObject);
    grip(&mut rig, 0x80);
    assert_eq!(rig.grip.task(), Task::Approach);
}

#[test]
fn an_object_wider_than_its_window_is_no_grip_and_a_narrower_one_is_not_there() {
    let ends = |width_mm| {
        let mut rig = Rig::enabled(true);
        rig.object = Some((width_mm, 50.0));
        // 30 mm, 4 mm to either side.
        rig.order(mode::GRIP, |command| {
            (command.position, command.force, command.flags) = (600, 500, 3 << 2);
        });
        for _ in 0..20_000 {
            rig.tick();
        }
        rig.grip.task()
    };
    assert_eq!(ends(35.0), Task::GripFailed);
    assert_eq!(ends(30.0), Task::HoldLatched);
    assert_eq!(ends(25.0), Task::NoObject);
}

#[test]
fn a_touch_on_the_way_stops() {
    let mut rig = Rig::enabled(true);
    rig.object = Some((40.0, 50.0));
    rig.order(mode::MOVE, |command| {
        (command.position, command.speed) = (200, 80)
    });
    rig.run_until(Task::ContactStop);
    rig.run_until(Task::Idle);
    assert!(rig.force_n() < 10.0, "{}", rig.force_n());
    assert_eq!(rig.said.as_ref().unwrap().status.object, 2);
}

#[test]
fn homing_finds_both_ends_and_refuses_a_way_that_is_too_short() {
    let home = |true_mm: f32, stroke_mm: f32| {
        let mut rig = Rig::new(true);
        rig.motor.opening_mm = None;
        rig.arm();
        rig.order(mode::ENABLE, |_| {});
        assert_eq!(rig.grip.task(), Task::Unhomed);
        rig.order(mode::MOVE, |command| {
            (command.position, command.speed) = (200, 80)
        });
        assert_eq!(rig.refused, [Reason::NotHomed]);
        rig.order(mode::HOME, |_| {});
        let mut true_mm = true_mm;
        for _ in 0..40_000 {
            let known = rig.motor.opening_mm;
            // The motor of this rig moves what it knows; the fingers are moved here.
            let closing_mm_s = match rig.setpoint() {
                Setpoint::Speed { closing_mm_s, .. } => closing_mm_s,
                _ => 0.0,
            };
            let before_mm = true_mm;
            true_mm = (true_mm - 1e-3 * closing_mm_s).min(stroke_mm);
            let force_n = (500.0 * -true_mm).max(0.0);
            let half = f64::from(0.5 * force_n);
            rig.estimates = Some(super::super::fixture::pressed([half; 4], [0.0; 4]));
            rig.tick();
            rig.motor.closing_mm_s = 1e3 * (before_mm - true_mm);
            if let (Some(known), None) = (known, rig.said.as_ref().unwrap().opening_mm) {
                rig.motor.opening_mm = Some(known + true_mm - before_mm);
            }
            if rig.grip.task() != Task::Homing {
                break;
            }
        }
        rig
    };
    let rig = home(12.0, 80.0);
    assert_eq!(rig.grip.task(), Task::Idle);
    assert!(
        (rig.motor.opening_mm.unwrap() - 80.0).abs() < 0.1,
        "{:?}",
        rig.motor.opening_mm
    );
    let mut rig = home(12.0, 70.0);
    assert_eq!(
        (rig.grip.task(), rig.motor.opening_mm),
        (Task::Unhomed, None)
    );
    rig.run(1);
    assert_eq!(rig.grip.first_cause().unwrap().fault, Fault::StrokeWrong);
}
