//! Whatever arrives: nothing happens that no table lists.

use proptest::prelude::*;
use std::vec::Vec;

use super::super::states::{Power, Task};
use super::super::table::{POWER, TASK};
use super::rig::Rig;
use crate::motor::{Setpoint, State, Trip};
use crate::status::Fault;
use crate::wire::messages::Command;

/// Both layers' states.
type Place = (Power, Task);

/// Where a tick may lead: a step of the tables, another where an order or an event follows at once, and a third
/// where a fault or a stop came in between.
const STEPS: usize = 3;

fn next((power, task): Place) -> Vec<Place> {
    let powers = POWER.iter().filter(|row| row.0 == power);
    let mut places: Vec<Place> = powers
        .flat_map(|row| {
            match row.2 {
                // What it begins with hangs on the opening and on what is gripped.
                Power::Enabled => std::vec![Task::Unhomed, Task::Idle, Task::GripFailed],
                _ => std::vec![task],
            }
            .into_iter()
            .map(|task| (row.2, task))
        })
        .collect();
    if power == Power::Enabled {
        let tasks = TASK.iter().filter(|row| row.0 == task);
        places.extend(tasks.map(|row| (power, row.2)));
    }
    places
}

fn may_follow(from: Place, to: Place) -> bool {
    let mut reached = std::vec![from];
    for _ in 0..STEPS {
        if reached.contains(&to) {
            return true;
        }
        reached = reached.into_iter().flat_map(next).collect();
    }
    reached.contains(&to)
}

/// What arrives for some milliseconds.
#[derive(Clone, Debug)]
struct Stretch {
    ms: u32,
    command: (u8, u16, u8, u16, u8),
    fault: Option<usize>,
    trip: Option<u8>,
    object: Option<(f32, f32)>,
    /// Stop, clear, offered, open, alive.
    said: [bool; 5],
}

fn stretches() -> impl Strategy<Value = Vec<Stretch>> {
    let command = (
        0_u8..10,
        any::<u16>(),
        any::<u8>(),
        any::<u16>(),
        any::<u8>(),
    );
    let fault = prop::option::weighted(0.15, 0..Fault::ALL.len());
    let trip = prop::option::weighted(0.05, 0_u8..4);
    let object = prop::option::weighted(0.7, (0_f32..60.0, 5_f32..333.0));
    let one = (
        1_u32..150,
        command,
        fault,
        trip,
        object,
        prop::array::uniform5(any::<bool>()),
    );
    let one = one.prop_map(|(ms, command, fault, trip, object, said)| Stretch {
        ms,
        command,
        fault,
        trip,
        object,
        said,
    });
    prop::collection::vec(one, 1..25)
}

/// Sets out what a stretch says; `is_open` where the host is there more often than not.
fn begin(rig: &mut Rig, stretch: &Stretch) {
    let (mode, position, speed, force, flags) = stretch.command;
    rig.command = Some(Command {
        mode,
        position: position & 0x7FF,
        speed,
        force: force & 0xFFF,
        flags,
        ..Command::default()
    });
    for (number, fault) in Fault::ALL.into_iter().enumerate() {
        rig.fault(fault, stretch.fault == Some(number));
    }
    if let Some(trip) = stretch.trip {
        let trips = [
            Trip::OverSpeed,
            Trip::Encoder,
            Trip::CurrentSense,
            Trip::Runaway,
        ];
        rig.motor.state = State::Tripped(trips[usize::from(trip)]);
    }
    rig.object = stretch.object;
    let [stop, clear, offered, open, alive] = stretch.said;
    (rig.stop, rig.clear) = (stop && alive && offered, clear);
    (rig.host.is_offered, rig.host.is_open, rig.host.is_alive) = (offered, open || alive, alive);
}

proptest! {
    #[test]
    fn no_step_is_taken_that_no_table_lists(locks in any::<bool>(), stretches in stretches()) {
        let mut rig = Rig::enabled(locks);
        let mut was_faulty = false;
        for stretch in &stretches {
            begin(&mut rig, stretch);
            for _ in 0..stretch.ms {
                let before = (rig.grip.power(), rig.grip.task());
                rig.tick();
                let after = (rig.grip.power(), rig.grip.task());
                prop_assert!(may_follow(before, after), "{:?} {:?}", before, after);
                // From a fault the way leads through safe and a new arming.
                was_faulty |= after.0 == Power::Fault;
                was_faulty &= after.0 != Power::Safe;
                prop_assert!(!(was_faulty && after.0 == Power::Enabled));
                let drives = !matches!(rig.setpoint(), Setpoint::Off | Setpoint::Brake);
                let may_drive = matches!(after.0, Power::Armed | Power::Enabled | Power::QuickStop);
                prop_assert!(!drives || may_drive, "{:?} {:?}", after, rig.setpoint());
            }
        }
    }

    #[test]
    fn nothing_is_enabled_by_itself_after_a_fault_or_a_stop(
        locks in any::<bool>(),
        stretches in stretches(),
    ) {
        let mut rig = Rig::enabled(locks);
        rig.fault(Fault::SensorLost, true);
        rig.run(300);
        prop_assert_eq!(rig.grip.power(), Power::Armed);
        for stretch in &stretches {
            begin(&mut rig, stretch);
            // The host clears nothing, however often it commands.
            rig.clear = false;
            for _ in 0..stretch.ms {
                rig.tick();
                prop_assert!(rig.grip.power() != Power::Enabled);
            }
        }
    }
}

#[test]
fn windings_that_were_shorted_stay_so_until_a_host_clears() {
    let mut rig = Rig::holding(false);
    rig.motor.state = State::Tripped(Trip::Encoder);
    rig.run(1000);
    assert_eq!(rig.grip.power(), Power::Fault);
    // The motor was not disarmed: what hangs on the screw gives way slowly.
    assert_eq!(rig.motor.state, State::Tripped(Trip::Encoder));
    assert_eq!(rig.setpoint(), Setpoint::Brake);
    rig.host.is_open = false;
    rig.clear = true;
    rig.tick();
    rig.clear = false;
    rig.run(5);
    assert_eq!(
        (rig.grip.power(), rig.motor.state),
        (Power::Safe, State::Disarmed)
    );
}
