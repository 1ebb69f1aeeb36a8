//! A recording at the sensors of the image: fields and forces of every tick on the serial line, and of every message on the
//! CAN bus, are those of a replay, bit for bit.

use std::path::Path;

use device_run::networks::NetworkSet;
use embedded_can::Frame;
use firmware::config::limits::DetectionLimits;
use firmware::parameters::Parameters;
use firmware::protocol::messages::{Force, Message};
use firmware::protocol::serial::{Packet, PacketDecoder, Tick};
use libtest_mimic::{Failed, Trial};
use model_export::recordings::align::Alignment;
use model_export::recordings::stream::RawStream;
use sim::board::world::{RecordedWorld, World, WorldSample};
use sim::board::{Connections, Program, SimulatedBoard, VirtualTimeBoard};
use sim::closed_loop::emulated_board::{ChipConditions, EmulatedBoard};

use crate::Effort;
use crate::boards::{CONDITIONS, board, image, violations};
use crate::images::{Made, Variant};

/// As much of a recording as the repository has of the shortest.
const SECONDS: u64 = 12;

pub fn trials(_: Effort) -> Vec<Trial> {
    let of = |variant: Variant, name: &str, conditions: ChipConditions| {
        let test = move || replays(variant, conditions);
        Trial::test(format!("replay_{}_{name}", variant.name()), test)
    };
    let [fast, typical, slow] = CONDITIONS;
    let mut trials: Vec<_> =
        Variant::ALL.into_iter().map(|variant| of(variant, slow.0, slow.1)).collect();
    trials.extend([fast, typical].map(|(name, conditions)| of(Variant::Clean, name, conditions)));
    trials
}

/// The fields of a recording, without its inertial sensor: the two boards read that at different moments.
struct FieldsOnly(RecordedWorld);

impl World for FieldsOnly {
    fn next(&mut self) -> Option<WorldSample> {
        let moment = self.0.next()?;
        Some(WorldSample { inertial: None, ..moment })
    }
}

/// The first recording of an image's campaign.
pub fn recorded(made: &Made) -> Box<dyn World> {
    let folder = made.campaign.join("1");
    Box::new(FieldsOnly(RecordedWorld::new(stream(&folder), &made.built)))
}

fn replays(variant: Variant, conditions: ChipConditions) -> Result<(), Failed> {
    let made = image(variant)?;
    let board = board(&made, conditions, recorded(&made));
    assert_replays(&made, board, 17)
}

/// Runs a board that measures the recording of `made`; it starts within so many milliseconds.
pub fn assert_replays(made: &Made, mut board: EmulatedBoard, start_ms: u64) -> Result<(), Failed> {
    let mut receiver = PacketDecoder::default();
    let mut packets = Vec::new();
    for step in 1..=SECONDS {
        board.run_until(1_000_000 * step)?;
        let received = board.take_packets(&mut receiver).into_iter();
        packets.extend(received.map(|(_, packet)| packet));
    }
    let reported = reported(packets.into_iter(), &board.connections);
    let expected = in_virtual_time(made);
    // The image starts a few milliseconds later, and some ticks are on their way at the end. Lost ones would differ.
    let compared = reported.ticks.len();
    assert!(compared as u64 > 1000 * SECONDS - start_ms, "{compared} ticks");
    for (number, (tick, expected)) in reported.ticks.iter().zip(&expected.ticks).enumerate() {
        assert_eq!(tick.sensors, expected.sensors, "tick {number}");
    }
    let forces = reported.forces.len();
    assert!(forces as u64 > 4 * (100 * SECONDS - start_ms / 10 - 1), "{forces} messages");
    for (number, (force, expected)) in reported.forces.iter().zip(&expected.forces).enumerate() {
        assert_eq!(force, expected, "message {number}");
    }
    let violations = violations(&board);
    assert!(
        violations.is_empty() && board.chip.resets.is_empty(),
        "{violations:?} {:?}",
        board.chip.resets
    );
    println!("{compared} ticks and {forces} messages are equal");
    Ok(())
}

fn stream(folder: &Path) -> RawStream {
    RawStream::open_folder(folder, Alignment { delay_us: 0.0 }).unwrap()
}

/// What a board reports while its sensors measure a recording: every tick, and every force message with its sensor.
struct Reported {
    ticks: Vec<Tick>,
    forces: Vec<(usize, Force)>,
}

/// The same by the firmware's loops in virtual time, which `host-tools/tests/board` compares with `replay`.
fn in_virtual_time(made: &Made) -> Reported {
    let world = recorded(made);
    let networks = made
        .networks
        .as_ref()
        .map(|networks| NetworkSet::of(networks.file.clone(), &made.path, &made.built).unwrap());
    let program = Program {
        tables: made.built.chosen.tables.clone(),
        compensations: made.built.compensations.clone(),
        networks: networks.map(|networks| networks.packed),
        description: "",
        parameters: Parameters::DEFAULT,
        limits: DetectionLimits::GRIPPER,
    };
    let mut board = VirtualTimeBoard::start(program, world);
    board.run_until(1_000_000 * SECONDS);
    let mut receiver = PacketDecoder::default();
    let bytes = std::mem::take(&mut board.connections.line.borrow_mut().sent);
    let packets = bytes.iter().filter_map(|byte| receiver.push(*byte));
    reported(packets, &board.connections)
}

/// Ticks from the serial line, force messages from the CAN bus.
fn reported(packets: impl Iterator<Item = Packet>, connections: &Connections) -> Reported {
    let ticks = packets.filter_map(|packet| match packet {
        Packet::Tick(tick) => Some(tick),
        Packet::Message { .. } => None,
    });
    let bus = connections.can.borrow();
    let forces = bus.board_frames.iter().filter_map(|(_, frame)| {
        let number = (frame.identifier() & 0x1F) as u8;
        match Message::from_frame(number, frame.data()) {
            Ok(Message::Force(force)) => Some((usize::from(number - Force::LAYOUT.number), force)),
            _ => None,
        }
    });
    Reported { ticks: ticks.collect(), forces: forces.collect() }
}
