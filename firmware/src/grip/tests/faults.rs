//! What faults do to a grasp.

use super::super::order::mode;
use super::super::react::{Reaction, reaction};
use super::super::reason::Reason;
use super::super::states::{Phase, Power, Task};
use super::rig::Rig;
use crate::force::Estimate;
use crate::motor::{Setpoint, State, Trip};
use crate::status::Fault;
use Reaction::{Brake, Hold, Off, QuickStop, Warn};

/// The rows of the matrix of faults: moving; holding on a screw that locks itself, on one that is driven back;
/// as a foot.
const MATRIX: [(Fault, [Reaction; 4]); 32] = [
    (Fault::SensorLost, [QuickStop, Hold, Hold, Warn]),
    (Fault::SensorFrozen, [QuickStop, Hold, Hold, Warn]),
    (Fault::SensorSaturated, [QuickStop, Hold, Hold, Warn]),
    (Fault::BusStuck, [QuickStop, Hold, Hold, Warn]),
    (Fault::OutsideModel, [QuickStop, Hold, Hold, Warn]),
    (Fault::Unbalanced, [QuickStop, Hold, Hold, Warn]),
    (Fault::Disturbed, [QuickStop, Hold, Hold, Warn]),
    (Fault::TablesUnsound, [QuickStop; 4]),
    (Fault::StoreUnsound, [Warn; 4]),
    (Fault::TicksMissed, [Warn; 4]),
    (Fault::Crashed, [Warn; 4]),
    (Fault::BusOff, [Warn; 4]),
    (Fault::HostSilent, [Warn; 4]),
    (Fault::Flooded, [Warn; 4]),
    (Fault::StrangeFrames, [Warn; 4]),
    (Fault::OverCurrent, [Off; 4]),
    (Fault::OverSpeed, [Brake; 4]),
    (Fault::RotorSensor, [Brake, Off, Brake, Off]),
    (Fault::CurrentSense, [Off; 4]),
    (Fault::NotANumber, [Off; 4]),
    (Fault::Blind, [QuickStop, Off, QuickStop, Warn]),
    (Fault::OverForce, [QuickStop, QuickStop, QuickStop, Warn]),
    (Fault::Jammed, [QuickStop, QuickStop, QuickStop, Warn]),
    (Fault::StrokeWrong, [QuickStop, QuickStop, QuickStop, Warn]),
    (Fault::ObjectLost, [Warn; 4]),
    (Fault::Slipping, [Warn; 4]),
    (Fault::FootOverload, [Warn; 4]),
    (Fault::NetworkAstray, [Warn; 4]),
    (Fault::Supply, [Brake, Hold, Hold, Warn]),
    (Fault::Hot, [QuickStop, Hold, Hold, Warn]),
    (Fault::Runaway, [Brake; 4]),
    (Fault::PowerStage, [Off; 4]),
];

#[test]
fn each_fault_does_what_the_matrix_says() {
    for (fault, expected) in MATRIX {
        let told = [
            reaction(fault, Phase::Moving, true),
            reaction(fault, Phase::Holding, true),
            reaction(fault, Phase::Holding, false),
            reaction(fault, Phase::Foot, true),
        ];
        assert_eq!(told, expected, "{fault:?}");
        assert_eq!(reaction(fault, Phase::Moving, false), expected[0]);
        assert_eq!(reaction(fault, Phase::Foot, false), expected[3]);
    }
}

fn moving(locks: bool) -> Rig {
    let mut rig = Rig::enabled(locks);
    rig.order(mode::MOVE, |command| {
        (command.position, command.speed) = (200, 40)
    });
    rig.run(20);
    assert_eq!(rig.grip.task(), Task::Moving);
    rig
}

/// Where a gripper is some milliseconds after a fault of others.
fn after(mut rig: Rig, fault: Fault) -> (Power, Setpoint) {
    rig.fault(fault, true);
    rig.tick();
    let at_once = rig.setpoint();
    (rig.grip.power(), at_once)
}

#[test]
fn each_reaction_leads_where_it_says_from_a_way_a_hold_and_a_foot() {
    for (fault, [moves, locked, driven, foot]) in MATRIX {
        for (rig, reaction) in [
            (moving(true), moves),
            (moving(false), moves),
            (Rig::holding(true), locked),
            (Rig::holding(false), driven),
            (Rig::foot(true), foot),
            (Rig::foot(false), foot),
        ] {
            let (power, setpoint) = after(rig, fault);
            let expected = match reaction {
                Warn | Hold => power == Power::Enabled,
                QuickStop => power == Power::QuickStop || power == Power::Armed,
                Brake => setpoint == Setpoint::Brake,
                Off => setpoint == Setpoint::Off && power != Power::Enabled,
            };
            assert!(expected, "{fault:?} {reaction:?}: {power:?} {setpoint:?}");
        }
    }
}

