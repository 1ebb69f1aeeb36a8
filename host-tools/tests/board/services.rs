//! Services of the board over the CAN bus.

use embedded_can::Frame;
use firmware::config::limits::DetectionLimits;
use firmware::fixed_point::Force;
use firmware::parameters::schema::id;
use firmware::parameters::{Parameters, op as parameter, status as parameters};
use firmware::protocol::can::CanFrame;
use firmware::protocol::messages::{Message, ParamReply, ParamRequest, Service, ServiceReply};
use firmware::protocol::serial::{Packet, PacketDecoder, Tick};
use firmware::protocol::session::{SERVICE_MAGIC, op, status};
use firmware::protocol::{DEFAULT_NODE, frame_id};
use firmware::system::faults::{Fault, FaultSet};
use firmware::tasks::{FIRST_TICK_US, FaultReporter};
use model_export::inverse::build::{ModelVariant, build};
use sim::board::world::PressedWorld;
use sim::board::{Program, VirtualTimeBoard};

use crate::workdir::fitted_model;

/// A board with a constant load of 20 N on its first sensor.
fn board() -> VirtualTimeBoard {
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

fn run_to(board: &mut VirtualTimeBoard, ms: u64) {
    board.run_until(FIRST_TICK_US + 1000 * ms);
}

fn send(board: &VirtualTimeBoard, message: &Message) {
    let id = frame_id(DEFAULT_NODE, message.layout().number);
    let frame = CanFrame::from_bytes(id, message.to_bytes());
    board.connections.can.borrow_mut().put(frame);
}

fn service(op: u8, nonce: u16) -> Message {
    Message::Service(Service { op, magic: SERVICE_MAGIC, nonce, argument: 0 })
}

/// Messages of the board since the last call.
fn messages(board: &VirtualTimeBoard) -> Vec<Message> {
    let frames = std::mem::take(&mut board.connections.can.borrow_mut().board_frames);
    let messages = frames.iter().map(|(_, frame)| {
        let number = (frame.identifier() & 0x1F) as u8;
        Message::from_frame(number, frame.data()).unwrap()
    });
    messages.collect()
}

fn replies(board: &VirtualTimeBoard) -> Vec<ServiceReply> {
    let reply = |message| match message {
        Message::ServiceReply(reply) => Some(reply),
        _ => None,
    };
    messages(board).into_iter().filter_map(reply).collect()
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
    run_to(&mut board, 200);
    assert!((fz_n(&board) - 20.0).abs() < 1.0);
    send(&board, &service(op::TARE, 0));
    run_to(&mut board, 500);
    let [reply] = replies(&board)[..] else {
        panic!("one reply");
    };
    assert_eq!((reply.op, reply.status), (op::TARE, status::DONE));
    fz_n(&board);
    run_to(&mut board, 1000);
    assert!(fz_n(&board).abs() < 0.3);
    let read = ParamRequest { op: parameter::READ, id: id::TARE + 1, ..ParamRequest::default() };
    send(&board, &Message::ParamRequest(read));
    send(&board, &service(op::SAVE, 0));
    run_to(&mut board, 1010);
    let messages = messages(&board);
    let tare = messages.iter().find_map(|message| match message {
        Message::ParamReply(ParamReply { value, status, .. }) if *status == parameters::DONE => {
            Some(f64::from(*value as i32) / Force::PER_NEWTON)
        }
        _ => None,
    });
    assert!((tare.unwrap() - 20.0).abs() < 1.0);
    let saved = |message: &&Message| {
        matches!(message, Message::ServiceReply(reply)
            if reply.op == op::SAVE && reply.status == status::DONE)
    };
    assert!(messages.iter().find(saved).is_some());
}

#[test]
fn unsound_tables_end_the_session_and_prevent_arming() {
    let mut board = board();
    let arm = |board: &mut VirtualTimeBoard, ms| {
        send(board, &service(op::ARM, 0));
        run_to(board, ms);
        let offer = replies(board)[0];
        if offer.status == status::CHALLENGE {
            send(board, &service(op::ARM, offer.nonce));
            run_to(board, ms + 10);
            return replies(board)[0].status;
        }
        offer.status
    };
    run_to(&mut board, 100);
    assert_eq!(arm(&mut board, 110), status::DONE);
    // Saving is refused while armed.
    send(&board, &service(op::SAVE, 0));
    run_to(&mut board, 130);
    assert_eq!(replies(&board)[0].status, status::ARMED);
    let unsound = (Fault::TablesUnsound, 0);
    let mut faults = FaultSet::default();
    board.exchange.update_fault(FaultReporter::Scrub, &mut faults, unsound, true, 0);
    assert_eq!(arm(&mut board, 150), status::FAULTY);
    send(&board, &service(op::SAVE, 0));
    run_to(&mut board, 170);
    assert_eq!(replies(&board)[0].status, status::DONE);
}
