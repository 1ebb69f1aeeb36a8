//! The board in virtual time tells over its buses what a replay tells of the same recording.

mod desk;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;

use desk::Desk;
use embedded_can::Frame;
use firmware::frame::SENSORS;
use firmware::limits::Limits;
use firmware::loops::FIRST_TICK_US;
use firmware::parameters::Parameters;
use firmware::params::TICK_US;
use firmware::units;
use firmware::wire::messages::{Force, Message};
use firmware::wire::serial::{Packet, Receiver, Tick};
use firmware::wire::{DEFAULT_NODE, identifier};
use host_tools::board::recorded::Recorded;
use host_tools::board::{Board, Program};
use host_tools::replay::{Models, replay_watched};
use model_export::inverse::build::{Built, Variant, build};
use model_export::recordings::align::Alignment;
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;

const RECORDING_S: f64 = 12.0;

fn data(campaign: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data");
    root.join(campaign)
}

fn built(desk: &Desk, campaign: &str) -> Built {
    let folder = data(campaign);
    desk.done(&format!("fit {} -o model.toml", folder.display()));
    build(&desk.0.path().join("model.toml"), Variant::Fitted).unwrap()
}

fn stream(folder: &Path) -> RawStream {
    let (description, _) = Description::read(folder).unwrap();
    RawStream::open(folder, &description, Alignment { delay_us: 0.0 }).unwrap()
}

/// What a board told while it felt a recording.
struct Heard {
    ticks: Vec<Tick>,
    /// With the time at which the frame had passed.
    forces: Vec<(u64, usize, Force)>,
    /// Ticks that were missed, packets that found no place.
    missed: u32,
    unsent: u32,
}

fn run(built: &Built, folder: &Path, seconds: f64) -> Heard {
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        parameters: Parameters::DEFAULT,
        limits: Limits::GRIPPER,
    };
    let world = Recorded::new(stream(folder), built);
    let mut board = Board::start(program, Box::new(world));
    board.run_until(FIRST_TICK_US + (1e6 * seconds) as u64);
    let mut receiver = Receiver::default();
    let bytes = std::mem::take(&mut board.line.borrow_mut().sent);
    let packets = bytes.iter().filter_map(|byte| receiver.take(*byte));
    let ticks = packets.filter_map(|packet| match packet {
        Packet::Tick(tick) => Some(tick),
        Packet::Message { .. } => None,
    });
    let first = identifier(DEFAULT_NODE, Force::LAYOUT.number);
    let can = board.can.borrow();
    let forces = can.heard.iter().filter_map(|(time_us, frame)| {
        let number = (frame.identifier() & 0x1F) as u8;
        let sensor = usize::from(frame.identifier().checked_sub(first)?);
        match Message::from_frame(number, frame.data()) {
            Ok(Message::Force(force)) => Some((*time_us, sensor, force)),
            _ => None,
        }
    });
    let counts = &board.exchange.counts;
    Heard {
        ticks: ticks.collect(),
        forces: forces.collect(),
        missed: counts.ticks_missed.load(Relaxed),
        unsent: counts.packets_unsent.load(Relaxed),
    }
}

/// Raw forces of a replay: for each row of the recording those of each sensor, where they are valid.
fn replayed(built: &Built, folder: &Path) -> Vec<[Option<[i32; 2]>; SENSORS]> {
    let mut rows = stream(folder);
    let mut places = HashMap::new();
    while let Some(row) = rows.next_row().unwrap() {
        places.insert(row.time_s.to_bits(), places.len());
    }
    let mut forces = vec![[None; SENSORS]; places.len()];
    replay_watched(
        Models::of(built),
        "",
        stream(folder),
        |_| (),
        |seen| {
            let row = places[&seen.time_s.to_bits()];
            let raw = seen.found_n.map(|n| (n * units::Force::PER_NEWTON) as i32);
            forces[row][seen.sensor] = Some(raw);
        },
    )
    .unwrap();
    forces
}

#[test]
fn over_the_serial_line_and_the_bus_go_the_forces_of_a_replay_bit_for_bit() {
    let desk = Desk::empty();
    for (campaign, sensors) in [("clean", 4), ("friction", 2)] {
        let built = built(&desk, campaign);
        for recording in ["1", "2", "3"] {
            let folder = data(campaign).join(recording);
            let expected = replayed(&built, &folder);
            let heard = run(&built, &folder, RECORDING_S);
            assert_eq!((heard.missed, heard.unsent), (0, 0));
            let mut compared = 0;
            for tick in &heard.ticks {
                let row = (u64::from(tick.time_us) - FIRST_TICK_US) / TICK_US;
                for (sensor, expected) in tick.sensors.iter().zip(&expected[row as usize]) {
                    if let Some(expected) = expected {
                        assert_eq!(sensor.force, *expected, "{campaign}/{recording} row {row}");
                        compared += 1;
                    }
                }
            }
            let rows = (RECORDING_S * 1000.0) as usize;
            assert!(compared > sensors * rows * 95 / 100, "{compared}");
            // On the bus in units of 0.05 N, rounded.
            let units = |raw: i32| ((raw * 20 + 512) >> 10) as i16;
            let mut on_bus = 0;
            for (time_us, sensor, force) in &heard.forces {
                let row = (time_us - FIRST_TICK_US) / TICK_US;
                if let Some(expected) = expected[row as usize][*sensor] {
                    assert_eq!([force.fx, force.fz], expected.map(units), "row {row}");
                    on_bus += 1;
                }
            }
            assert!(on_bus > sensors * rows / 10 * 95 / 100, "{on_bus}");
        }
    }
}

#[test]
fn the_frames_of_all_four_sensors_have_passed_within_a_millisecond_of_the_sample() {
    let desk = Desk::empty();
    let built = built(&desk, "clean");
    let heard = run(&built, &data("clean/1"), 1.0);
    let mut worst_us = 0;
    for (time_us, _, _) in &heard.forces {
        worst_us = worst_us.max((time_us - FIRST_TICK_US) % (10 * TICK_US));
    }
    // Two transfers of 102 us; four frames of 132 us where a heartbeat or an event goes not before.
    assert!((204 + 4 * 132..=1000).contains(&worst_us), "{worst_us} us");
}
