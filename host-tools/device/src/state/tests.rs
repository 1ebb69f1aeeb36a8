use firmware::compensation::covariates::Covariates;
use firmware::estimator::Estimate;
use firmware::sensors::hall::HallFrame;
use firmware::system::faults::FaultSet;

use super::*;

fn message(message: Message) -> Packet {
    Packet::Message { copy: 0, message }
}

fn tick(time_us: u32, force: [i32; 2]) -> Packet {
    let mut estimates = [Estimate::MISSING; SENSORS];
    estimates[1] =
        Estimate { force: force.map(Force), validity: Validity::Valid, ..Estimate::MISSING };
    let mut frame = HallFrame { time_us, ..HallFrame::default() };
    frame.readings[1] = Some(HallReading { field: [1, 2, 3], temperature: 4 });
    Packet::Tick(Tick::of(&frame, &estimates, Covariates::default()))
}

#[test]
fn ticks_carry_full_forces_and_messages_add_sigma() {
    let mut state = GripperState::default();
    state.update(1.0, &tick(5_000_000, [1025, -512]));
    let force = messages::Force {
        fx: 20,
        fz: -10,
        sigma_x: 2,
        sigma_z: 255,
        disturbed: true,
        model: 1,
        ..messages::Force::default()
    };
    let packet = Packet::Message { copy: 1, message: Message::Force(force) };
    state.update(1.0, &packet);
    let sensor = &state.sensors[1];
    assert_eq!(sensor.force_n, [1025.0 / 1024.0, -0.5]);
    assert_eq!(sensor.sigma_n, [Some(0.5), None]);
    assert_eq!(sensor.validity, Validity::Valid);
    assert!(sensor.disturbed && sensor.network);
    assert_eq!(sensor.reading.map(|latest| latest.value.field), Some([1, 2, 3]));
    assert!(state.sensors[0].reading.is_none());
    // Without ticks, forces and validity come from the messages.
    state.update(2.0, &packet);
    assert_eq!(state.sensors[1].force_n, [1.0, -0.5]);
    assert_eq!(state.sensors[1].validity, Validity::OutsideModel);
}

#[test]
fn lost_ticks_and_messages_are_counted_over_overflows() {
    let mut state = GripperState::default();
    for (at_s, time_us) in [(0.0, 1_000), (0.0, 2_000), (0.0, 5_000)] {
        state.update(at_s, &tick(time_us, [0; 2]));
    }
    assert_eq!(state.lost.ticks, 2);
    for counter in [254, 255, 1] {
        let heartbeat =
            Heartbeat { counter, protocol_major: PROTOCOL_VERSION.0, ..Heartbeat::default() };
        state.update(0.1, &message(Message::Heartbeat(heartbeat)));
    }
    assert_eq!(state.lost.messages, 1);
    // A four-bit counter overflows at sixteen.
    for counter in [14, 15, 2] {
        let grip = messages::GripStatus { counter, ..messages::GripStatus::default() };
        state.update(0.2, &message(Message::GripStatus(grip)));
    }
    assert_eq!(state.lost.messages, 1 + 2);
}

#[test]
fn fault_appears_with_its_source_and_clears() {
    let mut state = GripperState::default();
    let mut faults = FaultSet::default();
    state.update(1.0, &tick(7_000_000, [0; 2]));
    let came = faults.update(Fault::SensorLost, 2, true, 5).unwrap();
    state.update(1.5, &message(Message::FaultEvent(came)));
    let active = ActiveFault { since_s: 1.5, since_board_s: Some(7.0), detail: Some(5) };
    assert_eq!(state.faults.get(&(100, Some(2))), Some(&active));
    let gone = faults.update(Fault::SensorLost, 2, false, 0).unwrap();
    state.update(2.0, &message(Message::FaultEvent(gone)));
    assert!(state.faults.is_empty());
}

#[test]
fn heartbeat_adds_and_clears_faults_without_events() {
    let mut state = GripperState::default();
    let mut faults = FaultSet::default();
    let came = faults.update(Fault::BusOff, 0, true, 0).unwrap();
    let beat = |faults: &FaultSet| {
        let heartbeat = Heartbeat {
            faults: faults.bits(),
            protocol_major: PROTOCOL_VERSION.0,
            ..Heartbeat::default()
        };
        message(Message::Heartbeat(heartbeat))
    };
    state.update(1.0, &beat(&faults));
    assert_eq!(state.faults.keys().collect::<Vec<_>>(), [&(400, None)]);
    state.update(1.1, &message(Message::FaultEvent(came)));
    assert_eq!(state.faults.keys().collect::<Vec<_>>(), [&(400, Some(0))]);
    assert_eq!(state.faults[&(400, Some(0))].since_s, 1.0);
    faults.update(Fault::BusOff, 0, false, 0);
    state.update(1.2, &beat(&faults));
    assert!(state.faults.is_empty());
}

#[test]
fn restart_clears_faults_and_loses_no_ticks() {
    let mut state = GripperState::default();
    state.update(10.0, &tick(9_000_000, [0; 2]));
    let mut faults = FaultSet::default();
    let came = faults.update(Fault::BusStuck, 1, true, 0).unwrap();
    state.update(10.0, &message(Message::FaultEvent(came)));
    state.update(11.0, &tick(2_000, [0; 2]));
    state.update(11.0, &tick(3_000, [0; 2]));
    assert!(state.faults.is_empty());
    assert_eq!((state.lost.ticks, state.lost.restarts), (0, 1));
}

#[test]
fn clock_continues_over_its_overflow_and_a_gap() {
    for (first, later, elapsed_s, expected) in [
        (u32::MAX - 499, 500, 0.001, 0xFFFF_FE0C + 1000),
        (1_000_000, 61_000_000, 60.0, 61_000_000),
    ] {
        let mut clock = BoardClock::default();
        assert_eq!(clock.extend(first, 0.0), Some(u64::from(first)));
        assert_eq!(clock.extend(later, elapsed_s), Some(expected));
    }
}

#[test]
fn clock_that_repeats_or_decreases_is_a_restart() {
    for again in [5_000_000, 4_999_000, 2_000] {
        let mut clock = BoardClock::default();
        clock.extend(5_000_000, 10.0);
        assert_eq!(clock.extend(again, 11.0), None);
        assert_eq!(clock.extend(again + 1000, 11.0), Some(u64::from(again) + 1000));
    }
    // Beyond half the range a backward step looks like a forward step longer than the elapsed time.
    let mut clock = BoardClock::default();
    clock.extend(3_000_000_000, 10.0);
    assert_eq!(clock.extend(2_000, 12.0), None);
}

#[test]
fn messages_of_other_hosts_are_ignored() {
    let mut state = GripperState::default();
    state.update(1.0, &message(Message::Heartbeat(Heartbeat::default())));
    for counter in [5, 9] {
        let code = messages::Authentication { counter, ..messages::Authentication::default() };
        state.update(2.0, &message(Message::Authentication(code)));
        state.update(3.0, &message(Message::Command(messages::Command::default())));
    }
    assert_eq!((state.received_s, state.lost.messages), (Some(1.0), 0));
}
