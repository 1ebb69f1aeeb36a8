use firmware::force::Estimate;
use firmware::frame::Frame;
use firmware::status::Faults;

use super::*;

fn message(message: Message) -> Packet {
    Packet::Message { copy: 0, message }
}

fn tick(time_us: u32, force: [i32; 2]) -> Packet {
    let mut estimates = [Estimate::MISSING; SENSORS];
    estimates[1] = Estimate {
        force: force.map(Force),
        validity: Validity::Valid,
        ..Estimate::MISSING
    };
    let mut frame = Frame {
        time_us,
        ..Frame::default()
    };
    frame.readings[1] = Some(Reading {
        field: [1, 2, 3],
        temperature: 4,
    });
    Packet::Tick(Tick::of(&frame, &estimates))
}

#[test]
fn a_tick_tells_forces_in_full_and_messages_add_their_sigma() {
    let mut state = State::default();
    state.take(1.0, &tick(5_000_000, [1025, -512]));
    let force = messages::Force {
        fx: 20,
        fz: -10,
        sigma_x: 2,
        sigma_z: 255,
        disturbed: true,
        model: 1,
        ..messages::Force::default()
    };
    let packet = Packet::Message {
        copy: 1,
        message: Message::Force(force),
    };
    state.take(1.0, &packet);
    let sensor = &state.sensors[1];
    assert_eq!(sensor.force_n, [1025.0 / 1024.0, -0.5]);
    assert_eq!(sensor.sigma_n, [Some(0.5), None]);
    assert_eq!(sensor.validity, Validity::Valid);
    assert!(sensor.disturbed && sensor.network);
    assert_eq!(sensor.reading.map(|told| told.value.field), Some([1, 2, 3]));
    assert!(state.sensors[0].reading.is_none());
    // Where no ticks come any more, the message's forces count, and whether they are valid.
    state.take(2.0, &packet);
    assert_eq!(state.sensors[1].force_n, [1.0, -0.5]);
    assert_eq!(state.sensors[1].validity, Validity::OutsideModel);
}

#[test]
fn ticks_and_messages_that_are_missing_are_counted_over_the_turns_of_their_counters() {
    let mut state = State::default();
    for (at_s, time_us) in [(0.0, 1_000), (0.0, 2_000), (0.0, 5_000)] {
        state.take(at_s, &tick(time_us, [0; 2]));
    }
    assert_eq!(state.lost.ticks, 2);
    for counter in [254, 255, 1] {
        let heartbeat = Heartbeat {
            counter,
            ..Heartbeat::default()
        };
        state.take(0.1, &message(Message::Heartbeat(heartbeat)));
    }
    assert_eq!(state.lost.messages, 1);
    // A counter of four bits turns over at sixteen.
    for counter in [14, 15, 2] {
        let grip = messages::GripStatus {
            counter,
            ..messages::GripStatus::default()
        };
        state.take(0.2, &message(Message::GripStatus(grip)));
    }
    assert_eq!(state.lost.messages, 1 + 2);
}

#[test]
fn a_fault_comes_with_its_source_and_goes_again() {
    let mut state = State::default();
    let mut faults = Faults::default();
    state.take(1.0, &tick(7_000_000, [0; 2]));
    let came = faults.note(Fault::SensorLost, 2, true, 5).unwrap();
    state.take(1.5, &message(Message::FaultEvent(came)));
    let active = Active {
        since_s: 1.5,
        since_board_s: Some(7.0),
        detail: Some(5),
    };
    assert_eq!(state.faults.get(&(100, Some(2))), Some(&active));
    let gone = faults.note(Fault::SensorLost, 2, false, 0).unwrap();
    state.take(2.0, &message(Message::FaultEvent(gone)));
    assert!(state.faults.is_empty());
}

#[test]
fn a_heartbeat_tells_faults_that_nobody_heard_come_and_ends_those_that_nobody_heard_go() {
    let mut state = State::default();
    let mut faults = Faults::default();
    let came = faults.note(Fault::BusOff, 0, true, 0).unwrap();
    let beat = |faults: &Faults| {
        let heartbeat = Heartbeat {
            faults: faults.bits(),
            ..Heartbeat::default()
        };
        message(Message::Heartbeat(heartbeat))
    };
    state.take(1.0, &beat(&faults));
    assert_eq!(state.faults.keys().collect::<Vec<_>>(), [&(400, None)]);
    state.take(1.1, &message(Message::FaultEvent(came)));
    assert_eq!(state.faults.keys().collect::<Vec<_>>(), [&(400, Some(0))]);
    assert_eq!(state.faults[&(400, Some(0))].since_s, 1.0);
    faults.note(Fault::BusOff, 0, false, 0);
    state.take(1.2, &beat(&faults));
    assert!(state.faults.is_empty());
}

#[test]
fn a_board_that_starts_anew_loses_its_faults_and_no_ticks() {
    let mut state = State::default();
    state.take(10.0, &tick(9_000_000, [0; 2]));
    let mut faults = Faults::default();
    let came = faults.note(Fault::BusStuck, 1, true, 0).unwrap();
    state.take(10.0, &message(Message::FaultEvent(came)));
    state.take(11.0, &tick(2_000, [0; 2]));
    state.take(11.0, &tick(3_000, [0; 2]));
    assert!(state.faults.is_empty());
    assert_eq!((state.lost.ticks, state.lost.restarts), (0, 1));
}
