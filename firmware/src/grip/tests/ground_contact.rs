//! Foot mode.

use proptest::prelude::*;

use crate::grip::commands::{RefusalReason, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::{GripRig, pressed};
use crate::motor::Setpoint;
use crate::protocol::messages::Command;
use crate::system::faults::Fault;

#[test]
fn foot_mode_requires_parked_and_unloaded_fingers() {
    let mut rig = GripRig::enabled(true);
    rig.send(mode::FOOT, |_| {});
    assert_eq!(rig.refused, [RefusalReason::NotParked]);
    let mut rig = GripRig::enabled_at(true, 0.5);
    rig.run(20);
    rig.estimates = Some(pressed([0.0; 4], [21.0; 4]));
    rig.run(60);
    rig.send(mode::FOOT, |_| {});
    assert_eq!(rig.refused, [RefusalReason::Loaded]);
    let mut rig = GripRig::foot(true);
    rig.estimates = Some(pressed([0.0; 4], [21.0; 4]));
    rig.run(100);
    rig.send(mode::LEAVE, |_| {});
    rig.estimates = Some(pressed([0.0; 4], [19.0; 4]));
    rig.run(48);
    rig.send(mode::LEAVE, |_| {});
    assert_eq!(rig.refused, [RefusalReason::Loaded; 2]);
    rig.send(mode::LEAVE, |_| {});
    assert_eq!(rig.grip.task(), TaskState::Idle);
}

#[test]
fn foot_mode_reports_contacts_without_a_host() {
    let mut rig = GripRig::foot(true);
    rig.host.is_alive = false;
    rig.estimates = Some(pressed([0.0; 4], [50.0, 50.0, 0.0, 0.0]));
    rig.run(300);
    let foot = rig.outputs.as_ref().unwrap().foot.unwrap();
    assert_eq!((foot.contacts, foot.total_fz, foot.centre), (0b0011, 1000, 0));
    assert_eq!(rig.grip.task(), TaskState::Foot);
}

#[test]
fn foot_overload_is_latched_without_motion() {
    let mut rig = GripRig::foot(true);
    rig.estimates = Some(pressed([0.0; 4], [230.0, 0.0, 0.0, 0.0]));
    rig.tick();
    let events = &rig.outputs.as_ref().unwrap().events;
    assert_eq!(events.first().unwrap().code, Fault::FootOverload as u16);
    rig.estimates = None;
    rig.run(100);
    assert!(rig.grip.fault_bits() != 0);
    rig.clear = true;
    rig.run(1);
    assert_eq!((rig.grip.fault_bits(), rig.grip.task()), (0, TaskState::Foot));
}

proptest! {
    #[test]
    fn foot_mode_never_moves(
        self_locking in any::<bool>(),
        ticks in prop::collection::vec(
            (
                (0_u8..16, any::<u16>(), any::<u8>(), any::<u16>(), any::<u8>()),
                prop::array::uniform4(-400_f64..400.0),
                prop::array::uniform4(21_f64..400.0),
                any::<u32>(),
                (any::<bool>(), any::<bool>(), any::<bool>()),
            ),
            1..60,
        ),
    ) {
        let mut rig = GripRig::foot(self_locking);
        let parked = rig.motor.opening_mm;
        for ((mode, position, speed, force, flags), lateral, longitudinal, faults, (stop, open, alive)) in ticks {
            rig.command = Some(Command {
                mode,
                position: position & 0xFFF,
                speed,
                force: force & 0xFFF,
                flags,
            });
            rig.estimates = Some(pressed(lateral, longitudinal));
            for (bit, fault) in Fault::ALL.into_iter().enumerate() {
                rig.fault(fault, (faults >> bit) & 1 != 0 && faults & 3 == 0);
            }
            rig.stop = stop && faults & 4 == 0;
            (rig.host.is_open, rig.host.is_alive) = (open, alive);
            rig.tick();
            let is_still = match rig.setpoint() {
                Setpoint::Off | Setpoint::Brake => true,
                Setpoint::Speed { closing_mm_s, .. } => closing_mm_s == 0.0,
                Setpoint::Position { opening_mm, .. } => Some(opening_mm) == parked,
                Setpoint::Current { .. } => false,
            };
            prop_assert!(is_still, "{:?}", rig.setpoint());
            prop_assert_eq!(rig.motor.opening_mm, parked);
            if rig.grip.power() != PowerState::Enabled {
                break;
            }
            prop_assert_eq!(rig.grip.task(), TaskState::Foot);
        }
    }
}
