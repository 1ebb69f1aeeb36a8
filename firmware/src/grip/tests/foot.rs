//! A foot never moves.

use proptest::prelude::*;

use super::super::fixture::pressed;
use super::super::order::mode;
use super::super::reason::Reason;
use super::super::states::{Power, Task};
use super::rig::Rig;
use crate::motor::Setpoint;
use crate::status::Fault;
use crate::wire::messages::Command;

#[test]
fn a_foot_needs_fingers_that_are_parked_and_unloaded_and_ends_unloaded() {
    let mut rig = Rig::enabled(true);
    rig.order(mode::FOOT, |_| {});
    assert_eq!(rig.refused, [Reason::NotParked]);
    let mut rig = Rig::enabled_at(true, 0.5);
    rig.run(20);
    rig.estimates = Some(pressed([0.0; 4], [21.0; 4]));
    rig.run(60);
    rig.order(mode::FOOT, |_| {});
    assert_eq!(rig.refused, [Reason::Loaded]);
    let mut rig = Rig::foot(true);
    rig.estimates = Some(pressed([0.0; 4], [21.0; 4]));
    rig.run(100);
    rig.order(mode::LEAVE, |_| {});
    rig.estimates = Some(pressed([0.0; 4], [19.0; 4]));
    rig.run(48);
    rig.order(mode::LEAVE, |_| {});
    assert_eq!(rig.refused, [Reason::Loaded; 2]);
    rig.order(mode::LEAVE, |_| {});
    assert_eq!(rig.grip.task(), Task::Idle);
}

#[test]
fn a_line_foot_stands_at_half_the_stroke() {
    let mut rig = Rig::enabled_at(false, 41.5);
    rig.run(20);
    rig.order(mode::FOOT, |command| command.flags = 0x40);
    assert_eq!(rig.refused, [Reason::NotParked]);
    let mut rig = Rig::enabled_at(false, 40.5);
    rig.run(20);
    rig.order(mode::FOOT, |command| command.flags = 0x40);
    assert_eq!(rig.grip.task(), Task::Foot);
}

#[test]
fn a_foot_tells_its_contacts_each_millisecond_and_a_silent_host_changes_nothing() {
    let mut rig = Rig::foot(true);
    rig.host.is_alive = false;
    rig.estimates = Some(pressed([0.0; 4], [50.0, 50.0, 0.0, 0.0]));
    rig.run(300);
    let foot = rig.said.as_ref().unwrap().foot.unwrap();
    assert_eq!(
        (foot.contacts, foot.total_fz, foot.centre),
        (0b0011, 1000, 0)
    );
    assert_eq!(rig.grip.task(), Task::Foot);
}

#[test]
fn an_overload_is_told_and_latched_and_moves_nothing() {
    let mut rig = Rig::foot(true);
    rig.estimates = Some(pressed([0.0; 4], [230.0, 0.0, 0.0, 0.0]));
    rig.tick();
    let events = &rig.said.as_ref().unwrap().events;
    assert_eq!(events.first().unwrap().code, Fault::FootOverload as u16);
    rig.estimates = None;
    rig.run(100);
    assert!(rig.grip.fault_bits() != 0);
    rig.clear = true;
    rig.run(1);
    assert_eq!((rig.grip.fault_bits(), rig.grip.task()), (0, Task::Foot));
}

proptest! {
    #[test]
    fn a_foot_never_moves_whatever_arrives(
        locks in any::<bool>(),
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
        let mut rig = Rig::foot(locks);
        let parked = rig.motor.opening_mm;
        for ((mode, position, speed, force, flags), lateral, longitudinal, faults, (stop, open, alive)) in ticks {
            rig.command = Some(Command {
                mode,
                position: position & 0xFFF,
                speed,
                force: force & 0xFFF,
                flags,
                ..Command::default()
            });
            rig.estimates = Some(pressed(lateral, longitudinal));
            for (bit, fault) in Fault::ALL.into_iter().enumerate() {
                rig.fault(fault, (faults >> bit) & 1 != 0 && faults & 3 == 0);
            }
            rig.stop = stop && faults & 4 == 0;
            (rig.host.is_open, rig.host.is_alive) = (open, alive);
            rig.tick();
            let stands = match rig.setpoint() {
                Setpoint::Off | Setpoint::Brake => true,
                Setpoint::Speed { closing_mm_s, .. } => closing_mm_s == 0.0,
                Setpoint::Position { opening_mm, .. } => Some(opening_mm) == parked,
                Setpoint::Current { .. } => false,
            };
            prop_assert!(stands, "{:?}", rig.setpoint());
            prop_assert_eq!(rig.motor.opening_mm, parked);
            if rig.grip.power() != Power::Enabled {
                break;
            }
            prop_assert_eq!(rig.grip.task(), Task::Foot);
        }
    }
}
