use firmware::compensation::covariates::{AccelerationSample, Covariates, MotorSample};
use firmware::estimator::Estimate;
use firmware::fixed_point::Force;
use firmware::protocol::messages::{Heartbeat, Message, Power, Timing, Version};
use firmware::protocol::serial::{Packet, Tick};
use firmware::protocol::{self, PROTOCOL_VERSION};
use firmware::sensors::hall::{HallReading, SENSORS};
use firmware::system::faults::{Fault, FaultSet};
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::*;

fn drawn(width: u16, height: u16, state: &GripperState, now_s: f64) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    let draw = |frame: &mut Frame| draw(frame, "/dev/pts/7 (virtual board)", state, now_s);
    terminal.draw(draw).unwrap();
    terminal.backend().to_string()
}

/// Twelve seconds of a loaded gripper that loses its third sensor at 10 s.
fn pressed() -> GripperState {
    let mut state = GripperState::default();
    let mut say = |at_s, copy, message| state.update(at_s, &Packet::Message { copy, message });
    let version = Version {
        protocol_major: PROTOCOL_VERSION.0,
        firmware_minor: 1,
        tables: 0xBEEF,
        ..Version::default()
    };
    say(0.0, 0, Message::Version(version));
    let timing =
        Timing { worst_loop: 312, worst_inference: 108, i2c_errors: 7, ..Timing::default() };
    say(11.0, 0, Message::Timing(timing));
    let came = FaultSet::default().update(Fault::SensorLost, 2, true, 2).unwrap();
    let power = Power { bus: 2400, current: 150, mcu: 41, motor: i8::MIN, sensor: 27, counter: 0 };
    say(11.0, 0, Message::Power(power));
    let covariates = Covariates {
        opening_um: None,
        motor: Some(MotorSample { age_us: 500, iq_ma: -2500, turn: 0x4000 }),
        acceleration: Some(AccelerationSample { age_us: 300, mm_s2: [10, -20, 9807] }),
        attitude: None,
    };
    for tick in 0..12_000_u32 {
        let at_s = f64::from(tick) * 1e-3;
        let wave = (40.0 * (0.7 * at_s).sin() * 1024.0) as i32;
        let frame = firmware::sensors::hall::HallFrame {
            time_us: 1000 * tick,
            readings: [0, 1, 2, 3].map(|sensor| {
                let lost = sensor == 2 && at_s >= 10.0;
                (!lost).then_some(HallReading { field: [-113, 9899, 67], temperature: 11 })
            }),
        };
        let mut estimates = [Estimate::MISSING; SENSORS];
        for (sensor, estimate) in estimates.iter_mut().enumerate() {
            if frame.readings[sensor].is_some() {
                let sign = if sensor < 2 { 1 } else { -1 };
                *estimate = Estimate {
                    force: [Force(sign * wave), Force(wave / 4 + 1024 * sensor as i32)],
                    sigma: Some([Force(512), Force(1024)]),
                    validity: if sensor == 1 { Validity::MissingInputs } else { Validity::Valid },
                    disturbed: sensor == 3,
                    ..Estimate::MISSING
                };
            }
            let message = Message::Force(protocol::force_message(estimate, tick as u8));
            let copy = sensor as u8;
            state.update(at_s, &Packet::Message { copy, message });
        }
        state.update(at_s, &Packet::Tick(Tick::of(&frame, &estimates, covariates)));
        if tick == 10_001 {
            let message = Message::FaultEvent(came);
            state.update(at_s, &Packet::Message { copy: 0, message });
        }
    }
    state
}

#[test]
fn the_view_shows_forces_with_sigma_faults_and_load() {
    let page = drawn(100, 30, &pressed(), 12.0);
    println!("{page}");
    for text in [
        "/dev/pts/7 (virtual board)   1000 ticks/s   q: quit",
        "firmware 0.1.0, protocol 2.0, board 0, tables beef, 12 s since its start",
        "34.20   0.50",
        "no reading",
        "-113 9899 67",
        "opening unknown, -2.50 A, rotor 1.57 rad, accel. 0.0 -0.0 9.8 m/s², attitude unknown",
        "effect not compensated",
        "24.0 V 1.50 A, MCU 41, motor ?, sensors 27",
        "valid, disturbed",
        "sensor lost, sensor 2, 2 ticks old (2.0 s)",
        "tick 312 us of 1000 at the most",
        "estimate 108 us at the most",
        "0 ticks missed, 7 transfers failed",
        "nothing lost",
    ] {
        assert!(page.contains(text), "{text:?} is not in\n{page}");
    }
}

#[test]
fn silence_is_reported_and_no_force_without_messages() {
    let page = drawn(100, 30, &GripperState::default(), 3.0);
    assert!(page.contains("no message yet"));
    assert!(page.contains("no heartbeat yet"));
    assert!(!page.contains("0.00"), "{page}");
    let mut state = pressed();
    let beat = Heartbeat { protocol_major: PROTOCOL_VERSION.0, ..Heartbeat::default() };
    let message = Message::Heartbeat(beat);
    state.update(12.0, &Packet::Message { copy: 0, message });
    let page = drawn(100, 30, &state, 14.0);
    assert!(page.contains("silent for 2.0 s"), "{page}");
    assert!(page.contains("state: boot") && page.contains("no fault"), "{page}");
    let stopped = Heartbeat { state: 2, stopped: true, ..beat };
    state.update(14.1, &Packet::Message { copy: 0, message: Message::Heartbeat(stopped) });
    let page = drawn(100, 30, &state, 14.2);
    assert!(page.contains("state: safe") && page.contains("a stop is latched"), "{page}");
    assert!(!page.contains("no fault"), "{page}");
}

#[test]
fn small_terminals_show_what_fits() {
    let cases = [(80, 24, "34.20"), (40, 10, "sensor lost")];
    for (width, height, text) in cases {
        let page = drawn(width, height, &pressed(), 12.0);
        assert!(page.contains(text), "{text:?} is not in\n{page}");
    }
    for (width, height) in [(80, 24), (40, 10), (3, 2), (1, 1)] {
        let page = drawn(width, height, &pressed(), 12.0);
        assert_eq!(page.lines().count(), usize::from(height), "{width} x {height}");
    }
}

#[test]
fn plot_range_ends_at_a_round_number_above_all_values() {
    let steps = [(5.0, 5.0), (5.1, 10.0), (11.0, 20.0), (34.0, 50.0), (99.0, 100.0)];
    for (value, end) in steps {
        assert!((step_above(value) - end).abs() < 1e-9 * end, "{value}");
    }
}

/// Forces, their errors and validity stay; what else fits stays too.
#[test]
fn a_narrow_terminal_shows_the_forces() {
    let state = pressed();
    let wide = drawn(110, 32, &state, 12.0);
    for (width, heads) in [(70, ["Fx / N", "Fz / N", "lost"].as_slice()), (82, &["Fx / N", "age"])]
    {
        let page = drawn(width, 32, &state, 12.0);
        for head in heads {
            assert!(page.contains(head), "{width}: {head}\n{page}");
        }
        assert!(!page.contains("field / LSB") && wide.contains("field / LSB"));
        let force = |page: &str| {
            let row = page.lines().nth(5).unwrap_or_default();
            let numbers = row.split_whitespace().filter_map(|word| word.parse().ok());
            numbers.skip(1).take(4).collect::<Vec<f64>>()
        };
        assert_eq!(force(&page), force(&wide), "{page}");
        assert_eq!(force(&page).len(), 4, "{page}");
    }
}
