//! What a hold survives, and what ends it.

use super::super::order::mode;
use super::super::states::{Power, Task};
use super::rig::Rig;
use crate::force::Estimate;
use crate::motor::Setpoint;
use crate::status::Fault;
use crate::units::Force;

fn is_held(rig: &Rig) -> bool {
    matches!(rig.grip.task(), Task::HoldActive | Task::HoldLatched)
        && rig.grip.power() == Power::Enabled
        && (rig.force_n() - 100.0).abs() < 3.0
}

#[test]
fn a_hold_survives_host_bus_and_session() {
    for locks in [true, false] {
        let mut rig = Rig::holding(locks);
        rig.host.is_alive = false;
        rig.fault(Fault::HostSilent, true);
        rig.fault(Fault::BusOff, true);
        rig.run(2000);
        rig.host.is_open = false;
        rig.run(2000);
        assert!(is_held(&rig), "{:?}", rig.grip.task());
        assert_eq!(rig.grip.first_cause(), None);
    }
}

#[test]
fn a_hold_survives_the_sensors_of_one_finger_and_goes_on_with_the_other() {
    for locks in [true, false] {
        let mut rig = Rig::holding(locks);
        rig.spoil = Some(|estimates| {
            estimates[0] = Estimate::MISSING;
            estimates[1] = Estimate::MISSING;
        });
        rig.fault(Fault::SensorLost, true);
        rig.run(3000);
        assert!(is_held(&rig), "{:?}", rig.grip.task());
    }
}

#[test]
fn a_hold_survives_the_networks() {
    let told: fn(&mut [Estimate; 4]) = |estimates| {
        for estimate in estimates {
            estimate.sigma = Some([Force(1 << 10); 2]);
        }
    };
    for locks in [true, false] {
        let mut rig = Rig::enabled(locks);
        rig.object = Some((40.0, 50.0));
        rig.spoil = Some(told);
        rig.order(mode::GRIP, |command| command.force = 1000);
        rig.run_until(Task::HoldActive);
        rig.spoil = None;
        rig.run(2000);
        assert!(is_held(&rig), "{:?}", rig.grip.task());
    }
}

#[test]
fn a_finger_that_reads_low_does_not_raise_the_force() {
    let mut rig = Rig::holding(false);
    rig.spoil = Some(|estimates| {
        estimates[2].force = [Force(0); 2];
        estimates[3].force = [Force(0); 2];
    });
    rig.fault(Fault::Unbalanced, true);
    rig.run(1000);
    assert!(is_held(&rig));
}

#[test]
fn a_magnet_freezes_a_hold_and_its_end_lets_it_go_on() {
    for locks in [true, false] {
        let mut rig = Rig::holding(locks);
        rig.spoil = Some(|estimates| {
            for estimate in estimates {
                estimate.disturbed = true;
                estimate.force = [Force(5 << 10); 2];
            }
        });
        rig.fault(Fault::Disturbed, true);
        rig.run(500);
        assert_eq!(rig.grip.task(), Task::HoldFrozen);
        assert_eq!(rig.setpoint() == Setpoint::Off, locks);
        assert!((rig.force_n() - 100.0).abs() < 3.0);
        rig.spoil = None;
        rig.fault(Fault::Disturbed, false);
        rig.run(1000);
        assert!(is_held(&rig));
    }
}

#[test]
fn a_silent_host_stops_what_moves() {
    for mode in [mode::MOVE, mode::GRIP] {
        let mut rig = Rig::enabled(true);
        rig.order(mode, |command| {
            (command.position, command.speed, command.force) = (200, 40, 500);
        });
        rig.run(10);
        rig.host.is_alive = false;
        rig.run(20);
        assert_eq!(rig.grip.task(), Task::TimeoutHold);
        let place = rig.motor.opening_mm;
        rig.run(100);
        assert_eq!(rig.motor.opening_mm, place);
        rig.host.is_alive = true;
        rig.run(100);
        assert_eq!(rig.grip.task(), Task::TimeoutHold);
    }
}

#[test]
fn an_object_that_is_pulled_out_is_lost_and_nothing_closes_after_it() {
    for locks in [true, false] {
        let mut rig = Rig::holding(locks);
        rig.run(300);
        rig.object = None;
        rig.run(5);
        assert_eq!(rig.grip.task(), Task::Lost);
        rig.run(10);
        let place = rig.motor.opening_mm;
        rig.run(500);
        assert_eq!(rig.motor.opening_mm, place);
        assert!(rig.grip.fault_bits() != 0);
    }
}

#[test]
fn a_slip_raises_the_force_by_a_fifth_and_not_beyond_the_cap() {
    let mut rig = Rig::enabled(true);
    rig.object = Some((40.0, 50.0));
    rig.order(mode::GRIP, |command| command.force = 900);
    rig.run_until(Task::HoldActive);
    // 88 N of drag on 180 N of grip: 0.98 of what a friction of a half bears.
    rig.spoil = Some(|estimates| {
        for estimate in estimates {
            estimate.force[1] = Force(22 << 10);
        }
    });
    rig.run(1500);
    // 90 N * 1.2 = 108 N, capped.
    assert!((rig.force_n() - 100.0).abs() < 2.5, "{}", rig.force_n());
}

#[test]
fn a_grasp_that_weakens_is_gripped_again_three_times_and_then_kept_by_current() {
    let mut rig = Rig::holding(true);
    for again in 0..4 {
        for _ in 0..400 {
            rig.tick();
        }
        let expected = if again < 3 {
            Task::HoldLatched
        } else {
            Task::HoldActive
        };
        assert_eq!(rig.grip.task(), expected, "{again}");
        let (width_mm, stiffness) = rig.object.unwrap();
        rig.object = Some((width_mm - 0.3, stiffness));
    }
    rig.run(500);
    assert!(is_held(&rig));
}

#[test]
fn a_stop_for_everybody_stops_and_keeps_what_is_held() {
    for locks in [true, false] {
        let mut rig = Rig::holding(locks);
        rig.stop = true;
        rig.tick();
        rig.stop = false;
        rig.run(100);
        assert_eq!(rig.grip.power(), Power::Armed);
        assert!((rig.force_n() - 100.0).abs() < 3.0);
        assert_eq!(rig.setpoint() == Setpoint::Off, locks);
        // What hangs on the fingers may only be released.
        rig.order(mode::ENABLE, |_| {});
        assert_eq!(rig.grip.task(), Task::GripFailed);
        rig.order(mode::RELEASE, |command| {
            (command.position, command.speed) = (1200, 80)
        });
        rig.run_until(Task::Idle);
    }
}
