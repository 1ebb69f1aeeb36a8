//! Services of the board over the CAN bus.

use firmware::clock::Clock;
use firmware::config::limits::DetectionLimits;
use firmware::fixed_point::Force;
use firmware::grip::states::PowerState;
use firmware::parameters::schema::{PARAMETERS, id};
use firmware::parameters::{Parameters, op as parameter, status as parameters};
use firmware::protocol::messages::{Message, ParamRequest, Service};
use firmware::protocol::serial::{Packet, PacketDecoder, Tick};
use firmware::protocol::session::{op, status};
use firmware::system::faults::{Fault, FaultSet};
use firmware::tasks::{FIRST_TICK_US, FaultReporter};
use model_export::inverse::build::{ModelVariant, build};
use sim::board::host::CanHost;
use sim::board::world::PressedWorld;
use sim::board::{Program, VirtualTimeBoard};

use crate::workdir::fitted_model;

/// A board with a constant load of 20 N on its first sensor.
pub fn board() -> VirtualTimeBoard {
    let built = build(&fitted_model("clean"), ModelVariant::Fitted).unwrap();
    let world = PressedWorld::new(&built.model, 1, |_| [[0.0, 20.0], [0.0; 2], [0.0; 2], [0.0; 2]]);
    let program = Program {
        tables: built.chosen.tables,
        compensations: built.compensations,
        networks: None,
        description: "",
        parameters: Parameters::DEFAULT,
        limits: DetectionLimits::GRIPPER,
    };
    VirtualTimeBoard::start(program, Box::new(world))
}

pub fn run_to(board: &mut VirtualTimeBoard, host: &mut CanHost, ms: u64) {
    let from_ms = board.clock.now_us().saturating_sub(FIRST_TICK_US) / 1000;
    for ms in from_ms..ms {
        board.run_until(FIRST_TICK_US + 1000 * (ms + 1));
        host.tick();
    }
}

/// Status of each reply to this operation since the last call.
pub fn statuses(host: &mut CanHost, op: u8) -> Vec<u8> {
    let replies = std::mem::take(&mut host.received.replies);
    replies.iter().filter(|(_, reply)| reply.op == op).map(|(_, reply)| reply.status).collect()
}

/// Mean Fz of the first sensor since the last call, in newtons.
fn fz_n(board: &VirtualTimeBoard) -> f64 {
    let mut receiver = PacketDecoder::default();
    let bytes = std::mem::take(&mut board.connections.line.borrow_mut().sent);
    let packets = bytes.iter().filter_map(|byte| receiver.push(*byte));
    let ticks: Vec<Tick> = packets
        .filter_map(|packet| match packet {
            Packet::Tick(tick) => Some(tick),
            Packet::Message { .. } => None,
        })
        .collect();
    let sum: i64 = ticks.iter().map(|tick| i64::from(tick.sensors[0].force[1])).sum();
    sum as f64 / ticks.len() as f64 / Force::PER_NEWTON
}

#[test]
fn tare_removes_a_constant_load_and_is_saved() {
    let mut board = board();
    let mut host = CanHost::new(board.connections.can.clone());
    run_to(&mut board, &mut host, 200);
    assert!((fz_n(&board) - 20.0).abs() < 1.0);
    host.service(op::TARE, 0);
    run_to(&mut board, &mut host, 500);
    assert_eq!(statuses(&mut host, op::TARE), [status::DONE]);
    fz_n(&board);
    run_to(&mut board, &mut host, 1000);
    assert!(fz_n(&board).abs() < 0.3);
    let read = ParamRequest { op: parameter::READ, id: id::TARE + 1, ..ParamRequest::default() };
    host.request_parameter(read);
    host.service(op::SAVE, 0);
    run_to(&mut board, &mut host, 1020);
    let (_, tare) = host.received.parameters[0];
    assert_eq!(tare.status, parameters::DONE);
    assert!((f64::from(tare.value as i32) / Force::PER_NEWTON - 20.0).abs() < 1.0);
    assert_eq!(statuses(&mut host, op::SAVE), [status::DONE]);
}

#[test]
fn unsound_tables_end_the_session_and_prevent_arming() {
    let mut board = board();
    let mut host = CanHost::new(board.connections.can.clone());
    run_to(&mut board, &mut host, 100);
    host.arm();
    run_to(&mut board, &mut host, 120);
    assert_eq!(statuses(&mut host, op::ARM), [status::CHALLENGE, status::DONE]);
    // Saving is refused while armed.
    host.service(op::SAVE, 0);
    run_to(&mut board, &mut host, 130);
    assert_eq!(statuses(&mut host, op::SAVE), [status::ARMED]);
    let unsound = (Fault::TablesUnsound, 0);
    let mut faults = FaultSet::default();
    board.exchange.update_fault(FaultReporter::Scrub, &mut faults, unsound, true, 0);
    run_to(&mut board, &mut host, 140);
    host.arm();
    run_to(&mut board, &mut host, 150);
    assert_eq!(statuses(&mut host, op::ARM), [status::FAULTY]);
    host.service(op::SAVE, 0);
    run_to(&mut board, &mut host, 170);
    assert_eq!(statuses(&mut host, op::SAVE), [status::DONE]);
}

/// One frame without a session neither moves the motor nor changes anything.
#[test]
fn requests_without_a_session_change_nothing() {
    let mut board = board();
    let mut host = CanHost::new(board.connections.can.clone());
    run_to(&mut board, &mut host, 100);
    let before = board.exchange.parameters();
    // The host would open a session by these.
    for op in (0..=255).filter(|op| ![op::ARM, op::OPEN].contains(op)) {
        host.send(Message::Service(Service { op, argument: u32::from(op % 2) }));
        run_to(&mut board, &mut host, 101 + u64::from(op));
    }
    for (ms, row) in (360..).zip(PARAMETERS.iter()) {
        run_to(&mut board, &mut host, ms);
        let value = row.default as u32 ^ 1;
        let request = ParamRequest { op: parameter::WRITE, id: row.id, status: 0, value };
        host.send(Message::ParamRequest(request));
    }
    run_to(&mut board, &mut host, 400);
    assert_eq!(board.exchange.parameters(), before);
    let replies = &host.received.replies;
    let accepted = replies.iter().filter(|(_, reply)| reply.status == status::DONE);
    assert_eq!(accepted.count(), 0, "{replies:?}");
    assert_eq!(replies.len(), 253);
    assert_eq!(board.exchange.grip_summary.get().state, PowerState::Safe as u8);
    let refused = host.received.parameters.iter();
    assert_eq!(refused.clone().count(), PARAMETERS.len());
    assert!(refused.clone().all(|(_, reply)| reply.status == parameters::UNAUTHENTICATED));
}
