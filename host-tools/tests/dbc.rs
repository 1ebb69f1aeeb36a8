//! The `.dbc`, read by a library that shares no code with the gripper, against frames of the gripper.

use can_dbc::{Dbc, MultiplexIndicator, Signal, ValueType};
use firmware::force::{Estimate, Validity};
use firmware::units::Force;
use firmware::wire::messages::{Command, Foot, GripStatus, HallRaw, Heartbeat, Power};
use firmware::wire::{self, DEFAULT_NODE};
use host_tools::commands::dbc::dbc;

/// The value of a signal in a frame, by what the file says of it.
fn value(file: &Dbc, message: &str, signal: &str, bytes: [u8; 8]) -> f64 {
    let message = file.messages.iter().find(|m| m.name == message).unwrap();
    let signal: &Signal = message.signals.iter().find(|s| s.name == signal).unwrap();
    let bit = |i: u64| u64::from(bytes[(i / 8) as usize] >> (i % 8) & 1);
    let counts: u64 = (0..signal.size)
        .map(|i| bit(signal.start_bit + i) << i)
        .sum();
    let negative =
        signal.value_type == ValueType::Signed && bit(signal.start_bit + signal.size - 1) == 1;
    let counts = counts as i64 - if negative { 1_i64 << signal.size } else { 0 };
    counts as f64 * signal.factor + signal.offset
}

fn file() -> Dbc {
    Dbc::try_from(dbc(DEFAULT_NODE).as_str()).unwrap()
}

fn close(measured: f64, expected: f64) {
    assert!(
        (measured - expected).abs() < 1e-9,
        "{measured} instead of {expected}"
    );
}

#[test]
fn the_file_in_the_repository_is_the_one_that_the_command_writes() {
    let kept = include_str!("../../firmware/magpie.dbc");
    assert!(
        kept == dbc(DEFAULT_NODE),
        "run: cargo magpie dbc -o firmware/magpie.dbc"
    );
}

#[test]
fn forces_of_the_third_sensor_are_read_in_newtons() {
    let estimate = Estimate {
        force: [Force(-(123 << 10)), Force(47 << 10)],
        sigma: Some([Force(2 << 10), Force(5 << 9)]),
        validity: Validity::Valid,
        ..Estimate::MISSING
    };
    let bytes = wire::force(&estimate, 200).to_bytes();
    let file = file();
    let read = |signal| value(&file, "Force2", signal, bytes);
    close(read("fx"), -123.0);
    close(read("fz"), 47.0);
    close(read("sigma_x"), 2.0);
    close(read("sigma_z"), 2.5);
    close(read("valid"), 1.0);
    close(read("stale"), 0.0);
    close(read("model"), 1.0);
    close(read("counter"), 200.0);
}

#[test]
fn every_signal_of_these_frames_is_read_as_it_was_meant() {
    let file = file();
    let grip = GripStatus {
        position: 9012,
        speed: -5830,
        force: 3500,
        current: -1234,
        object: 2,
        counter: 9,
    };
    let read = |signal| value(&file, "GripStatus", signal, grip.to_bytes());
    close(read("position"), 90.12);
    close(read("speed"), -58.3);
    close(read("force"), 350.0);
    close(read("current"), -12.34);
    close(read("object"), 2.0);
    close(read("counter"), 9.0);
    let power = Power {
        bus: 2405,
        current: -310,
        mcu: -5,
        motor: 61,
        sensor: 33,
        counter: 1,
    };
    let read = |signal| value(&file, "Power", signal, power.to_bytes());
    close(read("bus"), 24.05);
    close(read("current"), -3.1);
    close(read("mcu"), -5.0);
    close(read("motor"), 61.0);
    let command = Command {
        mode: 3,
        counter: 14,
        position: 2000,
        speed: 233,
        force: 3500,
        flags: 0x81,
        crc: 0xABCD,
    };
    let read = |signal| value(&file, "Command", signal, command.to_bytes());
    close(read("mode"), 3.0);
    close(read("counter"), 14.0);
    close(read("position"), 100.0);
    close(read("speed"), 58.25);
    close(read("force"), 350.0);
    close(read("flags"), f64::from(0x81));
    close(read("crc"), f64::from(0xABCD));
    let foot = Foot {
        contacts: 0b1010,
        total_fz: -4321,
        centre: 1750,
        sigma: 12,
        counter: 3,
    };
    let read = |signal| value(&file, "Foot", signal, foot.to_bytes());
    close(read("contacts"), 10.0);
    close(read("total_fz"), -432.1);
    close(read("centre"), 17.5);
    close(read("sigma"), 3.0);
    let heartbeat = Heartbeat {
        faults: 0x8000_0001,
        state: 7,
        object: 3,
        command_alive: true,
        sensors_ok: 0b1101,
        protocol_major: 1,
        counter: 255,
    };
    let read = |signal| value(&file, "Heartbeat", signal, heartbeat.to_bytes());
    close(read("faults"), f64::from(0x8000_0001_u32));
    close(read("state"), 7.0);
    close(read("command_alive"), 1.0);
    close(read("sensors_ok"), 13.0);
    close(read("counter"), 255.0);
}

#[test]
fn a_raw_reading_is_read_under_its_sensor() {
    let raw = HallRaw {
        sensor: 3,
        x: -16384,
        y: 16383,
        z: -1,
        temperature: -2048,
    };
    let file = file();
    let read = |signal| value(&file, "HallRaw", signal, raw.to_bytes());
    close(read("sensor"), 3.0);
    close(read("x3"), -16384.0);
    close(read("y3"), 16383.0);
    close(read("z3"), -1.0);
    close(read("temperature3"), -2048.0);
    let message = file.messages.iter().find(|m| m.name == "HallRaw").unwrap();
    let shown = |name: &str| {
        let signal = message.signals.iter().find(|s| s.name == name).unwrap();
        signal.multiplexer_indicator
    };
    assert_eq!(shown("sensor"), MultiplexIndicator::Multiplexor);
    assert_eq!(shown("x3"), MultiplexIndicator::MultiplexedSignal(3));
}

#[test]
fn another_node_has_other_identifiers_and_the_same_messages() {
    let other = dbc(1);
    assert!(other.contains("BO_ 32 Version:"), "{other}");
    assert!(dbc(DEFAULT_NODE).contains("BO_ 512 Version:"));
    assert_eq!(
        other.matches("BO_ ").count(),
        dbc(DEFAULT_NODE).matches("BO_ ").count()
    );
}
