//! Holding an object: faults that it survives, and what ends it.

use crate::estimator::Estimate;
use crate::fixed_point::Force;
use crate::grip::commands::{RefusalReason, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::GripRig;
use crate::motor::Setpoint;
use crate::system::faults::Fault;

fn is_held(rig: &GripRig) -> bool {
    matches!(rig.grip.task(), TaskState::HoldActive | TaskState::HoldLatched)
        && rig.grip.power() == PowerState::Enabled
        && (rig.force_n() - 100.0).abs() < 3.0
}

#[test]
fn hold_survives_loss_of_host_bus_session_finger_and_networks() {
    type Begin = fn(&mut GripRig);
    let disturbances: [(&str, Begin); 5] = [
        ("host and bus", |rig| {
            rig.host.is_alive = false;
            rig.fault(Fault::HostSilent, true);
            rig.fault(Fault::BusOff, true);
        }),
        ("session", |rig| (rig.host.is_alive, rig.host.is_open) = (false, false)),
        ("one finger", |rig| {
            rig.fault(Fault::SensorLost, true);
            rig.corrupt = Some(|estimates| {
                estimates[0] = Estimate::MISSING;
                estimates[1] = Estimate::MISSING;
            });
        }),
        // A finger that reads low does not raise the force.
        ("low finger", |rig| {
            rig.fault(Fault::Unbalanced, true);
            rig.corrupt = Some(|estimates| {
                estimates[2].force = [Force(0); 2];
                estimates[3].force = [Force(0); 2];
            });
        }),
        // Only networks estimate a sigma.
        ("networks", |rig| rig.corrupt = None),
    ];
    for self_locking in [true, false] {
        for (name, begin) in disturbances {
            let mut rig = GripRig::enabled(self_locking);
            rig.object = Some((40.0, 50.0));
            rig.corrupt = Some(|estimates| {
                for estimate in estimates {
                    estimate.sigma = Some([Force(1 << 10); 2]);
                }
            });
            rig.send(mode::GRIP, |command| command.force = 1000);
            rig.run_until(TaskState::HoldActive);
            begin(&mut rig);
            rig.run(3000);
            assert!(is_held(&rig), "{name} {:?}", rig.grip.task());
            assert_eq!(rig.grip.first_cause(), None);
        }
    }
}

#[test]
fn magnetic_disturbance_freezes_the_hold() {
    for self_locking in [true, false] {
        let mut rig = GripRig::holding(self_locking);
        rig.corrupt = Some(|estimates| {
            for estimate in estimates {
                estimate.disturbed = true;
                estimate.force = [Force(5 << 10); 2];
            }
        });
        rig.fault(Fault::Disturbed, true);
        rig.run(500);
        assert_eq!(rig.grip.task(), TaskState::HoldFrozen);
        assert_eq!(rig.setpoint() == Setpoint::Off, self_locking);
        assert!((rig.force_n() - 100.0).abs() < 3.0);
        rig.corrupt = None;
        rig.fault(Fault::Disturbed, false);
        rig.run(1000);
        assert!(is_held(&rig));
    }
}

#[test]
fn host_timeout_stops_a_motion() {
    for mode in [mode::MOVE, mode::GRIP] {
        let mut rig = GripRig::enabled(true);
        rig.send(mode, |command| {
            (command.position, command.speed, command.force) = (200, 40, 500);
        });
        rig.run(10);
        rig.host.is_alive = false;
        rig.run(20);
        assert_eq!(rig.grip.task(), TaskState::TimeoutHold);
        let place = rig.motor.opening_mm;
        rig.run(100);
        assert_eq!(rig.motor.opening_mm, place);
        rig.host.is_alive = true;
        rig.run(100);
        assert_eq!(rig.grip.task(), TaskState::TimeoutHold);
    }
}

#[test]
fn removed_object_is_lost_without_closing() {
    for self_locking in [true, false] {
        let mut rig = GripRig::holding(self_locking);
        rig.run(300);
        rig.object = None;
        rig.run(5);
        assert_eq!(rig.grip.task(), TaskState::Lost);
        rig.run(10);
        let place = rig.motor.opening_mm;
        rig.run(500);
        assert_eq!(rig.motor.opening_mm, place);
        assert!(rig.grip.fault_bits() != 0);
    }
}

#[test]
fn slip_raises_the_force_up_to_the_cap() {
    let mut rig = GripRig::enabled(true);
    rig.object = Some((40.0, 50.0));
    rig.send(mode::GRIP, |command| command.force = 900);
    rig.run_until(TaskState::HoldActive);
    // 88 N of drag on 180 N of grip force: 0.98 of the friction limit.
    rig.corrupt = Some(|estimates| {
        for estimate in estimates {
            estimate.force[1] = Force(22 << 10);
        }
    });
    rig.run(1500);
    // 90 N * 1.2 = 108 N, capped.
    assert!((rig.force_n() - 100.0).abs() < 2.5, "{}", rig.force_n());
}

#[test]
fn dropping_force_is_regripped_three_times() {
    let mut rig = GripRig::holding(true);
    // Milliseconds since the first regrip.
    let mut since_ms = None;
    for regrip in 0..4 {
        for _ in 0..400 {
            let before = rig.grip.task();
            rig.tick();
            since_ms = since_ms.map(|ms| ms + 1);
            if before == TaskState::HoldLatched && rig.grip.task() == TaskState::Force {
                since_ms.get_or_insert(0);
            }
        }
        let expected = if regrip < 3 { TaskState::HoldLatched } else { TaskState::HoldActive };
        assert_eq!(rig.grip.task(), expected, "{regrip}");
        let (width_mm, stiffness) = rig.object.unwrap();
        rig.object = Some((width_mm - 0.3, stiffness));
    }
    // Ten seconds after the first of the three it may hold alone again.
    let waits_ms = 10_000 - since_ms.unwrap();
    rig.run(waits_ms - 1);
    assert!(is_held(&rig));
    assert_ne!(rig.grip.task(), TaskState::HoldLatched);
    rig.tick();
    assert_eq!(rig.grip.task(), TaskState::HoldLatched);
}

#[test]
fn stop_frame_keeps_the_object_gripped() {
    for self_locking in [true, false] {
        let mut rig = GripRig::holding(self_locking);
        rig.stop_all();
        rig.run(100);
        assert_eq!(rig.grip.power(), PowerState::Armed);
        assert!((rig.force_n() - 100.0).abs() < 3.0);
        assert_eq!(rig.setpoint() == Setpoint::Off, self_locking);
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1200, 80));
        rig.send(mode::ENABLE, |_| {});
        assert_eq!(rig.refused, [RefusalReason::Stopped; 2]);
        rig.clear_faults();
        // A gripped object may only be released.
        rig.send(mode::ENABLE, |_| {});
        assert_eq!(rig.grip.task(), TaskState::GripFailed);
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1200, 80));
        rig.run_until(TaskState::Idle);
    }
}
