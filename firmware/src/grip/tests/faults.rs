//! Fault detection, reactions and clearing.

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::fixed_point::Force;
use crate::grip::commands::{CommandRefusal, RefusalReason, mode};
use crate::grip::fault_reactions::{REACTION_TABLE, Reaction};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::GripRig;
use crate::motor::state::SupplyState;
use crate::motor::{MotorState, Setpoint, Trip};
use crate::protocol::messages::ServiceReply;
use crate::system::faults::Fault;
use Reaction::{Brake, Hold, Off, QuickStop, Warn};

fn moving(self_locking: bool) -> GripRig {
    let mut rig = GripRig::enabled(self_locking);
    rig.send(mode::MOVE, |command| (command.position, command.speed) = (200, 40));
    rig.run(20);
    assert_eq!(rig.grip.task(), TaskState::Moving);
    rig
}

fn releasing(self_locking: bool) -> GripRig {
    let mut rig = GripRig::holding(self_locking);
    rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1400, 40));
    rig.run(20);
    assert_eq!(rig.grip.task(), TaskState::Releasing);
    rig
}

/// Power state and set-point right after an external fault.
fn after(mut rig: GripRig, fault: Fault) -> (PowerState, Setpoint) {
    rig.fault(fault, true);
    rig.tick();
    let at_once = rig.setpoint();
    (rig.grip.power(), at_once)
}

#[test]
fn reactions_take_effect_in_every_phase() {
    for row in REACTION_TABLE {
        let fault = row.fault;
        let [locked, driven] = row.holding;
        for (rig, reaction) in [
            (moving(true), row.moving),
            (moving(false), row.moving),
            (GripRig::holding(true), locked),
            (GripRig::holding(false), driven),
            (releasing(true), row.releasing),
            (releasing(false), row.releasing),
            (GripRig::foot(true), row.foot),
            (GripRig::foot(false), row.foot),
        ] {
            let (power, setpoint) = after(rig, fault);
            let expected = match reaction {
                Warn | Hold => power == PowerState::Enabled,
                QuickStop => power == PowerState::QuickStop || power == PowerState::Armed,
                Brake => setpoint == Setpoint::Brake,
                Off => setpoint == Setpoint::Off && power != PowerState::Enabled,
            };
            assert!(expected, "{fault:?} {reaction:?}: {power:?} {setpoint:?}");
        }
    }
}

#[test]
fn trip_is_latched_until_cleared_and_armed_again() {
    let mut rig = moving(true);
    rig.motor.state = MotorState::Tripped(Trip::OverSpeed);
    rig.tick();
    assert_eq!(rig.setpoint(), Setpoint::Brake);
    // A later fault does not replace the first.
    rig.fault(Fault::SensorLost, true);
    rig.run(300);
    let cause = rig.grip.first_cause().unwrap();
    assert_eq!((cause.fault, cause.state), (Fault::OverSpeed, 16 + TaskState::Moving as u8));
    assert_eq!(rig.grip.power(), PowerState::Fault);
    assert!(!rig.outputs.as_ref().unwrap().may_arm);
    // Disarming cleared the trip; only a clear and a new session lead back.
    rig.fault(Fault::SensorLost, false);
    rig.run(1000);
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(
        (rig.grip.power(), rig.refused.pop()),
        (PowerState::Fault, Some(RefusalReason::NotEnabled))
    );
    rig.host.is_open = false;
    rig.clear_faults();
    rig.run(1000);
    assert_eq!(rig.grip.power(), PowerState::Safe);
    rig.arm();
    assert_eq!(rig.grip.first_cause(), None);
}

#[test]
fn active_fault_is_not_cleared() {
    let mut rig = moving(true);
    rig.fault(Fault::OverCurrent, true);
    rig.run(300);
    rig.clear = true;
    rig.run(3);
    assert_eq!(rig.grip.power(), PowerState::Fault);
    assert!(rig.grip.first_cause().is_some());
}

#[test]
fn quick_stop_blocks_enabling_until_cleared() {
    let mut rig = moving(true);
    rig.fault(Fault::SensorLost, true);
    rig.run(100);
    assert_eq!(rig.grip.power(), PowerState::Armed);
    rig.send(mode::ENABLE, |_| {});
    rig.fault(Fault::SensorLost, false);
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.refused, [RefusalReason::FaultActive, RefusalReason::FaultLatched]);
    rig.clear = true;
    rig.send(mode::ENABLE, |_| {});
    assert_eq!(rig.grip.power(), PowerState::Enabled);
}

#[test]
fn excessive_force_backs_off_to_50_n() {
    let mut rig = GripRig::holding(false);
    rig.object = Some((48.0, 50.0));
    assert!(rig.force_n() > 450.0);
    rig.run(300);
    assert_eq!(rig.grip.power(), PowerState::Armed);
    assert!((40.0..61.0).contains(&rig.force_n()), "{}", rig.force_n());
    assert_eq!(rig.grip.first_cause().unwrap().fault, Fault::OverForce);
}

#[test]
fn strange_frames_end_nothing() {
    for mut rig in [GripRig::enabled(true), moving(true), GripRig::holding(true)] {
        let (power, task) = (rig.grip.power(), rig.grip.task());
        rig.fault(Fault::StrangeFrames, true);
        rig.run(10);
        assert_eq!((rig.grip.power(), rig.grip.task()), (power, task));
        assert!(may_arm(&rig));
    }
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.arm();
    rig.fault(Fault::StrangeFrames, true);
    rig.run(10);
    assert_eq!((rig.grip.power(), may_arm(&rig)), (PowerState::Armed, true));
}