#[test]
fn what_the_motor_trips_on_is_latched_and_only_a_clear_and_a_new_arming_lead_back() {
    let mut rig = moving(true);
    rig.motor.state = State::Tripped(Trip::OverSpeed);
    rig.tick();
    assert_eq!(rig.setpoint(), Setpoint::Brake);
    // Whatever follows, the first stays.
    rig.fault(Fault::SensorLost, true);
    rig.run(300);
    let cause = rig.grip.first_cause().unwrap();
    assert_eq!(
        (cause.fault, cause.state),
        (Fault::OverSpeed, 16 + Task::Moving as u8)
    );
    assert_eq!(rig.grip.power(), Power::Fault);
    assert!(!rig.said.as_ref().unwrap().may_arm);
    // The trip is gone since the motor was disarmed; nothing arms by itself, nor on a clear.
    rig.fault(Fault::SensorLost, false);
    rig.run(1000);
    rig.order(mode::ENABLE, |_| {});
    assert_eq!(
        (rig.grip.power(), rig.refused.pop()),
        (Power::Fault, Some(Reason::NotEnabled))
    );
    rig.host.is_open = false;
    rig.clear = true;
    rig.run(1);
    rig.clear = false;
    rig.run(1000);
    assert_eq!(rig.grip.power(), Power::Safe);
    rig.arm();
    assert_eq!(rig.grip.first_cause(), None);
}

#[test]
fn a_clear_while_the_cause_is_there_clears_nothing() {
    let mut rig = moving(true);
    rig.fault(Fault::OverCurrent, true);
    rig.run(300);
    rig.clear = true;
    rig.run(3);
    assert_eq!(rig.grip.power(), Power::Fault);
    assert!(rig.grip.first_cause().is_some());
}

#[test]
fn after_a_quick_stop_nothing_is_enabled_until_the_cause_is_cleared() {
    let mut rig = moving(true);
    rig.fault(Fault::SensorLost, true);
    rig.run(100);
    assert_eq!(rig.grip.power(), Power::Armed);
    rig.order(mode::ENABLE, |_| {});
    rig.fault(Fault::SensorLost, false);
    rig.order(mode::ENABLE, |_| {});
    assert_eq!(rig.refused, [Reason::Faulty, Reason::Latched]);
    rig.clear = true;
    rig.order(mode::ENABLE, |_| {});
    assert_eq!(rig.grip.power(), Power::Enabled);
}

#[test]
fn blind_a_screw_that_locks_is_switched_off_and_another_keeps_its_place() {
    for locks in [true, false] {
        let mut rig = Rig::holding(locks);
        rig.spoil = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
        rig.run(2);
        assert_eq!(rig.grip.power(), Power::Enabled);
        rig.run(100);
        let place = rig.motor.opening_mm;
        let expected = if locks { Power::Fault } else { Power::Armed };
        assert_eq!(rig.grip.power(), expected);
        assert_eq!(rig.setpoint() == Setpoint::Off, locks);
        rig.run(1000);
        assert_eq!(rig.motor.opening_mm, place);
    }
}

#[test]
fn too_much_force_gives_way_to_fifty_newtons() {
    let mut rig = Rig::holding(false);
    rig.object = Some((48.0, 50.0));
    assert!(rig.force_n() > 450.0);
    rig.run(300);
    assert_eq!(rig.grip.power(), Power::Armed);
    assert!((40.0..61.0).contains(&rig.force_n()), "{}", rig.force_n());
    assert_eq!(rig.grip.first_cause().unwrap().fault, Fault::OverForce);
}

#[test]
fn strange_frames_end_the_session_of_a_gripper_at_rest_and_no_other() {
    let mut rig = Rig::enabled(true);
    rig.fault(Fault::StrangeFrames, true);
    rig.tick();
    assert_eq!(rig.grip.power(), Power::Armed);
    assert!(!rig.said.as_ref().unwrap().may_arm);
    for mut rig in [moving(true), Rig::holding(true)] {
        rig.fault(Fault::StrangeFrames, true);
        rig.run(10);
        assert_eq!(rig.grip.power(), Power::Enabled);
        assert!(rig.said.as_ref().unwrap().may_arm);
    }
}

#[test]
fn tables_that_are_unsound_let_nobody_arm() {
    let mut rig = Rig::new(true);
    rig.fault(Fault::TablesUnsound, true);
    rig.run(10);
    assert_eq!(rig.grip.power(), Power::Safe);
    assert!(!rig.said.as_ref().unwrap().may_arm);
}