#[test]
fn unsound_tables_prevent_arming() {
    let mut rig = GripRig::new(true);
    rig.fault(Fault::TablesUnsound, true);
    rig.run(10);
    assert_eq!(rig.grip.power(), PowerState::Safe);
    assert!(!rig.outputs.as_ref().unwrap().may_arm);
}

const LIMITS: GripLimits = GripLimits::GRIPPER;

#[test]
fn supply_and_heat_faults_need_an_armed_motor() {
    for is_armed in [true, false] {
        let mut rig = GripRig::new(true);
        rig.run(5);
        if is_armed {
            rig.arm();
        }
        rig.motor.supply = SupplyState::Low;
        rig.motor.bus_v = 15.5;
        rig.motor.is_hot = true;
        rig.tick();
        assert_eq!(rig.new_fault(Fault::Supply), is_armed.then_some(15_500));
        assert_eq!(rig.new_fault(Fault::Hot), is_armed.then_some(0));
    }
}

#[test]
fn over_force_fault_above_450_n_has_force_detail() {
    let mut rig = GripRig::enabled(true);
    rig.press(450.0);
    rig.run(3);
    assert_eq!(rig.new_fault(Fault::OverForce), None);
    assert_ne!(rig.grip.power(), PowerState::Fault);
    rig.press(451.0);
    rig.tick();
    assert_eq!(rig.new_fault(Fault::OverForce), Some((451.0 * Force::PER_NEWTON) as u32));
}

/// Ticks until an opening is rejected, with a force on the fingers.
fn rejected_after(opening_mm: f32, newtons: f64) -> Option<u32> {
    let mut rig = GripRig::new(true);
    rig.run(3);
    rig.press(newtons);
    rig.run(1);
    rig.motor.opening_mm = Some(opening_mm);
    (1..20).find(|_| {
        rig.tick();
        let detail = rig.new_fault(Fault::StrokeWrong);
        assert_eq!(rig.motor.opening_mm.is_none(), detail.is_some());
        // In micrometres.
        let is_near = |detail: u32| (1e-3 * detail as f32 - opening_mm.abs()).abs() < 2e-3;
        assert!(detail.is_none_or(is_near), "{detail:?}");
        detail.is_some()
    })
}

#[test]
fn implausible_opening_becomes_unknown_after_3_ms() {
    let stroke = constants::STROKE.value as f32;
    assert_eq!(rejected_after(stroke + 0.81, 0.0), Some(3));
    assert_eq!(rejected_after(stroke + 0.7, 0.0), None);
    assert_eq!(rejected_after(stroke + 0.8, 0.0), None);
    assert_eq!(rejected_after(-0.81, 0.0), Some(3));
    assert_eq!(rejected_after(-0.7, 0.0), None);
    assert_eq!(rejected_after(-0.8, 0.0), None);
    // Fingers that press on each other deflect.
    assert_eq!(rejected_after(-0.9, f64::from(LIMITS.contact_n)), None);
    assert_eq!(rejected_after(-0.9, f64::from(LIMITS.contact_n) - 0.1), Some(3));
    // Beyond the far end the force is irrelevant.
    assert_eq!(rejected_after(stroke + 0.9, 20.0), Some(3));
}

#[test]
fn homing_accepts_any_opening() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::HOME, |_| {});
    assert_eq!(rig.grip.task(), TaskState::Homing);
    rig.motor.opening_mm = Some(constants::STROKE.value as f32 + 5.0);
    for _ in 0..10 {
        rig.tick();
        assert_eq!(rig.new_fault(Fault::StrokeWrong), None);
    }
}

fn may_arm(rig: &GripRig) -> bool {
    rig.outputs.as_ref().unwrap().may_arm
}

#[test]
fn arming_is_refused_by_severe_or_latched_faults_only() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    assert!(may_arm(&rig));
    rig.fault(Fault::SensorLost, true);
    rig.tick();
    assert!(may_arm(&rig), "a quick stop stops nothing that rests");
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.arm();
    assert!(may_arm(&rig));
    // The cause has ended but is still latched.
    rig.fault(Fault::OverSpeed, true);
    rig.run(300);
    rig.fault(Fault::OverSpeed, false);
    rig.run(5);
    assert_eq!((rig.grip.power(), may_arm(&rig)), (PowerState::Fault, false));
}

#[test]
fn refusal_detail_has_reason_state_and_mode() {
    let refused =
        CommandRefusal { mode: mode::GRIP, reason: RefusalReason::NotEnabled, state: 0x13 };
    let detail = 0x0004_1300 | RefusalReason::NotEnabled as u32;
    let reply = refused.reply();
    assert_eq!((mode::GRIP, reply.detail, reply.extra), (4, detail, 0));
    assert_ne!(reply, ServiceReply::default());
    assert_ne!(RefusalReason::NotEnabled as u32, 0);
}

#[test]
fn backdrivable_screw_stays_armed_without_a_session() {
    for (self_locking, stays_armed) in [(true, false), (false, true)] {
        let mut rig = GripRig::holding(self_locking);
        // Stopped while holding: armed with a load.
        rig.fault(Fault::TablesUnsound, true);
        rig.run(300);
        assert_eq!(rig.grip.power(), PowerState::Armed);
        rig.host.is_open = false;
        rig.run(5);
        assert_eq!(rig.grip.power() == PowerState::Armed, stays_armed, "{self_locking}");
    }
}

#[test]
fn closed_session_makes_an_armed_gripper_safe() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.arm();
    rig.run(50);
    assert_eq!(rig.grip.power(), PowerState::Armed);
    rig.host.is_open = false;
    rig.run(2);
    assert_eq!(rig.grip.power(), PowerState::Safe);
}
